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
//! give the same bytes at any thread count and any limit, however often the build was killed and resumed; 3. the
//! output is a temporary file until it is whole; 4. nothing is left behind, but for a build that can be resumed what it
//! resumes from (`journal`, `checkpoint`).

mod checkpoint;
mod clusters;
mod draft;
mod emit;
mod fragment;
mod input_sizes;
mod journal;
mod model_materials;
mod options;
mod partition;
mod phases;
mod plan;
mod planned_triangles;
mod report;
mod scan;
mod scratch;
mod shard_file;
mod shard_plan;
pub mod shards;
mod site;
#[cfg(test)]
mod tests;

pub use crate::output::ExistingOutput;
pub use input_sizes::InputSizes;
pub use journal::left_over;
pub use options::{BuildOptions, Precision, Resume, Voxels};
pub use phases::{PhaseCpuMs, PhaseMs};
pub use plan::{Plan, smallest_bytes, smallest_bytes_for};
pub use report::BuildReport;
pub use scan::Scan;

use crate::error::Result;
use crate::output::check_apart;
use crate::progress::{Progress, Report};
use crate::source::{SourceStats, TriangleSource};
use checkpoint::{Checkpoint, FilePlaces};
use draft::Draft;
use emit::voxels::VoxelWork;
use input_sizes::CountingSource;
use journal::{FileKind, Journal};
use model_materials::ModelMaterials;
use partition::outcome::PartitionOutcome;
use partition::{PartitionWork, SortStart};
use phases::PhaseClock;
use plan::plan;
use scan::{Grid, lattice};
use site::{BuildSite, stopped};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Builds `output` from `source`. `on_plan` is called once, before anything is written.
///
/// # Errors
/// Those of the source; [`Code::Usage`](crate::Code::Usage) when the output exists, the source names it, or the
/// precision cannot be had; [`Code::InputEmpty`](crate::Code::InputEmpty) when no triangle is left;
/// [`Code::MemoryLimit`](crate::Code::MemoryLimit), [`Code::DiskFull`](crate::Code::DiskFull),
/// [`Code::Io`](crate::Code::Io), [`Code::Interrupted`](crate::Code::Interrupted). Nothing is left behind then, but
/// after an interrupt, and where the limit was too small, what [`BuildOptions::resume`] resumes from.
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
    let mut clock = PhaseClock::start();
    let BuildSite { folder, scratch_folder } = BuildSite::check(output, options)?;
    let report_phase = |phase, unit, done, total| {
        report(Progress { phase, done, total, unit, memory_bytes: options.budget.used_bytes() });
    };
    let mut journal = Journal::begin(output, &scratch_folder, options)?;
    let site = Site {
        output,
        folder: &folder,
        scratch_folder: &scratch_folder,
        options,
        report: &report_phase,
        on_plan,
    };
    let built = site.build(source, journal.as_mut());
    let mut out = built.map_err(|error| stopped(error, output, journal.as_mut()))?;
    (out.phase_ms.total, out.phase_cpu_ms.total) = clock.lap();
    Ok(out)
}

/// What is built where.
struct Site<'a> {
    output: &'a Path,
    folder: &'a Path,
    scratch_folder: &'a Path,
    options: &'a BuildOptions,
    report: report::PhaseReport<'a>,
    on_plan: &'a (dyn Fn(&Plan) + Sync),
}

impl Site<'_> {
    fn build(
        &self,
        source: &mut dyn TriangleSource,
        mut journal: Option<&mut Journal>,
    ) -> Result<BuildReport> {
        let mut out = BuildReport::default();

        // Where a build before this was stopped.
        let checkpoint = Checkpoint::find(journal.as_deref_mut(), self.options)?;
        let FilePlaces { cells: place, voxels, draft } =
            checkpoint.places(journal.as_deref(), self.scratch_folder);

        // The input in chunks: scan, lattice, partition.
        let (outcome, emitted) = match checkpoint {
            Checkpoint::Fresh => {
                let (scan, grid) = self.scan(source, &mut out)?;
                let start = SortStart::New { scan, grid, place };
                (self.partition(source, start, journal.as_deref_mut(), &mut out)?, None)
            }
            Checkpoint::Sorted(sorted) => {
                self.plan(&InputSizes {
                    triangle_count: sorted.scan.triangle_count,
                    attributes: sorted.scan.attributes,
                    ..InputSizes::default()
                })?;
                let start = SortStart::Resumed(sorted);
                (self.partition(source, start, journal.as_deref_mut(), &mut out)?, None)
            }
            Checkpoint::Partitioned(outcome) => {
                self.plan(&outcome.sizes)?;
                (*outcome, None)
            }
            Checkpoint::Emitting(outcome, emitted) => {
                self.plan(&outcome.sizes)?;
                (*outcome, Some(*emitted))
            }
        };
        self.check_apart(&outcome.source)?;
        out.keeping_error = outcome.partition.summary.keeping_error();

        // Clusters, voxels, pages: chunk by chunk, in order.
        let mut clock = PhaseClock::start();
        let draft = Draft::create(self.output, self.folder, draft)?;
        let folder = self.scratch_folder;
        let voxels = VoxelWork::begin(&outcome.partition.summary, voxels)?;
        let work = emit::EmitWork { outcome: &outcome, voxels, journal, checkpoint: emitted, folder };
        let block = emit::emit(work, self.options, draft.file(), self.report, &mut out)?;
        let (wall, cpu) = clock.lap();
        out.phase_ms.clusters = wall.saturating_sub(out.phase_ms.voxels);
        out.phase_cpu_ms.clusters = cpu.saturating_sub(out.phase_cpu_ms.voxels);

        // Publish.
        draft.publish(self.output, &block, self.options, self.report)?;
        (out.phase_ms.publish, out.phase_cpu_ms.publish) = clock.lap();
        out.source = outcome.source;
        Ok(out)
    }

    /// Bounds and edges of the input, and the lattice for them.
    fn scan(&self, source: &mut dyn TriangleSource, out: &mut BuildReport) -> Result<(Scan, Grid)> {
        let mut clock = PhaseClock::start();
        let scan = scan::scan(source, self.options, self.report, &mut out.phase_ms.generate)?;
        let grid = lattice::choose(&scan, self.options.precision, &source.name())?;
        self.check_apart(&source.stats())?;
        (out.phase_ms.scan, out.phase_cpu_ms.scan) = clock.lap();
        let Scan { triangle_count, attributes, .. } = scan;
        self.plan(&InputSizes { triangle_count, attributes, ..InputSizes::default() })?;
        Ok((scan, grid))
    }

    /// Hands out the plan for an input of such sizes.
    fn plan(&self, sizes: &InputSizes) -> Result<()> {
        (self.on_plan)(&plan(sizes, self.options, self.scratch_folder)?);
        Ok(())
    }

    /// Refuses an output that the input names: what a source has read is known once its stream has ended.
    fn check_apart(&self, source: &SourceStats) -> Result<()> {
        let mut named = source.named_files.iter().map(|(path, _)| Path::new(OsStr::from_bytes(path)));
        named.try_for_each(|named| check_apart(self.output, named))
    }

    /// Snapped triangles in cells, and these in chunks.
    fn partition(
        &self,
        source: &mut dyn TriangleSource,
        start: SortStart,
        mut journal: Option<&mut Journal>,
        out: &mut BuildReport,
    ) -> Result<PartitionOutcome> {
        let mut clock = PhaseClock::start();
        out.resumed_sorted_count = start.sorted_count();
        let (options, report) = (self.options, self.report);
        let work = PartitionWork { start, journal: journal.as_deref_mut(), options, report };
        let mut source = CountingSource::new(source);
        let partition = partition::partition(&mut source, work)?;
        out.phase_ms.generate += partition.wait_ms;
        let materials = ModelMaterials::of(source.materials(), &partition.mean_colours, &options.budget)?;
        let (sizes, source) = (source.sizes(), source.stats());
        let outcome = PartitionOutcome { partition, materials, sizes, source };
        if let Some(journal) = journal.filter(|journal| journal.has_records() || journal.is_due()) {
            outcome.record(journal, &options.budget)?;
            journal.remove_record(FileKind::Sorted)?;
            outcome.partition.scratch.release_segments();
        }
        (out.phase_ms.partition, out.phase_cpu_ms.partition) = clock.lap();
        Ok(outcome)
    }
}
