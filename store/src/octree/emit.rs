//! Records in key order to the stored octree, without holding it: its streams go to scratch files, block by block.
//!
//! ```text
//! record -> leaf -> bitmap, normal, area, material -> their streams' blocks -> scratch files -> the section
//!                -> masks of its nodes, which stay in memory: about a byte a leaf
//! ```
//!
//! Invariants: 1. memory is a block for each stream, the length of each of its blocks, and the masks; 2. a block in a
//! scratch file is named by its offset.

use super::coarsen::OpenLeaf;
use super::payload::{LeafNormal, pack_area};
use super::record::Record;
use super::stored::{BLOCK_BYTES, head, packed_planes};
use super::{KEY_BITS, MAX_DEPTH, VoxelGrid};
use crate::error::Result;
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use std::path::Path;

/// Bytes of memory that the blocks of all streams take, with what packing takes.
pub(crate) const STREAM_BYTES: u64 = 16 * BLOCK_BYTES as u64;

/// Makes the stored form of records in key order.
pub(crate) struct UpperBuilder {
    grid: VoxelGrid,
    /// Masks per level, the root's first, and the key of the last node of each.
    masks: [Vec<u64>; MAX_DEPTH],
    last: [Option<u64>; MAX_DEPTH],
    bitmaps: Stream,
    normals: Stream,
    areas: Stream,
    materials: Stream,
    leaf_count: u32,
    facet_count: u32,
    /// Facets of the last node, as bits.
    facets: u8,
    open: OpenLeaf,
}

impl UpperBuilder {
    /// An empty octree; scratch files go to `folder`.
    pub(crate) fn new(grid: VoxelGrid, folder: &Path) -> Result<UpperBuilder> {
        Ok(UpperBuilder {
            grid,
            masks: Default::default(),
            last: [None; MAX_DEPTH],
            bitmaps: Stream::new(8, folder)?,
            normals: Stream::new(2, folder)?,
            areas: Stream::new(1, folder)?,
            materials: Stream::new(2, folder)?,
            leaf_count: 0,
            facet_count: 0,
            facets: 0,
            open: OpenLeaf::default(),
        })
    }

    /// Adds what one material brings to a leaf; keys never go back.
    pub(crate) fn push(&mut self, record: Record) -> Result<()> {
        self.open.push(record).map_or(Ok(()), |leaf| self.add(leaf))
    }

    fn add(&mut self, leaf: Record) -> Result<()> {
        let depth = self.grid.depth();
        for level in 0..depth {
            let child = leaf.key() >> (KEY_BITS as usize * (depth - 1 - level));
            let node = child >> KEY_BITS;
            if self.last[level] != Some(node) {
                self.last[level] = Some(node);
                self.masks[level].push(0);
                if level + 1 == depth {
                    self.facets = 0;
                }
            }
            *self.masks[level].last_mut().expect("just pushed") |= 1 << (child & 63);
        }
        let surface = leaf.surface();
        let normal = LeafNormal::pack(surface.normal, surface.flatness);
        let facet = 1 << normal.facet();
        self.facet_count += u32::from(self.facets & facet == 0);
        self.facets |= facet;
        self.leaf_count += 1;
        self.bitmaps.push(leaf.bitmap)?;
        self.normals.push(u64::from(normal.0))?;
        self.areas.push(u64::from(pack_area(surface.side_area)))?;
        self.materials.push(u64::from(leaf.material()))
    }

    /// Leaves up to now, the last one not counted.
    pub(crate) fn leaf_count(&self) -> u32 {
        self.leaf_count
    }

    /// Bytes of memory that the masks take.
    pub(crate) fn masks_bytes(&self) -> u64 {
        self.masks.iter().map(|masks| 8 * masks.capacity() as u64).sum()
    }

    /// Gives the bytes of the section, piece by piece, and the count of leaves. Panics when there was no record.
    pub(crate) fn finish(mut self, put: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<u32> {
        self.open.close().map_or(Ok(()), |leaf| self.add(leaf))?;
        assert!(self.leaf_count > 0, "an octree has a leaf");
        let node_count = self.masks.iter().map(Vec::len).sum();
        put(&head(&self.grid, self.leaf_count, self.facet_count, node_count))?;
        let all: Vec<u64> = self.masks.concat();
        for masks in all.chunks(BLOCK_BYTES / 8) {
            put(&packed_planes(masks, 8))?;
        }
        for stream in [self.bitmaps, self.normals, self.areas, self.materials] {
            stream.finish(put)?;
        }
        Ok(self.leaf_count)
    }
}

/// Words of so many bytes on their way to a scratch file.
struct Stream {
    bytes: usize,
    block: Vec<u64>,
    scratch: ScratchFile,
    /// Bytes of each block in it.
    written: Vec<u32>,
    scratch_bytes: u64,
}

impl Stream {
    fn new(bytes: usize, folder: &Path) -> Result<Stream> {
        let scratch = ScratchFile::create(folder)?;
        Ok(Stream { bytes, block: Vec::new(), scratch, written: Vec::new(), scratch_bytes: 0 })
    }

    fn push(&mut self, word: u64) -> Result<()> {
        self.block.push(word);
        if self.block.len() == BLOCK_BYTES / self.bytes { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        if self.block.is_empty() {
            return Ok(());
        }
        let mut sealed = vec![0; SEAL_BYTES];
        sealed.extend(packed_planes(&self.block, self.bytes));
        self.block.clear();
        seal(&mut sealed, self.scratch_bytes);
        self.scratch.write(&sealed, self.scratch_bytes)?;
        self.written.push(sealed.len() as u32);
        self.scratch_bytes += sealed.len() as u64;
        Ok(())
    }

    fn finish(mut self, put: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
        self.flush()?;
        let (mut offset, mut buffer) = (0, Vec::new());
        for bytes in self.written {
            put(self.scratch.read(offset, bytes as usize, offset, &mut buffer)?)?;
            offset += u64::from(bytes);
        }
        Ok(())
    }
}
