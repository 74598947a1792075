//! `PartitionCells`: snapped triangles sorted into cells, whose runs go to scratch; then cells joined into chunks.
//!
//! Invariants: 1. which triangles make a chunk, and in which order, follows from the stream alone; 2. buffered
//! triangles never exceed what `SortRule` allows.

use super::chunk::{CHUNK_TRIANGLES, Chunk, ChunkJoiner};
use crate::attributes::CornerAttributes;
use crate::build::options::BuildOptions;
use crate::build::scan::Grid;
use crate::build::scratch::run_writer::{RunWriter, WrittenRun};
use crate::build::scratch::{LatticeTriangle, RUN_TRIANGLES, Run, Scratch, TriangleList};
use crate::error::Result;
use crate::geom::hilbert_key;
use std::collections::HashMap;

/// Finest level of a first pass: 64^3 cells.
const LEVELS_FIRST: u32 = 6;
/// Levels that a second cut adds.
const LEVELS_MORE: u32 = 3;
/// Bits of a cell's Hilbert key per axis; cells cannot be cut finer.
const KEY_BITS: u32 = 18;

/// A cell: its place, also on the curve, its runs so far, and the buffered end.
struct PartitionCell {
    place: CellPlace,
    key: u64,
    runs: Vec<Run>,
    buffer: TriangleList,
    triangle_count: u64,
}

/// Which cell: its level, and where it is among the 2^level an axis.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct CellPlace {
    pub(crate) level: u32,
    pub(crate) at: [u32; 3],
}

impl CellPlace {
    /// On the Hilbert curve of the finest level.
    pub(super) fn key(&self) -> u64 {
        if self.level == 0 { 0 } else { hilbert_key(self.at, self.level) << (3 * (KEY_BITS - self.level)) }
    }
}

/// Where snapped triangles go, one by one.
pub(crate) trait CellSink {
    /// Takes the next one, with the attributes of its corners.
    fn push(&mut self, triangle: LatticeTriangle, attributes: &CornerAttributes) -> Result<()>;
}

/// What decides a triangle's cell.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum SortKey {
    SizeAndPlace,
    CellPlace,
}

/// How one pass sorts.
#[derive(Clone, Copy)]
pub(crate) struct SortRule {
    pub(crate) by: SortKey,
    /// Finest level: 2^levels cells an axis.
    pub(crate) levels: u32,
    /// Bits of a lattice coordinate.
    pub(crate) bits: u32,
    /// Most triangles in buffers.
    pub(crate) buffered_most: u64,
}

impl SortRule {
    /// Whether it can be that of a first sort.
    pub(crate) fn is_first(&self) -> bool {
        self.levels <= LEVELS_FIRST.min(self.bits)
    }

    /// Whether a cell of so many triangles is cut again, finer.
    pub(super) fn is_cut_again(&self, place: &CellPlace, triangle_count: u64) -> bool {
        triangle_count > CHUNK_TRIANGLES && place.level < self.finest()
    }

    /// The finest level of all.
    fn finest(&self) -> u32 {
        KEY_BITS.min(self.bits)
    }

    /// The cell of a triangle.
    pub(super) fn place_of(&self, triangle: &LatticeTriangle) -> CellPlace {
        let [a, b, c] = &triangle.q;
        let (bits, mut level) = (self.bits, self.levels);
        if self.by == SortKey::SizeAndPlace {
            let side =
                (0..3).map(|i| a[i].max(b[i]).max(c[i]) - a[i].min(b[i]).min(c[i])).max().expect("three");
            level = level.min(bits.saturating_sub(64 - (side as u64).leading_zeros()));
        }
        let at = std::array::from_fn(|axis| (((a[axis] + b[axis] + c[axis]) / 3) >> (bits - level)) as u32);
        CellPlace { level, at }
    }
}

impl PartitionCell {
    fn new(place: CellPlace, runs: Vec<Run>) -> PartitionCell {
        let triangle_count = runs.iter().map(|run| u64::from(run.triangle_count)).sum();
        PartitionCell { place, key: place.key(), runs, buffer: TriangleList::default(), triangle_count }
    }
}

/// Finest level of the first pass: cells of some 2^15 triangles on a surface.
pub(crate) fn first_levels(triangle_count: u64, grid: &Grid) -> u32 {
    let across = (triangle_count as f64 / 131_072.0).sqrt();
    (across.max(1.0).log2().ceil() as u32).min(LEVELS_FIRST).min(grid.bits)
}

/// All cells of one pass.
pub(crate) struct PartitionCells {
    writer: RunWriter,
    sorted: SortRule,
    cells: Vec<PartitionCell>,
    by_place: HashMap<CellPlace, usize>,
    /// Of the last triangle, and the index of its cell.
    last: (CellPlace, usize),
    /// Triangles in buffers, and on their way to scratch.
    buffered: u64,
}

impl PartitionCells {
    pub(crate) fn new(writer: RunWriter, sorted: SortRule) -> PartitionCells {
        let nowhere = (CellPlace { level: u32::MAX, at: [0; 3] }, 0);
        PartitionCells {
            writer,
            sorted,
            cells: Vec::new(),
            by_place: HashMap::new(),
            last: nowhere,
            buffered: 0,
        }
    }

    /// Adds a triangle to its cell.
    pub(super) fn push_at(
        &mut self,
        place: CellPlace,
        triangle: LatticeTriangle,
        attributes: &CornerAttributes,
    ) -> Result<()> {
        let index = self.cell_of(place);
        let cell = &mut self.cells[index];
        cell.buffer.push(triangle, attributes);
        cell.triangle_count += 1;
        self.buffered += 1;
        if cell.buffer.len() >= RUN_TRIANGLES {
            self.write_run(index)?;
        }
        if self.buffered >= self.sorted.buffered_most {
            self.write_all()?;
        }
        Ok(())
    }

    fn cell_of(&mut self, place: CellPlace) -> usize {
        if self.last.0 == place {
            return self.last.1;
        }
        let cells = &mut self.cells;
        let index = *self.by_place.entry(place).or_insert_with(|| {
            cells.push(PartitionCell::new(place, Vec::new()));
            cells.len() - 1
        });
        self.last = (place, index);
        index
    }

    fn write_run(&mut self, index: usize) -> Result<()> {
        let cell = &mut self.cells[index];
        if cell.buffer.is_empty() {
            return Ok(());
        }
        // The memory goes with it: many cells are left behind by the stream and never filled again.
        let buffer = std::mem::take(&mut cell.buffer);
        if let Some(written) = self.writer.write(index, buffer)? {
            self.add_run(written);
        }
        Ok(())
    }

    fn add_run(&mut self, WrittenRun { owner, run }: WrittenRun) {
        self.cells[owner].runs.push(run);
        self.buffered -= u64::from(run.triangle_count);
    }

    /// Writes what is buffered.
    fn write_all(&mut self) -> Result<()> {
        (0..self.cells.len()).try_for_each(|index| self.write_run(index))?;
        while let Some(written) = self.writer.next()? {
            self.add_run(written);
        }
        Ok(())
    }

    /// Writes what is buffered, and waits until all runs are on the disk.
    pub(crate) fn sync(&mut self) -> Result<()> {
        self.write_all()?;
        self.writer.scratch().flush()
    }

    /// The scratch file, and every cell's runs.
    pub(crate) fn runs(&self) -> (&Scratch, impl Iterator<Item = (CellPlace, &[Run])> + Clone) {
        (self.writer.scratch(), self.cells.iter().map(|cell| (cell.place, cell.runs.as_slice())))
    }

    /// Count of cells.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// The cells, with the counts of their triangles.
    pub(super) fn counts(&self) -> Vec<(CellPlace, u64)> {
        self.cells.iter().map(|cell| (cell.place, cell.triangle_count)).collect()
    }

    /// Restores the runs of cells that [`Self::runs`] gave, whose scratch file this one has.
    pub(crate) fn restore(&mut self, runs: Vec<(CellPlace, Vec<Run>)>) {
        for (place, runs) in runs {
            self.by_place.insert(place, self.cells.len());
            self.writer.scratch().set_unread(runs.iter().map(|run| (*run, run.triangle_count)));
            self.cells.push(PartitionCell::new(place, runs));
        }
    }

    /// Writes what is buffered, cuts cells that are too full, joins small ones.
    pub(crate) fn into_chunks(mut self, options: &BuildOptions) -> Result<(RunWriter, Vec<Chunk>)> {
        self.write_all()?;
        let mut whole = std::mem::take(&mut self.cells);
        // Large triangles first, then along the curve; a place is one cell, so the order is total.
        whole.sort_by_key(|cell| (cell.place.level, cell.key));
        let mut chunks = ChunkJoiner::default();
        for cell in whole {
            options.interrupt.check()?;
            if self.sorted.is_cut_again(&cell.place, cell.triangle_count) {
                let levels = (cell.place.level + LEVELS_MORE).min(self.sorted.finest());
                let (writer, finer) = cut(&cell, self.writer, levels, &self.sorted, options)?;
                self.writer = writer;
                chunks.close();
                chunks.done.extend(finer);
            } else {
                chunks.add(cell.triangle_count, &cell.runs);
            }
        }
        chunks.close();
        self.writer.scratch().flush()?;
        Ok((self.writer, chunks.done))
    }
}

impl CellSink for PartitionCells {
    fn push(&mut self, triangle: LatticeTriangle, attributes: &CornerAttributes) -> Result<()> {
        self.push_at(self.sorted.place_of(&triangle), triangle, attributes)
    }
}

/// Sorts the triangles of a cell that is too full into finer cells, by place alone: it may be full of
/// triangles as large as itself.
fn cut(
    cell: &PartitionCell,
    writer: RunWriter,
    levels: u32,
    like: &SortRule,
    options: &BuildOptions,
) -> Result<(RunWriter, Vec<Chunk>)> {
    let mut finer = PartitionCells::new(writer, SortRule { levels, by: SortKey::CellPlace, ..*like });
    let (mut buffer, mut list) = (Vec::new(), TriangleList::default());
    for run in &cell.runs {
        list.clear();
        finer.writer.scratch().read(run, &mut buffer, &mut list)?;
        // A run that somebody else has sealed may hold what no lattice does.
        if !list.triangles.iter().all(|triangle| is_on_lattice(&triangle.q, like.bits)) {
            return Err(finer.writer.scratch().damaged(run.offset));
        }
        finer.writer.scratch().consume(run, run.triangle_count);
        let mut all = list.triangles.iter().enumerate();
        all.try_for_each(|(index, &triangle)| finer.push(triangle, &list.attributes_of(index)))?;
    }
    finer.into_chunks(options)
}

/// Whether all coordinates have so many bits.
pub(crate) fn is_on_lattice<const N: usize>(q: &[[i64; 3]; N], bits: u32) -> bool {
    q.as_flattened().iter().all(|q| (0..1 << bits).contains(q))
}
