//! Emit: workers build chunks, one writer puts their pages into the file in chunk order, then tables and heads.
//!
//! Invariants: 1. pages stand in chunk order whatever the number of workers; 2. at most [`WINDOW`] finished
//! chunks a worker wait for their turn; 3. every byte written is covered by a hash.

use super::chunk::{Workspace, worker_bytes};
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
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Condvar, Mutex};
use std::time::{Duration, Instant};

/// Chunks that may be finished ahead of the writer, per worker.
const WINDOW: usize = 3;

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
    let workers = worker_count(options).min(parted.chunks.len()).max(1);
    let lease = options.budget.lease("the cluster builders", needed_bytes(options) * workers as u64)?;
    in_order(parted, voxels.as_ref(), workers, context, &options.interrupt, |chunk, pages| {
        writer.add_chunk(pages, &mut file)?;
        for piece in &parted.chunks[chunk].pieces {
            parted.scratch.consume(&piece.run, piece.take);
        }
        tell("clusters", "triangles", writer.triangle_count(), parted.triangle_count);
        Ok(())
    })?;
    writer.close(&mut file)?;
    drop(lease);
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
    options.threads.min((options.budget.free_bytes() / needed_bytes(options)) as usize).max(1)
}

/// Builds all chunks on `workers` threads and hands the results to `take`, in order.
fn in_order(
    parted: &Partition,
    voxels: Option<&VoxelWork>,
    workers: usize,
    context: PackContext<'_>,
    interrupt: &crate::Interrupt,
    mut take: impl FnMut(usize, ChunkPages) -> Result<()>,
) -> Result<()> {
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let written = (Mutex::new(0usize), Condvar::new());
    let window = WINDOW * workers;
    std::thread::scope(|scope| {
        let (sender, results) = sync_channel::<(usize, Result<ChunkPages>)>(workers);
        for worker in 0..workers {
            let (sender, next, stop, written) = (sender.clone(), &next, &stop, &written);
            let work = move || {
                let mut workspace = Workspace::default();
                let mut voxelizer = voxels.map(|work| Voxelizer::new(work.finest(), &work.runs));
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= parted.chunks.len() || stop.load(Ordering::Relaxed) {
                        return;
                    }
                    let mut done = written.0.lock().expect("no panic while held");
                    while index >= *done + window && !stop.load(Ordering::Relaxed) {
                        done = written.1.wait_timeout(done, Duration::from_millis(100)).expect("as above").0;
                    }
                    drop(done);
                    let built = workspace.build(&parted.chunks[index], &parted.scratch, context);
                    let result = built.and_then(|pages| {
                        voxelizer.as_mut().map_or(Ok(()), |v| voxelize(v, index, workspace.triangles()))?;
                        Ok(pages)
                    });
                    if sender.send((index, result)).is_err() {
                        return;
                    }
                }
            };
            let name = format!("trex-build-{worker}");
            std::thread::Builder::new().name(name).spawn_scoped(scope, work).expect("a thread");
        }
        drop(sender);
        let mut waiting = BTreeMap::new();
        let mut turn = 0;
        let outcome = loop {
            if let Err(error) = interrupt.check() {
                break Err(error);
            }
            let (index, result) = match results.recv_timeout(Duration::from_millis(100)) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => break Ok(()),
            };
            let taken = result.and_then(|pages| {
                waiting.insert(index, pages);
                while let Some(pages) = waiting.remove(&turn) {
                    take(turn, pages)?;
                    turn += 1;
                    *written.0.lock().expect("no panic while held") = turn;
                    written.1.notify_all();
                }
                Ok(())
            });
            if let Err(error) = taken {
                break Err(error);
            }
        };
        stop.store(true, Ordering::Relaxed);
        written.1.notify_all();
        drop(results);
        outcome
    })
}

/// Makes voxel records of a chunk.
fn voxelize(voxelizer: &mut Voxelizer<'_>, chunk: usize, triangles: &[LatticeTriangle]) -> Result<()> {
    voxelizer.begin(chunk);
    triangles.iter().for_each(|triangle| voxelizer.add(triangle.q, triangle.material));
    voxelizer.finish()
}
