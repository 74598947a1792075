//! The two halves of a partition that many machines share: one counts the cells of an input, the others sort those of
//! their shard; or the one sorts all, and the others read them.
//!
//! ```text
//! count     stream -> snap -> cells, counted       -> summary, mean colours, `CellTable`      once
//!                                   or sorted      -> the same, and scratch, chunks
//! sort      stream -> snap -> cells of a range     -> scratch, chunks                         by each shard
//! ```
//!
//! Invariants: 1. the chunks of all shards, one shard behind the other, are those of a partition by one; 2. a shard
//! whose input is not the one that was counted ends in an error: its triangles are hashed on the way.

use super::batches::for_each_batch;
use super::cell_table::{CELL_BYTES, CellRange, CellTable};
use super::cells::{CellPlace, CellSink, PartitionCells, SortRule, SortedChunks, first_levels};
use super::chunk::Chunk;
use super::list_memory::ListMemory;
use super::snap::{SnapSummary, Snapper};
use super::summary::PartitionSummary;
use super::{SortMemory, summarize};
use crate::attributes::{AttributeSet, CornerAttributes};
use crate::budget::Lease;
use crate::build::options::BuildOptions;
use crate::build::report::PhaseReport;
use crate::build::scan::{Grid, Scan};
use crate::build::scratch::run_writer::RunWriter;
use crate::build::scratch::{LatticeTriangle, Scratch};
use crate::cluster::Colour;
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use crate::scratch::Place;
use crate::source::TriangleSource;
use std::collections::HashMap;
use std::time::Duration;

/// An input that was counted.
pub(crate) struct CellCensus {
    pub(crate) summary: PartitionSummary,
    pub(crate) mean_colours: Vec<Colour>,
    pub(crate) cells: CellTable,
    /// The triangles, where they were sorted.
    pub(crate) sorted: Option<(Scratch, Vec<Chunk>)>,
    _lease: Lease,
}

/// Counts triangles by cell.
struct CellCounts {
    rule: SortRule,
    cells: Vec<(CellPlace, u64)>,
    by_place: HashMap<CellPlace, usize>,
    /// Of the last triangle, and the index of its cell.
    last: Option<(CellPlace, usize)>,
}

impl CellSink for CellCounts {
    fn push(&mut self, triangle: LatticeTriangle, _: &CornerAttributes) -> Result<()> {
        let place = self.rule.place_of(&triangle);
        let index = match self.last {
            Some((last, index)) if last == place => index,
            _ => *self.by_place.entry(place).or_insert_with(|| {
                self.cells.push((place, 0));
                self.cells.len() - 1
            }),
        };
        self.last = Some((place, index));
        self.cells[index].1 += 1;
        Ok(())
    }
}

/// What is counted, and how.
pub(crate) struct CensusWork<'a> {
    pub(crate) scan: &'a Scan,
    pub(crate) grid: Grid,
    /// Where the triangles go, where they are sorted, too.
    pub(crate) scratch: Option<Scratch>,
    pub(crate) options: &'a BuildOptions,
    pub(crate) report: PhaseReport<'a>,
}

impl CensusWork<'_> {
    /// Counts the cells of an input, which is read once.
    pub(crate) fn run(mut self, source: &mut dyn TriangleSource) -> Result<CellCensus> {
        let CensusWork { scan, grid, options, .. } = self;
        let memory = SortMemory::lease(scan.attributes, &options.budget)?;
        let rule = memory.rule(first_levels(scan.triangle_count, &grid), &grid);
        let mut lease = options.budget.lease(CELLS, 0)?;
        let (mut snapper, mut snapped) = (Snapper::new(grid, source.name()), SnapSummary::new(scan, &grid));
        let stream = (&mut snapper, &mut snapped);
        let (counts, sorted) = match self.scratch.take() {
            None => {
                let mut counts = CellCounts { rule, cells: Vec::new(), by_place: HashMap::new(), last: None };
                self.read(source, stream, &mut counts, |counts| counts.cells.len(), &mut lease)?;
                (counts.cells, None)
            }
            Some(scratch) => {
                let lists = ListMemory::begin(&options.budget)?;
                let mut cells = PartitionCells::new(RunWriter::start(scratch)?, rule, lists);
                self.read(source, stream, &mut cells, PartitionCells::len, &mut lease)?;
                let counts = cells.counts();
                let SortedChunks { writer, chunks, lists } = cells.into_chunks(options)?;
                lease.absorb(lists.into_lease());
                (counts, Some((writer.finish(), chunks)))
            }
        };
        let cells = CellTable::new(rule, counts);
        let mean_colours = snapped.mean_colours();
        let summary = summarize(scan, cells.triangle_count(), snapped, &snapper, options.voxels)?;
        Ok(CellCensus { summary, mean_colours, cells, sorted, _lease: lease })
    }

    /// Snaps all triangles into `cells`, of which `lease` grows with the number.
    fn read<C: CellSink>(
        &self,
        source: &mut dyn TriangleSource,
        (snapper, snapped): (&mut Snapper, &mut SnapSummary),
        cells: &mut C,
        cell_count: impl Fn(&C) -> usize,
        lease: &mut Lease,
    ) -> Result<()> {
        for_each_batch(source, self.options, |batch| {
            snapper.hash(batch)?;
            snapper.snap_all(batch, snapped, cells)?;
            let bytes = cell_count(cells) as u64 * CELL_BYTES;
            lease.grow(CELLS, bytes.saturating_sub(lease.bytes()))?;
            (self.report)("scan", "triangles", snapper.read, self.scan.triangle_count);
            Ok(())
        })
        .map(drop)
    }
}

/// What tables of cells are called in messages.
const CELLS: &str = "the table of cells";

/// What a shard sorts.
pub(crate) struct ShardSort<'a> {
    /// What is known of the whole model.
    pub(crate) summary: &'a PartitionSummary,
    pub(crate) attributes: AttributeSet,
    /// The finest level of the first sort.
    pub(crate) levels: u32,
    pub(crate) range: CellRange,
    /// Where the sorted triangles go.
    pub(crate) place: Place,
    pub(crate) options: &'a BuildOptions,
    pub(crate) report: PhaseReport<'a>,
}

/// What a shard has sorted.
pub(crate) struct SortedShard {
    pub(crate) scratch: Scratch,
    pub(crate) chunks: Vec<Chunk>,
    /// Of the chunks.
    pub(crate) lists: Lease,
    /// Time that the source was waited for.
    pub(crate) waited: Duration,
}

/// The cells of a shard; triangles of others are dropped.
struct ShardCells {
    cells: PartitionCells,
    rule: SortRule,
    range: CellRange,
    /// Of the last triangle, and whether it is one of these.
    last: Option<(CellPlace, bool)>,
}

impl CellSink for ShardCells {
    fn push(&mut self, triangle: LatticeTriangle, attributes: &CornerAttributes) -> Result<()> {
        let place = self.rule.place_of(&triangle);
        let is_ours = match self.last {
            Some((last, is_ours)) if last == place => is_ours,
            _ => self.range.contains(&place),
        };
        self.last = Some((place, is_ours));
        if is_ours { self.cells.push_at(place, triangle, attributes) } else { Ok(()) }
    }
}

impl ShardSort<'_> {
    /// Reads the source once, and sorts what is the shard's.
    ///
    /// # Errors
    /// [`Code::Usage`] where the source does not deliver what was counted.
    pub(crate) fn run(self, source: &mut dyn TriangleSource) -> Result<SortedShard> {
        let ShardSort { summary, attributes, levels, range, place, options, report } = self;
        let memory = SortMemory::lease(attributes, &options.budget)?;
        let rule = memory.rule(levels, &summary.grid);
        let lists = ListMemory::begin(&options.budget)?;
        let cells = PartitionCells::new(RunWriter::start(Scratch::create(place)?)?, rule, lists);
        let mut cells = ShardCells { cells, rule, range, last: None };
        let mut snapper = Snapper::new(summary.grid, source.name());
        let all = summary.input_triangle_count;
        report("partition", "triangles", 0, all);
        let waited = for_each_batch(source, options, |batch| {
            if !attributes.holds(batch.attributes.set()) {
                return Err(changed(
                    snapper.name(),
                    "it has colours or normals, and had none then".to_owned(),
                ));
            }
            snapper.hash(batch)?;
            snapper.snap_known(batch, &mut cells)?;
            report("partition", "triangles", snapper.read, all);
            Ok(())
        })?;
        let found = snapper.prefix();
        if (found.triangle_count, found.hash) != (all, summary.content_hash) {
            let differences = format!(
                "{} triangles of hash {:016x}, {all} of {:016x} then",
                found.triangle_count, found.hash, summary.content_hash
            );
            return Err(changed(snapper.name(), differences));
        }
        let SortedChunks { writer, chunks, lists } = cells.cells.into_chunks(options)?;
        let sorted: u64 = chunks.iter().map(|chunk| chunk.triangle_count).sum();
        if sorted != range.triangle_count {
            let differences = format!("{sorted} triangles in the shard, {} then", range.triangle_count);
            return Err(changed(snapper.name(), differences));
        }
        Ok(SortedShard { scratch: writer.finish(), chunks, lists: lists.into_lease(), waited })
    }
}

/// The error of an input that is not the one that was counted.
fn changed(name: &str, differences: String) -> Error {
    Error::new(Code::Usage, "the input is not the one that the plan was made of")
        .at_place(name)
        .numbers(differences)
        .next(NextStep::ScanAgain)
}
