//! Tests of smoothing: against the same one sample after the other, and at the edge of a shadow.

use super::*;
use crate::coarse::surface::Surface;
use crate::film::LayerPixel;
use crate::hash::mix;
use crate::testing::pool;
use glam::Vec3;

const RESOLUTION: [u32; 2] = [75, 58];

/// What a sample saw, and its light: some surfaces, an edge of a shadow, and noise on the right.
fn sample([x, y]: [u32; 2], seed: u64) -> (LayerPixel, [f64; 3]) {
    let chance = |of: u64| mix(seed << 40 | of << 32 | u64::from(y << 16 | x)) as f64 / u64::MAX as f64;
    let depth = if y < 20 { 2.0 } else { [2.0, 2.0625, 2.5][(chance(0) * 3.0) as usize] };
    // Few are turned away from all others.
    let normals = [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.2, 0.97], [1.0, 0.0, 0.0]];
    let normal = normals[(chance(1) * 3.1) as usize];
    let albedo = [[0.4; 3], [0.4, 0.43, 0.4], [0.8, 0.4, 0.2]][(chance(2) * chance(3) * 3.0) as usize];
    let seen = LayerPixel { depth, normal, albedo, id: 0, ..LayerPixel::NOTHING };
    let shade = if x < 30 { 1.0 } else { 6.0 };
    let noise = if x < 50 { 1.0 } else { 2.0 * chance(4) };
    match chance(5) < 0.03 {
        true => (LayerPixel::NOTHING, [0.5; 3]),
        false => (seen, [shade * noise, 0.5 * shade, 0.1 + noise]),
    }
}

/// Weighted means over neighbours `stride` apart, sample by sample; `share` tells how much the light of one beside
/// another counts, by their places. Where that is for less than a sixteenth of a sample's own, `or_all` has those alike
/// in depth and albedo count alone.
fn means<const N: usize>(
    [width, height]: [usize; 2],
    seen: &[LayerPixel],
    light: &[[f64; N]],
    (stride, or_all): (usize, bool),
    share: &dyn Fn(usize, usize) -> f64,
) -> Vec<[f64; N]> {
    let kept = |v: f32, parts: f64| (f64::from(v) * parts).round() / parts;
    let at = |x: usize, y: usize| y * width + x;
    let sums = |(x, y): (usize, usize), is_all: bool| {
        let (here, mut sum, mut total) = (at(x, y), [0.0; N], 0.0);
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let [x, y] = [(x, dx), (y, dy)].map(|(v, by): (usize, isize)| v as isize + by * stride as isize);
            if x < 0 || y < 0 || x >= width as isize || y >= height as isize {
                continue;
            }
            let there = at(x as usize, y as usize);
            let (a, b) = (&seen[here], &seen[there]);
            let mut weight = [0.5, 0.25][dx.unsigned_abs()] * [0.5, 0.25][dy.unsigned_abs()];
            if here != there {
                let dot: f64 = (0..3).map(|c| kept(a.normal[c], 127.0) * kept(b.normal[c], 127.0)).sum();
                let is_alike = (a.depth - b.depth).abs() < 0.08 * a.depth.min(b.depth)
                    && (0..3).all(|c| (kept(a.albedo[c], 255.0) - kept(b.albedo[c], 255.0)).abs() < 0.08);
                let guided = || dot.clamp(0.0, 1.0).powi(16) * share(here, there);
                weight *= if !is_alike {
                    0.0
                } else if is_all {
                    1.0
                } else {
                    guided()
                };
            }
            total += weight;
            (0..N).for_each(|c| sum[c] += weight * light[there][c]);
        }
        (sum, total)
    };
    let mean = |place| {
        let (mut sum, mut total) = sums(place, false);
        if or_all && total < 0.25 * 17.0 / 16.0 {
            (sum, total) = sums(place, true);
        }
        sum.map(|sum| sum / total)
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(mean).collect()
}

/// The smoothed light of samples, as the head of the file says it: one after the other, in f64.
fn naive(size: [usize; 2], seen: &[LayerPixel], mut light: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let bright = |light: &[f64; 3]| 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
    let mut moments: Vec<[f64; 2]> =
        light.iter().map(|light| [bright(light), bright(light).powi(2)]).collect();
    for stride in [1, 2] {
        moments = means(size, seen, &moments, (stride, false), &|_, _| 1.0);
    }
    for (stride, apart) in [(1, 4.0), (2, 2.0), (4, 1.0), (8, 0.5), (16, 0.25)] {
        let share = |here: usize, there: usize| {
            let (own, other) = (bright(&light[here]), bright(&light[there]));
            let [x, y] = [here % size[0] / 2 * 2, here / size[0] / 2 * 2];
            let block = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]];
            let block =
                block.iter().filter(|[x, y]| *x < size[0] && *y < size[1]).map(|[x, y]| y * size[0] + x);
            let count = block.clone().count() as f64;
            let variances = block.map(|at| (moments[at][1] - moments[at][0].powi(2)).max(0.0));
            let variance = (variances.sum::<f64>() / count).max(1e-30);
            // To the nearest power of 2.
            let floor = variance.log2().floor().exp2();
            let deviation = (if variance < 1.5 * floor { floor } else { 2.0 * floor }).sqrt();
            1.0 / (1.0 + ((other - own) / (apart * deviation + 0.02 * own)).powi(4))
        };
        light = means(size, seen, &light, (stride, stride == 1), &share);
    }
    light
}

/// Each grid, by one thread and by more: the light of each sample, and no other picture's.
#[test]
fn light_is_smoothed_as_one_sample_after_the_other_would_be() {
    for (seed, (step, threads)) in (0..).zip([(8, 1), (4, 2), (2, 1), (2, 3)]) {
        let mut coarse = Coarse::new(RESOLUTION);
        let (mut seen, mut light) = (vec![], vec![]);
        let mut size = [0; 2];
        for (row, y) in (0..RESOLUTION[1]).step_by(step as usize).enumerate() {
            for (column, x) in (0..RESOLUTION[0]).step_by(step as usize).enumerate() {
                let (saw, shade) = sample([x, y], seed);
                let albedo = Surface::new(&saw).albedo();
                coarse.set(
                    [x, y],
                    Vec3::from_array(std::array::from_fn(|c| shade[c] as f32 * albedo[c])),
                    &saw,
                );
                seen.push(saw);
                light.push(shade);
                size = [column + 1, row + 1];
            }
        }
        coarse.smooth(step, &pool(threads));
        let (_, found) = coarse.smoothed(step);
        let expected = naive(size, &seen, light);
        let apart = |at: usize| {
            let channel = |c: usize| (f64::from(found[c][at]) - expected[at][c]).abs() / expected[at][c];
            (0..3).map(channel).fold(0.0, f64::max)
        };
        // A variance half way between two powers may be rounded to either.
        let off = (0..expected.len()).filter(|at| apart(*at) > 1e-3).count();
        let furthest = (0..expected.len()).map(apart).fold(0.0, f64::max);
        assert!(50 * off <= expected.len() && furthest < 0.1, "every {step}th: {off} {furthest}");
    }
}

/// Beside the edge, where neighbours tell less than the noise, some samples are mixed: those further from it are of
/// their side alone, though the passes reach over 31.
#[test]
fn the_edge_of_a_shadow_stays() {
    let wall =
        LayerPixel { depth: 2.0, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 0, ..LayerPixel::NOTHING };
    for noise in [0.0, 0.4] {
        let mut coarse = Coarse::new([128, 64]);
        for [x, y] in (0..32).flat_map(|y| (0..64).map(move |x| [2 * x, 2 * y])) {
            let chance = mix(u64::from(y << 16 | x)) as f32 / u64::MAX as f32 - 0.5;
            let light = if x < 64 { 1.0 } else { 4.0 } * (1.0 + noise * chance);
            coarse.set([x, y], Vec3::splat(0.5 * light), &wall);
        }
        coarse.smooth(2, &pool(2));
        let (_, [red, ..]) = coarse.smoothed(2);
        let apart = |at: usize| (red[at] / if at % 64 < 32 { 1.0 } else { 4.0 } - 1.0).abs();
        let far = (0..64 * 32).filter(|at| !(26..38).contains(&(at % 64)));
        let furthest = far.map(apart).fold(0.0, f32::max);
        assert!(furthest < if noise == 0.0 { 0.01 } else { 0.12 }, "{noise}: {furthest}");
    }
}

/// A dark sample that is turned away from all around it is mixed with them; not over an edge of depth, and two alike
/// have each other.
#[test]
fn a_sample_on_an_outline_is_no_dot() {
    let wall =
        LayerPixel { depth: 2.0, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 0, ..LayerPixel::NOTHING };
    let turned = LayerPixel { normal: [0.0, 1.0, 0.0], ..wall };
    let light_of = |dark: &[[u32; 2]], saw: &LayerPixel| {
        let mut coarse = Coarse::new([64, 64]);
        for pixel in (0..32).flat_map(|y| (0..32).map(move |x| [2 * x, 2 * y])) {
            match dark.contains(&pixel) {
                true => coarse.set(pixel, Vec3::ZERO, saw),
                false => coarse.set(pixel, Vec3::splat(0.5), &wall),
            }
        }
        coarse.smooth(2, &pool(2));
        let (_, [red, ..]) = coarse.smoothed(2);
        dark.iter().map(|[x, y]| red[(y / 2 * 32 + x / 2) as usize]).collect::<Vec<_>>()
    };
    // A quarter of the weight of 3x3 is its own; its neighbours take hardly any of it.
    let found = light_of(&[[20, 30]], &turned)[0];
    assert!((found - 0.75).abs() < 0.01, "{found}");
    assert_eq!(light_of(&[[20, 30]], &LayerPixel { depth: 3.0, ..turned }), [0.0]);
    assert_eq!(light_of(&[[20, 30], [22, 30]], &turned), [0.0; 2]);
}
