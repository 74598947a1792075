//! Tiles: the parts of a picture that are worked on one at a time, in an order that keeps neighbours near.
//!
//! Invariants: 1. the tiles cover each pixel once; 2. a tile has fewer than 100 pixels; 3. the index of a tile is
//! its place in rows, whatever the order of work.

use crate::image::saliency::{Reduced, SIDE_PIXELS, Saliency};
use crate::sampler::mix;

/// Side of a tile, pixels. 64 pixels: small enough that its rays want few pages, a whole number of SIMD packets.
pub const TILE_SIDE_PIXELS: u32 = 8;

const _: () = assert!(TILE_SIDE_PIXELS * TILE_SIDE_PIXELS < 100 && TILE_SIDE_PIXELS == SIDE_PIXELS);

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Place in rows of tiles, from the top left.
    pub index: u32,
    /// First pixel (x, y).
    pub first: [u32; 2],
    /// Width and height, pixels; smaller than the side at the right and lower edge.
    pub size: [u32; 2],
}

/// The order in which tiles are worked on. Paper, section 5.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileOrder {
    /// Along a z-curve: neighbours share pages. What pictures without a deadline use.
    ZCurve,
    /// Row by row.
    Row,
    /// A random order, the same for every picture of a size.
    Random,
    /// Tiles that catch the eye in the last picture first.
    Saliency(Saliency),
}

impl Default for TileOrder {
    fn default() -> TileOrder {
        TileOrder::Saliency(Saliency::Achanta)
    }
}

/// The tiles of a picture.
#[derive(Clone, Debug)]
pub struct Tiles {
    resolution: [u32; 2],
    order: Vec<u32>,
}

impl Tile {
    /// The pixel (x, y) in its middle.
    pub(crate) fn middle(&self) -> [u32; 2] {
        std::array::from_fn(|a| self.first[a] + self.size[a].min(TILE_SIDE_PIXELS) / 2)
    }

    /// Count of pixels.
    pub fn pixel_count(&self) -> u32 {
        self.size[0] * self.size[1]
    }

    /// Pixel `index` of the tile as (x, y) in the picture: along a z-curve, so that a few in a row are close together;
    /// in rows where the picture's edge cuts the tile.
    pub fn pixel(&self, index: u32) -> [u32; 2] {
        let [x, y] = match self.size {
            [TILE_SIDE_PIXELS, TILE_SIDE_PIXELS] => [every_other(index), every_other(index >> 1)],
            [width, _] => [index % width, index / width],
        };
        [self.first[0] + x, self.first[1] + y]
    }
}

impl Tiles {
    /// The tiles of a picture of `resolution` (width, height; pixels), in z-curve order.
    pub fn z_curve(resolution: [u32; 2]) -> Tiles {
        let columns = columns(resolution);
        let mut order: Vec<u32> = (0..tile_count(resolution)).collect();
        order.sort_by_cached_key(|index| interleave(index % columns) | interleave(index / columns) << 1);
        Tiles { resolution, order }
    }

    /// The tiles of the picture in `order`; `eye` is the last picture, reduced, for saliency.
    pub(crate) fn ordered(&self, order: TileOrder, eye: &Reduced) -> Tiles {
        let mut tiles = Tiles::z_curve(self.resolution);
        match order {
            TileOrder::ZCurve => {}
            TileOrder::Row => tiles.order.sort_unstable(),
            TileOrder::Random => tiles.order.sort_unstable_by_key(|&index| mix(u64::from(index))),
            TileOrder::Saliency(metric) => {
                // A stable sort: tiles alike stay on the z-curve.
                let score = metric.tiles(eye);
                tiles.order.sort_by(|&a, &b| score[b as usize].total_cmp(&score[a as usize]));
            }
        }
        tiles
    }

    /// Moves tiles of a lower `age` before others; those of one age stay in their order.
    pub(crate) fn sort_by_age<A: Ord>(&mut self, age: impl Fn(u32) -> A) {
        self.order.sort_by_key(|&index| age(index));
    }

    /// Tile `index`, whatever the order.
    pub(crate) fn tile(&self, index: u32) -> Tile {
        tile(self.resolution, index)
    }

    /// Count of tiles.
    pub fn count(&self) -> u32 {
        self.order.len() as u32
    }

    /// The tile whose turn is `turn`-th, from 0.
    ///
    /// # Panics
    /// When there are not so many tiles.
    pub fn nth(&self, turn: u32) -> Tile {
        tile(self.resolution, self.order[turn as usize])
    }

    /// Bytes on the heap of the tiles of a picture of `resolution` (width, height; pixels).
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        u64::from(tile_count(resolution)) * size_of::<u32>() as u64
    }
}

/// Tile `index` of a picture of `resolution` (width, height; pixels).
pub(crate) fn tile(resolution: [u32; 2], index: u32) -> Tile {
    let columns = columns(resolution);
    let first = [index % columns, index / columns].map(|x| x * TILE_SIDE_PIXELS);
    Tile { index, first, size: std::array::from_fn(|a| TILE_SIDE_PIXELS.min(resolution[a] - first[a])) }
}

/// Count of tiles in a picture of `resolution` (width, height; pixels).
pub(crate) fn tile_count(resolution: [u32; 2]) -> u32 {
    columns(resolution) * resolution[1].div_ceil(TILE_SIDE_PIXELS)
}

fn columns(resolution: [u32; 2]) -> u32 {
    resolution[0].div_ceil(TILE_SIDE_PIXELS)
}

/// Spreads 16 bits to the even places.
fn interleave(x: u32) -> u32 {
    let x = (x | x << 8) & 0x00ff_00ff;
    let x = (x | x << 4) & 0x0f0f_0f0f;
    let x = (x | x << 2) & 0x3333_3333;
    (x | x << 1) & 0x5555_5555
}

/// The even places of 6 bits.
fn every_other(x: u32) -> u32 {
    x & 1 | x >> 1 & 2 | x >> 2 & 4
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_each_pixel_once() {
        for [width, height] in [[1, 1], [8, 8], [9, 17], [100, 3]] {
            let tiles = Tiles::z_curve([width, height]);
            let mut seen = vec![0; (width * height) as usize];
            for turn in 0..tiles.count() {
                let tile = tiles.nth(turn);
                for [x, y] in (0..tile.pixel_count()).map(|index| tile.pixel(index)) {
                    seen[(y * width + x) as usize] += 1;
                }
            }
            assert!(seen.iter().all(|&count| count == 1), "{width} x {height}");
        }
    }

    #[test]
    fn the_order_is_a_z() {
        let tiles = Tiles::z_curve([32, 32]);
        let first: Vec<_> = (0..6).map(|turn| tiles.nth(turn).first.map(|x| x / TILE_SIDE_PIXELS)).collect();
        assert_eq!(first, [[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [3, 0]]);
    }
}
