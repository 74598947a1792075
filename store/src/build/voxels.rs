//! Which voxel octree a model gets, and how the records of its chunks become pages and sections of the file.
//!
//! Invariants: 1. the choice depends on the input and the options alone, never on the memory limit; 2. memory of the
//! merge is leased, and does not grow with the leaves but for their nodes' masks and places; 3. sections are written
//! and hashed piece by piece.

use super::Voxels;
use super::publish::DraftFile;
use super::surface::{RESOLUTIONS, Surface};
use crate::budget::{Budget, Lease};
use crate::error::Result;
use crate::layout::{Section, SectionKind, section_hasher};
use crate::octree::{
    Finished, FirstPage, Known, LowerBuilder, RUN_BYTES, Refinement, RunsSize, STREAM_BYTES, VoxelGrid,
    VoxelRuns, family_bytes, leaf_bytes, merge,
};
use crate::scratch::Place;
use std::path::{Path, PathBuf};

/// Bytes of a leaf on disk, bytes of a triangle there: measured, rounded.
const DISK_BYTES_PER_LEAF: f64 = 8.0;
const DISK_BYTES_PER_TRIANGLE: f64 = 2.5;
/// Times that a surface crosses its cube, for the plan: 4.35 on `gen:isosurface:20k`, rounded up.
const PLAN_CROSSINGS: f64 = 5.0;

/// Bytes in memory that any model may spend on 256 leaves along its side, however few its triangles.
const CHEAP_BYTES: f64 = (32 << 20) as f64;

/// Records between two reports; their masks are what is counted as memory afterwards.
const TELL_RECORDS: u64 = 1 << 16;

/// Voxel records on their way.
pub(super) struct VoxelWork {
    /// The upper leaves.
    pub(super) grid: VoxelGrid,
    pub(super) refinement: Refinement,
    pub(super) runs: VoxelRuns,
    /// Where scratch files go.
    folder: PathBuf,
}

/// Leaves of the octree that is asked for, and how much finer the finest are; `None` for none.
pub(super) fn resolution(
    voxels: Voxels,
    surface: &Surface,
    lattice_bounds: [[i64; 3]; 2],
    triangle_count: u64,
) -> Option<(u32, Refinement)> {
    match voxels {
        Voxels::None => None,
        Voxels::Resolution(resolution) => Some((resolution, Refinement::None)),
        Voxels::Refined { upper, refinement } => Some((upper, refinement)),
        Voxels::Within { upper_bytes } => {
            let mesh_bytes = DISK_BYTES_PER_TRIANGLE * triangle_count as f64;
            Some((choose(surface, lattice_bounds, mesh_bytes, upper_bytes), Refinement::None))
        }
    }
}

/// The octree of [`resolution`], and the scratch file `place` for its records; others go to `folder`. `None` for none.
pub(super) fn begin(
    octree: Option<(u32, Refinement)>,
    [lo, hi]: [[i64; 3]; 2],
    place: Place,
    folder: &Path,
) -> Result<Option<VoxelWork>> {
    let Some((resolution, refinement)) = octree else { return Ok(None) };
    Ok(Some(VoxelWork {
        grid: VoxelGrid::from_bounds(lo, hi, resolution, refinement),
        refinement,
        runs: VoxelRuns::at(place)?,
        folder: folder.to_path_buf(),
    }))
}

/// The finest octree that takes less than the mesh on disk and less than `upper_bytes` in memory. The coarser ones are
/// for what is small: 256 up to [`CHEAP_BYTES`], since a picture needs that much whatever the model has. Units below it
/// are for who asks for them: rays that may wait for pages cannot go in batches, and were 2.6 to 3 times as slow when
/// measured (ao).
fn choose(surface: &Surface, [lo, hi]: [[i64; 3]; 2], mesh_bytes: f64, upper_bytes: u64) -> u32 {
    let fits = |which: &usize| {
        let leaf_steps = VoxelGrid::from_bounds(lo, hi, RESOLUTIONS[*which], Refinement::None).leaf_steps();
        let leaves = surface.leaf_count(*which, leaf_steps);
        let resident = leaves * leaf_bytes() as f64;
        let is_due = leaves * DISK_BYTES_PER_LEAF <= mesh_bytes;
        let is_cheap = RESOLUTIONS[*which] == 256 && resident <= CHEAP_BYTES;
        resident <= upper_bytes as f64 && (is_due || is_cheap)
    };
    (0..RESOLUTIONS.len()).rev().find(fits).map_or(64, |which| RESOLUTIONS[which])
}

/// About what voxels add to the file, before anything is known of the surface but how many triangles it has.
pub(super) fn plan_bytes(voxels: Voxels, triangle_count: u64) -> u64 {
    let of_surface = |side: u32| PLAN_CROSSINGS * f64::from(side) * f64::from(side) * DISK_BYTES_PER_LEAF;
    let bytes = match voxels {
        Voxels::None => 0.0,
        Voxels::Resolution(side) => of_surface(side),
        Voxels::Refined { upper, refinement } => of_surface(upper * refinement.factor()),
        // What `choose` allows.
        Voxels::Within { upper_bytes } => {
            let due = of_surface(256).max(DISK_BYTES_PER_TRIANGLE * triangle_count as f64);
            due.min(upper_bytes as f64 / leaf_bytes() as f64 * DISK_BYTES_PER_LEAF)
        }
    };
    bytes as u64
}

/// Merged records whose pages are written, and what is left to be written.
pub(super) struct Merged {
    finished: Finished,
    /// Bytes of scratch.
    pub(super) scratch_bytes: u64,
    _lease: Lease,
}

impl VoxelWork {
    /// The leaves that records are made of.
    pub(super) fn finest(&self) -> VoxelGrid {
        self.grid.refined(self.refinement)
    }

    /// Merges the records. The stored form of pages of units, before packing, goes to `put`; they are numbered from the
    /// given page on, for a model with so many materials.
    pub(super) fn merge(
        self,
        pages: FirstPage,
        put: &mut dyn FnMut(Vec<u8>) -> Result<()>,
        budget: &Budget,
        tell: &dyn Fn(u64),
    ) -> Result<Merged> {
        let RunsSize { bytes: runs_bytes, run_count } = self.runs.size();
        let what = "the merge of voxels";
        let family_bytes =
            if self.refinement == Refinement::None { 0 } else { family_bytes(self.refinement) };
        let mut lease = budget.lease(what, run_count * RUN_BYTES + STREAM_BYTES + family_bytes)?;
        let mut builder = LowerBuilder::new(self.grid, self.refinement, &self.folder)?;
        let (mut done, mut grown_bytes) = (0u64, 0);
        let known = Known::new(&self.grid.refined(self.refinement), pages.material_count);
        merge(self.runs, &known, |record| {
            builder.push(record)?;
            done += 1;
            if done.is_multiple_of(TELL_RECORDS) {
                tell(done);
                // Twice: once more when they are written.
                lease.grow(what, 2 * (builder.grown_bytes() - grown_bytes))?;
                grown_bytes = builder.grown_bytes();
            }
            Ok(())
        })?;
        tell(done);
        lease.grow(what, builder.finish_bytes())?;
        let scratch_bytes = runs_bytes + builder.scratch_bytes();
        Ok(Merged { finished: builder.finish(pages, put)?, scratch_bytes, _lease: lease })
    }
}

impl Merged {
    /// Leaves of all units.
    pub(super) fn lower_leaf_count(&self) -> u64 {
        self.finished.leaf_count
    }

    /// Writes the sections to the end of `file`; gives the count of upper leaves.
    pub(super) fn write(self, file: &mut DraftFile<'_>, file_id: u64, slots: &mut [Section]) -> Result<u64> {
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
