//! Light of exact samples in place of the preview's: a sample of the grid stands for the pixels of its cell.
//!
//! ```text
//! s p     light of s: the mean over those of s, p, q, r that are of one surface with s, over its albedo
//! q r
//! ```
//!
//! A pixel far brighter than its tile, in a cell where others are not, is a chance hit of a small light: smoothed it
//! would be a bright spot of many pixels. It counts up to a bound. That is the display's alone, and counts less with
//! each sample.

use super::corners::{CornersOf, TileCorners};
use super::surface::Surface;
use super::{Coarse, KEPT_STEP, LIGHT_MOST, TILE_SIDE_SAMPLES, grid_size};
use crate::film::{Film, LayerPixel};
use crate::packed::luminance;
use crate::tile::{TILE_SIDE_PIXELS, bit, tile};
use glam::Vec3;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Pixels of a tile that may be chance hits, and how many times brighter than the mean of the others a pixel counts.
const HITS: usize = 2;
const BRIGHT_MOST: f32 = 16.0;

/// The samples of a row of tiles: red, green and blue.
type Band<'a> = [&'a mut [f32]; 3];

impl Coarse {
    /// Sets what the samples of a tile saw to what exact ones did, and gives the corners that its pixels are of one
    /// surface with. A corner beyond the tile counts as what is known of it by now.
    pub(crate) fn set_seen(&mut self, seen: &[([u32; 2], LayerPixel)]) -> TileCorners {
        let is_sample = |pixel: &[u32; 2]| pixel.iter().all(|v| v % KEPT_STEP == 0);
        for (pixel, seen) in seen.iter().filter(|(pixel, _)| is_sample(pixel)) {
            self.see(self.place(*pixel), seen, false);
        }
        let [width, height] = self.resolution;
        let mut corners = TileCorners::default();
        for (pixel, seen) in seen {
            let surface = Surface::new(seen);
            let [x, y] = *pixel;
            let [right, below] = [(x + KEPT_STEP).min(width - 1), (y + KEPT_STEP).min(height - 1)];
            let around = [[x, y], [right, y], [x, below], [right, below]];
            for (corner, at) in corners.0.iter_mut().zip(around) {
                // A sample is the one surface that it saw, whatever else is like it.
                let is_same =
                    at == *pixel && is_sample(pixel) || self.surfaces[self.place(at)].is_same(&surface);
                *corner |= u64::from(is_same) << bit(*pixel);
            }
        }
        corners
    }

    /// Takes the light of the exact samples on `film`.
    pub(crate) fn take_light(&mut self, film: &Film, corners: CornersOf<'_>, pool: &ThreadPool) {
        let Coarse { resolution, surfaces, light, .. } = self;
        let columns = grid_size(*resolution, KEPT_STEP)[0] as usize;
        let tiles = resolution[0].div_ceil(TILE_SIDE_PIXELS);
        let (red, rest) = light.split_at_mut(surfaces.len());
        let (green, blue) = rest.split_at_mut(surfaces.len());
        let band = TILE_SIDE_SAMPLES * columns;
        let bands = red.par_chunks_mut(band).zip(green.par_chunks_mut(band)).zip(blue.par_chunks_mut(band));
        let bands = bands.zip(surfaces.par_chunks(band)).enumerate();
        pool.install(|| {
            bands.for_each(|(row, (((red, green), blue), surfaces))| {
                let first = row as u32 * tiles;
                for index in first..first + tiles {
                    if let Some(TileCorners([cells, ..])) = corners(index) {
                        take_tile(film, (index, cells), surfaces, [&mut *red, &mut *green, &mut *blue]);
                    }
                }
            });
        });
    }
}

/// Takes the light of a tile, of which `cells` are of one surface with their samples, into the samples of its row.
fn take_tile(film: &Film, (index, cells): (u32, u64), surfaces: &[Surface], light: Band<'_>) {
    let resolution = film.resolution();
    let columns = grid_size(resolution, KEPT_STEP)[0] as usize;
    let tile = tile(resolution, index);
    let [width, height] = tile.size;
    let mut rows = [[[0.0; 3]; TILE_SIDE_PIXELS as usize]; TILE_SIDE_PIXELS as usize];
    for (y, row) in (0..height).zip(&mut rows) {
        film.radiances([tile.first[0], tile.first[1] + y], &mut row[..width as usize]);
    }
    let most = bright_most(&rows, [width, height]);
    for v in (0..height).step_by(KEPT_STEP as usize) {
        for u in (0..width).step_by(KEPT_STEP as usize) {
            let pixels = (v..height.min(v + KEPT_STEP))
                .flat_map(|y| (u..width.min(u + KEPT_STEP)).map(move |x| [x, y]))
                .filter(|pixel| cells >> bit(*pixel) & 1 == 1)
                .map(|[x, y]| Vec3::from(rows[y as usize][x as usize]));
            // Where all are bright, so is what they saw.
            let least = match pixels.clone().count() {
                0 | 1 => 0.0,
                _ => pixels.clone().map(luminance).fold(f32::INFINITY, f32::min),
            };
            let bound =
                |light: Vec3| light * (most.max(least) / luminance(light).max(f32::MIN_POSITIVE)).min(1.0);
            let (sum, count) =
                pixels.fold((Vec3::ZERO, 0.0), |(sum, count), light| (sum + bound(light), count + 1.0));
            let at = (v / KEPT_STEP) as usize * columns + ((tile.first[0] + u) / KEPT_STEP) as usize;
            let shade = sum / f32::max(count, 1.0) / Vec3::from(surfaces[at].albedo());
            let shade = shade.min(Vec3::splat(LIGHT_MOST));
            (0..3).for_each(|c| light[c][at] = shade[c]);
        }
    }
}

/// Luminance above which a pixel of a tile, of so many columns and rows of `rows`, may be a chance hit.
fn bright_most(rows: &[[[f32; 3]; TILE_SIDE_PIXELS as usize]], [width, height]: [u32; 2]) -> f32 {
    let mut sorted = [0.0; (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS) as usize];
    let count = (width * height) as usize;
    let pixels = rows[..height as usize].iter().flat_map(|row| &row[..width as usize]);
    sorted.iter_mut().zip(pixels).for_each(|(place, rgb)| *place = luminance(Vec3::from(*rgb)));
    let sorted = &mut sorted[..count];
    sorted.sort_unstable_by(f32::total_cmp);
    let others = &sorted[..count.saturating_sub(HITS).max(1)];
    BRIGHT_MOST * others.iter().sum::<f32>() / others.len() as f32
}
