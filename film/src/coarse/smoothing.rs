//! Light of samples smoothed over neighbours that are alike.
//!
//! ```text
//! luminance, and its square -> means over 3x3 neighbours, then over 3x3 of every second one -> standard deviation
//! light -> means over 3x3 neighbours, then 3x3 of every second one, of every fourth, 8th, 16th (a-trous)
//! ```
//!
//! A neighbour counts where depth and albedo are alike, for less the more its normal differs, and its light from what
//! noise explains: so shadows keep their edges where light has little noise, and noise goes where it has much. A sample
//! on an outline may be turned away from all around it, and would stay a dot: the first pass mixes it with those alike
//! in depth and albedo.
//! H. Dammertz, D. Sewtz, J. Hanika, H. Lensch, "Edge-avoiding a-trous wavelet transform for fast global illumination
//! filtering" (2010); C. Schied et al., "Spatiotemporal variance-guided filtering" (2017), 4.2 to 4.4.
//!
//! ```text
//! step 8, 4   light of the samples -> copied to the work -> passes, back and forth between two halves of it
//! step 2      light of the samples <-> work, and back: they keep it smoothed
//! ```
//!
//! Deviations are kept for blocks of 2x2 samples, in a byte to a factor of the square root of 2: they say how much is
//! noise, no more.

use super::neighbours::{Contrast, Neighbours};
use super::surface::SurfaceRows;
use super::{Coarse, KEPT_STEP, SampleGrid, ToldTiles, grid_size, planes, planes_mut, work_count};
use crate::packed::{LUMINANCE, luminance};
use rayon::ThreadPool;
use rayon::prelude::*;

#[cfg(test)]
mod tests;

/// Weights along an axis, of the neighbour before, of the sample and of the neighbour after; and how far these are,
/// pass by pass.
const WEIGHTS: [f32; 3] = [0.25, 0.5, 0.25];
/// Those around a sample: down and to the right, from the one before on.
const AROUND: [[usize; 2]; 8] = [[0, 0], [0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1], [2, 2]];
const STRIDES: [usize; 5] = [1, 2, 4, 8, 16];
/// How far they are when the deviation is told.
const DEVIATION_STRIDES: [usize; 2] = [1, 2];
/// Deviations of a sample by which the light of a neighbour differs that counts half, pass by pass: each leaves less of
/// its noise.
const APART: [f32; 5] = [4.0, 2.0, 1.0, 0.5, 0.25];
/// A sample is alone when its neighbours weigh less together than this share of its own weight.
const ALONE_SHARE: f32 = 1.0 / 16.0;
/// Samples along a side of a block that has one deviation.
const BLOCK_SIDE: usize = 2;
/// Deviation of light that has no noise, as a share of it: of a slope.
const DEVIATION_LEAST: f32 = 0.02;
/// Most luminance that a deviation is told of.
const LUMINANCE_MOST: f32 = 1e18;
/// Numbers that a thread takes one after the other, at least.
const NUMBERS_LEAST: usize = 1 << 14;
/// Rows that a thread smooths one after the other, at least: those around them are decoded once.
const ROWS_LEAST: usize = 16;

const _: () = assert!(STRIDES.len() % 2 == 1, "the last pass writes where the first one did");

/// Planes of numbers, a number a sample each.
type Numbers<'a, const N: usize> = [&'a [f32]; N];

/// The deviations of the codes: 0, and the square roots of 2 to the powers from -126 to 128.
static DEVIATIONS: [f32; 256] = {
    let (mut table, mut code) = ([0.0; 256], 1);
    while code < table.len() {
        let power = f32::from_bits(((code as u32).div_ceil(2) + 63) << 23);
        table[code] = if code % 2 == 1 { power } else { power * std::f32::consts::SQRT_2 };
        code += 1;
    }
    table
};

/// Blocks of samples that have a deviation together, of a grid of so many columns and rows.
fn block_count(size: [usize; 2]) -> usize {
    size.into_iter().map(|side| side.div_ceil(BLOCK_SIDE)).product()
}

/// The code of a deviation of this square: the exponent of that, to the nearest.
fn code_of(variance: f32) -> u8 {
    ((variance.to_bits() + (1 << 22)) >> 23) as u8
}

impl Coarse {
    /// Bytes that are taken beside the samples from [`Coarse::smooth`] on, until [`Coarse::release_work`].
    pub(crate) fn work_bytes(resolution: [u32; 2]) -> u64 {
        let size = grid_size(resolution, KEPT_STEP).map(|side| side as usize);
        (work_count(resolution) * size_of::<f32>() + block_count(size)) as u64
    }

    /// Lets the work go; [`Coarse::fill`] and [`Coarse::set_samples`] want it, after the next [`Coarse::smooth`].
    pub(crate) fn release_work(&mut self) {
        (self.work, self.deviations) = (Vec::new(), Vec::new());
    }

    /// Takes the work, where it has been let go.
    pub(crate) fn make_room(&mut self) {
        // Exactly so many are leased.
        if self.work.is_empty() {
            self.work = vec![0.0; work_count(self.resolution)];
            let size = grid_size(self.resolution, KEPT_STEP).map(|side| side as usize);
            self.deviations = vec![0; block_count(size)];
        }
    }

    /// Smooths the samples at every `step`-th pixel, mixed with light that is kept in the world.
    pub(crate) fn smooth(&mut self, step: u32, pool: &ThreadPool) {
        if step == KEPT_STEP {
            self.recall(&|_| true, pool);
        }
        self.smooth_but(step, None, pool);
    }

    /// Smooths the samples of the finest step in all tiles but those that are told.
    pub(crate) fn smooth_exact(&mut self, is_fixed: ToldTiles<'_>, pool: &ThreadPool) {
        self.smooth_but(KEPT_STEP, Some(is_fixed), pool);
    }

    fn smooth_but(&mut self, step: u32, is_fixed: Option<ToldTiles<'_>>, pool: &ThreadPool) {
        self.make_room();
        let Coarse { resolution, surfaces, light, work, deviations, cache, .. } = self;
        let picked = SampleGrid { is_fixed, ..SampleGrid::new(surfaces, *resolution, step) };
        let count = picked.count();
        let (mut from, room) = if step == KEPT_STEP {
            (&mut light[..], &mut work[..])
        } else {
            let (copy, rest) = work.split_at_mut(3 * count);
            planes(light).into_iter().zip(copy.chunks_exact_mut(count)).for_each(|(light, copy)| {
                copy.iter_mut().zip(picked.places()).for_each(|(copy, at)| *copy = light[at]);
            });
            if let Some(cache) = cache {
                cache.mix(planes_mut(copy), picked.places().enumerate());
            }
            (copy, rest)
        };
        let (mut to, deviations) = (&mut room[..3 * count], &mut deviations[..block_count(picked.size)]);
        pool.install(|| {
            picked.find_deviations(from, to, deviations);
            for (stride, apart) in STRIDES.into_iter().zip(APART) {
                picked.smooth(stride, planes(from), to, Some((deviations, apart)));
                std::mem::swap(&mut from, &mut to);
            }
        });
        if step == KEPT_STEP {
            light.copy_from_slice(&work[..3 * count]);
        }
    }
}

impl SampleGrid<'_> {
    /// Finds the codes of the standard deviation of the luminance of `light` around the samples of each block, in the
    /// `room` of three planes.
    fn find_deviations(&self, light: &[f32], room: &mut [f32], codes: &mut [u8]) {
        let [red, green, blue] = planes(light);
        let [first, second, free] = planes_mut(room);
        let luminances = (red, green, blue).into_par_iter().map(|(r, g, b)| luminance([*r, *g, *b].into()));
        let moments = (&mut *first, &mut *second).into_par_iter().zip(luminances);
        moments.with_min_len(NUMBERS_LEAST).for_each(|((first, second), luminance)| {
            // Whose square is finite.
            *first = luminance.min(LUMINANCE_MOST);
            *second = *first * *first;
        });
        // One after the other, since one plane is free.
        let [near, far] = DEVIATION_STRIDES;
        self.smooth(near, [first], free, None);
        self.smooth(near, [second], first, None);
        self.smooth(far, [free], second, None);
        self.smooth(far, [first], free, None);
        let (mean, mean_square) = (&*second, &*free);
        let [width, height] = self.size;
        codes.par_chunks_exact_mut(width.div_ceil(BLOCK_SIDE)).enumerate().for_each(|(row, codes)| {
            let rows = row * BLOCK_SIDE..height.min((row + 1) * BLOCK_SIDE);
            for (column, code) in codes.iter_mut().enumerate() {
                let columns = column * BLOCK_SIDE..width.min((column + 1) * BLOCK_SIDE);
                let places = rows.clone().flat_map(|y| columns.clone().map(move |x| y * width + x));
                let variances = places.map(|at| (mean_square[at] - mean[at] * mean[at]).max(0.0));
                let count = (rows.len() * columns.len()) as f32;
                *code = code_of(variances.sum::<f32>() / count);
            }
        });
    }

    /// Smooths `light` over neighbours `stride` apart, to `out`; guided by deviations of samples, at so many of which a
    /// neighbour counts half.
    fn smooth<const N: usize>(
        &self,
        stride: usize,
        light: Numbers<'_, N>,
        out: &mut [f32],
        guide: Option<(&[u8], f32)>,
    ) {
        let [width, height] = self.size;
        let blocks = width.div_ceil(BLOCK_SIDE);
        let mut planes = out.chunks_exact_mut(self.count()).map(|plane| plane.chunks_exact_mut(width));
        let mut planes: [_; N] = std::array::from_fn(|_| planes.next().expect("room for all planes"));
        let mut row = |_| planes.each_mut().map(|rows| rows.next().expect("a plane has all rows"));
        let mut rows: Vec<(usize, [&mut [f32]; N])> = (0..height).map(|y| (y, row(y))).collect();
        // Those that are neighbours follow each other.
        rows.sort_unstable_by_key(|(y, _)| (y % stride, *y));
        let room = || RowRoom::new(stride, width);
        rows.into_par_iter().with_min_len(ROWS_LEAST).for_each_init(room, |room, (y, mut out)| {
            let guide =
                guide.map(|(deviations, apart)| (&deviations[y / BLOCK_SIDE * blocks..][..blocks], apart));
            self.smooth_row(room, [y, stride], light, &mut out, guide);
            self.restore_fixed(y, light, out);
        });
    }

    /// Writes the smoothed light of row `y`, which has these deviations, to `out`.
    fn smooth_row<const N: usize>(
        &self,
        room: &mut RowRoom,
        [y, stride]: [usize; 2],
        light: Numbers<'_, N>,
        out: &mut [&mut [f32]; N],
        guide: Option<(&[u8], f32)>,
    ) {
        let [width, height] = self.size;
        let RowRoom { surfaces, total, contrasts } = room;
        let row_of = |y: usize| light.map(|plane| &plane[y * width..][..width]);
        out.iter_mut().zip(row_of(y)).for_each(|(out, light)| out.copy_from_slice(light));
        let near = [y.checked_sub(stride), Some(y), Some(y + stride)];
        let near = near.map(|other| other.filter(|other| *other < height));
        near.into_iter().flatten().for_each(|other| self.see(other, surfaces));
        let here = surfaces.row(y);
        // Where nothing is seen there is nothing to smooth.
        let is_seen = |depth: &f32| *depth < f32::INFINITY;
        let Some(from) = here.depth.iter().position(is_seen) else { return };
        let to = here.depth.iter().rposition(is_seen).expect("there is a first one") + 1;
        if let Some(guide) = guide {
            contrasts.learn(near.map(|other| other.map(row_of)), guide);
        }
        // A sample weighs with itself, and is alike to itself.
        let own = WEIGHTS[1] * WEIGHTS[1];
        total.fill(own);
        out.iter_mut().flat_map(|row| row.iter_mut()).for_each(|light| *light *= own);
        for [down, right] in AROUND {
            let Some(other) = near[down] else { continue };
            // Columns whose neighbour is on the grid.
            let right_by = right * stride;
            let (first, end) = (
                from.max(stride.saturating_sub(right_by)),
                to.min((width + stride).saturating_sub(right_by)),
            );
            if first >= end {
                continue;
            }
            let (row, light) = (surfaces.row(other), row_of(other));
            let (at, contrast) = (first + right_by - stride, guide.map(|_| contrasts.with(down)));
            let sums = out.each_mut().map(|row| &mut row[first..end]);
            let neighbours = Neighbours { here, first, row, light, at, contrast };
            neighbours.add(&mut total[first..end], sums, WEIGHTS[right] * WEIGHTS[down]);
        }
        let is_first = guide.is_some() && stride == STRIDES[0];
        for x in (from..to).filter(|_| is_first) {
            if total[x] >= (1.0 + ALONE_SHARE) * own {
                continue;
            }
            total[x] = own;
            out.iter_mut().zip(row_of(y)).for_each(|(out, light)| out[x] = own * light[x]);
            for [down, right] in AROUND {
                let at = (x + right).checked_sub(1).filter(|at| *at < width);
                let (Some(other), Some(at)) = (near[down], at) else { continue };
                let (row, light) = (surfaces.row(other), row_of(other));
                let sums = out.each_mut().map(|row| &mut row[x..=x]);
                let neighbours = Neighbours { here, first: x, row, light, at, contrast: None };
                neighbours.add_turned(&mut total[x..=x], sums, WEIGHTS[right] * WEIGHTS[down]);
            }
        }
        for row in out {
            row.iter_mut().zip(&*total).for_each(|(light, total)| *light /= total);
        }
    }

    /// Takes the samples of row `y` in tiles that stay as they are from `light`.
    fn restore_fixed<const N: usize>(&self, y: usize, light: Numbers<'_, N>, mut out: [&mut [f32]; N]) {
        let Some(is_fixed) = self.is_fixed else { return };
        for (_, at) in self.tiles_of_row(y).filter(|(index, _)| is_fixed(*index)) {
            for (out, light) in out.iter_mut().zip(light) {
                out[at.clone()].copy_from_slice(&light[y * self.size[0]..][at.clone()]);
            }
        }
    }
}

/// Room to smooth rows in.
struct RowRoom {
    surfaces: SurfaceRows,
    /// Weights so far.
    total: Vec<f32>,
    contrasts: Contrasts,
}

/// The luminances of a row and of its neighbours before and after it, and what tells them apart.
struct Contrasts {
    luminances: [Vec<f32>; 3],
    per_half: Vec<f32>,
}

impl RowRoom {
    /// For rows of so many samples, with neighbours `stride` apart.
    fn new(stride: usize, width: usize) -> RowRoom {
        let row = || vec![0.0; width];
        let contrasts = Contrasts { luminances: [row(), row(), row()], per_half: row() };
        RowRoom { surfaces: SurfaceRows::new(stride), total: row(), contrasts }
    }
}

impl Contrasts {
    /// Learns the light of the row, which has these deviations, and of those beside it that are there.
    fn learn<const N: usize>(
        &mut self,
        rows: [Option<Numbers<'_, N>>; 3],
        (deviations, apart): (&[u8], f32),
    ) {
        let Contrasts { luminances, per_half } = self;
        for (luminances, light) in luminances.iter_mut().zip(rows) {
            let Some(light) = light else { continue };
            luminances.fill(0.0);
            for (plane, share) in light.into_iter().zip(LUMINANCE) {
                luminances.iter_mut().zip(plane).for_each(|(sum, light)| *sum += share * light);
            }
        }
        for (x, (per_half, luminance)) in per_half.iter_mut().zip(&luminances[1]).enumerate() {
            let deviation = DEVIATIONS[usize::from(deviations[x / BLOCK_SIDE])];
            *per_half = 1.0 / (apart * deviation + DEVIATION_LEAST * luminance + f32::MIN_POSITIVE);
        }
    }

    /// The contrast with the neighbours of row `down`: of the one before, of this row, or of the one after.
    fn with(&self, down: usize) -> Contrast<'_> {
        Contrast { luminances: [&self.luminances[1], &self.luminances[down]], per_half: &self.per_half }
    }
}
