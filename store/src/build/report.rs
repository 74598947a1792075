//! What a build reports: its progress while it runs, counts and times when it is done.

use super::phases::{PhaseCpuMs, PhaseMs};
use crate::source::SourceStats;
use serde::Serialize;

/// Progress: phase, unit, done, total.
pub(super) type PhaseReport<'a> = &'a (dyn Fn(&'static str, &'static str, u64, u64) + Sync);

/// Counts, sizes and times of a build that is done.
#[derive(Clone, Debug, Default, Serialize)]
pub struct BuildReport {
    /// Triangles delivered by the source.
    pub input_triangle_count: u64,
    /// Triangles stored.
    pub triangle_count: u64,
    /// Left out: two equal corners after the snap.
    pub rejected_degenerate: u64,
    /// Those of them that had area in the input: smaller than the lattice can tell.
    pub rejected_collapsed: u64,
    /// The greatest error bound, model units, on whose lattice at most one in 10,000 triangles with area is lost;
    /// `None` where no more are lost, and where no lattice keeps them.
    pub keeping_error: Option<f64>,
    /// Left out: not finite.
    pub rejected_non_finite: u64,
    /// Clusters, wide ones included.
    pub cluster_count: u64,
    /// Wide clusters.
    pub wide_cluster_count: u64,
    /// Pages.
    pub page_count: u32,
    /// Emissive triangles.
    pub emitter_count: u64,
    /// Length of the file.
    pub output_bytes: u64,
    /// Most scratch bytes alive at once.
    pub scratch_peak_bytes: u64,
    /// Triangles that a build before this had done.
    pub resumed_triangle_count: u64,
    /// Triangles that a build before this had sorted, and no more.
    pub resumed_sorted_count: u64,
    /// Leaves of the resident octree along an axis; 0 without one.
    pub upper_resolution: u32,
    /// Leaves of the resident octree.
    pub upper_leaf_count: u64,
    /// Finest leaves along an axis; 0 without voxels.
    pub finest_resolution: u32,
    /// Leaves below the resident ones, of all levels.
    pub lower_leaf_count: u64,
    /// File id.
    pub file_id: String,
    /// Milliseconds per phase.
    pub phase_ms: PhaseMs,
    /// Processor milliseconds of the process per phase.
    pub phase_cpu_ms: PhaseCpuMs,
    /// Mean share of cluster slots in use, 0 to 1.
    pub cluster_fill: f64,
    /// Per-axis error bound, model units.
    pub error_bound: f64,
    /// Counters of the source on its last pass.
    #[serde(skip)]
    pub source: SourceStats,
}
