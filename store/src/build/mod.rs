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

mod clusters;
mod draft;
mod emit;
mod journal;
mod options;
mod partition;
mod phases;
mod plan;
mod report;
mod scan;
mod scratch;
#[cfg(test)]
mod tests;

pub use crate::output::Existing;
pub use journal::left_over;
pub use options::{BuildOptions, Precision, Resume, Voxels};
pub use phases::{PhaseCpuMs, PhaseMs};
pub use plan::Plan;
pub use report::BuildReport;
pub use scan::Scan;

use crate::error::{Code, Error, Result};
use crate::octree::Voxelizer;
use crate::progress::{Progress, Report};
use crate::scratch::Place;
use crate::source::TriangleSource;
use clusters::workspace::worker_bytes;
use draft::Draft;
use emit::{voxels, writer};
use journal::Journal;
use partition::outcome::Read;
use partition::sort_checkpoint::Begun;
use partition::{Partition, Start};
use phases::Clock;
use plan::plan;
use scan::lattice;
use std::path::Path;

/// Builds `output` from `source`. `on_plan` is called once, before anything is written.
///
/// # Errors
/// Those of the source; [`Code::Usage`] when the output exists or the precision cannot be had;
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
    tell: report::Tell<'a>,
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
                on_plan(&plan(read.parted.input_triangle_count, options, self.scratch_folder)?);
                read
            }
            None => self.read(source, begun, journal.as_deref_mut(), on_plan, &mut out)?,
        };
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
                let scan = scan::scan(source, options, tell, &mut out.phase_ms.generate)?;
                (scan, lattice::choose(&scan, options.precision, &source.name())?)
            }
        };
        (out.phase_ms.scan, out.phase_cpu_ms.scan) = clock.lap();
        on_plan(&plan(scan.triangle_count, options, self.scratch_folder)?);

        // Partition: snapped triangles in cells.
        out.resumed_sorted_count = begun.as_ref().map_or(0, |begun| begun.again.triangle_count);
        let place = self.scratch(journal.as_deref(), "cells", false);
        let start = Start { scan, grid, place, begun, journal: journal.as_deref_mut() };
        let parted = partition::partition(source, start, options, tell)?;
        out.phase_ms.generate += parted.wait_ms;
        let materials_json = serde_json::to_vec(source.materials()).expect("materials are plain data");
        let read = Read { parted, materials_json, source: source.stats() };
        if let Some(journal) = journal.filter(|journal| journal.has_record || journal.is_due()) {
            journal.has_record = journal.write_chunks(&read, &options.budget)?;
            journal.forget("sorted")?;
            read.parted.scratch.let_go();
        }
        (out.phase_ms.partition, out.phase_cpu_ms.partition) = clock.lap();
        Ok(read)
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

/// What a source may lease while it is read: materials, the directory of 64 million vertices.
const SOURCE_BYTES: u64 = 1 << 20;

/// Least bytes that a build leases beside what its source has leased when it is opened: a small model. [`Plan`] tells
/// what the tables of others take.
pub fn smallest_bytes() -> u64 {
    let builder = worker_bytes() + Voxelizer::BYTES + writer::TABLES_LEAST;
    partition::SMALLEST_BYTES.max(builder) + SOURCE_BYTES
}
