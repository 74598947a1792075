//! A fragment: what one shard makes of its chunks, up to where chunks of other shards have a say.
//!
//! ```text
//! head | chunk ... | voxel runs | record: share, model, counts | materials | lengths of chunks | runs (`shard_file`)
//! chunk = seal (`crate::scratch`), and `chunk_bytes`
//! ```
//!
//! Pages stand in it as they will stand in the file, but for those that chunks share: which ends share one follows from
//! all chunks before, so each chunk's end waits for the merge. Voxel records are not summed, since sums of f32 depend
//! on their order.
//!
//! Invariants: 1. every byte is under a hash, and follows from plan and share alone; 2. no byte that was read is
//! believed: lengths, counts and references are compared with their bounds before they are used.

mod chunk_bytes;
pub(super) mod fragment_reader;
pub(super) mod fragment_writer;

pub(crate) use chunk_bytes::ChunkBytesReader;

use crate::build::partition::cell_table::ShardShare;
use crate::build::shard_file::StoredModel;
use serde::{Deserialize, Serialize};

/// Longest chunk: 2^17 triangles in pages, at most 53 bytes each where no corner is shared, and an emitter of each,
/// of 80 bytes; twice that.
pub(crate) const CHUNK_BYTES_MOST: u64 = 32 << 20;
/// Most shards of a build: all fragments are open while voxels are merged.
pub const SHARDS: u32 = 512;

/// What stands before the blobs of the record.
#[derive(Serialize, Deserialize)]
struct FragmentHead {
    /// Of the plan.
    plan_id: u64,
    share: [u32; 2],
    triangle_count: u64,
    /// Where the voxel runs begin.
    voxels_at: u64,
    model: StoredModel,
}

impl FragmentHead {
    fn share(&self) -> Option<ShardShare> {
        let [index, count] = self.share;
        (index < count && count <= SHARDS).then_some(ShardShare { index, count })
    }
}
