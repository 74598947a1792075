//! The filter beside its formula, and what it leaves alone.

use super::*;
use crate::film::{LayerPixel, Layers};
use crate::hash::mix;
use crate::testing::{Pinhole, pool};
use crate::tile::{tile, tile_count};
use trex_store::Budget;

const SIDE: u32 = 24;
/// Rows that the ring goes round in more than twice.
const HEIGHT: u32 = 56;
const SAMPLES: u32 = 4;

fn lens() -> Pinhole {
    let position = DVec3::new(1.0, 2.0, 9.0);
    Pinhole { position, target: DVec3::ZERO, fov_x: 40.0, resolution: [SIDE, HEIGHT] }
}

fn number(key: u64) -> f32 {
    (mix(key) >> 40) as f32 / (1u64 << 24) as f32
}

/// A wall on the left, a curved and a stepped part, another material, and a hole; what each pixel shows.
fn shown([x, y]: [u32; 2]) -> LayerPixel {
    let direction = lens().direction(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let level = if y < HEIGHT / 2 { 0.0 } else { 0.8 };
    let depth = ((level - lens().position.z) / direction[2]) as f32;
    let turn = if x > 2 * SIDE / 3 { 0.05 * x as f32 } else { 0.0 };
    let albedo = if (x / 6 + y / 6) % 2 == 0 { [0.5, 0.5, 0.5] } else { [0.5, 0.45, 0.3] };
    let is_hole = x.abs_diff(5) < 2 && y.abs_diff(18) < 3;
    LayerPixel {
        depth: if is_hole { f32::INFINITY } else { depth },
        normal: if is_hole { [0.0; 3] } else { [turn.sin(), 0.0, turn.cos()] },
        albedo,
        id: 0,
        ..LayerPixel::NOTHING
    }
}

/// A film of such pixels, with `indirect` light in samples that differ, and other light beside it.
fn film(indirect: &dyn Fn([u32; 2], u32) -> [f32; 3]) -> Film {
    let layers = Layers { filter: true, ..Layers::default() };
    let mut film = Film::new([SIDE, HEIGHT], layers, &Budget::unlimited()).unwrap();
    add_samples(&mut film, indirect);
    film
}

fn add_samples(film: &mut Film, indirect: &dyn Fn([u32; 2], u32) -> [f32; 3]) {
    for index in 0..tile_count([SIDE, HEIGHT]) {
        let tile = tile([SIDE, HEIGHT], index);
        let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
        let all = (0..SAMPLES).flat_map(|sample| pixels.iter().map(move |&pixel| (pixel, sample)));
        let indirect: Vec<_> = all.map(|(pixel, sample)| indirect(pixel, sample)).collect();
        let other: Vec<_> = indirect.iter().map(|light| light.map(|x| x + 2.0)).collect();
        film.add(&tile, &other);
        film.add_indirect(&tile, &indirect);
        pixels.iter().for_each(|&pixel| film.set_layers(pixel, &shown(pixel)));
    }
}

fn noise([x, y]: [u32; 2], sample: u32) -> [f32; 3] {
    [0, 1, 2].map(|c| number(u64::from(((y * SIDE + x) * SAMPLES + sample) * 3 + c)))
}

/// What `film` keeps of what a pixel shows.
fn kept(film: &Film, pixel: [u32; 2]) -> LayerPixel {
    let Guide { depth, normal, albedo } = film.guide(pixel);
    LayerPixel {
        depth,
        normal: normal.normal().into(),
        albedo: albedo.albedo(),
        id: 0,
        ..LayerPixel::NOTHING
    }
}

/// The formula of the head, term by term, over all pixels of the window, from what is `shown` and `light`.
fn oracle(
    pixel: [u32; 2],
    shown: &dyn Fn([u32; 2]) -> LayerPixel,
    light: &dyn Fn([u32; 2], u32) -> [f32; 3],
) -> [f64; 3] {
    let place = |pixel: [u32; 2]| {
        let direction = lens().direction(f64::from(pixel[0]) + 0.5, f64::from(pixel[1]) + 0.5);
        let depth = f64::from(shown(pixel).depth);
        [0, 1, 2].map(|a| lens().position[a] + depth * direction[a])
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
    for v in 0..HEIGHT {
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
    (0..SIDE * HEIGHT).map(|at| [at % SIDE, at / SIDE])
}

#[test]
fn it_is_the_formula_over_the_window_on_any_number_of_threads() {
    for threads in [1, 2, 5, 40] {
        let mut film = film(&noise);
        let before: Vec<_> = pixels().map(|pixel| film.radiance(pixel)).collect();
        smooth(&mut film, &lens(), &pool(threads), &|| false);
        for (pixel, before) in pixels().zip(before) {
            let shown = |pixel: [u32; 2]| kept(&film, pixel);
            let (found, expected) = (film.radiance(pixel), oracle(pixel, &shown, &noise));
            let raw = film.indirect(pixel);
            for c in 0..3 {
                let expected = f64::from(before[c] - raw[c]) + expected[c];
                assert!((f64::from(found[c]) - expected).abs() < 3e-4, "{pixel:?}: {found:?}");
            }
        }
    }
}

/// A wide wall and a high one, of more strips and of fewer rows than a ring: each pixel's neighbours are found.
#[test]
fn strips_meet_in_pictures_of_any_height() {
    for resolution in [[5, 1], [3, 8], [70, 9], [9, 70], [200, 31]] {
        let layers = Layers { filter: true, ..Layers::default() };
        let mut film = Film::new(resolution, layers, &Budget::unlimited()).unwrap();
        // One sample: the widest window. Only a slope along y comes out as itself where rows are in their places.
        let wall = LayerPixel {
            depth: 1e6,
            normal: [0.0, 0.0, 1.0],
            albedo: [0.5; 3],
            id: 0,
            ..LayerPixel::NOTHING
        };
        for tile in (0..tile_count(resolution)).map(|index| tile(resolution, index)) {
            let rows: Vec<_> = (0..tile.pixel_count()).map(|i| tile.pixel(i)[1] as f32).collect();
            let light: Vec<_> = rows.iter().map(|&y| [y, 2.0 * y, 1.0]).collect();
            film.add(&tile, &light);
            film.add_indirect(&tile, &light);
            (0..tile.pixel_count()).for_each(|i| film.set_layers(tile.pixel(i), &wall));
        }
        let lens = Pinhole { position: DVec3::ZERO, target: DVec3::NEG_Z, fov_x: 1e-3, resolution };
        smooth(&mut film, &lens, &pool(2), &|| false);
        let height = resolution[1];
        for [x, y] in (0..height).flat_map(|y| (0..resolution[0]).map(move |x| [x, y])) {
            let [found, twice, even] = film.radiance([x, y]);
            assert!((even - 1.0).abs() < 2e-2 && (twice - 2.0 * found).abs() < 5e-2);
            let is_inner = (11..height.saturating_sub(11)).contains(&y);
            assert!(!is_inner || (found - y as f32).abs() < 2e-2, "{resolution:?} {x} {y}: {found}");
            assert!(found >= 0.0 && found < height as f32);
        }
    }
}

#[test]
fn even_light_stays_even_noise_falls_and_edges_stay() {
    let mut even = film(&|_, _| [0.25, 0.5, 1.0]);
    smooth(&mut even, &lens(), &pool(2), &|| false);
    for pixel in pixels() {
        let found = even.radiance(pixel);
        assert!((0..3).all(|c| (found[c] - [2.25, 2.5, 3.0][c]).abs() < 2e-4), "{pixel:?} {found:?}");
    }
    // Two levels, one light each: the step stays where it was, and within a level and a material the noise falls.
    let level = |y: u32| if y < HEIGHT / 2 { 0.0 } else { 5.0 };
    let mut stepped = film(&|pixel, sample| noise(pixel, sample).map(|x| x + level(pixel[1])));
    let inner: Vec<_> = pixels().filter(|pixel| (6..15).contains(&pixel[0])).collect();
    let spread = |light: &dyn Fn([u32; 2]) -> f32| {
        let apart = |&pixel: &[u32; 2]| f64::from(light(pixel) - level(pixel[1]) - 0.5).powi(2);
        inner.iter().map(apart).sum::<f64>() / inner.len() as f64
    };
    let before = spread(&|pixel| stepped.indirect(pixel)[0]);
    smooth(&mut stepped, &lens(), &pool(2), &|| false);
    // All light is 2 and the indirect light.
    let after = spread(&|pixel| stepped.radiance(pixel)[0] - 2.0);
    assert!(after < before / 8.0, "{before} {after}");
}

/// Light beside the smoothed is that of all samples, until another state begins.
#[test]
fn what_was_smoothed_stays_while_samples_come() {
    let mut film = film(&noise);
    let (pixel, raw) = ([3, 3], film.radiance([3, 3]));
    smooth(&mut film, &lens(), &pool(1), &|| true);
    assert_eq!((film.radiance(pixel), film.smoothed_of()), (raw, 0), "it was stopped");
    smooth(&mut film, &lens(), &pool(1), &|| false);
    let smooth_light = film.radiance(pixel);
    assert!(smooth_light != raw && film.smoothed_of() == SAMPLES);
    let first = tile([SIDE, HEIGHT], 0);
    let dark = vec![[0.0; 3]; first.pixel_count() as usize];
    film.add(&first, &dark);
    // All light is 2 and the indirect light.
    let found = film.radiance(pixel);
    assert!((0..3).all(|c| (found[c] - (smooth_light[c] - 2.0 + 2.0 * 4.0 / 5.0)).abs() < 1e-6), "{found:?}");
    film.begin_state();
    film.add(&first, &dark);
    assert_eq!((film.radiance(pixel), film.smoothed_of()), ([0.0; 3], 0));
}

/// A picture does not depend on the layers that are written beside it: the filter once would have seen exact normals
/// with them, and packed ones without.
#[test]
fn layers_that_are_asked_for_change_nothing() {
    let mut plain = film(&noise);
    let all = Layers { depth: true, normal: true, albedo: true, id: true, filter: true };
    let mut layered = Film::new([SIDE, HEIGHT], all, &Budget::unlimited()).unwrap();
    add_samples(&mut layered, &noise);
    for film in [&mut plain, &mut layered] {
        smooth(film, &lens(), &pool(2), &|| false);
    }
    for pixel in pixels() {
        assert_eq!(plain.radiance(pixel), layered.radiance(pixel), "{pixel:?}");
        assert_eq!(layered.normal(pixel), shown(pixel).normal, "what is written is exact");
        assert_eq!(layered.albedo(pixel), shown(pixel).albedo);
    }
}
