//! `FragmentWriter`: puts chunks into a fragment as they come, then the voxel runs, then the record of both.

use super::chunk_bytes::write_chunk;
use super::{CHUNK_BYTES_MOST, FragmentHead};
use crate::budget::{Budget, Lease};
use crate::build::clusters::pages::ChunkPages;
use crate::build::draft::DraftFile;
use crate::build::emit::writer::make_room;
use crate::build::partition::cell_table::ShardShare;
use crate::build::shard_file::{PlannedModel, ShardFileKind, append_record};
use crate::error::Result;
use crate::octree::VoxelRuns;
use crate::scratch::{SEAL_BYTES, seal};

/// What the lists are called in messages.
const TABLES: &str = "the tables of the fragment";

/// Writes a fragment.
pub(crate) struct FragmentWriter<'a> {
    file: DraftFile<'a>,
    /// Bytes of each chunk, seal included.
    chunk_bytes: Vec<u32>,
    buffer: Vec<u8>,
    lease: Lease,
}

/// Whose fragment it is.
pub(crate) struct FragmentIdentity<'a> {
    pub(crate) plan_id: u64,
    pub(crate) share: ShardShare,
    pub(crate) model: &'a PlannedModel,
}

impl<'a> FragmentWriter<'a> {
    /// Begins a fragment.
    pub(crate) fn new(mut file: DraftFile<'a>, budget: &Budget) -> Result<FragmentWriter<'a>> {
        file.append(&ShardFileKind::Fragment.head())?;
        Ok(FragmentWriter {
            file,
            chunk_bytes: Vec::new(),
            buffer: Vec::new(),
            lease: budget.lease(TABLES, 0)?,
        })
    }

    /// Appends the next chunk.
    pub(crate) fn add_chunk(&mut self, chunk: &ChunkPages) -> Result<()> {
        make_room(&mut self.chunk_bytes, 1, &mut self.lease)?;
        self.buffer.clear();
        self.buffer.resize(SEAL_BYTES, 0);
        write_chunk(chunk, &mut self.buffer);
        assert!(self.buffer.len() as u64 <= CHUNK_BYTES_MOST, "a chunk of {} bytes", self.buffer.len());
        seal(&mut self.buffer, self.file.bytes());
        self.chunk_bytes.push(self.buffer.len() as u32);
        self.file.append(&self.buffer).map(drop)
    }

    /// Appends voxel runs and the record; gives the bytes of the fragment.
    pub(crate) fn finish(
        mut self,
        identity: &FragmentIdentity<'_>,
        triangle_count: u64,
        voxels: Option<&VoxelRuns>,
        budget: &Budget,
    ) -> Result<u64> {
        let FragmentIdentity { plan_id, share, model } = *identity;
        let voxels_at = self.file.bytes();
        let word_bytes = voxels.map_or(0, VoxelRuns::word_bytes);
        let mut lease = budget.lease(TABLES, 2 * word_bytes)?;
        let words = match voxels {
            None => Vec::new(),
            Some(runs) => runs.copy_in_order(|piece| self.file.append(piece).map(drop))?,
        };
        let (materials, _materials_lease) = model.materials.to_bytes(budget)?;
        lease.grow(TABLES, materials.len() as u64 + 4 * self.chunk_bytes.len() as u64)?;
        let share = [share.index, share.count];
        let head = FragmentHead { plan_id, share, triangle_count, voxels_at, model: model.stored() };
        let blobs: [&[u8]; 3] =
            [&materials, bytemuck::cast_slice(&self.chunk_bytes), bytemuck::cast_slice(&words)];
        append_record(&mut self.file, &head, &blobs)?;
        Ok(self.file.bytes())
    }
}
