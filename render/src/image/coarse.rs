//! `Coarse`: samples at every so many pixels, and the picture that is made of them.
//!
//! ```text
//! samples -> light alone: radiance over albedo
//!         -> smoothed over neighbours of one surface, 3x3 of them, then 3x3 of every second one, of every fourth
//!            (a-trous)
//!         -> pixels between, from the four samples around: bilinear where these are of one surface, else like the
//!            nearest -> radiance
//! ```
//!
//! One surface: alike in depth, normal and albedo. So an edge is a stair of the grid's step, and no colour bleeds
//! across it. H. Dammertz, D. Sewtz, J. Hanika, H. Lensch, "Edge-avoiding a-trous wavelet transform for fast global
//! illumination filtering" (2010).
//!
//! Invariants: 1. even light stays even; 2. a pixel's sums have one order, so the bytes do not depend on threads.

use super::film::LayerPixel;
use glam::Vec3;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Pixels from sample to sample, the coarsest first. Powers of two, so that each grid holds those before it. None is as
/// fine as the picture: with a sample at each pixel it would cost what the exact tiles cost.
pub(crate) const STEPS: [u32; 3] = [8, 4, 2];
/// Step of the finest grid, whose samples are kept.
const KEPT_STEP: u32 = STEPS[STEPS.len() - 1];
/// Depths of neighbours on one surface differ by less than this share.
const DEPTH_SHARE: f32 = 0.08;
/// Least cosine between the normals of neighbours on one surface.
const NORMAL_COS: f32 = 0.85;
/// Most that the albedos of neighbours on one surface differ by, per channel.
const ALBEDO_APART: f32 = 0.08;
/// Most light of a sample: sums of some are still finite.
const LIGHT_MOST: f32 = 1e30;
/// Least albedo that light is told from.
const ALBEDO_LEAST: f32 = 1.0 / 64.0;
/// Smoothing: weights along an axis, of the neighbour before, of the sample and of the neighbour after; and how far
/// these are, pass by pass.
const WEIGHTS: [f32; 3] = [0.25, 0.5, 0.25];
const STRIDES: [usize; 3] = [1, 2, 4];

/// What a sample saw.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Light that leaves the surface, over its albedo.
    light: Vec3,
    /// Infinite where nothing is seen.
    depth: f32,
    /// Parts of 127, and of 255.
    normal: [i8; 3],
    albedo: [u8; 3],
}

/// Samples at every [`KEPT_STEP`]-th pixel.
#[derive(Debug)]
pub(super) struct Coarse {
    resolution: [u32; 2],
    kept: Vec<Seen>,
    picked: Picked,
}

/// The samples that a picture is made of, number by number: so that those of a row go side by side.
#[derive(Debug, Default)]
struct Picked {
    /// Columns and rows.
    size: [usize; 2],
    depth: Vec<f32>,
    normal: [Vec<f32>; 3],
    albedo: [Vec<f32>; 3],
    light: [Vec<f32>; 3],
    smooth: [Vec<f32>; 3],
}

/// Numbers of a [`Picked`] sample.
const PICKED_NUMBERS: usize = 13;

/// Width and height of the grid with a sample at every `step`-th pixel of a picture of `resolution`.
pub(crate) fn grid_size(resolution: [u32; 2], step: u32) -> [u32; 2] {
    resolution.map(|side| side.div_ceil(step))
}

fn kept_count(resolution: [u32; 2]) -> usize {
    let [columns, rows] = grid_size(resolution, KEPT_STEP);
    columns as usize * rows as usize
}

impl Coarse {
    /// Bytes that the samples of a picture of `resolution` take.
    pub(super) fn bytes(resolution: [u32; 2]) -> u64 {
        (kept_count(resolution) * (size_of::<Seen>() + PICKED_NUMBERS * size_of::<f32>())) as u64
    }

    /// Samples that saw nothing.
    pub(super) fn new(resolution: [u32; 2]) -> Coarse {
        let count = kept_count(resolution);
        let kept = vec![Seen::new(Vec3::ZERO, &LayerPixel::NOTHING); count];
        Coarse { resolution, kept, picked: Picked::with_capacity(count) }
    }

    /// Sets the sample of a pixel (x, y), both of them multiples of [`KEPT_STEP`].
    pub(super) fn set(&mut self, [x, y]: [u32; 2], radiance: Vec3, seen: &LayerPixel) {
        let columns = grid_size(self.resolution, KEPT_STEP)[0];
        self.kept[((y / KEPT_STEP) * columns + x / KEPT_STEP) as usize] = Seen::new(radiance, seen);
    }

    /// Smooths the samples at every `step`-th pixel.
    pub(super) fn smooth(&mut self, step: u32, pool: &ThreadPool) {
        let columns = grid_size(self.resolution, KEPT_STEP)[0] as usize;
        let size = grid_size(self.resolution, step).map(|side| side as usize);
        self.picked.pick(&self.kept, columns, (step / KEPT_STEP) as usize, size);
        pool.install(|| STRIDES.iter().for_each(|&stride| self.picked.smooth(stride)));
    }

    /// Makes a picture of the samples that were smoothed, at every `step`-th pixel.
    pub(super) fn fill(&self, step: u32, radiance: &mut [[f32; 3]], pool: &ThreadPool) {
        pool.install(|| self.picked.fill(step as usize, radiance, self.resolution[0] as usize));
    }

    /// Shows each of them at its own pixel.
    pub(super) fn set_samples(&self, step: u32, radiance: &mut [[f32; 3]]) {
        let (step, width) = (step as usize, self.resolution[0] as usize);
        let pixels = radiance.chunks_mut(width).step_by(step).flat_map(|row| row.iter_mut().step_by(step));
        pixels.enumerate().for_each(|(at, pixel)| *pixel = self.picked.shade(at).into());
    }
}

impl Picked {
    fn with_capacity(count: usize) -> Picked {
        let room = || Vec::with_capacity(count);
        let three = || [room(), room(), room()];
        let (normal, albedo, light, smooth) = (three(), three(), three(), three());
        Picked { size: [0; 2], depth: room(), normal, albedo, light, smooth }
    }

    /// Takes every `stride`-th sample of every `stride`-th row of `kept`, whose rows have `columns`.
    fn pick(&mut self, kept: &[Seen], columns: usize, stride: usize, size: [usize; 2]) {
        let samples =
            || kept.chunks_exact(columns).step_by(stride).flat_map(|row| row.iter().step_by(stride));
        fn fill<'a>(
            plane: &mut Vec<f32>,
            samples: impl Iterator<Item = &'a Seen>,
            number: impl Fn(&Seen) -> f32,
        ) {
            plane.clear();
            plane.extend(samples.map(number));
        }
        fill(&mut self.depth, samples(), |seen| seen.depth);
        for c in 0..3 {
            fill(&mut self.normal[c], samples(), |seen| f32::from(seen.normal[c]) / 127.0);
            fill(&mut self.albedo[c], samples(), |seen| seen.albedo()[c]);
            fill(&mut self.light[c], samples(), |seen| seen.light[c]);
            self.smooth[c].resize(self.light[c].len(), 0.0);
        }
        self.size = size;
        debug_assert_eq!(self.depth.len(), size[0] * size[1]);
    }

    /// Smooths the light over neighbours `stride` apart.
    fn smooth(&mut self, stride: usize) {
        let [mut red, mut green, mut blue] = std::mem::take(&mut self.smooth);
        let width = self.size[0];
        let rows = red.par_chunks_exact_mut(width).zip(green.par_chunks_exact_mut(width));
        rows.zip(blue.par_chunks_exact_mut(width)).enumerate().for_each(|(y, ((red, green), blue))| {
            self.smooth_row(y, stride, [red, green, blue]);
        });
        self.smooth = [red, green, blue];
        std::mem::swap(&mut self.smooth, &mut self.light);
    }

    /// Writes the smoothed light of row `y` to `out`.
    fn smooth_row(&self, y: usize, stride: usize, out: [&mut [f32]; 3]) {
        let [width, height] = self.size;
        let row = y * width..(y + 1) * width;
        let [red, green, blue] = out;
        for (row_out, light) in [&mut *red, green, blue].into_iter().zip(&self.light) {
            row_out.copy_from_slice(&light[row.clone()]);
        }
        // Where nothing is seen there is nothing to smooth.
        let is_seen = |depth: &f32| *depth < f32::INFINITY;
        let Some(from) = self.depth[row.clone()].iter().position(is_seen) else { return };
        let to = self.depth[row].iter().rposition(is_seen).expect("there is a first one") + 1;
        // A sample weighs with itself, and is alike to itself.
        let own = WEIGHTS[1] * WEIGHTS[1];
        let mut total = vec![own; width];
        [&mut *red, green, blue].into_iter().flatten().for_each(|light| *light *= own);
        for (down, weight_y) in WEIGHTS.iter().enumerate() {
            let Some(other) = (y + down * stride).checked_sub(stride).filter(|y| *y < height) else {
                continue;
            };
            for (right, weight_x) in WEIGHTS.iter().enumerate() {
                // Columns whose neighbour is on the grid.
                let right_by = right * stride;
                let (first, end) = (
                    from.max(stride.saturating_sub(right_by)),
                    to.min((width + stride).saturating_sub(right_by)),
                );
                if first >= end || (down, right) == (1, 1) {
                    continue;
                }
                let (here, there) = (y * width + first, other * width + first + right_by - stride);
                let sums = [&mut *red, green, blue].map(|row| &mut row[first..end]);
                self.add_row((&mut total[first..end], sums), [here, there], weight_x * weight_y);
            }
        }
        for row in [red, green, blue] {
            row.iter_mut().zip(&total).for_each(|(light, total)| *light /= total);
        }
    }

    /// Adds the weights and the light of neighbours to their sums, where these are of one surface.
    #[inline]
    fn add_row(
        &self,
        (total, [red, green, blue]): (&mut [f32], [&mut [f32]; 3]),
        [here, there]: [usize; 2],
        weight: f32,
    ) {
        let count = total.len();
        let (red, green, blue) = (&mut red[..count], &mut green[..count], &mut blue[..count]);
        let [d0, d1] = [here, there].map(|at| &self.depth[at..at + count]);
        let [nx0, nx1] = [here, there].map(|at| &self.normal[0][at..at + count]);
        let [ny0, ny1] = [here, there].map(|at| &self.normal[1][at..at + count]);
        let [nz0, nz1] = [here, there].map(|at| &self.normal[2][at..at + count]);
        let [ar0, ar1] = [here, there].map(|at| &self.albedo[0][at..at + count]);
        let [ag0, ag1] = [here, there].map(|at| &self.albedo[1][at..at + count]);
        let [ab0, ab1] = [here, there].map(|at| &self.albedo[2][at..at + count]);
        let [lr, lg, lb] = [0, 1, 2].map(|c| &self.light[c][there..there + count]);
        for i in 0..count {
            let dot = nx0[i] * nx1[i] + ny0[i] * ny1[i] + nz0[i] * nz1[i];
            let apart = (ar0[i] - ar1[i]).abs().max((ag0[i] - ag1[i]).abs()).max((ab0[i] - ab1[i]).abs());
            let is_near = (d0[i] - d1[i]).abs() < DEPTH_SHARE * d0[i].min(d1[i]);
            let is_alike = is_near & (dot > NORMAL_COS) & (apart < ALBEDO_APART);
            let weight = if is_alike { weight } else { 0.0 };
            total[i] += weight;
            red[i] += weight * lr[i];
            green[i] += weight * lg[i];
            blue[i] += weight * lb[i];
        }
    }

    /// Fills the pixels of `radiance`, rows of `width`, from samples at every `step`-th.
    fn fill(&self, step: usize, radiance: &mut [[f32; 3]], width: usize) {
        let [columns, rows] = self.size;
        let weights: Vec<[f32; 4]> = (0..step * step)
            .map(|at| {
                let [u, v] = [at % step, at / step].map(|at| at as f32 / step as f32);
                [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]
            })
            .collect();
        radiance.par_chunks_mut(width * step).enumerate().for_each(|(y, band)| {
            for x in 0..columns {
                let [right, down] = [(x + 1).min(columns - 1), (y + 1).min(rows - 1)];
                let corners =
                    [y * columns + x, y * columns + right, down * columns + x, down * columns + right];
                self.fill_cell((band, width), [x * step, step], corners, &weights);
            }
        });
    }

    /// Fills the pixels of a cell of the grid, `step` along a side and from column `x` of `band` on, from its corners.
    fn fill_cell(
        &self,
        (band, width): (&mut [[f32; 3]], usize),
        [x, step]: [usize; 2],
        corners: [usize; 4],
        weights: &[[f32; 4]],
    ) {
        let is_one = corners[1..].iter().all(|&corner| self.is_alike(corners[0], corner));
        let shades = corners.map(|at| self.shade(at));
        let columns = step.min(width - x);
        for (row, weights) in band.chunks_exact_mut(width).zip(weights.chunks_exact(step)) {
            for (pixel, weights) in row[x..][..columns].iter_mut().zip(weights) {
                let mut weights = *weights;
                if !is_one {
                    self.keep_alike(corners, &mut weights);
                }
                let [a, b, c, d] = shades;
                *pixel = (weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d).into();
            }
        }
    }

    /// Radiance of a sample.
    fn shade(&self, at: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.light[c][at] * self.albedo[c][at]))
    }

    /// Leaves weight only to the nearest corner and those that are of one surface with it.
    fn keep_alike(&self, corners: [usize; 4], weights: &mut [f32; 4]) {
        let nearest =
            (1..4).fold(0, |best, corner| if weights[corner] > weights[best] { corner } else { best });
        for (corner, weight) in weights.iter_mut().enumerate() {
            let stays = corner == nearest || self.is_alike(corners[nearest], corners[corner]);
            *weight = if stays { *weight } else { 0.0 };
        }
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
    }

    /// True when two neighbours are of one surface, or both saw nothing.
    fn is_alike(&self, a: usize, b: usize) -> bool {
        if self.depth[a] == f32::INFINITY || self.depth[b] == f32::INFINITY {
            return self.depth[a] == self.depth[b];
        }
        let dot: f32 = self.normal.iter().map(|plane| plane[a] * plane[b]).sum();
        let apart = self.albedo.iter().map(|plane| (plane[a] - plane[b]).abs()).fold(0.0, f32::max);
        (self.depth[a] - self.depth[b]).abs() < DEPTH_SHARE * self.depth[a].min(self.depth[b])
            && dot > NORMAL_COS
            && apart < ALBEDO_APART
    }
}

impl Seen {
    fn new(radiance: Vec3, seen: &LayerPixel) -> Seen {
        let mut new = Seen {
            light: radiance,
            depth: seen.depth,
            normal: seen.normal.map(|v| (v * 127.0).round() as i8),
            albedo: seen.albedo.map(|v| (v * 255.0).round() as u8),
        };
        new.light = (radiance / new.albedo()).min(Vec3::splat(LIGHT_MOST));
        new
    }

    /// What light is multiplied by.
    fn albedo(&self) -> Vec3 {
        match self.depth == f32::INFINITY {
            true => Vec3::ONE,
            false => Vec3::from(self.albedo.map(|v| (f32::from(v) / 255.0).max(ALBEDO_LEAST))),
        }
    }
}
