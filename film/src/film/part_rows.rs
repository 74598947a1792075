//! Rows of tiles of a film as the bytes of a part file, and back: sums and layers as the film has them, before the
//! filter.
//!
//! ```text
//! a block: the pixels that a portion has of a row of tiles, by rows; plane after plane
//! | sums 16 | indirect 16 | depth 4 | normal 12 | albedo 12 | id 4 | guide normal 3 | guide albedo 3 |   bytes a pixel
//!             filter        '---- those that are kept, and of portions that begin with sample 0 alone ----'
//! ```
//!
//! Invariants: 1. a block that was written comes back bit by bit; 2. blocks of other samples are added to what is
//! there, in the order in which they are given.

use super::{Film, Layers, RgbSum};
use crate::packed::{PackedAlbedo, PackedNormal};
use crate::portion::Portion;
use crate::tile::TILE_SIDE_PIXELS;
use std::ops::Range;

/// Bytes of the block of a row of tiles in a part of a picture of `resolution`.
pub(crate) fn block_bytes(resolution: [u32; 2], layers: Layers, portion: &Portion, tile_row: u32) -> u64 {
    let rows = rows(resolution, tile_row).len() as u64;
    let columns = portion.columns(resolution, tile_row).len() as u64;
    rows * columns * pixel_bytes(layers, has_layers(portion)) as u64
}

/// Bytes of the largest block that a picture of `resolution` can have.
pub(crate) fn block_bytes_most(resolution: [u32; 2], layers: Layers) -> u64 {
    u64::from(resolution[0]) * u64::from(TILE_SIDE_PIXELS) * pixel_bytes(layers, true) as u64
}

fn pixel_bytes(layers: Layers, has_layers: bool) -> usize {
    let sums = if layers.filter { 2 * size_of::<RgbSum>() } else { size_of::<RgbSum>() };
    sums + if has_layers { layers.pixel_bytes() } else { 0 }
}

/// What a pixel shows is seen by its first sample.
fn has_layers(portion: &Portion) -> bool {
    portion.samples[0] == 0
}

/// The rows of pixels of a row of tiles.
fn rows(resolution: [u32; 2], tile_row: u32) -> Range<u32> {
    let first = tile_row * TILE_SIDE_PIXELS;
    first..resolution[1].min(first + TILE_SIDE_PIXELS)
}

impl Film {
    /// Writes the block of a row of tiles of this film behind `bytes`.
    pub(crate) fn write_block(&self, tile_row: u32, bytes: &mut Vec<u8>) {
        let runs = self.runs(tile_row, &self.portion);
        fn put<T, const N: usize>(
            bytes: &mut Vec<u8>,
            runs: &[Range<usize>],
            plane: &[T],
            of: impl Fn(&T) -> [u8; N],
        ) {
            runs.iter().for_each(|run| bytes.extend(plane[run.clone()].iter().flat_map(&of)));
        }
        let of_three = |three: &[f32; 3]| -> [u8; 12] {
            let mut bytes = [0; 12];
            bytes
                .chunks_exact_mut(4)
                .zip(three)
                .for_each(|(to, value)| to.copy_from_slice(&value.to_le_bytes()));
            bytes
        };
        put(bytes, &runs, &self.sums, |sum| sum.to_bytes());
        if self.layers.filter {
            put(bytes, &runs, &self.indirect, |sum| sum.to_bytes());
        }
        if !has_layers(&self.portion) {
            return;
        }
        let (planes, kept) = (&self.planes, self.layers.kept());
        if kept.depth {
            put(bytes, &runs, &planes.depth, |depth| depth.to_le_bytes());
        }
        if self.layers.normal {
            put(bytes, &runs, &planes.normal, of_three);
        }
        if self.layers.albedo {
            put(bytes, &runs, &planes.albedo, of_three);
        }
        if self.layers.id {
            put(bytes, &runs, &planes.id, |id| id.to_le_bytes());
        }
        if kept.guide_normal {
            put(bytes, &runs, &planes.guide_normal, |normal| normal.to_bytes());
        }
        if kept.guide_albedo {
            put(bytes, &runs, &planes.guide_albedo, |albedo| albedo.to_bytes());
        }
    }

    /// Adds the block of a row of tiles of a part with this `portion`; false when the bytes hold sums of no samples,
    /// and the film is of no use then.
    ///
    /// # Panics
    /// When the block is not as long as [`block_bytes`] says, or has pixels that this film has not.
    #[must_use]
    pub(crate) fn add_block(&mut self, tile_row: u32, portion: &Portion, mut bytes: &[u8]) -> bool {
        let runs = self.runs(tile_row, portion);
        fn fill<T, const N: usize>(
            bytes: &mut &[u8],
            runs: &[Range<usize>],
            plane: &mut [T],
            mut set: impl FnMut(&mut T, [u8; N]),
        ) {
            for value in runs.iter().flat_map(|run| run.clone()) {
                let (first, rest) = bytes.split_first_chunk().expect("a block is as long as it says");
                set(&mut plane[value], *first);
                *bytes = rest;
            }
        }
        let three = |bytes: [u8; 12]| -> [f32; 3] {
            std::array::from_fn(|c| f32::from_le_bytes([0, 1, 2, 3].map(|byte| bytes[4 * c + byte])))
        };
        let mut are_sums = true;
        let mut add = |sum: &mut RgbSum, bytes| match RgbSum::from_bytes(bytes) {
            Some(more) => sum.add_sum(more),
            None => are_sums = false,
        };
        fill(&mut bytes, &runs, &mut self.sums, &mut add);
        if self.layers.filter {
            fill(&mut bytes, &runs, &mut self.indirect, &mut add);
        }
        if has_layers(portion) {
            let (planes, kept) = (&mut self.planes, self.layers.kept());
            if kept.depth {
                fill(&mut bytes, &runs, &mut planes.depth, |depth, bytes| *depth = f32::from_le_bytes(bytes));
            }
            if self.layers.normal {
                fill(&mut bytes, &runs, &mut planes.normal, |normal, bytes| *normal = three(bytes));
            }
            if self.layers.albedo {
                fill(&mut bytes, &runs, &mut planes.albedo, |albedo, bytes| *albedo = three(bytes));
            }
            if self.layers.id {
                fill(&mut bytes, &runs, &mut planes.id, |id, bytes| *id = u32::from_le_bytes(bytes));
            }
            if kept.guide_normal {
                let set = |normal: &mut PackedNormal, bytes| *normal = PackedNormal::from_bytes(bytes);
                fill(&mut bytes, &runs, &mut planes.guide_normal, set);
            }
            if kept.guide_albedo {
                let set = |albedo: &mut PackedAlbedo, bytes| *albedo = PackedAlbedo::from_bytes(bytes);
                fill(&mut bytes, &runs, &mut planes.guide_albedo, set);
            }
        }
        assert!(bytes.is_empty(), "a block is as long as it says");
        are_sums
    }

    /// Every tile has so many samples: those of the blocks that were added.
    pub(crate) fn count_samples(&mut self, spp: u32) {
        self.counts.fill(spp);
    }

    /// Where the pixels of a block stand.
    fn runs(&self, tile_row: u32, portion: &Portion) -> Vec<Range<usize>> {
        let columns = portion.columns(self.resolution, tile_row);
        let run = |y: u32| {
            let first = self.place([columns.start, y]);
            first..first + columns.len()
        };
        rows(self.resolution, tile_row).map(run).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::{LayerPixel, NO_ID, portion_bytes};
    use crate::hash::mix;
    use crate::tile::{tile, tile_count};
    use trex_store::Budget;

    const RESOLUTION: [u32; 2] = [37, 29];

    fn film(layers: Layers, portion: Portion) -> Film {
        let bytes = portion_bytes(RESOLUTION, layers, &portion);
        let lease = Budget::unlimited().lease("a film", bytes).unwrap();
        Film::of_portion(RESOLUTION, layers, portion, lease)
    }

    fn light([x, y]: [u32; 2], sample: u32) -> [f32; 3] {
        let number =
            |c: u64| (mix(u64::from(x) << 40 ^ u64::from(y) << 20 ^ u64::from(sample) << 3 ^ c) >> 40) as f32;
        [number(0) * 1e-6, number(1) * 1e-9, number(2) * 1e3]
    }

    /// Takes the samples of a film's portion.
    fn sampled(layers: Layers, portion: Portion) -> Film {
        let mut film = film(layers, portion);
        for tile in (portion.tiles[0]..portion.tiles[1]).map(|index| tile(RESOLUTION, index)) {
            let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
            for sample in portion.samples[0]..portion.samples[1] {
                let lights: Vec<_> = pixels.iter().map(|&pixel| light(pixel, sample)).collect();
                film.add(&tile, &lights);
                if layers.filter {
                    film.add_indirect(
                        &tile,
                        &lights.iter().map(|light| light.map(|x| x / 3.0)).collect::<Vec<_>>(),
                    );
                }
            }
            for &[x, y] in pixels.iter().filter(|_| portion.samples[0] == 0) {
                let (normal, albedo) = ([0.6, -0.8, 0.0], [0.25, x as f32 / 40.0, 0.5]);
                let id = if x == 3 { NO_ID } else { x + 100 * y };
                film.set_layers(
                    [x, y],
                    &LayerPixel { depth: y as f32 + 0.5, normal, albedo, id, ..LayerPixel::NOTHING },
                );
            }
        }
        film
    }

    fn bytes_of(film: &Film, tile_row: u32) -> Vec<u8> {
        let mut bytes = vec![];
        film.write_block(tile_row, &mut bytes);
        assert_eq!(bytes.len() as u64, block_bytes(RESOLUTION, film.layers, &film.portion, tile_row));
        assert!(bytes.len() as u64 <= block_bytes_most(RESOLUTION, film.layers));
        bytes
    }

    /// Of all layers, blocks of the tiles of any cut put together are those of the whole film.
    #[test]
    fn blocks_of_tiles_come_back_bit_by_bit() {
        for bits in 0..32 {
            let is = |bit: u32| bits >> bit & 1 == 1;
            let layers = Layers { depth: is(0), normal: is(1), albedo: is(2), id: is(3), filter: is(4) };
            let whole = Portion::whole(RESOLUTION, 3);
            let expected = sampled(layers, whole);
            for count in [1, 3, 7] {
                let mut merged = film(layers, Portion { samples: [0, 0], ..whole });
                for index in 0..count {
                    let tiles = Portion::tiles_of_share(RESOLUTION, index, count);
                    let part = sampled(layers, Portion { tiles, ..whole });
                    for row in part.portion.tile_rows(RESOLUTION) {
                        assert!(merged.add_block(row, &part.portion, &bytes_of(&part, row)));
                    }
                }
                merged.count_samples(3);
                for row in whole.tile_rows(RESOLUTION) {
                    assert_eq!(bytes_of(&merged, row), bytes_of(&expected, row), "{layers:?} {count} {row}");
                }
                assert_eq!(merged.mean(), expected.mean());
            }
        }
    }

    /// Sums of other samples are added; what the pixels show is that of the first.
    #[test]
    fn blocks_of_samples_are_added() {
        let layers = Layers { filter: true, id: true, ..Layers::default() };
        let whole = Portion { tiles: [0, tile_count(RESOLUTION)], samples: [0, 9] };
        let expected = sampled(layers, whole);
        let mut merged = film(layers, Portion { samples: [0, 0], ..whole });
        for samples in [[0, 2], [2, 3], [3, 9]] {
            let part = sampled(layers, Portion { samples, ..whole });
            assert_eq!(part.samples(), samples[1]);
            for row in whole.tile_rows(RESOLUTION) {
                assert!(merged.add_block(row, &part.portion, &bytes_of(&part, row)));
            }
        }
        merged.count_samples(9);
        for pixel in whole.pixels(RESOLUTION) {
            let (found, expected) = (merged.radiance(pixel), expected.radiance(pixel));
            let brightest = expected.into_iter().fold(0.0, f32::max);
            for c in 0..3 {
                // Twice nine adds and three, and the step of an f32.
                let most = 21.0 * brightest * 2f32.powi(-38) + expected[c] * f32::EPSILON;
                assert!((found[c] - expected[c]).abs() <= most, "{pixel:?} {found:?} {expected:?}");
            }
            assert_eq!(merged.id(pixel), sampled_id(pixel));
        }
    }

    fn sampled_id([x, y]: [u32; 2]) -> u32 {
        if x == 3 { NO_ID } else { x + 100 * y }
    }

    #[test]
    fn sums_of_no_samples_are_refused() {
        let whole = Portion::whole(RESOLUTION, 1);
        let mut merged = film(Layers::default(), whole);
        let mut bytes = bytes_of(&sampled(Layers::default(), whole), 1);
        let last = bytes.len() - 1;
        bytes[last] = 0xff;
        assert!(!merged.add_block(1, &whole, &bytes));
    }
}
