//! `Coarse`: samples at every so many pixels, and the picture that is made of them.
//!
//! ```text
//! samples -> light alone: radiance over albedo
//!         -> smoothed over neighbours alike in depth and albedo, for less the more their normals differ: 3x3 of them,
//!            then 3x3 of every second one, of every fourth (a-trous)
//!         -> pixels between, from the four samples around: bilinear where these are of one surface, else like the
//!            nearest -> radiance
//! ```
//!
//! One surface: alike in depth and albedo. So an edge is a stair of the grid's step, and no colour bleeds
//! across it. H. Dammertz, D. Sewtz, J. Hanika, H. Lensch, "Edge-avoiding a-trous wavelet transform for fast global
//! illumination filtering" (2010).
//!
//! ```text
//! step 8, 4   light of the samples -> copied to the work -> passes, back and forth between two halves of it
//! step 2      light of the samples <-> work, and back: they keep it smoothed
//! ```
//!
//! Invariants: 1. even light stays even; 2. a pixel's sums have one order, so the bytes do not depend on threads;
//! 3. samples keep their light until a picture of the finest step is made of them, from then on that of the picture;
//! 4. the work may be let go once a picture is filled in, and is there again with the next.
//!
//! Before they are smoothed, samples are mixed with light that is kept in the world (`light_cache.rs`).
//! Exact samples of tiles replace those of the grid (`exact.rs`), and are smoothed as they are. What the preview has
//! smoothed already stays as it is beside them, and counts as their neighbour.

mod carry;
mod cells;
mod corners;
mod exact;
mod grid;
mod history;
mod light_cache;
mod neighbours;
mod recall;
mod surface;

use self::cells::{CellPixels, Cells};
pub(crate) use self::corners::{CornersOf, TileCorners};
use self::grid::{KEPT_STEP, sample_count};
pub use self::grid::{STEPS, grid_size};
use self::history::History;
pub use self::history::Reprojection;
use self::light_cache::LightCache;
use self::neighbours::Neighbours;
use self::surface::{Surface, SurfaceRows};
use super::film::LayerPixel;
use super::packed::PackedLight;
use super::tile::TILE_SIDE_PIXELS;
use glam::Vec3;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::Range;

/// Those of the finest grid along a side of a tile.
const TILE_SIDE_SAMPLES: usize = (TILE_SIDE_PIXELS / KEPT_STEP) as usize;
/// Most light of a sample: sums of some are still finite.
const LIGHT_MOST: f32 = 1e30;
/// Smoothing: weights along an axis, of the neighbour before, of the sample and of the neighbour after; and how far
/// these are, pass by pass.
const WEIGHTS: [f32; 3] = [0.25, 0.5, 0.25];
const STRIDES: [usize; 3] = [1, 2, 4];
/// Rows that a thread smooths one after the other, at least: those around them are decoded once.
const ROWS_LEAST: usize = 16;

/// Samples at every [`KEPT_STEP`]-th pixel, and the picture that is made of some or all of them.
#[derive(Debug)]
pub(super) struct Coarse {
    resolution: [u32; 2],
    surfaces: Vec<Surface>,
    /// Light that leaves the surfaces, over their albedo: three planes.
    light: Vec<f32>,
    /// Room for the passes; empty until it is wanted.
    work: Vec<f32>,
    /// The picture before; `None` where there is no room for it.
    history: Option<History>,
    /// Light kept in the world; `None` where there is no room for it.
    cache: Option<LightCache>,
}

/// The samples that a picture is made of: every `stride`-th of every `stride`-th row of those kept.
#[derive(Clone, Copy)]
struct SampleGrid<'a> {
    surfaces: &'a [Surface],
    /// Samples in a row of those kept.
    pitch: usize,
    stride: usize,
    /// Columns and rows of those picked.
    size: [usize; 2],
    /// Tells the tiles whose samples stay as they are; of the finest step alone.
    is_fixed: Option<FixedTiles<'a>>,
}

/// Tells tiles, by index.
type FixedTiles<'a> = &'a (dyn Fn(u32) -> bool + Sync);

/// Three planes of light, of the samples picked.
type Planes<'a> = [&'a [f32]; 3];

/// Numbers of the work: a copy of the light and as much again for every step but the finest.
fn work_count(resolution: [u32; 2]) -> usize {
    let sets = |step: u32| if step == KEPT_STEP { 1 } else { 2 };
    STEPS.into_iter().map(|step| 3 * sets(step) * sample_count(resolution, step)).max().unwrap_or(0)
}

/// Where in the work the light of the samples at every `step`-th pixel is, once it is smoothed: after an odd number of
/// passes.
fn smoothed_place(resolution: [u32; 2], step: u32) -> Range<usize> {
    let numbers = 3 * sample_count(resolution, step);
    let first = if step == KEPT_STEP { 0 } else { numbers };
    first..first + numbers
}

fn planes_mut(light: &mut [f32]) -> [&mut [f32]; 3] {
    let count = light.len() / 3;
    let (red, rest) = light.split_at_mut(count);
    let (green, blue) = rest.split_at_mut(count);
    [red, green, blue]
}

fn planes(light: &[f32]) -> Planes<'_> {
    let count = light.len() / 3;
    [0, 1, 2].map(|c| &light[c * count..][..count])
}

impl Coarse {
    /// Bytes that the samples of a picture of `resolution` take, without [`Coarse::work_bytes`].
    pub(super) fn bytes(resolution: [u32; 2]) -> u64 {
        let bytes = size_of::<Surface>() + 3 * size_of::<f32>();
        (sample_count(resolution, KEPT_STEP) * bytes) as u64
    }

    /// Bytes that are taken beside them from [`Coarse::smooth`] on, until [`Coarse::release_work`].
    pub(super) fn work_bytes(resolution: [u32; 2]) -> u64 {
        (work_count(resolution) * size_of::<f32>()) as u64
    }

    /// Samples that saw nothing.
    pub(super) fn new(resolution: [u32; 2]) -> Coarse {
        let count = sample_count(resolution, KEPT_STEP);
        let surfaces = vec![Surface::new(&LayerPixel::NOTHING); count];
        Coarse {
            resolution,
            surfaces,
            light: vec![0.0; 3 * count],
            work: Vec::new(),
            history: None,
            cache: None,
        }
    }

    /// Lets the work go; [`Coarse::fill`] and [`Coarse::set_samples`] want it, after the next [`Coarse::smooth`].
    pub(super) fn release_work(&mut self) {
        self.work = Vec::new();
    }

    /// Sets the sample of a pixel (x, y), both of them multiples of [`KEPT_STEP`].
    pub(super) fn set(&mut self, [x, y]: [u32; 2], radiance: Vec3, seen: &LayerPixel) {
        let at = self.place([x, y]);
        let surface = Surface::new(seen);
        let light = (radiance / Vec3::from(surface.albedo())).min(Vec3::splat(LIGHT_MOST));
        self.surfaces[at] = surface;
        self.set_key(at, seen);
        let count = self.surfaces.len();
        (0..3).for_each(|c| self.light[c * count + at] = light[c]);
    }

    /// The place of the sample of the cell that a pixel (x, y) is in.
    fn place(&self, [x, y]: [u32; 2]) -> usize {
        let columns = grid_size(self.resolution, KEPT_STEP)[0];
        ((y / KEPT_STEP) * columns + x / KEPT_STEP) as usize
    }

    /// True when the sample of the cell of a pixel (x, y), which what is shown there is made of, saw what is `seen`
    /// there.
    pub(super) fn is_same(&self, pixel: [u32; 2], seen: &LayerPixel) -> bool {
        self.surfaces[self.place(pixel)].is_same(&Surface::new(seen))
    }

    /// Smooths the samples at every `step`-th pixel.
    pub(super) fn smooth(&mut self, step: u32, pool: &ThreadPool) {
        self.smooth_but(step, None, pool);
    }

    /// Smooths the samples of the finest step in all tiles but those that are told.
    pub(super) fn smooth_exact(&mut self, is_fixed: FixedTiles<'_>, pool: &ThreadPool) {
        self.smooth_but(KEPT_STEP, Some(is_fixed), pool);
    }

    fn smooth_but(&mut self, step: u32, is_fixed: Option<FixedTiles<'_>>, pool: &ThreadPool) {
        // Exactly so many are leased.
        if self.work.is_empty() {
            self.work = vec![0.0; work_count(self.resolution)];
        }
        let Coarse { resolution, surfaces, light, work, .. } = self;
        let picked = SampleGrid { is_fixed, ..SampleGrid::new(surfaces, *resolution, step) };
        let numbers = 3 * picked.count();
        let (mut from, mut to) = if step == KEPT_STEP {
            (&mut light[..], &mut work[..numbers])
        } else {
            let (copy, rest) = work.split_at_mut(numbers);
            planes(light).into_iter().zip(copy.chunks_exact_mut(numbers / 3)).for_each(|(light, copy)| {
                copy.iter_mut().zip(picked.places()).for_each(|(copy, at)| *copy = light[at]);
            });
            (copy, &mut rest[..numbers])
        };
        pool.install(|| {
            for stride in STRIDES {
                picked.smooth(stride, planes(from), to);
                std::mem::swap(&mut from, &mut to);
            }
        });
        if step == KEPT_STEP {
            light.copy_from_slice(&work[..numbers]);
        }
    }

    /// The samples at every `step`-th pixel that were smoothed last, and their light.
    fn smoothed(&self, step: u32) -> (SampleGrid<'_>, Planes<'_>) {
        // Until the next picture is made that is the one before, if that has been taken for it.
        let surfaces = self.history.as_ref().and_then(History::surfaces_on_show).unwrap_or(&self.surfaces);
        let picked = SampleGrid::new(surfaces, self.resolution, step);
        (picked, planes(&self.work[smoothed_place(self.resolution, step)]))
    }

    /// Makes a picture of the samples that were smoothed, at every `step`-th pixel; of the finest step with what is
    /// known of pixels between them.
    pub(super) fn fill(
        &self,
        step: u32,
        corners: CornersOf<'_>,
        radiance: &mut [PackedLight],
        pool: &ThreadPool,
    ) {
        let (picked, light) = self.smoothed(step);
        let corners = (step == KEPT_STEP).then_some(corners);
        let width = self.resolution[0] as usize;
        pool.install(|| picked.fill((light, step as usize), corners, radiance, width));
    }

    /// Shows each of them at its own pixel.
    pub(super) fn set_samples(&self, step: u32, radiance: &mut [PackedLight]) {
        let (picked, light) = self.smoothed(step);
        let (step, width) = (step as usize, self.resolution[0] as usize);
        let pixels = radiance.chunks_mut(width).step_by(step).flat_map(|row| row.iter_mut().step_by(step));
        for ((at, kept_at), pixel) in picked.places().enumerate().zip(pixels) {
            let albedo = picked.surfaces[kept_at].albedo();
            *pixel = PackedLight::new([0, 1, 2].map(|c| light[c][at] * albedo[c]));
        }
    }
}

const _: () = assert!(STRIDES.len() % 2 == 1, "the last pass writes where the first one did");

impl<'a> SampleGrid<'a> {
    fn new(surfaces: &'a [Surface], resolution: [u32; 2], step: u32) -> SampleGrid<'a> {
        let size = grid_size(resolution, step).map(|side| side as usize);
        let pitch = grid_size(resolution, KEPT_STEP)[0] as usize;
        SampleGrid { surfaces, pitch, stride: (step / KEPT_STEP) as usize, size, is_fixed: None }
    }

    fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Where the samples stand among those kept, by rows.
    fn places(&self) -> impl Iterator<Item = usize> + use<> {
        let SampleGrid { pitch, stride, size: [columns, rows], .. } = *self;
        (0..rows).flat_map(move |y| (0..columns).map(move |x| (y * pitch + x) * stride))
    }

    /// Sees the surfaces of row `y`.
    fn see(&self, y: usize, rows: &mut SurfaceRows) {
        let row = &self.surfaces[y * self.stride * self.pitch..][..self.pitch];
        let is_new = rows.see(y, row, self.stride);
        if let Some(is_fixed) = self.is_fixed.filter(|_| is_new) {
            // Voxels that stand in are no neighbours of exact samples.
            self.tiles_of_row(y)
                .filter(|(index, _)| is_fixed(*index))
                .for_each(|(_, at)| rows.hide_voxels(y, at));
        }
    }

    /// The tiles that row `y` of the finest grid goes through, and their samples in it.
    fn tiles_of_row(&self, y: usize) -> impl Iterator<Item = (u32, Range<usize>)> + use<> {
        let width = self.size[0];
        let first = y / TILE_SIDE_SAMPLES * width.div_ceil(TILE_SIDE_SAMPLES);
        let parts = (0..width).step_by(TILE_SIDE_SAMPLES);
        (first as u32..).zip(parts.map(move |x| x..width.min(x + TILE_SIDE_SAMPLES)))
    }

    /// Smooths `light` over neighbours `stride` apart, to `out`.
    fn smooth(&self, stride: usize, light: Planes<'_>, out: &mut [f32]) {
        let width = self.size[0];
        let (red, rest) = out.split_at_mut(self.count());
        let (green, blue) = rest.split_at_mut(self.count());
        let rows = red.par_chunks_exact_mut(width).zip(green.par_chunks_exact_mut(width));
        let rows = rows.zip(blue.par_chunks_exact_mut(width)).enumerate();
        let seen = || SurfaceRows::new(stride);
        rows.with_min_len(ROWS_LEAST).for_each_init(seen, |room, (y, ((red, green), blue))| {
            self.smooth_row(room, [y, stride], light, [&mut *red, &mut *green, &mut *blue]);
            self.restore_fixed(y, light, [red, green, blue]);
        });
    }

    /// Writes the smoothed light of row `y` to `out`.
    fn smooth_row(
        &self,
        rows: &mut SurfaceRows,
        [y, stride]: [usize; 2],
        light: Planes<'_>,
        out: [&mut [f32]; 3],
    ) {
        let [width, height] = self.size;
        let [red, green, blue] = out;
        for (row_out, light) in [&mut *red, green, blue].into_iter().zip(light) {
            row_out.copy_from_slice(&light[y * width..][..width]);
        }
        let near = [y.checked_sub(stride), Some(y), Some(y + stride)];
        let near = near.map(|other| other.filter(|other| *other < height));
        near.into_iter().flatten().for_each(|other| self.see(other, rows));
        let here = rows.row(y);
        // Where nothing is seen there is nothing to smooth.
        let is_seen = |depth: &f32| *depth < f32::INFINITY;
        let Some(from) = here.depth.iter().position(is_seen) else { return };
        let to = here.depth.iter().rposition(is_seen).expect("there is a first one") + 1;
        // A sample weighs with itself, and is alike to itself.
        let own = WEIGHTS[1] * WEIGHTS[1];
        let mut total = vec![own; width];
        [&mut *red, green, blue].into_iter().flatten().for_each(|light| *light *= own);
        for (down, weight_y) in WEIGHTS.iter().enumerate() {
            let Some(other) = near[down] else { continue };
            let row = rows.row(other);
            let light = light.map(|plane| &plane[other * width..][..width]);
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
                let sums = [&mut *red, green, blue].map(|row| &mut row[first..end]);
                let neighbours = Neighbours { here, first, row, at: first + right_by - stride, light };
                neighbours.add(&mut total[first..end], sums, weight_x * weight_y);
            }
        }
        for row in [red, green, blue] {
            row.iter_mut().zip(&total).for_each(|(light, total)| *light /= total);
        }
    }

    /// Takes the samples of row `y` in tiles that stay as they are from `light`.
    fn restore_fixed(&self, y: usize, light: Planes<'_>, out: [&mut [f32]; 3]) {
        let Some(is_fixed) = self.is_fixed else { return };
        let fixed = self.tiles_of_row(y).filter(|(index, _)| is_fixed(*index)).map(|(_, at)| at);
        for (at, c) in fixed.flat_map(|at| (0..3).map(move |c| (at.clone(), c))) {
            let row = &light[c][y * self.size[0]..][..self.size[0]];
            out[c][at.clone()].copy_from_slice(&row[at]);
        }
    }

    /// Fills the pixels of `radiance`, rows of `width`, from the `light` of samples at every `step`-th.
    fn fill(
        &self,
        (light, step): (Planes<'_>, usize),
        corners: Option<CornersOf<'_>>,
        radiance: &mut [PackedLight],
        width: usize,
    ) {
        let [columns, rows] = self.size;
        let weights: Vec<[f32; 4]> = (0..step * step)
            .map(|at| {
                let [u, v] = [at % step, at / step].map(|at| at as f32 / step as f32);
                [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]
            })
            .collect();
        let bands = radiance.par_chunks_mut(width * step).enumerate();
        bands.for_each_init(
            || SurfaceRows::new(1),
            |room, (y, band)| {
                let ys = [y, (y + 1).min(rows - 1)];
                ys.into_iter().for_each(|y| self.see(y, room));
                let lights = ys.map(|y| light.map(|plane| &plane[y * columns..][..columns]));
                let cells = Cells { surfaces: ys.map(|y| room.row(y)), lights };
                for (tile, xs) in self.tiles_of_row(y) {
                    let corners = corners.and_then(|corners| corners(tile));
                    for x in xs {
                        let first = [x, y].map(|at| (at * step) as u32);
                        let known = corners.map(|corners| (first, corners));
                        cells.fill(CellPixels { band, width, known }, [x, step], &weights);
                    }
                }
            },
        );
    }
}
