//! `Coarse`: samples at every so many pixels, and the picture that is made of them.
//!
//! ```text
//! samples -> light alone: radiance over albedo
//!         -> smoothed over neighbours alike (`smoothing.rs`)
//!         -> pixels between, from the four samples around: bilinear where these are of one surface, else like the
//!            nearest -> radiance
//! ```
//!
//! One surface: alike in depth and albedo. So an edge is a stair of the grid's step, and no colour bleeds across it.
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
mod smoothing;
mod surface;

use self::cells::{CellPixels, Cells};
pub(crate) use self::corners::{CornersOf, TileCorners};
use self::grid::{KEPT_STEP, sample_count};
pub use self::grid::{STEPS, grid_size};
use self::history::History;
pub use self::history::Reprojection;
use self::light_cache::LightCache;
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

/// Samples at every [`KEPT_STEP`]-th pixel, and the picture that is made of some or all of them.
#[derive(Debug)]
pub(super) struct Coarse {
    resolution: [u32; 2],
    surfaces: Vec<Surface>,
    /// Light that leaves the surfaces, over their albedo: three planes.
    light: Vec<f32>,
    /// Room for the passes; empty until it is wanted.
    work: Vec<f32>,
    /// How noisy the light is around each sample, in codes; there when the work is.
    deviations: Vec<u8>,
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
    is_fixed: Option<ToldTiles<'a>>,
}

/// Tells tiles, by index.
type ToldTiles<'a> = &'a (dyn Fn(u32) -> bool + Sync);

/// Three planes of light, of the samples picked.
type Planes<'a> = [&'a [f32]; 3];

/// Planes of light that the work holds, of samples at every `step`-th pixel.
fn sets(step: u32) -> usize {
    if step == KEPT_STEP { 1 } else { 2 }
}

/// Numbers of the work: a copy of the light and as much again for every step but the finest.
fn work_count(resolution: [u32; 2]) -> usize {
    let count = |step: u32| 3 * sets(step) * sample_count(resolution, step);
    STEPS.into_iter().map(count).max().unwrap_or(0)
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

    /// Samples that saw nothing.
    pub(super) fn new(resolution: [u32; 2]) -> Coarse {
        let count = sample_count(resolution, KEPT_STEP);
        let surfaces = vec![Surface::new(&LayerPixel::NOTHING); count];
        Coarse {
            resolution,
            surfaces,
            light: vec![0.0; 3 * count],
            work: Vec::new(),
            deviations: Vec::new(),
            history: None,
            cache: None,
        }
    }

    /// Sets the sample of a pixel (x, y), both of them multiples of [`KEPT_STEP`].
    pub(super) fn set(&mut self, [x, y]: [u32; 2], radiance: Vec3, seen: &LayerPixel) {
        let at = self.place([x, y]);
        self.see(at, seen, true);
        let light = (radiance / Vec3::from(self.surfaces[at].albedo())).min(Vec3::splat(LIGHT_MOST));
        let count = self.surfaces.len();
        (0..3).for_each(|c| self.light[c * count + at] = light[c]);
    }

    /// The place of the sample of the cell that a pixel (x, y) is in.
    fn place(&self, [x, y]: [u32; 2]) -> usize {
        let columns = grid_size(self.resolution, KEPT_STEP)[0];
        ((y / KEPT_STEP) * columns + x / KEPT_STEP) as usize
    }

    /// True when the sample of the cell of a pixel (x, y), which what is shown there is made of where there is one at
    /// every `step`-th pixel, saw what is `seen` there.
    pub(super) fn is_same(&self, (step, pixel): (u32, [u32; 2]), seen: &LayerPixel) -> bool {
        let first = pixel.map(|v| v / step * step);
        self.surfaces[self.place(first)].is_same(&Surface::new(seen))
    }

    /// True when the sample of the cell of a pixel (x, y) saw voxels nearer than `depth`.
    pub(super) fn has_voxels_before(&self, depth: f32, pixel: [u32; 2]) -> bool {
        let seen = &self.surfaces[self.place(pixel)];
        seen.is_voxel() && seen.depth() < depth
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
    fn places(&self) -> impl Iterator<Item = usize> + Clone + use<> {
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
    fn tiles_of_row(&self, y: usize) -> impl Iterator<Item = (u32, Range<usize>)> + Clone + use<> {
        let width = self.size[0];
        let first = y / TILE_SIDE_SAMPLES * width.div_ceil(TILE_SIDE_SAMPLES);
        let parts = (0..width).step_by(TILE_SIDE_SAMPLES);
        (first as u32..).zip(parts.map(move |x| x..width.min(x + TILE_SIDE_SAMPLES)))
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
