//! Builds in shards: one model by many machines, which share nothing but the inputs, a plan and the fragments.
//!
//! ```text
//! scan    inputs -> plan                         once: lattice, octree, materials, cells with their counts
//! build   inputs, plan, share I/N -> fragment    by each machine: sort its cells, clusters, pages, voxel records
//!         plan, share I/N -> fragment            the same, where the plan holds the triangles in their cells
//! merge   fragments -> page file                 once: pages that chunks share, octree, top tree, tables
//! ```
//!
//! Invariants: 1. the merged file has the bytes of a single build of the inputs, whatever N is; 2. a plan, a fragment
//! and a page file appear whole or not at all; 3. what a build reads of others is refused, in words, where it is not
//! what it must be.

mod merge;
mod scan;
mod shard;

pub use crate::build::fragment::SHARDS;
pub use crate::build::shard_plan::ShardPlan;
pub use merge::{MergeWork, merge};
pub use scan::{ScanReport, ScanWork, scan};
pub use shard::{ShardReport, ShardWork, build};

use crate::budget::Budget;
use crate::build::report::PhaseReport;
use crate::error::Result;
use crate::output::check_apart;
use crate::progress::{Progress, Report};
use crate::source::SourceStats;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Calls `work` with what reports progress by phase.
fn by_phase<T>(budget: &Budget, report: Report<'_>, work: impl FnOnce(PhaseReport<'_>) -> T) -> T {
    work(&|phase, unit, done, total| {
        report(Progress { phase, done, total, unit, memory_bytes: budget.used_bytes() });
    })
}

/// Refuses an output that the input names: what a source has read is known once its stream has ended.
fn check_named(output: &Path, source: &SourceStats) -> Result<()> {
    let mut named = source.named_files.iter().map(|(path, _)| Path::new(OsStr::from_bytes(path)));
    named.try_for_each(|named| check_apart(output, named))
}
