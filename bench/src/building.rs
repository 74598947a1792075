//! Workload `build`: a generated mesh to a page file, again and again, generation not counted.
//!
//! Invariants: 1. every round writes the same bytes; the file id says so; 2. the time that the build waited for its
//! generator is taken off; the generator's own threads still compete with it.

use crate::median::median;
use crate::model::{Surroundings, build, temporary_folder};
use anyhow::ensure;
use datasets_gen::Spec;
use serde::Serialize;
use trex_store::build::Voxels;

/// What the rounds gave: medians.
#[derive(Clone, Debug, Serialize)]
pub struct BuildFigures {
    /// The generator's specification.
    pub scene: String,
    /// File id.
    pub result_hash: String,
    /// Triangles stored.
    pub triangle_count: u64,
    /// Worker threads.
    pub thread_count: usize,
    /// Rounds.
    pub round_count: usize,
    /// Triangles of the input per second, waiting for the generator not counted.
    pub triangles_per_s: f64,
    /// The same over the whole wall time.
    pub triangles_with_source_per_s: f64,
    /// Wall time per phase.
    pub phase_ms: PhaseMedians,
    /// Length of the file.
    pub output_bytes: u64,
    /// Output per triangle stored.
    pub bytes_per_triangle: f64,
    /// Most scratch alive at once.
    pub scratch_peak_bytes: u64,
}

/// Median wall time of each phase, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PhaseMedians {
    /// Waiting for the generator.
    pub generate: f64,
    /// Snap and sort into cells.
    pub partition: f64,
    /// Clusters, pages, emit.
    pub clusters: f64,
    /// fsync, read back, rename.
    pub publish: f64,
    /// All of it.
    pub total: f64,
}

/// Builds `spec` `rounds` times.
///
/// # Errors
/// Those of the generator and of the build; two rounds that differ.
pub fn run(spec: &str, rounds: usize, around: &Surroundings) -> anyhow::Result<BuildFigures> {
    ensure!(rounds > 0, "a median takes a round");
    let parsed = Spec::parse(spec)?;
    let mut reports = Vec::with_capacity(rounds);
    for _ in 0..rounds {
        let folder = temporary_folder(&around.folder)?;
        reports.push(build(&parsed, &folder.path().join("model.trex"), Voxels::None, around)?);
    }
    let last = &reports[rounds - 1];
    ensure!(reports.iter().all(|report| report.file_id == last.file_id), "two builds of {spec} differ");
    let mid = |ms: fn(&trex_store::build::PhaseMs) -> u64| {
        median(&reports.iter().map(|report| ms(&report.phase_ms) as f64).collect::<Vec<_>>())
    };
    let per_s = |ms: fn(&trex_store::build::PhaseMs) -> u64| {
        last.input_triangle_count as f64 * 1e3 / mid(ms).max(1.0)
    };
    Ok(BuildFigures {
        scene: spec.to_owned(),
        result_hash: last.file_id.clone(),
        triangle_count: last.triangle_count,
        thread_count: around.threads,
        round_count: rounds,
        triangles_per_s: per_s(|ms| ms.total.saturating_sub(ms.generate)),
        triangles_with_source_per_s: per_s(|ms| ms.total),
        phase_ms: PhaseMedians {
            generate: mid(|ms| ms.generate),
            partition: mid(|ms| ms.partition),
            clusters: mid(|ms| ms.clusters),
            publish: mid(|ms| ms.publish),
            total: mid(|ms| ms.total),
        },
        output_bytes: last.output_bytes,
        bytes_per_triangle: last.output_bytes as f64 / last.triangle_count.max(1) as f64,
        scratch_peak_bytes: last.scratch_peak_bytes,
    })
}
