//! `OctreeBuffers`: the octree in video memory, as it lies in the processor's but for what is known of its leaves.
//!
//! ```text
//! nodes    mask, mask, first child                          a node
//! bitmaps  bitmap, bitmap                                   a leaf
//! payload  normal | material << 16                          a leaf, then
//!          first facet, which of the six facets, unit word  a last node
//! ```
//!
//! Invariants: 1. sizes are computed in 64 bits, and compared with what the device binds before anything is taken; 2.
//! while it is sent, no more than a block is copied at a time.

use crate::device::{GpuDevice, VideoLease, count};
use crate::words::Params;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;
use trex_render::Voxels;
use trex_store::Result;

/// Bytes that are sent at a time.
const BLOCK_BYTES: usize = 4 << 20;
/// Longest wait for a block.
const BLOCK_WAIT: Duration = Duration::from_secs(10);
/// Words of a last node in the payload.
const LAST_NODE_WORDS: usize = 3;
/// Cubes that a ray visits at most, for each unit of the resolution: one along each axis.
const CUBES_PER_CELL: u32 = 3;

/// The buffers of an octree.
#[derive(Debug)]
pub(crate) struct OctreeBuffers {
    pub(crate) nodes: wgpu::Buffer,
    pub(crate) bitmaps: wgpu::Buffer,
    pub(crate) payload: wgpu::Buffer,
    /// The octree itself.
    pub(crate) voxels: Arc<Voxels>,
    _lease: VideoLease,
}

impl OctreeBuffers {
    /// Sends the octree to the device.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] where the limit or the device has no room for it.
    pub(crate) fn new(device: &GpuDevice, voxels: &Arc<Voxels>) -> Result<OctreeBuffers> {
        let octree = voxels.octree();
        let nodes: &[u32] = bytemuck::cast_slice(octree.nodes());
        let bitmaps: &[u32] = bytemuck::cast_slice(octree.bitmaps());
        let (leaves, last_nodes) = (octree.leaf_count(), octree.last_nodes().len());
        let payload_words = leaves as u64 + (LAST_NODE_WORDS * last_nodes) as u64;
        let bytes = 4 * (nodes.len() as u64 + bitmaps.len() as u64 + payload_words);
        let lease = device.lease("the octree", bytes)?;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let buffer = |what, words: u64| device.buffer(what, 4 * words, usage);
        let buffers = OctreeBuffers {
            nodes: buffer("nodes", nodes.len() as u64)?,
            bitmaps: buffer("bitmaps", bitmaps.len() as u64)?,
            payload: buffer("payload", payload_words)?,
            voxels: voxels.clone(),
            _lease: lease,
        };
        send(device, &buffers.nodes, 0, nodes.iter().copied());
        send(device, &buffers.bitmaps, 0, bitmaps.iter().copied());
        send(device, &buffers.payload, 0, (0..leaves).map(|leaf| octree.leaf_word(leaf)));
        let last_node_words = (0..last_nodes).flat_map(|node| {
            let [first, mask] = octree.facets().words(node);
            [first, mask, voxels.links().map_or(u32::MAX, |links| links.words()[node])]
        });
        send(device, &buffers.payload, leaves as u64, last_node_words);
        Ok(buffers)
    }

    /// Levels of leaves below the upper ones.
    pub(crate) fn finer(&self) -> u32 {
        self.voxels.links().map_or(0, |links| links.refinement().levels() as u32)
    }

    /// Parameters of batches without units; `ray_count` and `shadow_count` are still to be set.
    pub(crate) fn params(&self) -> Params {
        let octree = self.voxels.octree();
        let depth = octree.grid().depth() as u32;
        Params {
            depth,
            first_last: (octree.nodes().len() - octree.last_nodes().len()) as u32,
            last_nodes_at: octree.leaf_count() as u32,
            steps_max: CUBES_PER_CELL << (2 * (depth + self.finer() + 1)),
            ..Params::default()
        }
    }
}

/// Writes words to a buffer from word `at` on, block by block.
pub(crate) fn send(device: &GpuDevice, to: &wgpu::Buffer, at: u64, words: impl Iterator<Item = u32>) {
    let mut block: Vec<u32> = Vec::with_capacity(BLOCK_BYTES / 4);
    let mut at = 4 * at;
    let mut flush = |block: &mut Vec<u32>| {
        if block.is_empty() || device.lost().is_some() {
            return block.clear();
        }
        let bytes: &[u8] = bytemuck::cast_slice(block);
        device.queue.write_buffer(to, at, bytes);
        at += bytes.len() as u64;
        count(&device.counters.uploaded_bytes, bytes.len() as u64);
        block.clear();
        device.queue.submit([]);
        let (is_sent, sent) = channel();
        device.queue.on_submitted_work_done(move || {
            let _ = is_sent.send(());
        });
        match device.poll_until(BLOCK_WAIT, || sent.try_recv().is_ok()) {
            Ok(true) => {}
            Ok(false) => device.give_up("a block of the octree did not arrive in time"),
            Err(error) => device.give_up(&error.to_string()),
        }
    };
    for word in words {
        block.push(word);
        if block.len() == BLOCK_BYTES / 4 {
            flush(&mut block);
        }
    }
    flush(&mut block);
}
