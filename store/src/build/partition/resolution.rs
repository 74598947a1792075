//! Which voxel octree a model gets.
//!
//! Invariant: the choice depends on the input and the options alone, never on the memory limit.

use super::chunk::CHUNK_TRIANGLES;
use super::surface::{RESOLUTIONS, Surface};
use crate::build::options::Voxels;
use crate::octree::{RUN_BYTES, RUN_RECORDS, Refinement, VoxelGrid, leaf_bytes};

/// Bytes of a triangle on disk: measured, rounded.
const DISK_BYTES_PER_TRIANGLE: f64 = 2.5;
/// Bytes of a leaf there: of surface across an axis, whose leaves are alike, and of any other. Files have 0.4 of the
/// Cornell box, 0.7 of Sponza and 1.5 of a CAD board, all mostly flat, 4.7 of a scan and 7.6 of an iso-surface: says
/// `trex info`.
const DISK_BYTES_PER_LEAF: [f64; 2] = [1.0, 8.0];
/// Bytes of a finest leaf in scratch, for the plan: 52 of an iso-surface, 50 of a scan, 19 of a plant, 11 of a CAD
/// board, in voxels of 512/2048.
const SCRATCH_BYTES_PER_LEAF: f64 = 52.0;
/// Leaves of a surface over those of a side of its cube, for the plan: 7.3 of `gen:isosurface:20M` at 512, 6.7 of 2M at
/// 2048.
const PLAN_CROSSINGS: f64 = 7.0;

/// Bytes in memory that any model may spend on 256 leaves along its side, however few its triangles.
const CHEAP_BYTES: f64 = (32 << 20) as f64;

/// Leaves of the octree that is asked for, and how much finer the finest are; `None` for none.
pub(crate) fn resolution(
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

/// The finest octree that takes less than the mesh on disk, by how much of it is flat, and less than `upper_bytes` in
/// memory: light leaks round walls that are thinner than leaves. The coarser ones are for what is small: 256 up to
/// [`CHEAP_BYTES`], since a picture needs that much whatever the model has. Units below it are for who asks for them:
/// rays that may wait for pages cannot go in batches, and were 2.6 to 3 times as slow when measured (ao).
fn choose(surface: &Surface, [lo, hi]: [[i64; 3]; 2], mesh_bytes: f64, upper_bytes: u64) -> u32 {
    let [flat, bent] = DISK_BYTES_PER_LEAF;
    let disk_bytes_per_leaf = bent + surface.flat_share() * (flat - bent);
    let fits = |which: &usize| {
        let leaf_steps = VoxelGrid::from_bounds(lo, hi, RESOLUTIONS[*which], Refinement::None).leaf_steps();
        let leaves = surface.leaf_count(*which, leaf_steps);
        let resident = leaves * leaf_bytes() as f64;
        let is_due = leaves * disk_bytes_per_leaf <= mesh_bytes;
        let is_cheap = RESOLUTIONS[*which] == 256 && resident <= CHEAP_BYTES;
        resident <= upper_bytes as f64 && (is_due || is_cheap)
    };
    (0..RESOLUTIONS.len()).rev().find(fits).map_or(64, |which| RESOLUTIONS[which])
}

/// About what voxels take, before anything is known of the surface but how many triangles it has.
pub(crate) struct VoxelPlan {
    /// In the file, bytes.
    pub(crate) output_bytes: u64,
    /// Records in scratch, bytes.
    pub(crate) scratch_bytes: u64,
    /// Memory while these are merged, bytes.
    pub(crate) merge_bytes: u64,
}

impl VoxelPlan {
    /// Of an octree that is asked for so.
    pub(crate) fn of(voxels: Voxels, triangle_count: u64) -> VoxelPlan {
        let of_surface = |side: u32| PLAN_CROSSINGS * f64::from(side).powi(2);
        let leaves = match voxels {
            Voxels::None => 0.0,
            Voxels::Resolution(side) => of_surface(side),
            Voxels::Refined { upper, refinement } => of_surface(upper * refinement.factor()),
            // What `choose` allows.
            Voxels::Within { upper_bytes } => {
                let due = DISK_BYTES_PER_TRIANGLE / DISK_BYTES_PER_LEAF[1] * triangle_count as f64;
                due.max(of_surface(256)).min(upper_bytes as f64 / leaf_bytes() as f64)
            }
        };
        let bytes = |per_leaf: f64| (leaves * per_leaf) as u64;
        let run_count = triangle_count / CHUNK_TRIANGLES + leaves as u64 / RUN_RECORDS as u64;
        VoxelPlan {
            output_bytes: bytes(DISK_BYTES_PER_LEAF[1]),
            scratch_bytes: bytes(SCRATCH_BYTES_PER_LEAF),
            merge_bytes: run_count * RUN_BYTES,
        }
    }
}
