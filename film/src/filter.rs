//! The joint bilateral filter on indirect light, with what the pixels show as its edges. Paper, section 5; G.
//! Petschnigg et al., "Digital photography with flash and no-flash image pairs" (2004).
//!
//! ```text
//! indirect(p) = sum of w(p, q) indirect(q) / sum of w(p, q)          q up to 2 s pixels off, along both axes
//! w = exp(-|p - q|^2 / 2 s^2)                             s = 4 pixels at 4 samples
//!   * exp(-(q's distance from p's plane / pixel)^2 / 2)   a step in depth as high as a pixel is wide
//!   * max(0, cosine of the normals)^32                    half at 12 degrees
//!   * exp(-|difference of albedo|^2 / 2 (0.1)^2)          another material
//! ```
//!
//! Only what gather rays bring to the surface that is seen is smoothed: lights, shadows of lights, and what mirrors
//! show stay as they are. `s` falls with the sixth root of the samples: the noise of n samples falls as 1 / (n s^2),
//! the blur's error rises as s^4, and their sum is least where s^6 goes as 1 / n. So the filter fades as the picture
//! converges.
//!
//! Strips of a few rows are smoothed one after the other. What the filter sees of the rows around them is decoded into
//! a ring of rows: it takes no more for a higher picture.
//!
//! ```text
//! row   0  1  2  3 | 4  5  6  7 | 8  9 10 11 | 12 ...          strips of 4 rows, a reach of 2: a ring of 8
//!             '----- rows seen -----'                          the second strip: 8 and 9 take the places of 0 and 1
//! ```
//!
//! Invariants: 1. weights are divided by their sum, so even light stays even; 2. a pixel's sum has one order, so the
//! bytes do not depend on threads or strips; 3. a pixel that shows nothing neither gives nor takes; 4. the memory is
//! that of [`STRIP_ROWS`] and the reach on both sides, and the caller has leased it.

#[cfg(test)]
mod tests;

use super::film::{Film, Guide};
use super::packed::PackedLight;
use crate::lens::Lens;
use glam::{DVec3, Vec3};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::Range;

/// Reach of the filter at 4 samples, pixels: 4 pi s^2 = 200 pixels count, which makes 1600 gather rays of a pixel's 8.
const REACH_PIXELS: f64 = 4.0;
/// Samples of a pixel that [`REACH_PIXELS`] is meant for.
const REACH_SAMPLES: f64 = 4.0;
/// Window, in reaches: what is left out weighs an eighth of the middle or less.
const WINDOW_REACHES: f64 = 2.0;
/// Pixels of the window on each side, at most: those at one sample, ceil(2 * 4 * 4^(1/6)).
const RADIUS_MOST: usize = 11;
/// Rows that are smoothed together.
pub(crate) const STRIP_ROWS: usize = 8;
/// Pixels of a strip that a thread takes at a time: some tens of microseconds.
const PART_PIXELS: usize = 64;
/// Depth that counts as an edge, in pixels' widths.
const PLANE_PIXELS: f32 = 1.0;
/// Power of the normals' cosine.
const NORMAL_POWER: i32 = 32;
/// Difference of albedo that counts as an edge.
const ALBEDO_REACH: f32 = 0.1;
/// Exponent below which a weight is none: 3e-7.
const EXPONENT_LEAST: f32 = -15.0;

/// Bytes that the filter takes at `resolution` (width, height; pixels) while it works, film not counted.
pub fn filter_bytes([width, height]: [u32; 2]) -> u64 {
    let rows = (height as usize).min(STRIP_ROWS + 2 * RADIUS_MOST);
    (width as usize * rows * size_of::<GuidePixel>() + (RADIUS_MOST + 1) * size_of::<f32>()) as u64
}

/// A pixel as the filter sees it.
#[derive(Clone, Copy, Debug)]
struct GuidePixel {
    /// Place from the camera, model units; zero where nothing is seen.
    place: Vec3,
    normal: Vec3,
    albedo: Vec3,
    /// Width of the pixel there, model units; 0 where nothing is seen.
    width: f32,
    indirect: Vec3,
}

/// The rows around a strip: row y at the place y % rows.
pub(crate) struct Window {
    seen: Vec<GuidePixel>,
    /// Width of the picture and rows of the ring.
    width: usize,
    rows: usize,
    /// Rows of the picture.
    height: usize,
    radius: usize,
    /// -d^2 / 2 s^2 for d from 0 to the radius.
    near: Vec<f32>,
}

/// Smooths the indirect light of `film`, whose pixels look through `lens`, on the threads of `pool`; the
/// caller has leased [`filter_bytes`]. `stop` is asked in between: what is left then stays as it was.
///
/// # Panics
/// When the film keeps no indirect light.
pub fn smooth(film: &mut Film, lens: &dyn Lens, pool: &ThreadPool, stop: &(dyn Fn() -> bool + Sync)) {
    let [width, height] = film.resolution().map(|side| side as usize);
    let mut window = Window::new([width, height], film.samples().max(1));
    // All strips in one call of the pool: to go in and out for each wakes its threads hundreds of times.
    pool.install(|| {
        let mut seen_to = 0;
        for first in (0..height).step_by(STRIP_ROWS) {
            let strip = first..height.min(first + STRIP_ROWS);
            let rows = seen_to..window.end_of_view(strip.end);
            seen_to = rows.end;
            window.see(film, lens, rows);
            window.smooth(strip.start, film.smoothed_mut(strip), stop);
        }
    });
    if !stop() {
        film.set_smooth();
    }
}

impl Window {
    /// A window that has seen nothing of a picture of width and height, pixels, with so many samples each.
    pub(crate) fn new([width, height]: [usize; 2], samples: u32) -> Window {
        let reach = REACH_PIXELS * (REACH_SAMPLES / f64::from(samples)).powf(1.0 / 6.0);
        let radius = (WINDOW_REACHES * reach).ceil() as usize;
        assert!(radius <= RADIUS_MOST, "a window of {radius} pixels is not leased");
        let near = (0..=radius).map(|d| (-0.5 * (d as f64 / reach).powi(2)) as f32).collect();
        let rows = height.min(STRIP_ROWS + 2 * radius);
        Window { seen: vec![GuidePixel::NOTHING; width * rows], width, rows, height, radius, near }
    }

    /// The end of the rows that a strip before row `end` is smoothed with.
    pub(crate) fn end_of_view(&self, end: usize) -> usize {
        self.height.min(end + self.radius)
    }

    /// Smooths the strip from row `first` on to `out`, on the threads of this call; the rows around it have been seen.
    pub(crate) fn smooth(&self, first: usize, out: &mut [PackedLight], stop: &(dyn Fn() -> bool + Sync)) {
        let width = self.width;
        let parts = out.par_chunks_mut(PART_PIXELS).enumerate();
        parts.filter(|_| !stop()).for_each(|(part, out)| {
            let start = first * width + part * PART_PIXELS;
            (start..).zip(out).for_each(|(at, out)| {
                *out = PackedLight::new(self.mean([at % width, at / width]).into());
            });
        });
    }

    /// Sees these rows of `film`, in the places of the oldest.
    pub(crate) fn see(&mut self, film: &Film, lens: &dyn Lens, rows: Range<usize>) {
        let ring = self.rows;
        let places = self.seen.par_chunks_mut(self.width).enumerate();
        places.for_each(|(place, seen)| {
            // The one row of those, if any, that stands there.
            let y = rows.start + (place + ring - rows.start % ring) % ring;
            if rows.contains(&y) {
                let pixels = (0..).map(|x| [x, y as u32]);
                seen.iter_mut()
                    .zip(pixels)
                    .for_each(|(seen, pixel)| *seen = GuidePixel::of(film, lens, pixel));
            }
        });
    }

    /// Row `y`, one of those seen last.
    fn row(&self, y: usize) -> &[GuidePixel] {
        &self.seen[y % self.rows * self.width..][..self.width]
    }

    /// The smoothed light of pixel (x, y).
    fn mean(&self, [x, y]: [usize; 2]) -> Vec3 {
        let here = &self.row(y)[x];
        if here.width == 0.0 {
            return here.indirect;
        }
        let first = x.saturating_sub(self.radius);
        let end = (x + self.radius + 1).min(self.width);
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        for v in y.saturating_sub(self.radius)..(y + self.radius + 1).min(self.height) {
            let near = self.near[v.abs_diff(y)];
            for (u, there) in (first..).zip(&self.row(v)[first..end]) {
                let weight = here.weight(there, self.near[u.abs_diff(x)] + near);
                weights += weight;
                sum += weight * there.indirect;
            }
        }
        // The pixel itself counts with 1, or with nothing where its normal is none.
        if weights > 0.0 { sum / weights } else { here.indirect }
    }
}

impl GuidePixel {
    const NOTHING: GuidePixel = GuidePixel {
        place: Vec3::ZERO,
        normal: Vec3::ZERO,
        albedo: Vec3::ZERO,
        width: 0.0,
        indirect: Vec3::ZERO,
    };

    /// A pixel (x, y) of `film`.
    fn of(film: &Film, lens: &dyn Lens, pixel: [u32; 2]) -> GuidePixel {
        let Guide { depth, normal, albedo } = film.guide(pixel);
        let depth = f64::from(depth);
        let [x, y] = pixel.map(|x| f64::from(x) + 0.5);
        let is_hit = depth.is_finite();
        let place = if is_hit { depth } else { 0.0 } * DVec3::from(lens.direction(x, y));
        GuidePixel {
            place: place.as_vec3(),
            normal: normal.normal(),
            albedo: albedo.albedo().into(),
            width: if is_hit { (depth * lens.pixel_angle()) as f32 } else { 0.0 },
            indirect: film.indirect(pixel).into(),
        }
    }

    /// Weight of the light at `there` for the light here, 0 to 1; `near`: the exponent of their distance.
    fn weight(&self, there: &GuidePixel, near: f32) -> f32 {
        let cos = self.normal.dot(there.normal);
        if there.width == 0.0 || cos <= 0.0 {
            return 0.0;
        }
        let off_plane = self.normal.dot(there.place - self.place) / (PLANE_PIXELS * self.width);
        let albedo = (self.albedo - there.albedo).length_squared() / (ALBEDO_REACH * ALBEDO_REACH);
        let exponent = near - 0.5 * (off_plane * off_plane + albedo);
        if exponent < EXPONENT_LEAST { 0.0 } else { cos.min(1.0).powi(NORMAL_POWER) * exponent.exp() }
    }
}
