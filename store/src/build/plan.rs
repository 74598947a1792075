//! The plan of a build: what it is going to take, known before anything is written.

use super::clusters::workspace::worker_bytes;
use super::emit::{self, table_bytes};
use super::input_sizes::InputSizes;
use super::options::BuildOptions;
use super::partition::{self, VoxelPlan};
use crate::attributes::AttributeSet;
use crate::error::{Error, Result};
use crate::layout::FRAME_BYTES;
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::octree::Voxelizer;
use serde::Serialize;
use std::path::Path;

/// Memory and disk that a build is going to take, known before anything is written.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Triangles to come.
    pub triangle_count: u64,
    /// Whether they have colours, which are kept.
    pub has_colours: bool,
    /// Whether they have normals, which are kept.
    pub has_normals: bool,
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
/// What colours add to either, rounded up; and normals.
const PLAN_COLOUR_SCRATCH_BYTES: u64 = 6;
const PLAN_COLOUR_BYTES: u64 = 2;
const PLAN_NORMAL_SCRATCH_BYTES: u64 = 9;
const PLAN_NORMAL_BYTES: u64 = 2;

/// The plan for so many triangles.
pub(super) fn plan(sizes: &InputSizes, options: &BuildOptions, scratch_folder: &Path) -> Result<Plan> {
    let triangle_count = sizes.triangle_count;
    let free = rustix::io::retry_on_intr(|| rustix::fs::statvfs(scratch_folder))
        .map_err(|e| Error::io("ask for the free space", scratch_folder, &e.into()))?;
    let builders = emit::needed_bytes(sizes, options) * emit::worker_count(sizes, options) as u64;
    let AttributeSet { colours: has_colours, normals: has_normals } = sizes.attributes;
    let of = |has: bool, bytes: u64| if has { bytes } else { 0 };
    let lists = partition::chunks_bytes(triangle_count);
    let voxels = VoxelPlan::of(options.voxels, triangle_count);
    let attribute_scratch_bytes =
        of(has_colours, PLAN_COLOUR_SCRATCH_BYTES) + of(has_normals, PLAN_NORMAL_SCRATCH_BYTES);
    let attribute_bytes = of(has_colours, PLAN_COLOUR_BYTES) + of(has_normals, PLAN_NORMAL_BYTES);
    let plan = Plan {
        triangle_count,
        has_colours,
        has_normals,
        memory_bytes: crate::RESERVE_BYTES
            + options.budget.used_bytes()
            + partition::phase_bytes(options.budget.free_bytes(), sizes)
                .max(lists + builders.max(voxels.merge_bytes) + table_bytes::tables_bytes(sizes))
                .max(lists + table_bytes::top_tree_bytes(sizes)),
        limit_bytes: options.budget.limit_bytes(),
        scratch_bytes: triangle_count * (PLAN_SCRATCH_BYTES + attribute_scratch_bytes) + voxels.scratch_bytes,
        output_bytes: triangle_count * (PLAN_OUTPUT_BYTES + attribute_bytes) + voxels.output_bytes,
        free_bytes: free.f_bavail * free.f_frsize,
    };
    Ok(plan)
}

/// What a source may lease while it is read: materials, the directory of 64 million vertices.
const SOURCE_BYTES: u64 = 1 << 20;

/// Least bytes that a build leases beside what its source has leased when it is opened: a small model.
pub fn smallest_bytes() -> u64 {
    smallest_bytes_for(&InputSizes::default()) + SOURCE_BYTES
}

/// Least bytes that a build of such an input leases, beside what its source has leased by the end of its stream.
pub fn smallest_bytes_for(sizes: &InputSizes) -> u64 {
    let materials = sizes.material_count * (size_of::<Material>() + size_of::<bool>()) as u64;
    let builder = worker_bytes(sizes.attributes) + emit::chunk_emitter_bytes(sizes) + Voxelizer::BYTES;
    let chunks = builder + table_bytes::tables_bytes(sizes);
    // What was written is opened to be read back.
    let tables = MaterialList::bytes(sizes.material_count, sizes.name_bytes) + table_bytes::file_bytes(sizes);
    let read_back = tables + 5 * FRAME_BYTES as u64;
    let partition = partition::smallest_bytes(sizes);
    let lists = partition::chunks_bytes(sizes.triangle_count);
    let behind = [chunks, table_bytes::top_tree_bytes(sizes), read_back].into_iter().max().unwrap_or(0);
    materials + partition.max(lists + behind)
}
