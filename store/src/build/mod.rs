//! Build: from a stream of triangles to a page file, in bounded memory.
//!
//! ```text
//! scan        bounds, median edge, count            (generators know them: no pass)
//! lattice     one step for the whole model
//! partition   snap, weld by integers, sort into cells: runs in a scratch file beside the output
//! chunks      cells in Hilbert order, up to 2^17 triangles each
//! clusters    per chunk: SAH tree, clusters of 128, 8-wide nodes, pages       (a pool of threads, in order)
//! voxels      per chunk: records of the leaf voxels that its triangles touch; merged into the octree at the end
//! emit        pages, page table, top tree, materials, emitters, octree, links, superblocks
//! publish     fsync, read back, rename, fsync the folder
//! ```
//!
//! Invariants: 1. memory is leased before it is taken, whatever the input's size; 2. the same input and options
//! give the same bytes at any thread count and any limit, however often the build was killed and gone on with; 3. the
//! output is a temporary file until it is whole; 4. nothing is left behind, but for a build that can be resumed what it
//! goes on from (`journal`).

mod cells;
mod chunk;
mod clusters;
mod emit;
mod in_order;
mod input_sizes;
mod journal;
mod lattice;
pub mod left_over;
mod model_materials;
mod pages;
mod partition;
mod phases;
mod plan;
mod progress_record;
mod publish;
mod record;
mod run_writer;
mod sah;
mod scratch;
mod snap;
mod sorted_record;
mod surface;
mod table_bytes;
#[cfg(test)]
mod tests;
mod voxels;
mod writer;

pub use crate::output::Existing;
pub use input_sizes::InputSizes;
pub use lattice::Scan;
pub use phases::{PhaseCpuMs, PhaseMs};
pub use plan::{Plan, smallest_bytes, smallest_bytes_for};

use crate::budget::Budget;
use crate::error::{Code, Error, Result};
use crate::octree::Refinement;
use crate::output::check_apart;
use crate::progress::{Interrupt, Progress, Report};
use crate::scratch::Place;
use crate::source::{SourceStats, TriangleSource};
use input_sizes::Counted;
use journal::Journal;
use model_materials::ModelMaterials;
use partition::{Partition, Start};
use phases::Clock;
use plan::plan;
use progress_record::Read;
use publish::Draft;
use rayon::ThreadPool;
use serde::Serialize;
use sorted_record::Begun;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// How the lattice step is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// Half a step is at most 1/128 of the median edge and 2^-17 of the extent.
    Default,
    /// The extent takes so many bits, 1 to 40.
    GridBits(u32),
    /// Half a step is at most this, model units.
    Error(f64),
}

/// Which voxel octree goes into the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Voxels {
    /// None: no global illumination from this file.
    None,
    /// As fine as the model's own bytes and this much resident memory allow.
    Within {
        /// Most bytes of the resident octree, without light.
        upper_bytes: u64,
    },
    /// So many leaves along the longest side: 64, 256, 512 or 1024.
    Resolution(u32),
    /// The same, with finer leaves below them that are read when they are asked for.
    Refined {
        /// Leaves of the resident octree along the longest side: 64, 256, 512 or 1024.
        upper: u32,
        /// How much finer the finest ones are.
        refinement: Refinement,
    },
}

impl Default for Voxels {
    fn default() -> Voxels {
        Voxels::Within { upper_bytes: 64 << 20 }
    }
}

/// Options of a build. The bytes of the output depend on `precision` and `voxels` alone.
#[derive(Clone, Debug)]
pub struct BuildOptions {
    /// The lattice.
    pub precision: Precision,
    /// The voxel octree.
    pub voxels: Voxels,
    /// The threads that chunks are built on. A build is called from another thread: it waits for these.
    pub pool: Arc<ThreadPool>,
    /// Where memory is leased from.
    pub budget: Budget,
    /// Folder of the scratch file; `None` = the output's folder.
    pub temp_dir: Option<PathBuf>,
    /// Whether an output that exists is kept or replaced.
    pub existing: Existing,
    /// Stops the build when raised.
    pub interrupt: Interrupt,
    /// How a build that is killed or interrupted goes on when it is started again; `None`: it leaves nothing.
    pub resume: Option<Resume>,
}

/// What a build does so that it can go on after it was killed.
#[derive(Clone, Debug)]
pub struct Resume {
    /// What tells the input apart from others, by name: paths, lengths, times. A build goes on with the same ones only.
    pub input: Vec<(String, String)>,
    /// About how much work a kill may cost, once the input has been read.
    pub every: Duration,
}

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

/// Builds `output` from `source`. `on_plan` is called once, before anything is written.
///
/// # Errors
/// Those of the source; [`Code::Usage`] when the output exists, the source names it, or the precision cannot be had;
/// [`Code::InputEmpty`] when no triangle is left; [`Code::MemoryLimit`], [`Code::DiskFull`], [`Code::Io`],
/// [`Code::Interrupted`]. Nothing is left behind then, but after an interrupt what [`BuildOptions::resume`] goes on
/// from.
///
/// # Panics
/// On a thread of the options' pool.
pub fn build(
    source: &mut dyn TriangleSource,
    output: &Path,
    options: &BuildOptions,
    on_plan: &(dyn Fn(&Plan) + Sync),
    report: Report<'_>,
) -> Result<BuildReport> {
    let mut clock = Clock::start();
    let folder = options.existing.check(output)?.to_path_buf();
    let scratch_folder = options.temp_dir.clone().unwrap_or_else(|| folder.clone());
    if !scratch_folder.is_dir() {
        return Err(Error::new(Code::Usage, "the folder for scratch files does not exist")
            .at(&scratch_folder)
            .next("make the folder, or name another with --temp-dir"));
    }
    let tell = |phase, unit, done, total| {
        report(Progress { phase, done, total, unit, memory_bytes: options.budget.used_bytes() });
    };
    if options.resume.is_none() {
        left_over::clean(output)?;
    }
    let mut journal = Journal::begin(output, &scratch_folder, options)?;
    let site = Site { output, folder: &folder, scratch_folder: &scratch_folder, options, tell: &tell };
    let built = site.build(source, journal.as_mut(), on_plan);
    let mut out = built.map_err(|error| match journal.as_mut().filter(|journal| journal.has_record) {
        Some(journal) if error.code() == Code::Interrupted => kept(error, output, journal.keep()),
        _ => error,
    })?;
    (out.phase_ms.total, out.phase_cpu_ms.total) = clock.lap();
    Ok(out)
}

/// What is built where.
struct Site<'a> {
    output: &'a Path,
    folder: &'a Path,
    scratch_folder: &'a Path,
    options: &'a BuildOptions,
    tell: lattice::Tell<'a>,
}

impl Site<'_> {
    fn build(
        &self,
        source: &mut dyn TriangleSource,
        mut journal: Option<&mut Journal>,
        on_plan: &(dyn Fn(&Plan) + Sync),
    ) -> Result<BuildReport> {
        let (options, tell) = (self.options, self.tell);
        let mut out = BuildReport::default();
        let mut clock = Clock::start();

        // What a build before this has done.
        let (mut done, mut read, mut begun) = (None, None, None);
        if let Some(journal) = &mut journal {
            (read, done) = journal.left(&options.budget)?;
            read.as_ref().map_or(Ok(()), |read| journal.compare_named(&read.source))?;
            if read.is_none() {
                begun = journal.left_sorted(options.precision, &options.budget)?;
            }
            let is_left = [("done", done.is_some()), ("chunks", read.is_some()), ("sorted", begun.is_some())];
            for (ending, _) in is_left.iter().filter(|(_, is_left)| !is_left) {
                journal.forget(ending)?;
            }
            journal.has_record = read.is_some() || begun.is_some();
        }

        let read = match read {
            Some(read) => {
                on_plan(&plan(&read.sizes, options, self.scratch_folder)?);
                read
            }
            None => self.read(source, begun, journal.as_deref_mut(), on_plan, &mut out)?,
        };
        self.check_apart(&read.source)?;
        clock.lap();

        // Clusters and pages, chunk by chunk, in order.
        let is_left = done.is_some();
        let draft =
            Draft::create(self.output, self.folder, self.scratch(journal.as_deref(), "part", is_left))?;
        let place = self.scratch(journal.as_deref(), "voxels", is_left);
        let Partition { octree, lattice_bounds, .. } = read.parted;
        let voxels = voxels::begin(octree, lattice_bounds, place, self.scratch_folder)?;
        let work = emit::Work { read: &read, voxels, journal, done };
        let block = emit::emit(work, options, draft.file(), tell, &mut out)?;
        let (wall, cpu) = clock.lap();
        out.phase_ms.clusters = wall.saturating_sub(out.phase_ms.voxels);
        out.phase_cpu_ms.clusters = cpu.saturating_sub(out.phase_cpu_ms.voxels);

        // Publish.
        draft.publish(self.output, &block, options, tell)?;
        (out.phase_ms.publish, out.phase_cpu_ms.publish) = clock.lap();
        out.source = read.source;
        Ok(out)
    }

    /// Reads the input into chunks.
    fn read(
        &self,
        source: &mut dyn TriangleSource,
        begun: Option<Begun>,
        mut journal: Option<&mut Journal>,
        on_plan: &(dyn Fn(&Plan) + Sync),
        out: &mut BuildReport,
    ) -> Result<Read> {
        let (options, tell) = (self.options, self.tell);
        let mut clock = Clock::start();
        // Scan: bounds and edges.
        let (scan, grid) = match &begun {
            Some(begun) => (begun.scan, begun.grid),
            None => {
                let scan = lattice::scan(source, options, tell, &mut out.phase_ms.generate)?;
                (scan, lattice::choose(&scan, options.precision, &source.name())?)
            }
        };
        self.check_apart(&source.stats())?;
        (out.phase_ms.scan, out.phase_cpu_ms.scan) = clock.lap();
        let known = InputSizes { triangle_count: scan.triangle_count, ..InputSizes::default() };
        on_plan(&plan(&known, options, self.scratch_folder)?);

        // Partition: snapped triangles in cells.
        out.resumed_sorted_count = begun.as_ref().map_or(0, |begun| begun.again.triangle_count);
        let place = self.scratch(journal.as_deref(), "cells", false);
        let start = Start { scan, grid, place, begun, journal: journal.as_deref_mut() };
        let mut source = Counted::new(source);
        let parted = partition::partition(&mut source, start, options, tell)?;
        out.phase_ms.generate += parted.wait_ms;
        let materials = ModelMaterials::of(source.materials(), &options.budget)?;
        let read = Read { parted, materials, sizes: source.sizes(), source: source.stats() };
        if let Some(journal) = journal.filter(|journal| journal.has_record || journal.is_due()) {
            journal.has_record = journal.write_chunks(&read, &options.budget)?;
            journal.forget("sorted")?;
            read.parted.scratch.let_go();
        }
        (out.phase_ms.partition, out.phase_cpu_ms.partition) = clock.lap();
        Ok(read)
    }

    /// Refuses an output that the input names: what a source has read is known once its stream has ended.
    fn check_apart(&self, source: &SourceStats) -> Result<()> {
        let mut named = source.named_files.iter().map(|(path, _)| Path::new(OsStr::from_bytes(path)));
        named.try_for_each(|named| check_apart(self.output, named))
    }

    /// Where the file of an ending is.
    fn scratch(&self, journal: Option<&Journal>, ending: &str, is_left: bool) -> Place {
        match journal {
            None => Place::Unnamed(self.scratch_folder.to_path_buf()),
            Some(journal) if is_left => Place::Left(journal.path(ending)),
            Some(journal) => Place::New(journal.path(ending)),
        }
    }
}

/// The error of an interrupt after which so many bytes are kept to go on from.
fn kept(error: Error, output: &Path, bytes: u64) -> Error {
    error
        .at(output)
        .numbers(format!(
            "{} MiB are kept beside the output, or in the folder of scratch",
            bytes.div_ceil(1 << 20)
        ))
        .next("run the same command again to go on, or remove them with trex build --clean")
}

/// What became of the triangles of an input of which none is left.
#[derive(Clone, Copy)]
struct Rejected {
    read: u64,
    degenerate: u64,
    /// Those of them that had area.
    collapsed: u64,
    non_finite: u64,
}

fn no_triangles(name: &str, Rejected { read, degenerate, collapsed, non_finite }: Rejected) -> Error {
    let what = match read {
        0 => "there are no triangles in the input",
        _ => "the input holds no triangle that can be drawn",
    };
    let next = match collapsed {
        0 => "check the input in the program that wrote it",
        _ => "ask for a finer lattice with --error: some triangles are smaller than its step",
    };
    Error::new(Code::InputEmpty, what)
        .at_place(name)
        .numbers(format!(
            "{read} triangles read, {degenerate} degenerate, {non_finite} with coordinates that are no finite numbers"
        ))
        .next(next)
}
