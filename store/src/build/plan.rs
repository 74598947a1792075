//! The plan of a build: what it is going to take, known before anything is written.

use super::emit::{self, writer};
use super::options::BuildOptions;
use super::partition;
use crate::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// Memory and disk that a build is going to take, known before anything is written.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Triangles to come.
    pub triangle_count: u64,
    /// Most memory that the build leases.
    pub memory_bytes: u64,
    /// The limit it runs under.
    pub limit_bytes: u64,
    /// Scratch, estimated.
    pub scratch_bytes: u64,
    /// Output, estimated.
    pub output_bytes: u64,
    /// Free space where the scratch goes.
    pub free_bytes: u64,
}

/// Scratch and output per triangle, voxels apart, for the plan: measured on iso-surfaces and CAD models, rounded up.
const PLAN_SCRATCH_BYTES: u64 = 24;
const PLAN_OUTPUT_BYTES: u64 = 5;

/// The plan for so many triangles.
pub(super) fn plan(triangle_count: u64, options: &BuildOptions, scratch_folder: &Path) -> Result<Plan> {
    let free = rustix::io::retry_on_intr(|| rustix::fs::statvfs(scratch_folder))
        .map_err(|e| Error::io("ask for the free space", scratch_folder, &e.into()))?;
    let builders = emit::needed_bytes(options) * emit::worker_count(triangle_count, options) as u64;
    let plan = Plan {
        triangle_count,
        memory_bytes: crate::RESERVE_BYTES
            + options.budget.used_bytes()
            + partition::phase_bytes(options.budget.free_bytes())
                .max(builders + writer::tables_bytes(triangle_count))
                .max(writer::top_tree_bytes(triangle_count)),
        limit_bytes: options.budget.limit_bytes(),
        scratch_bytes: triangle_count * PLAN_SCRATCH_BYTES,
        output_bytes: triangle_count * PLAN_OUTPUT_BYTES
            + partition::plan_bytes(options.voxels, triangle_count),
        free_bytes: free.f_bavail * free.f_frsize,
    };
    Ok(plan)
}
