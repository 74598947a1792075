//! `Portion`: a share of the work on a picture, which one machine of many does: some tiles, some of their samples.
//!
//! ```text
//! tiles, numbered in rows:   0  1  2  3        tiles 3..9 of 12: full rows of pixels 0 to 23 are kept,
//!                            4  5  6  7        of the first row of tiles the last, of the third the first
//!                            8  9 10 11
//! ```
//!
//! Invariant: portions make a picture when each sample of each tile is in one of them: [`misfit`] finds what is not.

use crate::tile::{TILE_SIDE_PIXELS, tile_count};
use std::ops::Range;

/// A run of tiles, in rows, and a run of samples of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Portion {
    /// Index of the first tile, and of the one behind the last.
    pub tiles: [u32; 2],
    /// Index of the first sample, and of the one behind the last.
    pub samples: [u32; 2],
}

/// Why some portions make no picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misfit {
    /// No portion has these.
    Missing(Portion),
    /// Two portions have these: their indices.
    Doubled(Portion, [usize; 2]),
}

impl Portion {
    /// All of a picture of `resolution` (width, height; pixels) with so many samples a pixel.
    pub fn whole(resolution: [u32; 2], spp: u32) -> Portion {
        Portion { tiles: [0, tile_count(resolution)], samples: [0, spp] }
    }

    /// The tiles of share `index`, from 0, of `count`: as many as the others have, or one less.
    ///
    /// # Panics
    /// When there are not so many shares.
    pub fn tiles_of_share(resolution: [u32; 2], index: u32, count: u32) -> [u32; 2] {
        assert!(index < count, "share {index} of {count}");
        let tiles = u64::from(tile_count(resolution));
        [index, index + 1].map(|border| (tiles * u64::from(border) / u64::from(count)) as u32)
    }

    /// Samples of a pixel.
    pub fn sample_count(&self) -> u32 {
        self.samples[1] - self.samples[0]
    }

    /// The rows of tiles that it has tiles of.
    pub fn tile_rows(&self, resolution: [u32; 2]) -> Range<u32> {
        let columns = resolution[0].div_ceil(TILE_SIDE_PIXELS).max(1);
        self.tiles[0] / columns..self.tiles[1].div_ceil(columns)
    }

    /// The rows of pixels of these.
    pub(crate) fn rows(&self, resolution: [u32; 2]) -> Range<u32> {
        let rows = self.tile_rows(resolution);
        rows.start * TILE_SIDE_PIXELS..resolution[1].min(rows.end * TILE_SIDE_PIXELS)
    }

    /// The columns of pixels that it has of a row of tiles.
    pub(crate) fn columns(&self, resolution: [u32; 2], tile_row: u32) -> Range<u32> {
        let in_row = resolution[0].div_ceil(TILE_SIDE_PIXELS);
        let first = tile_row * in_row;
        let tiles = self.tiles.map(|tile| tile.clamp(first, first + in_row) - first);
        tiles[0] * TILE_SIDE_PIXELS..resolution[0].min(tiles[1] * TILE_SIDE_PIXELS)
    }

    /// Its pixels (x, y), by rows.
    pub(crate) fn pixels(&self, resolution: [u32; 2]) -> impl Iterator<Item = [u32; 2]> + use<> {
        let portion = *self;
        let rows = portion.rows(resolution);
        rows.flat_map(move |y| portion.columns(resolution, y / TILE_SIDE_PIXELS).map(move |x| [x, y]))
    }
}

/// What is missing in, or twice in, the `portions` of a picture of `whole`; `None` when they make it. The first by
/// tiles, and of as many tiles as lack or double the same.
pub fn misfit(portions: &[Portion], whole: &Portion) -> Option<Misfit> {
    let mut borders: Vec<u32> =
        portions.iter().flat_map(|portion| portion.tiles).chain(whole.tiles).collect();
    borders.sort_unstable();
    borders.dedup();
    let mut by_sample: Vec<usize> = (0..portions.len()).collect();
    by_sample.sort_by_key(|&index| portions[index].samples);
    let of_tiles = |tiles: [u32; 2]| misfit_of_tiles(portions, &by_sample, tiles, whole.samples);
    let pairs = borders.windows(2).map(|pair| [pair[0], pair[1]]);
    let mut found: Option<Misfit> = None;
    for tiles in pairs {
        match (found, of_tiles(tiles)) {
            (None, first) => found = first,
            (Some(Misfit::Missing(before)), Some(Misfit::Missing(more)))
                if before.samples == more.samples =>
            {
                found = Some(Misfit::Missing(Portion { tiles: [before.tiles[0], tiles[1]], ..before }));
            }
            (Some(Misfit::Doubled(before, both)), Some(Misfit::Doubled(more, again)))
                if both == again && before.samples == more.samples =>
            {
                found = Some(Misfit::Doubled(Portion { tiles: [before.tiles[0], tiles[1]], ..before }, both));
            }
            (Some(_), _) => break,
        }
    }
    found
}

/// As [`misfit`], of tiles that each portion has all or none of.
fn misfit_of_tiles(
    portions: &[Portion],
    by_sample: &[usize],
    tiles: [u32; 2],
    samples: [u32; 2],
) -> Option<Misfit> {
    let (mut next, mut last) = (samples[0], 0);
    for &index in by_sample {
        let portion = &portions[index];
        if portion.tiles[0] > tiles[0] || portion.tiles[1] < tiles[1] {
            continue;
        }
        let [begin, end] = portion.samples;
        if begin > next {
            return Some(Misfit::Missing(Portion { tiles, samples: [next, begin] }));
        }
        if begin < next {
            return Some(Misfit::Doubled(Portion { tiles, samples: [begin, next.min(end)] }, [last, index]));
        }
        (next, last) = (end, index);
    }
    (next < samples[1]).then_some(Misfit::Missing(Portion { tiles, samples: [next, samples[1]] }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;
    use crate::tile::tile;
    use std::collections::HashSet;

    #[test]
    fn shares_have_each_tile_once_and_as_many_as_the_others() {
        for resolution in [[8, 8], [100, 75], [9, 1]] {
            for count in [1, 3, 8, 100] {
                let shares: Vec<_> =
                    (0..count).map(|index| Portion::tiles_of_share(resolution, index, count)).collect();
                assert!(shares.windows(2).all(|pair| pair[0][1] == pair[1][0]));
                assert_eq!((shares[0][0], shares[count as usize - 1][1]), (0, tile_count(resolution)));
                let sizes = shares.iter().map(|share| share[1] - share[0]);
                assert!(sizes.clone().max().unwrap() - sizes.min().unwrap() <= 1);
            }
        }
    }

    #[test]
    fn pixels_are_those_of_the_tiles() {
        for resolution in [[8, 8], [101, 75], [5, 300]] {
            for count in [1, 2, 5] {
                for index in 0..count {
                    let tiles = Portion::tiles_of_share(resolution, index, count);
                    let portion = Portion { tiles, samples: [0, 1] };
                    let mut expected: Vec<_> = (tiles[0]..tiles[1])
                        .map(|index| tile(resolution, index))
                        .flat_map(|tile| (0..tile.pixel_count()).map(move |pixel| tile.pixel(pixel)))
                        .collect();
                    expected.sort_unstable_by_key(|&[x, y]| [y, x]);
                    let found: Vec<_> = portion.pixels(resolution).collect();
                    assert_eq!(found, expected, "{resolution:?} {index} of {count}");
                    assert!(found.iter().all(|pixel| portion.rows(resolution).contains(&pixel[1])));
                }
            }
        }
    }

    /// Portions by chance: what is found is missing or doubled where a set of all samples says so, and nothing is
    /// found only where each is there once.
    #[test]
    fn misfits_are_those_of_the_sets() {
        let whole = Portion { tiles: [0, 6], samples: [0, 5] };
        let all = |portion: &Portion| {
            let [tiles, samples] = [portion.tiles, portion.samples].map(|[from, to]| from..to);
            tiles.flat_map(|tile| samples.clone().map(move |sample| (tile, sample))).collect::<Vec<_>>()
        };
        let (mut whole_count, mut refused) = (0, 0);
        for key in 0..20_000u64 {
            let mut draw = (0..).map(|index| mix(key * 100 + index));
            let mut number = |most: u32| (draw.next().unwrap() % u64::from(most)) as u32;
            let cut = number(7);
            let mut portions = vec![];
            for tiles in [[0, cut], [cut, 6]] {
                let cut = number(6);
                portions.extend([[0, cut], [cut, 5]].map(|samples| Portion { tiles, samples }));
            }
            if number(2) == 0 {
                let index = number(4) as usize;
                portions[index].samples = [number(3), 3 + number(3)];
            }
            portions.retain(|portion| {
                portion.tiles[0] < portion.tiles[1] && portion.samples[0] < portion.samples[1]
            });
            let cells: Vec<_> = portions.iter().flat_map(all).collect();
            let set: HashSet<_> = cells.iter().copied().collect();
            match misfit(&portions, &whole) {
                None => {
                    assert!(cells.len() == 30 && set.len() == 30, "{portions:?}");
                    whole_count += 1;
                }
                Some(Misfit::Missing(part)) => {
                    assert!(!all(&part).is_empty() && all(&part).iter().all(|cell| !set.contains(cell)));
                    refused += 1;
                }
                Some(Misfit::Doubled(part, both)) => {
                    assert!(!all(&part).is_empty() && both[0] != both[1], "{portions:?}");
                    for index in both {
                        let has: HashSet<_> = all(&portions[index]).into_iter().collect();
                        assert!(all(&part).iter().all(|cell| has.contains(cell)), "{portions:?} {part:?}");
                    }
                    refused += 1;
                }
            }
        }
        assert!(whole_count > 5_000 && refused > 5_000, "{whole_count} {refused}");
    }

    #[test]
    fn what_is_missing_is_named_with_all_its_tiles() {
        let part = |tiles, samples| Portion { tiles, samples };
        let whole = part([0, 12], [0, 16]);
        let some = [part([0, 4], [0, 16]), part([8, 10], [0, 16]), part([10, 12], [0, 16])];
        assert_eq!(misfit(&some, &whole), Some(Misfit::Missing(part([4, 8], [0, 16]))));
        let some = [part([0, 12], [0, 4]), part([0, 12], [8, 16])];
        assert_eq!(misfit(&some, &whole), Some(Misfit::Missing(part([0, 12], [4, 8]))));
        let some = [part([0, 12], [0, 8]), part([0, 5], [8, 16]), part([3, 12], [8, 16])];
        assert_eq!(misfit(&some, &whole), Some(Misfit::Doubled(part([3, 5], [8, 16]), [1, 2])));
        assert_eq!(misfit(&[], &whole), Some(Misfit::Missing(whole)));
    }
}
