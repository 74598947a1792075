//! Partition: triangles are snapped to the lattice and sorted into cells; runs of each cell go to scratch.
//!
//! A loose octree without pointers: a triangle goes to the finest level whose cells are at least as large as
//! the triangle, and there to the cell of its centroid; so plates do not widen the boxes of bolts. Cells are
//! then put in Hilbert order and joined into *chunks* of up to [`CHUNK_TRIANGLES`](chunk::CHUNK_TRIANGLES); a
//! cell with more is cut again, finer.
//!
//! Invariants: 1. which triangles make a chunk, and in which order, follows from the stream alone: not from
//! threads, limits or the lengths of runs; 2. buffered triangles never exceed the leased bytes; 3. a chunk holds
//! at most `CHUNK_TRIANGLES`.

mod batches;
pub(super) mod cell_table;
pub(super) mod cells;
pub(super) mod chunk;
mod collapsed;
mod colour_means;
mod list_memory;
pub(super) mod outcome;
mod resolution;
pub(super) mod shard;
mod snap;
pub(super) mod sort_checkpoint;
pub(super) mod summary;
mod surface;

pub(super) use resolution::VoxelPlan;

use crate::attributes::AttributeSet;
use crate::budget::{Budget, Lease};
use crate::build::input_sizes::InputSizes;
use crate::build::journal::Journal;
use crate::build::options::{BuildOptions, Voxels};
use crate::build::report::PhaseReport;
use crate::build::scan::rejected::{RejectedCounts, no_triangles};
use crate::build::scan::{Grid, Scan};
use crate::build::scratch::run_writer::RunWriter;
use crate::build::scratch::{RUN_TRIANGLES, Run, Scratch, TriangleList};
use crate::cluster::Colour;
use crate::error::{Code, Error, Result};
use crate::scratch::Place;
use crate::source::{TriangleBatch, TriangleSource};
use batches::{BATCHES, for_each_batch};
use cells::{
    CELL_BYTES, PartitionCells, RUNS_LEAST, SortKey, SortRule, SortedChunks, first_levels, levels_of,
};
use chunk::{Chunk, Piece};
use colour_means::ColourMeans;
use list_memory::ListMemory;
use snap::{Prefix, SnapSummary, Snapper};
use sort_checkpoint::SortCheckpoint;
use std::time::Duration;
use summary::PartitionSummary;

/// Times that a surface crosses its cube, rounded up: see `resolution.rs`.
const CROSSINGS: u64 = 7;
/// Memory for buffered triangles: at least this, so that runs are worth a disk access.
const BUFFER_BYTES_LEAST: u64 = 16 << 20;
/// Most memory for buffered triangles; more does not make runs longer.
const BUFFER_BYTES_MOST: u64 = 128 << 20;

/// The whole input in chunks, or a shard of it, in scratch.
pub(crate) struct Partition {
    pub(crate) scratch: Scratch,
    pub(crate) chunks: Vec<Chunk>,
    pub(crate) summary: PartitionSummary,
    /// Of each material, once; none where the input has no colours.
    pub(crate) mean_colours: Vec<Colour>,
    pub(crate) wait_ms: u64,
    /// Of `chunks`; `None` where somebody else holds it.
    pub(crate) _lists: Option<Lease>,
}

impl Partition {
    /// Triangles in chunks: those of the model, or of a shard of it.
    pub(crate) fn chunk_triangle_count(&self) -> u64 {
        self.chunks.iter().map(|chunk| chunk.triangle_count).sum()
    }

    /// Counts the triangles of chunks from `first` on as those that are still to be read from scratch.
    pub(crate) fn set_unread(&self, first: usize) {
        let pieces = self.chunks[first..].iter().flat_map(|chunk| &chunk.pieces);
        self.scratch.set_unread(pieces.map(|piece| (piece.run, piece.take)));
    }
}

/// Where sorting starts.
pub(crate) enum SortStart {
    /// At the first triangle, into a new scratch file.
    New { scan: Scan, grid: Grid, place: Place },
    /// Behind what a build before this has sorted.
    Resumed(Box<SortCheckpoint>),
}

impl SortStart {
    /// What is known of the input.
    fn scan(&self) -> &Scan {
        match self {
            SortStart::New { scan, .. } => scan,
            SortStart::Resumed(checkpoint) => &checkpoint.scan,
        }
    }

    /// Triangles that are in cells already.
    pub(crate) fn sorted_count(&self) -> u64 {
        match self {
            SortStart::New { .. } => 0,
            SortStart::Resumed(checkpoint) => checkpoint.prefix.triangle_count,
        }
    }
}

/// What the phase works with.
pub(crate) struct PartitionWork<'a> {
    pub(crate) start: SortStart,
    /// Where it is recorded how far the work is, so that it can resume.
    pub(crate) journal: Option<&'a mut Journal>,
    pub(crate) options: &'a BuildOptions,
    pub(crate) report: PhaseReport<'a>,
}

/// Runs the phase. The source is read once, on its own thread.
pub(crate) fn partition(source: &mut dyn TriangleSource, work: PartitionWork<'_>) -> Result<Partition> {
    let PartitionWork { start, journal, options, report } = work;
    let memory = SortMemory::lease(start.scan().attributes, &options.budget)?;
    let lists = ListMemory::begin(&options.budget)?;
    let sorted_count = start.sorted_count();
    let name = source.name();
    let rule = |scan: &Scan, grid: &Grid| memory.rule(first_levels(scan.triangle_count, grid), grid);
    let (mut sorter, grid) = match start {
        SortStart::New { scan, grid, place } => {
            let writer = RunWriter::start(Scratch::create(place)?)?;
            let cells = PartitionCells::new(writer, rule(&scan, &grid), lists);
            let snapped = SnapSummary::new(&scan, &grid);
            (Sorter { scan, is_resumed: false, again: None, snapped, cells, journal }, grid)
        }
        SortStart::Resumed(checkpoint) => {
            let SortCheckpoint { scan, grid, prefix, snapped, scratch, runs } = *checkpoint;
            let mut cells = PartitionCells::new(RunWriter::start(scratch)?, rule(&scan, &grid), lists);
            cells.restore(runs)?;
            let again = Some(prefix).filter(|prefix| prefix.triangle_count > 0);
            (Sorter { scan, is_resumed: true, again, snapped, cells, journal }, grid)
        }
    };
    let scan = sorter.scan;
    let mut snapper = Snapper::new(grid, name.clone());
    let report_count = |count| report("partition", "triangles", count, scan.triangle_count);
    let waited = sorter.run(source, &mut snapper, options, &report_count);
    let sorted_count = snapper.read.max(sorted_count);
    let lacking_bytes = sorter.cells.lacking_bytes([sorted_count, scan.triangle_count]);
    let waited = waited.map_err(|error| error.with_room(lacking_bytes))?;

    let Sorter { cells, snapped, .. } = sorter;
    let chunked = cells.into_chunks(options).map_err(|error| error.with_room(lacking_bytes));
    let SortedChunks { writer, chunks, lists } = chunked?;
    let triangle_count = chunks.iter().map(|c| c.triangle_count).sum();
    let mean_colours = snapped.mean_colours();
    Ok(Partition {
        scratch: writer.finish(),
        chunks,
        summary: summarize(&scan, triangle_count, snapped, &snapper, options.voxels)?,
        mean_colours,
        wait_ms: waited.as_millis() as u64,
        _lists: Some(lists.into_lease()),
    })
}

/// What is known of an input of which `triangle_count` triangles are in cells.
///
/// # Errors
/// [`Code::InputEmpty`](crate::Code::InputEmpty) where there are none.
fn summarize(
    scan: &Scan,
    triangle_count: u64,
    snapped: SnapSummary,
    snapper: &Snapper,
    voxels: Voxels,
) -> Result<PartitionSummary> {
    if triangle_count == 0 {
        let rejected = RejectedCounts {
            read: snapper.read,
            degenerate: snapped.rejected_degenerate,
            collapsed: snapped.collapsed.count(),
            non_finite: snapped.rejected_non_finite,
        };
        return Err(no_triangles(snapper.name(), rejected));
    }
    let (grid, lattice_bounds) = (snapper.grid(), [snapped.bounds.lo, snapped.bounds.hi]);
    Ok(PartitionSummary {
        grid,
        input_triangle_count: snapper.read,
        triangle_count,
        rejected_degenerate: snapped.rejected_degenerate,
        collapsed: snapped.collapsed,
        rejected_non_finite: snapped.rejected_non_finite,
        error_bound: if snapped.exact { 0.0 } else { grid.lattice.step() / 2.0 },
        lattice_bounds,
        median_edge: scan.median_edge,
        octree: resolution::resolution(voxels, &snapped.surface, lattice_bounds, triangle_count),
        content_hash: snapper.prefix().hash,
    })
}

/// The memory in which triangles are sorted.
struct SortMemory {
    /// Most triangles that buffers have room for.
    buffered_most: u64,
    _leases: [Lease; 3],
}

impl SortMemory {
    fn lease(attributes: AttributeSet, budget: &Budget) -> Result<SortMemory> {
        let batch_bytes = BATCHES * TriangleBatch::bytes(attributes);
        let batches = budget.lease("batches of triangles", batch_bytes)?;
        let means = budget.lease("the mean colours of materials", means_bytes(attributes))?;
        let buffer_bytes = buffer_bytes(budget.free_bytes());
        let buffers = budget.lease("the cells' buffers", buffer_bytes)?;
        let buffered_most = buffer_bytes / triangle_bytes(attributes);
        Ok(SortMemory { buffered_most, _leases: [batches, means, buffers] })
    }

    /// The rule of a first sort.
    fn rule(&self, levels: u32, grid: &Grid) -> SortRule {
        SortRule { by: SortKey::SizeAndPlace, levels, bits: grid.bits, buffered_most: self.buffered_most }
    }
}

/// Triangles on their way into cells.
struct Sorter<'a> {
    scan: Scan,
    /// True where the scan is of a build before this.
    is_resumed: bool,
    /// What is in the cells since a build before this: it is read again, and compared.
    again: Option<Prefix>,
    snapped: SnapSummary,
    cells: PartitionCells,
    journal: Option<&'a mut Journal>,
}

impl Sorter<'_> {
    /// Reads the source on a thread of its own, and sorts what comes into cells; gives the time that it was waited for.
    fn run(
        &mut self,
        source: &mut dyn TriangleSource,
        snapper: &mut Snapper,
        options: &BuildOptions,
        report: &dyn Fn(u64),
    ) -> Result<Duration> {
        report(0);
        if self.again.is_none() {
            self.record(snapper, options)?;
        }
        let waited = for_each_batch(source, options, |batch| {
            snapper.hash(batch)?;
            match self.again {
                None => self.snap(batch, snapper)?,
                Some(prefix) => self.compare(prefix, snapper)?,
            }
            report(snapper.read);
            if self.again.is_none() { self.record(snapper, options) } else { Ok(()) }
        })?;
        self.again.map_or(Ok(waited), |prefix| Err(self.changed(prefix)))
    }

    /// Snaps a batch into cells. What lies outside of a scan of a build before this is of another input than that.
    fn snap(&mut self, batch: &TriangleBatch, snapper: &Snapper) -> Result<()> {
        let snapped = snapper.snap_all(batch, &mut self.snapped, &mut self.cells);
        snapped.map_err(|error| match &mut self.journal {
            Some(journal) if self.is_resumed && error.code() == Code::InputFormat => {
                journal.refuse(error.numbers_text().to_owned())
            }
            _ => error,
        })
    }

    /// Records how far it is, where that is due.
    fn record(&mut self, snapper: &Snapper, options: &BuildOptions) -> Result<()> {
        let Some(journal) = self.journal.as_deref_mut().filter(|journal| journal.is_due()) else {
            return Ok(());
        };
        let read = (&self.scan, snapper.prefix());
        SortCheckpoint::record(journal, read, &self.snapped, &mut self.cells, &options.budget)
    }

    /// Holds what was read so far against what a build before this had read.
    fn compare(&mut self, prefix: Prefix, snapper: &Snapper) -> Result<()> {
        if snapper.read < prefix.triangle_count {
            return Ok(());
        }
        if snapper.prefix() != prefix {
            return Err(self.changed(prefix));
        }
        self.again = None;
        Ok(())
    }

    fn changed(&mut self, prefix: Prefix) -> Error {
        let differences =
            format!("the first {} triangles are not those that were read then", prefix.triangle_count);
        self.journal.as_mut().expect("a checkpoint is of a journal").refuse(differences)
    }
}

/// Bytes for buffered triangles when so many are free.
fn buffer_bytes(free_bytes: u64) -> u64 {
    (free_bytes / 3).clamp(BUFFER_BYTES_LEAST, BUFFER_BYTES_MOST)
}

/// Least that this phase leases.
pub(crate) fn smallest_bytes(sizes: &InputSizes) -> u64 {
    BUFFER_BYTES_LEAST + fixed_bytes(sizes)
}

/// About the cells and runs of a surface of so many triangles that come in the order of their places.
fn list_counts(triangle_count: u64) -> [u64; 2] {
    let levels = levels_of(triangle_count);
    let cells = (CROSSINGS << (2 * levels)).min(1 << (3 * levels));
    [cells, 2 * triangle_count.div_ceil(RUN_TRIANGLES as u64) + RUNS_LEAST as u64 * cells]
}

/// About the bytes of its chunks.
pub(crate) fn chunks_bytes(triangle_count: u64) -> u64 {
    let [_, runs] = list_counts(triangle_count);
    runs * size_of::<Piece>() as u64
}

/// About the bytes of all its lists.
fn list_bytes(triangle_count: u64) -> u64 {
    let [cells, runs] = list_counts(triangle_count);
    cells * CELL_BYTES + runs * size_of::<Run>() as u64 + chunks_bytes(triangle_count)
}

/// Bytes beside the buffers.
fn fixed_bytes(sizes: &InputSizes) -> u64 {
    let attributes = sizes.attributes;
    let lists = list_bytes(sizes.triangle_count);
    BATCHES * TriangleBatch::bytes(attributes) + means_bytes(attributes) + lists
}

/// Bytes for the mean colours of materials.
fn means_bytes(attributes: AttributeSet) -> u64 {
    if attributes.colours { ColourMeans::BYTES } else { 0 }
}

/// Bytes of a buffered triangle.
fn triangle_bytes(attributes: AttributeSet) -> u64 {
    TriangleList::TRIANGLE_BYTES + attributes.row_bytes()
}

/// Bytes that this phase leases when so many are free.
pub(crate) fn phase_bytes(free_bytes: u64, sizes: &InputSizes) -> u64 {
    let fixed = fixed_bytes(sizes);
    fixed + buffer_bytes(free_bytes.saturating_sub(fixed))
}
