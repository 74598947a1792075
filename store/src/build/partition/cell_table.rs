//! `CellTable`: the cells of a first sort with the counts of their triangles, and how shards share them out.
//!
//! ```text
//! cells in the order of chunks:  | a | b | c | D | e | f |        D is cut again, finer
//! chunks                         |  a + b  | c | D1 D2 .. | e + f |
//! stretches                      ^         ^   ^          ^          begin where a chunk is certain to begin
//! ```
//!
//! A stretch is never divided. Shard I of N has the stretches whose first triangle t has floor(t N / T) = I - 1, of T
//! triangles: so any N shares all of them out, each once, and nobody has to agree on a list of cuts.
//!
//! Invariants: 1. no two cells have the same place; 2. they stand in the order in which cells are joined to chunks; 3.
//! the sum of their triangles is what all shards have together.

use super::cells::{CellPlace, SortRule};
use super::chunk::CHUNK_TRIANGLES;
use std::collections::HashSet;

/// Words of a cell in a record.
const CELL_WORDS: usize = 5;
/// Bytes of memory of a cell while a table is made or read: with the words of its record, and in a set.
pub(crate) const CELL_BYTES: u64 = 160;

/// Share `index` of `count` of a build, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ShardShare {
    pub(crate) index: u32,
    pub(crate) count: u32,
}

/// Cells that follow each other in the order of chunks, by their levels and places on the curve: from the first one up
/// to, but not including, the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CellRange {
    first: (u32, u64),
    end: (u32, u64),
    /// Triangles in those before them.
    pub(crate) first_triangle: u64,
    /// Triangles in them.
    pub(crate) triangle_count: u64,
}

impl CellRange {
    pub(super) fn contains(&self, place: &CellPlace) -> bool {
        (self.first..self.end).contains(&(place.level, place.key()))
    }
}

/// All cells of a first sort, none of which is empty.
pub(crate) struct CellTable {
    rule: SortRule,
    cells: Vec<(CellPlace, u64)>,
}

impl CellTable {
    /// Of cells in any order.
    pub(super) fn new(rule: SortRule, mut cells: Vec<(CellPlace, u64)>) -> CellTable {
        cells.sort_by_key(|(place, _)| (place.level, place.key()));
        CellTable { rule, cells }
    }

    /// The finest level.
    pub(crate) fn levels(&self) -> u32 {
        self.rule.levels
    }

    /// Count of cells.
    pub(crate) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Triangles in all of them.
    pub(crate) fn triangle_count(&self) -> u64 {
        self.cells.iter().map(|(_, count)| count).sum()
    }

    /// Level, place and triangles of each.
    pub(crate) fn words(&self) -> Vec<u64> {
        let word = |(CellPlace { level, at: [x, y, z] }, count): &(CellPlace, u64)| {
            [u64::from(*level), u64::from(*x), u64::from(*y), u64::from(*z), *count]
        };
        self.cells.iter().flat_map(word).collect()
    }

    /// The table of [`Self::words`]; `None` where they cannot be those of one.
    pub(crate) fn parse(rule: SortRule, words: &[u64]) -> Option<CellTable> {
        let (all, []) = words.as_chunks::<CELL_WORDS>() else { return None };
        let (mut cells, mut seen) = (Vec::with_capacity(all.len()), HashSet::with_capacity(all.len()));
        let mut triangle_count = 0u64;
        for &[level, x, y, z, count] in all {
            let level = u32::try_from(level).ok().filter(|&level| level <= rule.levels)?;
            if count == 0 || [x, y, z].iter().any(|&at| at >> level != 0) {
                return None;
            }
            triangle_count = triangle_count.checked_add(count)?;
            let place = CellPlace { level, at: [x, y, z].map(|at| at as u32) };
            if !seen.insert(place) {
                return None;
            }
            cells.push((place, count));
        }
        Some(CellTable::new(rule, cells))
    }

    /// Calls `visit` with the index of the first cell of each stretch and the triangles before it.
    fn for_each_stretch(&self, mut visit: impl FnMut(usize, u64)) {
        // Triangles of the chunk under way, as `ChunkJoiner` has them; and of all cells so far.
        let (mut open, mut before) = (0, 0);
        for (index, &(place, count)) in self.cells.iter().enumerate() {
            let is_cut_again = self.rule.is_cut_again(&place, count);
            let begins = open == 0 || is_cut_again || open + count > CHUNK_TRIANGLES;
            if begins {
                visit(index, before);
                open = 0;
            }
            open = if is_cut_again { 0 } else { (open + count) % CHUNK_TRIANGLES };
            before += count;
        }
    }

    /// Triangles of each stretch.
    pub(crate) fn stretch_lengths(&self) -> Vec<u64> {
        let mut begins = Vec::new();
        self.for_each_stretch(|_, before| begins.push(before));
        begins.push(self.triangle_count());
        begins.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    /// The cells of a share.
    pub(crate) fn range(&self, share: ShardShare) -> CellRange {
        let all = u128::from(self.triangle_count().max(1));
        let (mut first, mut end) = (self.cells.len(), self.cells.len());
        self.for_each_stretch(|index, before| {
            let shard = u128::from(before) * u128::from(share.count) / all;
            if shard >= u128::from(share.index) {
                first = first.min(index);
            }
            if shard > u128::from(share.index) {
                end = end.min(index);
            }
        });
        let at = |index: usize| {
            self.cells.get(index).map_or((u32::MAX, u64::MAX), |(place, _)| (place.level, place.key()))
        };
        let count = |cells: &[(CellPlace, u64)]| cells.iter().map(|(_, count)| count).sum();
        let (first_triangle, triangle_count) = (count(&self.cells[..first]), count(&self.cells[first..end]));
        CellRange { first: at(first), end: at(end), first_triangle, triangle_count }
    }
}

#[cfg(test)]
mod tests {
    use super::super::cells::SortKey;
    use super::*;
    use proptest::prelude::*;

    fn rule() -> SortRule {
        SortRule { by: SortKey::SizeAndPlace, levels: 3, bits: 20, buffered_most: 0 }
    }

    fn table(counts: &[u64]) -> CellTable {
        let at = |index: usize| [index as u32 & 7, index as u32 >> 3 & 7, index as u32 >> 6];
        let cell = |(index, &count): (usize, &u64)| (CellPlace { level: 3, at: at(index) }, count);
        CellTable::new(rule(), counts.iter().enumerate().map(cell).collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

        /// Every cell is of one shard, whatever their number.
        #[test]
        fn shards_have_each_cell_once(
            counts in proptest::collection::vec(1u64..300_000, 1..512),
            shard_count in 1u32..600,
        ) {
            let table = table(&counts);
            let ranges: Vec<_> =
                (0..shard_count).map(|index| table.range(ShardShare { index, count: shard_count })).collect();
            for (place, _) in &table.cells {
                prop_assert_eq!(ranges.iter().filter(|range| range.contains(place)).count(), 1);
            }
            let all: u64 = ranges.iter().map(|range| range.triangle_count).sum();
            prop_assert_eq!(all, counts.iter().sum::<u64>());
            let parsed = CellTable::parse(rule(), &table.words()).unwrap();
            prop_assert_eq!(parsed.words(), table.words());
        }
    }

    #[test]
    fn tables_that_cannot_be_are_refused() {
        let words = table(&[5, 7, 9]).words();
        let with = |at: usize, value: u64| {
            let mut words = words.clone();
            words[at] = value;
            CellTable::parse(rule(), &words).is_none()
        };
        assert!(CellTable::parse(rule(), &words[1..]).is_none(), "a cell that is not whole");
        assert!(with(0, 4), "a level that is too fine");
        assert!(with(1, 8), "a place outside of its level");
        assert!(with(4, 0), "an empty cell");
        assert!(with(4, u64::MAX), "more triangles than can be counted");
        assert!(CellTable::parse(rule(), &words.repeat(2)).is_none(), "a cell that is there twice");
    }
}
