//! `PartitionCells`: snapped triangles sorted into cells, whose runs go to scratch; then cells joined into chunks.
//!
//! Invariants: 1. which triangles make a chunk, and in which order, follows from the stream alone; 2. buffers have no
//! more room than `SortRule` allows; 3. lists are leased before they grow (`ListMemory`).

use super::chunk::{CHUNK_TRIANGLES, Chunk, ChunkJoiner, Piece};
use super::list_memory::ListMemory;
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
/// Runs that a cell gets room for at first; then for twice as many.
pub(super) const RUNS_LEAST: usize = 4;
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
    /// Most triangles that buffers have room for.
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
    levels_of(triangle_count).min(grid.bits)
}

/// The same on a fine lattice.
pub(super) fn levels_of(triangle_count: u64) -> u32 {
    let across = (triangle_count as f64 / 131_072.0).sqrt();
    (across.max(1.0).log2().ceil() as u32).min(LEVELS_FIRST)
}

/// All cells of one pass.
pub(crate) struct PartitionCells {
    writer: RunWriter,
    sorted: SortRule,
    cells: Vec<PartitionCell>,
    by_place: HashMap<CellPlace, usize>,
    /// Of the last triangle, and the index of its cell.
    last: (CellPlace, usize),
    /// Triangles that buffers, here and on their way to scratch, have room for.
    buffered: u64,
    lists: ListMemory,
    /// What `lists` holds for these cells and their runs.
    list_bytes: u64,
}

/// Chunks, the scratch file that they are in, and the memory of their lists.
pub(crate) struct SortedChunks {
    pub(crate) writer: RunWriter,
    pub(crate) chunks: Vec<Chunk>,
    pub(crate) lists: ListMemory,
}

/// Bytes of a cell in lists that grow by doubling, and are there twice while they grow.
pub(super) const CELL_BYTES: u64 =
    3 * size_of::<PartitionCell>() as u64 + 4 * size_of::<(CellPlace, usize)>() as u64;

impl PartitionCells {
    pub(crate) fn new(writer: RunWriter, sorted: SortRule, lists: ListMemory) -> PartitionCells {
        let nowhere = (CellPlace { level: u32::MAX, at: [0; 3] }, 0);
        PartitionCells {
            writer,
            sorted,
            cells: Vec::new(),
            by_place: HashMap::new(),
            last: nowhere,
            buffered: 0,
            lists,
            list_bytes: 0,
        }
    }

    /// Leases what lists are about to take.
    fn take(&mut self, bytes: u64) -> Result<()> {
        self.lists.take(bytes)?;
        self.list_bytes += bytes;
        Ok(())
    }

    /// Adds a triangle to its cell.
    pub(super) fn push_at(
        &mut self,
        place: CellPlace,
        triangle: LatticeTriangle,
        attributes: &CornerAttributes,
    ) -> Result<()> {
        let index = self.cell_of(place)?;
        let cell = &mut self.cells[index];
        let room = cell.buffer.room();
        cell.buffer.push(triangle, attributes);
        cell.triangle_count += 1;
        self.buffered += cell.buffer.room() - room;
        if cell.buffer.len() >= RUN_TRIANGLES {
            self.write_run(index)?;
        }
        if self.buffered >= self.sorted.buffered_most {
            self.write_all()?;
        }
        Ok(())
    }

    fn cell_of(&mut self, place: CellPlace) -> Result<usize> {
        if self.last.0 == place {
            return Ok(self.last.1);
        }
        let index = match self.by_place.get(&place) {
            Some(&index) => index,
            None => self.add(place, Vec::new())?,
        };
        self.last = (place, index);
        Ok(index)
    }

    /// Adds a cell that is not there yet; gives its index.
    fn add(&mut self, place: CellPlace, runs: Vec<Run>) -> Result<usize> {
        self.take(CELL_BYTES)?;
        self.by_place.insert(place, self.cells.len());
        self.cells.push(PartitionCell::new(place, runs));
        Ok(self.cells.len() - 1)
    }

    fn write_run(&mut self, index: usize) -> Result<()> {
        let cell = &mut self.cells[index];
        if cell.buffer.is_empty() {
            return Ok(());
        }
        // The memory goes with it: many cells are left behind by the stream and never filled again.
        let buffer = std::mem::take(&mut cell.buffer);
        self.writer.write(index, buffer)?.map_or(Ok(()), |written| self.add_run(written))
    }

    fn add_run(&mut self, WrittenRun { owner, run, room }: WrittenRun) -> Result<()> {
        let runs = &self.cells[owner].runs;
        if runs.len() == runs.capacity() {
            let more = runs.len().max(RUNS_LEAST);
            self.take(runs_bytes(more))?;
            self.cells[owner].runs.reserve_exact(more);
        }
        self.cells[owner].runs.push(run);
        self.buffered -= room;
        Ok(())
    }

    /// Writes what is buffered.
    fn write_all(&mut self) -> Result<()> {
        (0..self.cells.len()).try_for_each(|index| self.write_run(index))?;
        while let Some(written) = self.writer.next()? {
            self.add_run(written)?;
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
    pub(crate) fn restore(&mut self, runs: Vec<(CellPlace, Vec<Run>)>) -> Result<()> {
        for (place, runs) in runs {
            self.writer.scratch().set_unread(runs.iter().map(|run| (*run, run.triangle_count)));
            self.take(runs_bytes(runs.capacity()))?;
            self.add(place, runs)?;
        }
        Ok(())
    }

    /// About what is lacking for the lists of all triangles, of which `read` of `all` have come, where the others are
    /// like these: runs, as much again for the pieces of chunks, and the third of what is free that buffers take.
    pub(super) fn lacking_bytes(&self, [read, all]: [u64; 2]) -> u64 {
        let runs = self.list_bytes - self.cells.len() as u64 * CELL_BYTES;
        let whole = 3.0 * runs as f64 * (all as f64 / read.max(1) as f64).max(1.0);
        (whole as u64).saturating_sub(runs)
    }

    /// Writes what is buffered, cuts cells that are too full, joins small ones.
    pub(crate) fn into_chunks(mut self, options: &BuildOptions) -> Result<SortedChunks> {
        self.write_all()?;
        self.by_place = HashMap::new();
        let mut whole = std::mem::take(&mut self.cells);
        // Large triangles first, then along the curve; a place is one cell, so the order is total.
        whole.sort_by_key(|cell| (cell.place.level, cell.key));
        let mut chunks = ChunkJoiner::default();
        let PartitionCells { mut writer, sorted, mut lists, list_bytes, .. } = self;
        // A run may go to two chunks.
        let joined = whole.iter().filter(|cell| !sorted.is_cut_again(&cell.place, cell.triangle_count));
        let pieces: usize = joined.map(|cell| cell.runs.len() + 1).sum();
        lists.take((pieces * size_of::<Piece>()) as u64)?;
        for cell in whole {
            options.interrupt.check()?;
            if sorted.is_cut_again(&cell.place, cell.triangle_count) {
                let levels = (cell.place.level + LEVELS_MORE).min(sorted.finest());
                let rule = SortRule { levels, by: SortKey::CellPlace, ..sorted };
                let finer = PartitionCells::new(writer, rule, lists);
                let finer = cut(&cell, finer, options)?;
                (writer, lists) = (finer.writer, finer.lists);
                chunks.close();
                chunks.done.extend(finer.chunks);
            } else {
                chunks.add(cell.triangle_count, &cell.runs);
            }
        }
        chunks.close();
        lists.give_back(list_bytes);
        writer.scratch().flush()?;
        Ok(SortedChunks { writer, chunks: chunks.done, lists })
    }
}

impl CellSink for PartitionCells {
    fn push(&mut self, triangle: LatticeTriangle, attributes: &CornerAttributes) -> Result<()> {
        self.push_at(self.sorted.place_of(&triangle), triangle, attributes)
    }
}

/// Sorts the triangles of a cell that is too full into finer cells, by place alone: it may be full of
/// triangles as large as itself.
fn cut(cell: &PartitionCell, mut finer: PartitionCells, options: &BuildOptions) -> Result<SortedChunks> {
    let (mut buffer, mut list) = (Vec::new(), TriangleList::default());
    for run in &cell.runs {
        list.clear();
        finer.writer.scratch().read(run, &mut buffer, &mut list)?;
        // A run that somebody else has sealed may hold what no lattice does.
        if !list.triangles.iter().all(|triangle| is_on_lattice(&triangle.q, finer.sorted.bits)) {
            return Err(finer.writer.scratch().damaged(run.offset));
        }
        finer.writer.scratch().consume(run, run.triangle_count);
        let mut all = list.triangles.iter().enumerate();
        all.try_for_each(|(index, &triangle)| finer.push(triangle, &list.attributes_of(index)))?;
    }
    finer.into_chunks(options)
}

/// Bytes of a list of so many runs.
fn runs_bytes(room: usize) -> u64 {
    (room * size_of::<Run>()) as u64
}

/// Whether all coordinates have so many bits.
pub(crate) fn is_on_lattice<const N: usize>(q: &[[i64; 3]; N], bits: u32) -> bool {
    q.as_flattened().iter().all(|q| (0..1 << bits).contains(q))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Budget;
    use crate::error::Code;
    use crate::scratch::Place;
    use rand_pcg::Pcg64;
    use rand_pcg::rand_core::{Rng, SeedableRng};

    /// Sorts so many triangles that come in no order, with hardly any room in buffers.
    fn sorted(triangle_count: u64, budget: &Budget) -> Result<PartitionCells> {
        let scratch = Scratch::create(Place::Unnamed(std::env::temp_dir()))?;
        let rule = SortRule { by: SortKey::SizeAndPlace, levels: 4, bits: 16, buffered_most: 20_000 };
        let mut cells = PartitionCells::new(RunWriter::start(scratch)?, rule, ListMemory::begin(budget)?);
        let mut random = Pcg64::seed_from_u64(9);
        for _ in 0..triangle_count {
            let q: [i64; 3] = std::array::from_fn(|_| i64::from(random.next_u32() % 65_000));
            let [x, y, z] = q;
            let triangle = LatticeTriangle { q: [q, q.map(|v| v + 3), [x + 5, y, z]], material: 0 };
            cells.push(triangle, &CornerAttributes::NONE)?;
        }
        Ok(cells)
    }

    /// Runs of a few triangles took more memory than the buffers, and nobody had leased it.
    #[test]
    fn lists_are_leased() {
        let budget = Budget::unlimited();
        let cells = sorted(300_000, &budget).unwrap();
        let room = cells.cells.iter().map(|cell| cell.buffer.room()).sum::<u64>();
        let runs = cells.cells.iter().map(|cell| runs_bytes(cell.runs.capacity())).sum::<u64>();
        let lists = runs + (cells.cells.capacity() * size_of::<PartitionCell>()) as u64;
        let leased = budget.used_bytes();
        assert!(room <= 20_000 && runs > 500_000, "{room} triangles, {runs} bytes of runs");
        assert!((lists..4 * lists).contains(&leased), "{lists} of {leased}");
        let options = crate::build::tests::options(1, u64::MAX);
        let SortedChunks { chunks, lists, .. } = cells.into_chunks(&options).unwrap();
        let bytes = chunks.iter().map(Chunk::bytes).sum::<u64>();
        assert!(lists.into_lease().bytes() * 10 / 9 >= bytes, "{bytes} of chunks");
        let refused = sorted(300_000, &Budget::new(crate::RESERVE_BYTES + leased / 2)).map(drop).unwrap_err();
        assert_eq!(refused.code(), Code::MemoryLimit);
    }
}
