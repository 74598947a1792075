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
//! Invariants: 1. weights are divided by their sum, so even light stays even; 2. a pixel's sum has one order, so the
//! bytes do not depend on threads; 3. a pixel that shows nothing neither gives nor takes.

use super::film::Film;
use crate::scene::camera::Projection;
use glam::{DVec3, Vec3};
use rayon::ThreadPool;
use rayon::prelude::*;
use trex_store::{Budget, Result};

/// Reach of the filter at 4 samples, pixels: 4 pi s^2 = 200 pixels count, which makes 1600 gather rays of a pixel's 8.
const REACH_PIXELS: f64 = 4.0;
/// Samples of a pixel that [`REACH_PIXELS`] is meant for.
const REACH_SAMPLES: f64 = 4.0;
/// Window, in reaches: what is left out weighs an eighth of the middle or less.
const WINDOW_REACHES: f64 = 2.0;
/// Depth that counts as an edge, in pixels' widths.
const PLANE_PIXELS: f32 = 1.0;
/// Power of the normals' cosine.
const NORMAL_POWER: i32 = 32;
/// Difference of albedo that counts as an edge.
const ALBEDO_REACH: f32 = 0.1;
/// Exponent below which a weight is none: 3e-7.
const EXPONENT_LEAST: f32 = -15.0;

/// Bytes that the filter takes at `resolution` (width, height; pixels) while it works, film not counted.
pub fn filter_bytes(resolution: [u32; 2]) -> u64 {
    u64::from(resolution[0]) * u64::from(resolution[1]) * size_of::<Seen>() as u64
}

/// A pixel as the filter sees it.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Place from the camera, model units; zero where nothing is seen.
    place: Vec3,
    normal: Vec3,
    albedo: Vec3,
    /// Width of the pixel there, model units; 0 where nothing is seen.
    width: f32,
    indirect: Vec3,
}

struct Window<'a> {
    seen: &'a [Seen],
    resolution: [usize; 2],
    radius: usize,
    /// -d^2 / 2 s^2 for d from 0 to the radius.
    near: Vec<f32>,
}

/// Smooths the indirect light of `film`, which was taken by the rays of `projection`, on the threads of `pool`. `stop`
/// is asked between lines: those that are left then stay as they were.
///
/// # Errors
/// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`filter_bytes`].
///
/// # Panics
/// When the film keeps no indirect light.
pub(crate) fn smooth(
    film: &mut Film,
    projection: &Projection,
    pool: &ThreadPool,
    budget: &Budget,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<()> {
    let _lease = budget.lease("the filter", filter_bytes(film.resolution()))?;
    let resolution = film.resolution().map(|side| side as usize);
    let seen = seen(film, projection);
    let reach = REACH_PIXELS * (REACH_SAMPLES / f64::from(film.samples().max(1))).powf(1.0 / 6.0);
    let radius = (WINDOW_REACHES * reach).ceil() as usize;
    let near = (0..=radius).map(|d| (-0.5 * (d as f64 / reach).powi(2)) as f32).collect();
    let window = Window { seen: &seen, resolution, radius, near };
    pool.install(|| {
        let lines = film.smoothed_mut().par_chunks_mut(resolution[0]).enumerate();
        lines.filter(|_| !stop()).for_each(|(y, line)| {
            line.iter_mut().enumerate().for_each(|(x, out)| *out = window.mean(y * resolution[0] + x).into());
        });
    });
    if !stop() {
        film.set_smooth();
    }
    Ok(())
}

fn seen(film: &Film, projection: &Projection) -> Vec<Seen> {
    let [width, height] = film.resolution();
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    let seen = pixels.map(|pixel| {
        let depth = f64::from(film.depth(pixel));
        let [x, y] = pixel.map(|x| f64::from(x) + 0.5);
        let is_hit = depth.is_finite();
        let place = if is_hit { depth } else { 0.0 } * DVec3::from(projection.ray(x, y).direction);
        Seen {
            place: place.as_vec3(),
            normal: film.normal(pixel).into(),
            albedo: film.albedo(pixel).into(),
            width: if is_hit { (depth * projection.pixel_angle()) as f32 } else { 0.0 },
            indirect: film.indirect(pixel).into(),
        }
    });
    seen.collect()
}

impl Window<'_> {
    /// The smoothed light of pixel `at`.
    fn mean(&self, at: usize) -> Vec3 {
        let [width, height] = self.resolution;
        let (x, y) = (at % width, at / width);
        let here = &self.seen[at];
        if here.width == 0.0 {
            return here.indirect;
        }
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        for v in y.saturating_sub(self.radius)..(y + self.radius + 1).min(height) {
            for u in x.saturating_sub(self.radius)..(x + self.radius + 1).min(width) {
                let there = &self.seen[v * width + u];
                let weight = here.weight(there, self.near[u.abs_diff(x)] + self.near[v.abs_diff(y)]);
                weights += weight;
                sum += weight * there.indirect;
            }
        }
        // The pixel itself counts with 1, or with nothing where its normal is none.
        if weights > 0.0 { sum / weights } else { here.indirect }
    }
}

impl Seen {
    /// Weight of the light at `there` for the light here, 0 to 1; `near`: the exponent of their distance.
    fn weight(&self, there: &Seen, near: f32) -> f32 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::film::{LayerPixel, Layers};
    use crate::image::tile::{tile, tile_count};
    use crate::sampler::mix;
    use crate::scene::camera::{Camera, Fov};
    use crate::testing::pool;

    const SIDE: u32 = 24;
    const SAMPLES: u32 = 4;

    fn projection() -> Projection {
        let camera =
            Camera { position: [1.0, 2.0, 9.0], target: [0.0; 3], up: [0.0, 1.0, 0.0], fov: Fov::X(40.0) };
        camera.project([SIDE, SIDE]).unwrap()
    }

    fn number(key: u64) -> f32 {
        (mix(key) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// A wall on the left, a curved and a stepped part, another material, and a hole; what each pixel shows.
    fn shown([x, y]: [u32; 2]) -> LayerPixel {
        let ray = projection().ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let level = if y < SIDE / 2 { 0.0 } else { 0.8 };
        let depth = ((level - ray.origin[2]) / ray.direction[2]) as f32;
        let turn = if x > 2 * SIDE / 3 { 0.05 * x as f32 } else { 0.0 };
        let albedo = if (x / 6 + y / 6) % 2 == 0 { [0.5, 0.5, 0.5] } else { [0.5, 0.45, 0.3] };
        let is_hole = x.abs_diff(5) < 2 && y.abs_diff(18) < 3;
        LayerPixel {
            depth: if is_hole { f32::INFINITY } else { depth },
            normal: if is_hole { [0.0; 3] } else { [turn.sin(), 0.0, turn.cos()] },
            albedo,
            id: 0,
        }
    }

    /// A film of such pixels, with `indirect` light in samples that differ, and other light beside it.
    fn film(indirect: &dyn Fn([u32; 2], u32) -> [f32; 3]) -> Film {
        let layers = Layers { filter: true, ..Layers::default() };
        let mut film = Film::new([SIDE, SIDE], layers, &Budget::unlimited()).unwrap();
        for index in 0..tile_count([SIDE, SIDE]) {
            let tile = tile([SIDE, SIDE], index);
            let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
            let all = (0..SAMPLES).flat_map(|sample| pixels.iter().map(move |&pixel| (pixel, sample)));
            let indirect: Vec<_> = all.map(|(pixel, sample)| indirect(pixel, sample)).collect();
            let other: Vec<_> = indirect.iter().map(|light| light.map(|x| x + 2.0)).collect();
            film.add(&tile, &other);
            film.add_indirect(&tile, &indirect);
            pixels.iter().for_each(|&pixel| film.set_layers(pixel, &shown(pixel)));
        }
        film
    }

    fn noise([x, y]: [u32; 2], sample: u32) -> [f32; 3] {
        [0, 1, 2].map(|c| number(u64::from(((y * SIDE + x) * SAMPLES + sample) * 3 + c)))
    }

    /// The formula of the head, term by term, over all pixels of the window, from what `shown` and `noise` say.
    fn oracle(pixel: [u32; 2], light: &dyn Fn([u32; 2], u32) -> [f32; 3]) -> [f64; 3] {
        let place = |pixel: [u32; 2]| {
            let ray = projection().ray(f64::from(pixel[0]) + 0.5, f64::from(pixel[1]) + 0.5);
            let depth = f64::from(shown(pixel).depth);
            [0, 1, 2].map(|a| ray.origin[a] + depth * ray.direction[a])
        };
        let mean = |pixel| {
            let sum = (0..SAMPLES).fold([0.0; 3], |sum, sample| {
                let light = light(pixel, sample);
                [0, 1, 2].map(|c| sum[c] + f64::from(light[c]))
            });
            sum.map(|sum: f64| sum / f64::from(SAMPLES))
        };
        let here = shown(pixel);
        if here.depth.is_infinite() {
            return mean(pixel);
        }
        let width = 2.0 * 20f64.to_radians().tan() / f64::from(SIDE) * f64::from(here.depth);
        let (mut above, mut below) = ([0.0; 3], 0.0);
        for v in 0..SIDE {
            for u in 0..SIDE {
                let there = shown([u, v]);
                let (dx, dy) = (f64::from(u) - f64::from(pixel[0]), f64::from(v) - f64::from(pixel[1]));
                if dx.abs() > 8.0 || dy.abs() > 8.0 || there.depth.is_infinite() {
                    continue;
                }
                let (p, q) = (place(pixel), place([u, v]));
                let across: f64 = (0..3).map(|a| f64::from(here.normal[a]) * (q[a] - p[a])).sum();
                let cos: f64 = (0..3).map(|a| f64::from(here.normal[a]) * f64::from(there.normal[a])).sum();
                let apart: f64 =
                    (0..3).map(|a| (f64::from(here.albedo[a]) - f64::from(there.albedo[a])).powi(2)).sum();
                let weight = (-(dx * dx + dy * dy) / 32.0).exp()
                    * (-0.5 * (across / width).powi(2)).exp()
                    * cos.clamp(0.0, 1.0).powf(32.0)
                    * (-apart / (2.0 * 0.01)).exp();
                let light = mean([u, v]);
                below += weight;
                above = [0, 1, 2].map(|c| above[c] + weight * light[c]);
            }
        }
        above.map(|above| above / below)
    }

    fn pixels() -> impl Iterator<Item = [u32; 2]> {
        (0..SIDE * SIDE).map(|at| [at % SIDE, at / SIDE])
    }

    #[test]
    fn it_is_the_formula_over_the_window_on_any_number_of_threads() {
        for threads in [1, 2, 5, 40] {
            let mut film = film(&noise);
            let before: Vec<_> = pixels().map(|pixel| film.radiance(pixel)).collect();
            smooth(&mut film, &projection(), &pool(threads), &Budget::unlimited(), &|| false).unwrap();
            for (pixel, before) in pixels().zip(before) {
                let (found, expected) = (film.radiance(pixel), oracle(pixel, &noise));
                let raw = film.indirect(pixel);
                for c in 0..3 {
                    let expected = f64::from(before[c] - raw[c]) + expected[c];
                    assert!((f64::from(found[c]) - expected).abs() < 1e-4, "{pixel:?}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn even_light_stays_even_noise_falls_and_edges_stay() {
        let mut even = film(&|_, _| [0.25, 0.5, 1.0]);
        smooth(&mut even, &projection(), &pool(2), &Budget::unlimited(), &|| false).unwrap();
        for pixel in pixels() {
            let found = even.radiance(pixel);
            assert!((0..3).all(|c| (found[c] - [2.25, 2.5, 3.0][c]).abs() < 1e-5), "{pixel:?} {found:?}");
        }
        // Two levels, one light each: the step stays where it was, and within a level and a material the noise falls.
        let level = |y: u32| if y < SIDE / 2 { 0.0 } else { 5.0 };
        let mut stepped = film(&|pixel, sample| noise(pixel, sample).map(|x| x + level(pixel[1])));
        let inner: Vec<_> = pixels().filter(|pixel| (6..15).contains(&pixel[0])).collect();
        let spread = |light: &dyn Fn([u32; 2]) -> f32| {
            let apart = |&pixel: &[u32; 2]| f64::from(light(pixel) - level(pixel[1]) - 0.5).powi(2);
            inner.iter().map(apart).sum::<f64>() / inner.len() as f64
        };
        let before = spread(&|pixel| stepped.indirect(pixel)[0]);
        smooth(&mut stepped, &projection(), &pool(2), &Budget::unlimited(), &|| false).unwrap();
        // All light is 2 and the indirect light.
        let after = spread(&|pixel| stepped.radiance(pixel)[0] - 2.0);
        assert!(after < before / 8.0, "{before} {after}");
    }

    /// Light beside the smoothed is that of all samples, until another state begins.
    #[test]
    fn what_was_smoothed_stays_while_samples_come() {
        let mut film = film(&noise);
        let (pixel, raw) = ([3, 3], film.radiance([3, 3]));
        smooth(&mut film, &projection(), &pool(1), &Budget::unlimited(), &|| true).unwrap();
        assert_eq!((film.radiance(pixel), film.smoothed_of()), (raw, 0), "it was stopped");
        smooth(&mut film, &projection(), &pool(1), &Budget::unlimited(), &|| false).unwrap();
        let smooth_light = film.radiance(pixel);
        assert!(smooth_light != raw && film.smoothed_of() == SAMPLES);
        let first = tile([SIDE, SIDE], 0);
        let dark = vec![[0.0; 3]; first.pixel_count() as usize];
        film.add(&first, &dark);
        // All light is 2 and the indirect light.
        let found = film.radiance(pixel);
        assert!(
            (0..3).all(|c| (found[c] - (smooth_light[c] - 2.0 + 2.0 * 4.0 / 5.0)).abs() < 1e-6),
            "{found:?}"
        );
        film.begin_state();
        film.add(&first, &dark);
        assert_eq!((film.radiance(pixel), film.smoothed_of()), ([0.0; 3], 0));
        let tight = Budget::new(trex_store::RESERVE_BYTES + filter_bytes([SIDE, SIDE]) - 1);
        assert!(super::smooth(&mut film, &projection(), &pool(1), &tight, &|| false).is_err());
    }
}
