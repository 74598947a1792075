//! `Fragment`: an open fragment, whose record was checked; its chunks and voxel runs are checked as they are read.

use super::{CHUNK_BYTES_MOST, ChunkBytesReader, FragmentHead};
use crate::budget::{Budget, Lease};
use crate::build::clusters::pages::ChunkPages;
use crate::build::journal::record;
use crate::build::partition::cell_table::ShardShare;
use crate::build::shard_file::{HEAD_BYTES, PlannedModel, ShardFile, ShardFileKind, blobs};
use crate::error::Result;
use crate::octree::{VoxelRunTable, VoxelRuns};
use crate::scratch::{SEAL_BYTES, ScratchFile};
use std::path::{Path, PathBuf};

/// Memory of a chunk while it is taken apart, over its bytes: these, what they are read to, the page under way.
const PARSING: u64 = 3;

/// A fragment that can be read.
pub(crate) struct Fragment {
    pub(crate) path: PathBuf,
    pub(crate) plan_id: u64,
    pub(crate) share: ShardShare,
    pub(crate) triangle_count: u64,
    pub(crate) bytes: u64,
    /// Bytes of each chunk, seal included.
    chunk_bytes: Vec<u32>,
    /// Where the voxel runs are, of a model with an octree.
    runs: Option<VoxelRunTable>,
    _lease: Lease,
}

impl Fragment {
    /// Opens a fragment, and reads all that it says of itself, and of the model, which is the same in all of a plan.
    ///
    /// # Errors
    /// [`Code::InputFormat`](crate::Code::InputFormat), [`Code::Version`](crate::Code::Version) or
    /// [`Code::Damaged`](crate::Code::Damaged) for what is no whole fragment of this version;
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit); those of reading.
    pub(crate) fn open(path: &Path, budget: &Budget) -> Result<(Fragment, PlannedModel)> {
        let file = ShardFile::open(ShardFileKind::Fragment, path)?;
        let (bytes, not_whole) = (file.bytes, || file.not_whole());
        let place = file.record_before(bytes)?;
        let (record_at, record_bytes) = (place.start, place.end - place.start);
        let mut lease =
            budget.lease("the tables of a fragment", record_bytes.saturating_mul(record::READING))?;
        let (_, record) = file.record::<FragmentHead>(place)?;
        let (head, [section, chunk_bytes, words]) = blobs(record).ok_or_else(not_whole)?;
        let share = head.share().ok_or_else(not_whole)?;
        let FragmentHead { plan_id, triangle_count, voxels_at, .. } = head;
        let model = PlannedModel::parse(head.model, &section, budget)?.ok_or_else(not_whole)?;
        let chunk_bytes = bytemuck::allocation::pod_collect_to_vec::<u8, u32>(&chunk_bytes);
        let is_chunk = |&bytes: &u32| (SEAL_BYTES as u64..=CHUNK_BYTES_MOST).contains(&u64::from(bytes));
        let chunks_end = HEAD_BYTES as u64 + chunk_bytes.iter().map(|&bytes| u64::from(bytes)).sum::<u64>();
        let runs = match model.summary.octree {
            None => None,
            Some(_) => {
                let words = bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words);
                let table = VoxelRunTable::parse(&words).ok_or_else(not_whole)?;
                Some(table).filter(|table| table.is_of(chunk_bytes.len()))
            }
        };
        let run_bytes = runs.as_ref().map_or(0, VoxelRunTable::bytes);
        let is_sound = chunk_bytes.iter().all(is_chunk)
            && chunks_end == voxels_at
            && voxels_at.checked_add(run_bytes) == Some(record_at)
            && runs.is_some() == model.summary.octree.is_some()
            && triangle_count <= model.summary.triangle_count;
        if !is_sound {
            return Err(not_whole());
        }
        let runs = runs.map(|table| table.behind(voxels_at));
        lease.shrink_to(record_bytes.saturating_sub(section.len() as u64));
        let path = path.to_path_buf();
        let fragment =
            Fragment { path, plan_id, share, triangle_count, bytes, chunk_bytes, runs, _lease: lease };
        Ok((fragment, model))
    }

    /// Count of its chunks.
    pub(crate) fn chunk_count(&self) -> usize {
        self.chunk_bytes.len()
    }

    /// Hands all chunks to `put`, in order.
    pub(crate) fn for_each_chunk(
        &self,
        reader: ChunkBytesReader<'_>,
        budget: &Budget,
        mut put: impl FnMut(ChunkPages) -> Result<()>,
    ) -> Result<()> {
        let file = ScratchFile::of_fragment(self.path.clone())?;
        let longest = self.chunk_bytes.iter().max().copied().unwrap_or(0);
        let _lease = budget.lease("a chunk of a fragment", PARSING * u64::from(longest))?;
        let (mut offset, mut buffer, mut triangle_count) = (HEAD_BYTES as u64, Vec::new(), 0);
        for &bytes in &self.chunk_bytes {
            let content = file.read(offset, bytes as usize, offset, &mut buffer)?;
            let (pages, its_count) = reader.read(content).ok_or_else(|| file.damaged(offset))?;
            triangle_count += its_count;
            if triangle_count > self.triangle_count {
                return Err(file.damaged(offset));
            }
            put(pages)?;
            offset += u64::from(bytes);
        }
        if triangle_count == self.triangle_count { Ok(()) } else { Err(file.damaged(offset)) }
    }

    /// Count of its voxel runs.
    pub(crate) fn run_count(&self) -> u64 {
        self.runs.as_ref().map_or(0, VoxelRunTable::run_count)
    }

    /// Its voxel runs, of a model with an octree.
    pub(crate) fn take_runs(&mut self) -> Result<VoxelRuns> {
        let no_runs =
            || ShardFileKind::Fragment.damaged(&self.path, "no voxel runs of a model with an octree");
        let table = self.runs.take().ok_or_else(no_runs)?;
        VoxelRuns::of_fragment(self.path.clone(), table)
    }
}
