//! Emit: workers build chunks, one writer puts their pages into the file in chunk order, then tables and heads.
//!
//! Invariants: 1. pages stand in chunk order whatever the number of workers; 2. every byte written is covered by a
//! hash.

pub(super) mod emit_checkpoint;
pub(super) mod file_id;
pub(super) mod finish;
mod in_order;
pub(super) mod table_bytes;
pub(super) mod voxels;
pub(super) mod writer;

use crate::build::clusters::packed_page::{PackContext, PageEmitter};
use crate::build::clusters::pages::ChunkPages;
use crate::build::clusters::workspace::{Workspace, worker_bytes};
use crate::build::draft::DraftFile;
use crate::build::input_sizes::InputSizes;
use crate::build::journal::{FileKind, Journal};
use crate::build::options::{BuildOptions, Voxels};
use crate::build::partition::Partition;
use crate::build::partition::chunk::CHUNK_TRIANGLES;
use crate::build::partition::outcome::PartitionOutcome;
use crate::build::partition::summary::PartitionSummary;
use crate::build::report::{BuildReport, PhaseReport};
use crate::build::scratch::LatticeTriangle;
use crate::cluster::LatticeBox;
use crate::error::Result;
use crate::layout::{SUPERBLOCK_BYTES, Superblock};
use crate::octree::Voxelizer;
use emit_checkpoint::EmitCheckpoint;
use file_id::file_id;
use finish::{FinishWork, finish};
use in_order::{InOrder, WINDOW};
use std::path::Path;
use table_bytes::tables_bytes;
use voxels::{OctreeShape, VoxelMerge, VoxelWork};
use writer::PageWriter;

/// What is written.
pub(crate) struct EmitWork<'a> {
    pub(crate) outcome: &'a PartitionOutcome,
    /// The octree that was asked for; its records come with the chunks.
    pub(crate) voxels: Option<VoxelWork>,
    /// Where it is recorded how far the work is, so that it can resume.
    pub(crate) journal: Option<&'a mut Journal>,
    /// What a build before this has emitted.
    pub(crate) checkpoint: Option<EmitCheckpoint>,
    /// Where scratch files go.
    pub(crate) folder: &'a Path,
}

/// Writes everything between the two superblocks and the superblocks themselves.
pub(crate) fn emit(
    work: EmitWork<'_>,
    options: &BuildOptions,
    mut file: DraftFile<'_>,
    report: PhaseReport<'_>,
    out: &mut BuildReport,
) -> Result<Superblock> {
    let EmitWork { outcome, mut voxels, journal, checkpoint, folder } = work;
    let PartitionOutcome { partition: parted, materials, sizes, .. } = outcome;
    let emissive = materials.emissive();
    let context = pack_context(&parted.summary, &emissive, sizes);
    let shape = OctreeShape::of(&parted.summary);
    let file_id = file_id(&parted.summary, shape, materials);
    let mut writer = PageWriter::new(file_id, parted.summary.superblock(), context, &options.budget)?;

    // Pages of the mesh and voxel records, chunk by chunk, in order.
    let work = ChunkWork { outcome, journal, checkpoint, context, options, report };
    out.resumed_triangle_count = work.run(&mut writer, &mut file, &mut voxels)?;
    out.scratch_peak_bytes = parted.scratch.bytes();

    // All that is made of more than a chunk.
    let voxels = voxels.map(|VoxelWork { shape, runs }| VoxelMerge { shape, runs: vec![runs], folder });
    finish(FinishWork { writer, materials, voxels, options, report }, file, out)
}

/// What the pages of all chunks of a model share.
pub(crate) fn pack_context<'a>(
    summary: &PartitionSummary,
    emissive: &'a [bool],
    sizes: &InputSizes,
) -> PackContext<'a> {
    let [lo, hi] = summary.lattice_bounds;
    PackContext { emissive, bounds: LatticeBox { lo, hi }, attributes: sizes.attributes }
}

/// All chunks, of which a build before this may have done some.
struct ChunkWork<'a> {
    outcome: &'a PartitionOutcome,
    journal: Option<&'a mut Journal>,
    checkpoint: Option<EmitCheckpoint>,
    context: PackContext<'a>,
    options: &'a BuildOptions,
    report: PhaseReport<'a>,
}

impl ChunkWork<'_> {
    /// Writes what is not done; gives the triangles of chunks that were.
    fn run(
        self,
        writer: &mut PageWriter<'_>,
        file: &mut DraftFile<'_>,
        voxels: &mut Option<VoxelWork>,
    ) -> Result<u64> {
        let ChunkWork { outcome, mut journal, checkpoint, context, options, report } = self;
        let parted = &outcome.partition;
        let mut given_back = 0;
        let first = match checkpoint {
            // The head's place; it is written last.
            None => file.append(&[0; SUPERBLOCK_BYTES]).map(|_| 0)?,
            Some(checkpoint) => {
                let first = checkpoint.chunk_count();
                let open = checkpoint.restore(writer, file, voxels.as_mut())?;
                given_back = open.first().copied().unwrap_or(first);
                reopen(writer, &open, parted, context, options)?;
                first
            }
        };
        let voxels = voxels.as_ref();
        report("clusters", "triangles", writer.triangle_count(), parted.summary.triangle_count);
        build_chunks(&ChunkSet { first, outcome, voxels, context }, options, |chunk, pages| {
            writer.add_chunk(chunk, pages, file)?;
            // Chunks that nobody will ask for again.
            let last = match &mut journal {
                None => chunk + 1,
                Some(journal) if journal.is_due() => {
                    if !journal.has_record(FileKind::Chunks) {
                        outcome.record(journal, &options.budget)?;
                    }
                    let tables = (voxels, &options.budget);
                    let is_written = journal.has_record(FileKind::Chunks)
                        && EmitCheckpoint::record(journal, chunk + 1, writer, file, tables)?;
                    let open = writer.open_chunks.first().copied().unwrap_or(chunk + 1);
                    if is_written { open } else { given_back }
                }
                Some(_) => given_back,
            };
            for piece in parted.chunks[given_back..last].iter().flat_map(|chunk| &chunk.pieces) {
                parted.scratch.consume(&piece.run, piece.take);
            }
            given_back = last;
            report("clusters", "triangles", writer.triangle_count(), parted.summary.triangle_count);
            Ok(())
        })?;
        if let Some(journal) = journal.filter(|journal| journal.has_record(FileKind::Chunks)) {
            // The merge has no units of its own: a build that is killed in it resumes from here.
            let tables = (voxels, &options.budget);
            EmitCheckpoint::record(journal, parted.chunks.len(), writer, file, tables)?;
        }
        Ok(parted.chunks[..first].iter().map(|chunk| chunk.triangle_count).sum())
    }
}

/// What one worker needs.
pub(crate) fn needed_bytes(sizes: &InputSizes, options: &BuildOptions) -> u64 {
    let voxelizer = if options.voxels == Voxels::None { 0 } else { Voxelizer::BYTES };
    worker_bytes(sizes.attributes) + chunk_emitter_bytes(sizes) + voxelizer
}

/// Bytes of the emitters in the chunks of a worker that wait for their turn.
pub(crate) fn chunk_emitter_bytes(sizes: &InputSizes) -> u64 {
    let waiting = WINDOW as u64 * CHUNK_TRIANGLES;
    waiting.min(sizes.emissive_count) * size_of::<PageEmitter>() as u64
}

/// As many workers as there is room for, beside the tables of such an input: the result does not depend on it.
pub(crate) fn worker_count(sizes: &InputSizes, options: &BuildOptions) -> usize {
    let free_bytes = options.budget.free_bytes().saturating_sub(tables_bytes(sizes));
    options.pool.current_num_threads().min((free_bytes / needed_bytes(sizes, options)) as usize).max(1)
}

/// Makes the ends of chunks again, which share a page that was not written.
fn reopen(
    writer: &mut PageWriter<'_>,
    open: &[usize],
    parted: &Partition,
    context: PackContext<'_>,
    options: &BuildOptions,
) -> Result<()> {
    let _lease = options.budget.lease("a cluster builder", worker_bytes(context.attributes))?;
    let mut workspace = Workspace::default();
    for &chunk in open {
        options.interrupt.check()?;
        let pages = workspace.build(&parted.chunks[chunk], &parted.scratch, context)?;
        writer.reopen(chunk, pages)?;
    }
    Ok(())
}

/// Chunks to be built.
pub(crate) struct ChunkSet<'a> {
    /// The first of them.
    pub(crate) first: usize,
    pub(crate) outcome: &'a PartitionOutcome,
    /// Where their voxel records go, of a model that gets an octree.
    pub(crate) voxels: Option<&'a VoxelWork>,
    pub(crate) context: PackContext<'a>,
}

/// Builds chunks, with their voxel records, and hands their pages to `put`, in order.
pub(crate) fn build_chunks(
    chunks: &ChunkSet<'_>,
    options: &BuildOptions,
    mut put: impl FnMut(usize, ChunkPages) -> Result<()>,
) -> Result<()> {
    let ChunkSet { first, outcome, voxels, context } = *chunks;
    let PartitionOutcome { partition: parted, sizes, .. } = outcome;
    let worker_count = worker_count(sizes, options).min(parted.chunks.len()).max(1);
    let bytes = needed_bytes(sizes, options) * worker_count as u64;
    let _lease = options.budget.lease("the cluster builders", bytes)?;
    let (pool, item_count, interrupt) = (&options.pool, parted.chunks.len() - first, &options.interrupt);
    let begin = || {
        let mut workspace = Workspace::default();
        let mut voxelizer = voxels.map(|work| Voxelizer::new(work.shape.finest(), &work.runs));
        move |index: usize| {
            let chunk = first + index;
            let pages = workspace.build(&parted.chunks[chunk], &parted.scratch, context)?;
            voxelizer.as_mut().map_or(Ok(()), |v| voxelize(v, chunk, workspace.triangles()))?;
            Ok(pages)
        }
    };
    InOrder { pool, worker_count, item_count, interrupt }.run(begin, |index, pages| put(first + index, pages))
}

/// Makes voxel records of a chunk.
fn voxelize(voxelizer: &mut Voxelizer<'_>, chunk: usize, triangles: &[LatticeTriangle]) -> Result<()> {
    voxelizer.begin(chunk);
    triangles.iter().for_each(|triangle| voxelizer.add(triangle.q, triangle.material));
    voxelizer.finish()
}
