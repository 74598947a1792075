//! How the voxel records of the chunks become pages and sections of the file.
//!
//! Invariants: 1. memory of the merge is leased, and does not grow with the leaves but for their nodes' masks and
//! places; 2. sections are written and hashed piece by piece.

use crate::budget::{Budget, Lease};
use crate::build::draft::DraftFile;
use crate::build::partition::summary::PartitionSummary;
use crate::error::Result;
use crate::layout::{Section, SectionKind, section_hasher};
use crate::octree::{
    FamilyOutcome, FirstPage, LowerBuilder, RUN_BYTES, RecordBounds, Refinement, RunsSize, STREAM_BYTES,
    VoxelGrid, VoxelRuns, family_bytes, merge,
};
use crate::scratch::Place;
use std::path::Path;

/// Records between two reports; their masks are what is counted as memory afterwards.
const TELL_RECORDS: u64 = 1 << 16;

/// The octree that a model gets.
#[derive(Clone, Copy)]
pub(crate) struct OctreeShape {
    /// The upper leaves.
    pub(crate) grid: VoxelGrid,
    pub(crate) refinement: Refinement,
}

/// Voxel records on their way.
pub(crate) struct VoxelWork {
    pub(crate) shape: OctreeShape,
    pub(crate) runs: VoxelRuns,
}

/// Records that wait for their merge.
pub(crate) struct VoxelMerge<'a> {
    pub(crate) shape: OctreeShape,
    /// Those of the first chunks, those of the next ones, ..: all of them.
    pub(crate) runs: Vec<VoxelRuns>,
    /// Where scratch files go.
    pub(crate) folder: &'a Path,
}

/// Merged records whose pages are written, and what is left to be written.
pub(crate) struct MergeOutcome {
    finished: FamilyOutcome,
    /// Bytes of scratch.
    pub(crate) scratch_bytes: u64,
    _lease: Lease,
}

impl OctreeShape {
    /// The one that the partition chose; `None` where it chose none.
    pub(crate) fn of(summary: &PartitionSummary) -> Option<OctreeShape> {
        let [lo, hi] = summary.lattice_bounds;
        summary.octree.map(|(resolution, refinement)| {
            let grid = VoxelGrid::from_bounds(lo, hi, resolution, refinement);
            OctreeShape { grid, refinement }
        })
    }

    /// The leaves that records are made of.
    pub(crate) fn finest(&self) -> VoxelGrid {
        self.grid.refined(self.refinement)
    }
}

impl VoxelWork {
    /// For the octree that the partition chose, into the scratch file `place`; `None` where it chose none.
    pub(crate) fn begin(summary: &PartitionSummary, place: Place) -> Result<Option<VoxelWork>> {
        let Some(shape) = OctreeShape::of(summary) else { return Ok(None) };
        Ok(Some(VoxelWork { shape, runs: VoxelRuns::at(place)? }))
    }
}

impl VoxelMerge<'_> {
    /// Merges the records. The stored form of pages of units, before packing, goes to `put`; they are numbered from the
    /// given page on, for a model with so many materials.
    pub(crate) fn run(
        self,
        pages: FirstPage,
        put: &mut dyn FnMut(Vec<u8>) -> Result<()>,
        budget: &Budget,
        report: &dyn Fn(u64),
    ) -> Result<MergeOutcome> {
        let OctreeShape { grid, refinement } = self.shape;
        let sizes = self.runs.iter().map(VoxelRuns::size);
        let all =
            sizes.reduce(|a, b| RunsSize { bytes: a.bytes + b.bytes, run_count: a.run_count + b.run_count });
        let RunsSize { bytes: runs_bytes, run_count } = all.expect("runs of a build at least");
        let what = "the merge of voxels";
        let family_bytes = if refinement == Refinement::None { 0 } else { family_bytes(refinement) };
        let mut lease = budget.lease(what, run_count * RUN_BYTES + STREAM_BYTES + family_bytes)?;
        let mut builder = LowerBuilder::new(grid, refinement, self.folder)?;
        let (mut done, mut grown_bytes) = (0u64, 0);
        let known = RecordBounds::new(&self.shape.finest(), pages.material_count);
        merge(self.runs, &known, |record| {
            builder.push(record)?;
            done += 1;
            if done.is_multiple_of(TELL_RECORDS) {
                report(done);
                // Twice: once more when they are written.
                lease.grow(what, 2 * (builder.grown_bytes() - grown_bytes))?;
                grown_bytes = builder.grown_bytes();
            }
            Ok(())
        })?;
        report(done);
        lease.grow(what, builder.finish_bytes())?;
        let scratch_bytes = runs_bytes + builder.scratch_bytes();
        Ok(MergeOutcome { finished: builder.finish(pages, put)?, scratch_bytes, _lease: lease })
    }
}

impl MergeOutcome {
    /// Leaves of all units.
    pub(crate) fn lower_leaf_count(&self) -> u64 {
        self.finished.leaf_count
    }

    /// Writes the sections to the end of `file`; gives the count of upper leaves.
    pub(crate) fn write(self, file: &mut DraftFile<'_>, file_id: u64, slots: &mut [Section]) -> Result<u64> {
        let (upper, links) = (self.finished.upper, self.finished.links);
        slots[0] = section(SectionKind::Upper, file, file_id, |put| upper.finish(put))?;
        if let Some((bytes, count)) = links {
            slots[1] = section(SectionKind::Lower, file, file_id, |put| put(&bytes).map(|()| count as u32))?;
        }
        Ok(u64::from(slots[0].count))
    }
}

/// Writes what `make` gives, piece by piece, and the count of items that it returns.
fn section(
    kind: SectionKind,
    file: &mut DraftFile<'_>,
    file_id: u64,
    make: impl FnOnce(&mut dyn FnMut(&[u8]) -> Result<()>) -> Result<u32>,
) -> Result<Section> {
    let (kind, offset) = (kind as u32, file.bytes());
    let mut hasher = section_hasher(file_id, kind);
    let count = make(&mut |piece| {
        hasher.update(piece);
        file.append(piece).map(drop)
    })?;
    Ok(Section { kind, count, offset, bytes: file.bytes() - offset, hash: hasher.digest() })
}
