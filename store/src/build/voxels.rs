//! Which voxel octree a model gets, and how the records of its chunks become a section of the file.
//!
//! Invariants: 1. the choice depends on the input and the options alone, never on the memory limit; 2. memory of the
//! merge is leased, and does not grow with the leaves but for their nodes' masks; 3. the section is written and hashed piece by piece.

use super::Voxels;
use super::partition::Partition;
use super::publish::DraftFile;
use crate::budget::Budget;
use crate::error::Result;
use crate::layout::{Section, SectionKind, section_hasher};
use crate::octree::{RUN_BYTES, STREAM_BYTES, UpperBuilder, VoxelGrid, VoxelRuns, leaf_bytes, merge};
use std::path::{Path, PathBuf};

/// Leaves per square of surface of a leaf's side: a plane of any direction meets 1 to 1.7 voxels per square, a rough one
/// fewer of its own area.
const LEAVES_PER_SQUARE: f64 = 1.5;
/// Bytes of a leaf on disk, bytes of a triangle there: measured, rounded.
const DISK_BYTES_PER_LEAF: f64 = 10.0;
const DISK_BYTES_PER_TRIANGLE: f64 = 2.5;

/// Records between two reports; their masks are what is counted as memory afterwards.
const TELL_RECORDS: u64 = 1 << 16;

/// Voxel records on their way.
pub(super) struct VoxelWork {
    pub(super) grid: VoxelGrid,
    pub(super) runs: VoxelRuns,
    /// Where scratch files go.
    folder: PathBuf,
}

/// The octree that the options ask for, and a scratch file for its records; `None` for none.
pub(super) fn begin(parted: &Partition, voxels: Voxels, folder: &Path) -> Result<Option<VoxelWork>> {
    let [lo, hi] = parted.lattice_bounds;
    let resolution = match voxels {
        Voxels::None => return Ok(None),
        Voxels::Resolution(resolution) => resolution,
        Voxels::Within { upper_bytes } => choose(parted, upper_bytes),
    };
    Ok(Some(VoxelWork {
        grid: VoxelGrid::over(lo, hi, resolution),
        runs: VoxelRuns::create(folder)?,
        folder: folder.to_path_buf(),
    }))
}

/// The finest octree that takes less than the mesh on disk and less than `upper_bytes` in memory. The coarser ones are
/// for what is small: 256 as long as it is allowed, since a picture needs that much whatever the model has.
fn choose(parted: &Partition, upper_bytes: u64) -> u32 {
    let [lo, hi] = parted.lattice_bounds;
    let mesh_bytes = DISK_BYTES_PER_TRIANGLE * parted.triangle_count as f64;
    let leaves = |resolution: u32| {
        let leaf = VoxelGrid::over(lo, hi, resolution).leaf_steps() as f64;
        LEAVES_PER_SQUARE * parted.area / (leaf * leaf)
    };
    let resident = |resolution| leaves(resolution) * leaf_bytes() as f64;
    let fits = |resolution: &u32| {
        resident(*resolution) <= upper_bytes as f64 && leaves(*resolution) * DISK_BYTES_PER_LEAF <= mesh_bytes
    };
    match [1024, 512].into_iter().find(fits) {
        Some(resolution) => resolution,
        None if resident(256) <= upper_bytes as f64 => 256,
        None => 64,
    }
}

impl VoxelWork {
    /// Merges the records, writes the octree to the end of `file`. The section, and bytes of scratch.
    pub(super) fn finish(
        self,
        file: &mut DraftFile<'_>,
        file_id: u64,
        budget: &Budget,
        tell: &dyn Fn(u64),
    ) -> Result<(Section, u64)> {
        let (scratch_bytes, run_count, _) = self.runs.size();
        let what = "the merge of voxels";
        let mut lease = budget.lease(what, run_count * RUN_BYTES + STREAM_BYTES)?;
        let mut builder = UpperBuilder::new(self.grid, &self.folder)?;
        let (mut done, mut masks_bytes) = (0u64, 0);
        merge(self.runs, |record| {
            builder.push(record)?;
            done += 1;
            if done.is_multiple_of(TELL_RECORDS) {
                tell(done);
                // Twice: once more when they are written.
                lease.grow(what, 2 * (builder.masks_bytes() - masks_bytes))?;
                masks_bytes = builder.masks_bytes();
            }
            Ok(())
        })?;
        let (kind, mut hasher) =
            (SectionKind::Upper as u32, section_hasher(file_id, SectionKind::Upper as u32));
        let offset = file.bytes();
        let count = builder.finish(&mut |piece| {
            hasher.update(piece);
            file.append(piece).map(drop)
        })?;
        let bytes = file.bytes() - offset;
        Ok((Section { kind, count, offset, bytes, hash: hasher.digest() }, scratch_bytes))
    }
}
