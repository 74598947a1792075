//! Emit: workers build chunks, one writer puts their pages into the file in chunk order, then tables and heads.
//!
//! Invariants: 1. pages stand in chunk order whatever the number of workers; 2. every byte written is covered by a
//! hash.

use super::chunk::{Workspace, worker_bytes};
use super::in_order::InOrder;
use super::lattice::{Scan, Tell};
use super::pages::{ChunkPages, PackContext};
use super::partition::Partition;
use super::publish::DraftFile;
use super::scratch::LatticeTriangle;
use super::voxels::VoxelWork;
use super::writer::{Writer, file_id, superblock_of};
use super::{BuildOptions, BuildReport, Voxels};
use crate::error::Result;
use crate::layout::{SUPERBLOCK_BYTES, Superblock};
use crate::material::Material;
use crate::octree::{FirstPage, Voxelizer};
use std::time::Instant;

/// What is written.
pub(super) struct Work<'a> {
    pub(super) parted: &'a Partition,
    pub(super) scan: &'a Scan,
    /// The octree that was asked for; its records come with the chunks.
    pub(super) voxels: Option<VoxelWork>,
    pub(super) materials: &'a [Material],
}

/// Writes everything between the two superblocks and the superblocks themselves.
pub(super) fn emit(
    work: Work<'_>,
    options: &BuildOptions,
    mut file: DraftFile<'_>,
    tell: Tell<'_>,
    out: &mut BuildReport,
) -> Result<Superblock> {
    let Work { parted, scan, voxels, materials } = work;
    let emissive: Vec<bool> = materials.iter().map(Material::emits).collect();
    let context = PackContext { emissive: &emissive };
    let materials_json = serde_json::to_vec(materials).expect("materials are plain data");
    let file_id = file_id(parted, voxels.as_ref(), &materials_json);
    let mut writer = Writer::new(file_id, superblock_of(parted, scan), context);

    // The head's place; it is written last.
    file.append(&[0; SUPERBLOCK_BYTES])?;
    tell("clusters", "triangles", 0, parted.triangle_count);

    // Pages of the mesh and voxel records, chunk by chunk, in order.
    build_chunks(parted, voxels.as_ref(), context, options, |chunk, pages| {
        writer.add_chunk(pages, &mut file)?;
        for piece in &parted.chunks[chunk].pieces {
            parted.scratch.consume(&piece.run, piece.take);
        }
        tell("clusters", "triangles", writer.triangle_count(), parted.triangle_count);
        Ok(())
    })?;
    writer.close(&mut file)?;
    out.scratch_peak_bytes = parted.scratch.bytes();

    // Records merged into the octree; pages of units.
    let start = Instant::now();
    let merged = match voxels {
        None => None,
        Some(work) => {
            (out.upper_resolution, out.finest_resolution) = (work.grid.resolution, work.finest().resolution);
            let tell = |done| tell("voxels", "records", done, 0);
            let pages = FirstPage { number: writer.page_count(), material_count: materials.len() };
            let put = &mut |raw| writer.add_units(raw, &mut file);
            Some(work.merge(pages, put, &options.budget, &tell)?)
        }
    };

    // Tables, then the sections of the octree.
    writer.write_tables(&mut file, &materials_json, materials.len())?;
    if let Some(merged) = merged {
        out.scratch_peak_bytes = out.scratch_peak_bytes.max(merged.scratch_bytes);
        out.lower_leaf_count = merged.lower_leaf_count();
        out.upper_leaf_count = merged.write(&mut file, file_id, writer.voxel_sections())?;
    }
    out.phase_ms.voxels = start.elapsed().as_millis() as u64;

    // Both superblocks.
    writer.seal(&mut file, out)
}

/// What one worker needs.
pub(super) fn needed_bytes(options: &BuildOptions) -> u64 {
    worker_bytes() + if options.voxels == Voxels::None { 0 } else { Voxelizer::BYTES }
}

/// As many workers as there is room for: the result does not depend on it.
pub(super) fn worker_count(options: &BuildOptions) -> usize {
    options
        .pool
        .current_num_threads()
        .min((options.budget.free_bytes() / needed_bytes(options)) as usize)
        .max(1)
}

/// Builds all chunks, with their voxel records, and hands their pages to `put`, in order.
fn build_chunks(
    parted: &Partition,
    voxels: Option<&VoxelWork>,
    context: PackContext<'_>,
    options: &BuildOptions,
    put: impl FnMut(usize, ChunkPages) -> Result<()>,
) -> Result<()> {
    let worker_count = worker_count(options).min(parted.chunks.len()).max(1);
    let bytes = needed_bytes(options) * worker_count as u64;
    let _lease = options.budget.lease("the cluster builders", bytes)?;
    let (pool, item_count, interrupt) = (&options.pool, parted.chunks.len(), &options.interrupt);
    let begin = || {
        let mut workspace = Workspace::default();
        let mut voxelizer = voxels.map(|work| Voxelizer::new(work.finest(), &work.runs));
        move |chunk: usize| {
            let pages = workspace.build(&parted.chunks[chunk], &parted.scratch, context)?;
            voxelizer.as_mut().map_or(Ok(()), |v| voxelize(v, chunk, workspace.triangles()))?;
            Ok(pages)
        }
    };
    InOrder { pool, worker_count, item_count, interrupt }.run(begin, put)
}

/// Makes voxel records of a chunk.
fn voxelize(voxelizer: &mut Voxelizer<'_>, chunk: usize, triangles: &[LatticeTriangle]) -> Result<()> {
    voxelizer.begin(chunk);
    triangles.iter().for_each(|triangle| voxelizer.add(triangle.q, triangle.material));
    voxelizer.finish()
}
