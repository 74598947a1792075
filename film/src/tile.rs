//! Tiles: the parts of a picture that are worked on one at a time, in an order that keeps neighbours near.
//!
//! Invariants: 1. the tiles cover each pixel once; 2. a tile has fewer than 100 pixels; 3. the index of a tile is
//! its place in rows, whatever the order of work.

use crate::hash::mix;
use crate::saliency::{ReducedPicture, SIDE_PIXELS, Saliency};

/// Side of a tile, pixels. 64 pixels: small enough that its rays want few pages, a whole number of SIMD packets.
pub const TILE_SIDE_PIXELS: u32 = 8;

/// Side of a group of tiles that are worked on one after the other, tiles: 64 pixels.
const GROUP_SIDE_TILES: u32 = 8;

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
    /// Groups of 8x8 tiles that catch the eye in the last picture first, those of a group along a z-curve: single tiles
    /// by saliency are strewn over the picture, so that where frames are scarce each page is read again and again.
    Saliency(Saliency),
    /// The same groups, by how wrong they are likely to look in the last picture: by contrast, more where they catch
    /// the eye.
    Error(Saliency),
}

/// The bit of a pixel (x, y) among those of its tile, by rows.
pub(crate) fn bit([x, y]: [u32; 2]) -> u32 {
    y % TILE_SIDE_PIXELS * TILE_SIDE_PIXELS + x % TILE_SIDE_PIXELS
}

impl Default for TileOrder {
    fn default() -> TileOrder {
        TileOrder::Error(Saliency::Achanta)
    }
}

/// The tiles of a picture.
#[derive(Clone, Debug)]
pub struct Tiles {
    resolution: [u32; 2],
    order: Vec<u32>,
}

impl Tile {
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
        Tiles::z_curve_of(resolution, [0, tile_count(resolution)])
    }

    /// Those of the tiles of such a picture from the `first` to the one before `end`, in z-curve order.
    pub fn z_curve_of(resolution: [u32; 2], [first, end]: [u32; 2]) -> Tiles {
        let columns = columns(resolution);
        let mut order: Vec<u32> = (first..end).collect();
        order.sort_by_cached_key(|index| interleave(index % columns) | interleave(index / columns) << 1);
        Tiles { resolution, order }
    }

    /// The tiles of the picture in `order`; `eye` is the last picture, reduced, for saliency.
    pub fn ordered(&self, order: TileOrder, eye: &ReducedPicture) -> Tiles {
        let mut tiles = Tiles::z_curve(self.resolution);
        match order {
            TileOrder::ZCurve => {}
            TileOrder::Row => tiles.order.sort_unstable(),
            TileOrder::Random => tiles.order.sort_unstable_by_key(|&index| mix(u64::from(index))),
            TileOrder::Saliency(metric) => tiles.sort_groups(&metric.tiles(eye)),
            TileOrder::Error(metric) => tiles.sort_groups(&metric.errors(eye)),
        }
        tiles
    }

    /// Moves groups of a greater mean `score` before others; those of one score, and the tiles of a group, stay on
    /// their curve.
    fn sort_groups(&mut self, score: &[f32]) {
        let means = self.group_means(score);
        self.order.sort_by(|&a, &b| means[b as usize].total_cmp(&means[a as usize]));
    }

    /// The mean of `score` over the group of each tile, both by the tiles' indices.
    fn group_means(&self, score: &[f32]) -> Vec<f32> {
        let columns = columns(self.resolution);
        let group = |index: u32| [index % columns / GROUP_SIDE_TILES, index / columns / GROUP_SIDE_TILES];
        let groups = columns.div_ceil(GROUP_SIDE_TILES);
        let place = |index: u32| (group(index)[1] * groups + group(index)[0]) as usize;
        let mut sums = vec![(0.0, 0.0); self.order.iter().map(|&index| place(index) + 1).max().unwrap_or(0)];
        for &index in &self.order {
            let (sum, count) = &mut sums[place(index)];
            (*sum, *count) = (*sum + f64::from(score[index as usize]), *count + 1.0);
        }
        (0..self.count()).map(|index| sums[place(index)]).map(|(sum, count)| (sum / count) as f32).collect()
    }

    /// Moves tiles of a lower `age` before others; those of one age stay in their order.
    pub fn sort_by_age<A: Ord>(&mut self, age: impl Fn(u32) -> A) {
        self.order.sort_by_key(|&index| age(index));
    }

    /// Tile `index`, whatever the order.
    pub fn tile(&self, index: u32) -> Tile {
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
pub fn tile(resolution: [u32; 2], index: u32) -> Tile {
    let columns = columns(resolution);
    let first = [index % columns, index / columns].map(|x| x * TILE_SIDE_PIXELS);
    Tile { index, first, size: std::array::from_fn(|a| TILE_SIDE_PIXELS.min(resolution[a] - first[a])) }
}

/// Count of tiles in a picture of `resolution` (width, height; pixels).
pub fn tile_count(resolution: [u32; 2]) -> u32 {
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

    const ORDERS: [TileOrder; 7] = [
        TileOrder::ZCurve,
        TileOrder::Row,
        TileOrder::Random,
        TileOrder::Saliency(Saliency::Achanta),
        TileOrder::Saliency(Saliency::Itti),
        TileOrder::Error(Saliency::Achanta),
        TileOrder::Error(Saliency::Itti),
    ];
    /// Pictures that are and are not a square of a power of two, and some whose last tiles are cut.
    const RESOLUTIONS: [[u32; 2]; 5] = [[64, 64], [128, 40], [101, 75], [5, 300], [8, 8]];

    /// A picture of colours by chance.
    fn picture(resolution: [u32; 2]) -> ReducedPicture {
        let chance = |[x, y]: [u32; 2]| [1, 2, 3].map(|c| (mix(u64::from(x * y + c)) % 256) as f32 / 255.0);
        ReducedPicture::of(resolution, chance)
    }

    /// The indices of the tiles in the order of work, for a picture of colours by chance.
    fn indices(resolution: [u32; 2], order: TileOrder) -> Vec<u32> {
        Tiles::z_curve(resolution).ordered(order, &picture(resolution)).order
    }

    #[test]
    fn every_order_has_each_tile_once() {
        for (resolution, order) in RESOLUTIONS.into_iter().flat_map(|r| ORDERS.map(|order| (r, order))) {
            let mut found = indices(resolution, order);
            found.sort_unstable();
            let all: Vec<u32> = (0..tile_count(resolution)).collect();
            assert_eq!(found, all, "{resolution:?} {order:?}");
        }
    }

    /// Tiles of a square of `side` from `corner` on, quarter by quarter.
    fn quarters([x, y]: [u32; 2], side: u32, found: &mut Vec<[u32; 2]>) {
        if side == 1 {
            return found.push([x, y]);
        }
        let half = side / 2;
        for corner in [[x, y], [x + half, y], [x, y + half], [x + half, y + half]] {
            quarters(corner, half, found);
        }
    }

    /// Takes the tile with the greatest score out, again and again, the first of equals.
    fn select(mut tiles: Vec<u32>, score: impl Fn(u32) -> f64) -> Vec<u32> {
        let mut found = Vec::new();
        while !tiles.is_empty() {
            let best = (1..tiles.len()).fold(0, |a, b| if score(tiles[b]) > score(tiles[a]) { b } else { a });
            found.push(tiles.remove(best));
        }
        found
    }

    #[test]
    fn every_order_is_that_of_its_definition() {
        for resolution in RESOLUTIONS {
            let [width, height] = resolution.map(|pixels| pixels.div_ceil(TILE_SIDE_PIXELS));
            let mut square = Vec::new();
            quarters([0, 0], 64, &mut square);
            let there = square.into_iter().filter(|&[x, y]| x < width && y < height);
            let z_curve: Vec<u32> = there.map(|[x, y]| y * width + x).collect();
            let by_groups = |score: Vec<f32>| {
                assert!(score.len() == 1 || score.iter().any(|one| *one != score[0]), "{resolution:?}");
                let near = |a: u32, b: u32| a % width / 8 == b % width / 8 && a / width / 8 == b / width / 8;
                select(z_curve.clone(), |index| {
                    let group = (0..width * height).filter(|&other| near(index, other));
                    let scores: Vec<f64> = group.map(|other| f64::from(score[other as usize])).collect();
                    f64::from((scores.iter().sum::<f64>() / scores.len() as f64) as f32)
                })
            };
            for order in ORDERS {
                let expected = match order {
                    TileOrder::ZCurve => z_curve.clone(),
                    TileOrder::Row => (0..width * height).collect(),
                    // The lowest hash first: 53 of its bits tell these few apart.
                    TileOrder::Random => {
                        select(z_curve.clone(), |index| -((mix(u64::from(index)) >> 11) as f64))
                    }
                    TileOrder::Saliency(metric) => by_groups(metric.tiles(&picture(resolution))),
                    TileOrder::Error(metric) => by_groups(metric.errors(&picture(resolution))),
                };
                assert_eq!(indices(resolution, order), expected, "{resolution:?} {order:?}");
            }
        }
    }

    #[test]
    fn rows_are_from_left_to_right_and_then_down() {
        let tiles = Tiles::z_curve([20, 17]).ordered(TileOrder::Row, &ReducedPicture::default());
        let first: Vec<_> = (0..tiles.count()).map(|turn| tiles.nth(turn).first).collect();
        assert_eq!(first, [[0, 0], [8, 0], [16, 0], [0, 8], [8, 8], [16, 8], [0, 16], [8, 16], [16, 16]]);
    }

    #[test]
    fn the_random_order_is_always_the_same_and_no_other() {
        let resolution = [101, 75];
        let random = indices(resolution, TileOrder::Random);
        assert_eq!(random, indices(resolution, TileOrder::Random));
        for order in ORDERS {
            assert_eq!(random == indices(resolution, order), order == TileOrder::Random, "{order:?}");
        }
        // Nor is it near to the rows: by chance, one tile of all is at its place, and one follows its neighbour.
        let steps = random.windows(2).filter(|pair| pair[0] + 1 == pair[1]).count();
        let at_home = (0..).zip(&random).filter(|&(turn, &index)| turn == index).count();
        assert!(steps < 8 && at_home < 8, "{steps} {at_home}");
    }

    /// Each run of 4, 16, 64 tiles is a square of 2, 4, 8 along a side; of a picture that is no such square, the curve
    /// leaves out what is not there.
    #[test]
    fn tiles_near_on_the_z_curve_are_near_in_the_picture() {
        let place = |tile: Tile| tile.first.map(|x| x / TILE_SIDE_PIXELS);
        let tiles = Tiles::z_curve([128, 128]);
        let square: Vec<_> = (0..tiles.count()).map(|turn| place(tiles.nth(turn))).collect();
        for side in [2, 4, 8, 16] {
            for run in square.chunks((side * side) as usize) {
                assert!(run.iter().all(|at| at.map(|x| x / side) == run[0].map(|x| x / side)), "{side}");
            }
        }
        let tiles = Tiles::z_curve([101, 75]);
        let found: Vec<_> = (0..tiles.count()).map(|turn| place(tiles.nth(turn))).collect();
        let there = square.into_iter().filter(|&[x, y]| x < 13 && y < 10);
        assert_eq!(found, there.collect::<Vec<_>>());
    }

    /// One tile is not as the others, which are all as salient as each other.
    #[test]
    fn the_group_of_the_most_salient_tile_is_first_and_tiles_alike_stay_on_the_z_curve() {
        let resolution = [101, 75];
        let z_curve = Tiles::z_curve(resolution).order;
        for metric in [Saliency::Achanta, Saliency::Itti] {
            let order = |value: f32| {
                let is_odd = |pixel: [u32; 2]| pixel.map(|x| x / TILE_SIDE_PIXELS) == [7, 5];
                let picture =
                    ReducedPicture::of(
                        resolution,
                        |pixel| if is_odd(pixel) { [value; 3] } else { [0.25; 3] },
                    );
                Tiles::z_curve(resolution).ordered(TileOrder::Saliency(metric), &picture).order
            };
            assert_eq!(order(0.25), z_curve, "{metric:?}");
            let is_near = |index: u32| index % columns(resolution) < 8 && index / columns(resolution) < 8;
            let (near, rest): (Vec<u32>, Vec<u32>) = z_curve.iter().partition(|&&index| is_near(index));
            assert_eq!(order(0.75)[..64], near, "{metric:?}");
            if metric == Saliency::Achanta {
                assert_eq!(order(0.75)[64..], rest);
            }
        }
    }

    #[test]
    fn tiles_of_one_age_stay_in_their_order() {
        for order in ORDERS {
            let before = indices([101, 75], order);
            let mut tiles = Tiles { resolution: [101, 75], order: before.clone() };
            // Without a sample is before any.
            let age = |index: u32| [None, Some(1), Some(2)][index as usize % 3];
            tiles.sort_by_age(age);
            let expected = [None, Some(1), Some(2)]
                .into_iter()
                .flat_map(|now| before.iter().copied().filter(move |&index| age(index) == now));
            assert_eq!(tiles.order, expected.collect::<Vec<_>>(), "{order:?}");
        }
    }

    #[test]
    fn the_order_is_a_z() {
        let tiles = Tiles::z_curve([32, 32]);
        let first: Vec<_> = (0..6).map(|turn| tiles.nth(turn).first.map(|x| x / TILE_SIDE_PIXELS)).collect();
        assert_eq!(first, [[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [3, 0]]);
    }
}
