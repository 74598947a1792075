//! How many samples of a pixel the smoothed light of a tile is worth, from how the two differ.
//!
//! ```text
//! r = mean of the n samples of a pixel - smoothed light
//! mean r^2             = noise + bias^2   noise: variance of the mean of a pixel's samples; bias: of smoothed light
//! mean (r - r')^2 / 2  = noise            r, r' of neighbours: their bias is alike, their noise is not
//! worth = n noise / bias^2                the mix that is nearest to the truth, by least squares
//! ```
//!
//! So light that is noisy gives way to smoothed light, and smoothed light to samples where it hides an edge of a shadow
//! or a pattern; the more samples, the sooner. Where the noise is too little to be seen it counts for nothing.
//!
//! Shrinkage towards a target, after W. James and C. Stein, "Estimation with quadratic loss" (1961).

use crate::tile::{TILE_SIDE_PIXELS, bit};

/// Most that smoothed light is worth, by the samples of a pixel, and at all: a bias of a third of the noise cannot be
/// told in a tile. Of pictures of four kinds of model, of 1, 2 and 4 samples, none looks worse than with a quarter of
/// these (`bench/denoise.sh`).
pub(super) const SHARE_MOST: f32 = 8.0;
pub(super) const WORTH_MOST: f32 = 16.0;
/// Pairs of neighbours that noise is told from, at least.
const PAIRS_LEAST: f32 = 12.0;
/// Share of the mean luminance that is no difference: what is kept is rounded to less.
const LUMINANCE_STEP: f32 = 1.0 / 1024.0;
/// Noise over the square of the mean luminance at which smoothed light begins to count, and at which it counts in full:
/// where there is less noise than the eye sees, its blur would be the greater error.
const NOISE_SEEN: [f32; 2] = [0.03, 0.15];

/// Luminances of the pixels of a tile, by rows: of the mean of the samples, and as smoothed.
pub(super) type TileLuminances = [[[f32; 2]; TILE_SIDE_PIXELS as usize]; TILE_SIDE_PIXELS as usize];

/// Samples of a pixel that smoothed light is worth in a tile of pixels of `samples` each; of the pixels whose bit is
/// set in `pixels`. 0 where too few are to tell.
pub(super) fn worth(luminances: &TileLuminances, pixels: u64, samples: u32) -> f32 {
    let is_there = |x: usize, y: usize| pixels >> bit([x as u32, y as u32]) & 1 == 1;
    let residual = |x: usize, y: usize| luminances[y][x][0] - luminances[y][x][1];
    let side = TILE_SIDE_PIXELS as usize;
    let (mut count, mut square, mut mean) = (0.0f32, 0.0f32, 0.0f32);
    let (mut pairs, mut apart) = (0.0f32, 0.0f32);
    for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))).filter(|(y, x)| is_there(*x, *y)) {
        let here = residual(x, y);
        count += 1.0;
        square += here * here;
        mean += luminances[y][x][1];
        for (x, y) in [(x + 1, y), (x, y + 1)].into_iter().filter(|(x, y)| x.max(y) < &side) {
            if is_there(x, y) {
                pairs += 1.0;
                apart += (here - residual(x, y)).powi(2);
            }
        }
    }
    if pairs < PAIRS_LEAST {
        return 0.0;
    }
    let (square, noise) = (square / count, apart / (2.0 * pairs));
    let bias = (square - noise).max(0.0);
    let noise = noise + (mean / count * LUMINANCE_STEP).powi(2);
    let worth = if noise > 0.0 { samples as f32 * noise / bias.max(noise / SHARE_MOST) } else { 0.0 };
    let relative = noise / (mean / count).powi(2).max(f32::MIN_POSITIVE);
    let [none, all] = NOISE_SEEN;
    let gate = ((relative - none) / (all - none)).clamp(0.0, 1.0);
    gate * worth.min(WORTH_MOST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    /// A tile of truth 1 plus `edge` on its right half, smoothed to a ramp there, with noise of variance `variance` on
    /// the means of its samples; the `index`-th of its kind.
    fn tile(edge: f32, variance: f32, index: u64) -> TileLuminances {
        let chance = |at: usize| (mix(index << 8 | at as u64) >> 40) as f32 / (1u64 << 24) as f32 - 0.5;
        std::array::from_fn(|y| {
            std::array::from_fn(|x| {
                let truth = if x < 4 { 1.0 } else { 1.0 + edge };
                let smoothed = 1.0 + edge * (x as f32 + 0.5) / 8.0;
                [truth + (12.0 * variance).sqrt() * chance(y * 8 + x), smoothed]
            })
        })
    }

    /// Where there is noise the squared error against the truth is near the least that any share leaves, and below that
    /// of the samples alone.
    #[test]
    fn the_worth_is_that_of_the_least_error() {
        let samples = 4;
        for (edge, variance) in [(0.0, 1.0), (1.0, 1.0), (0.6, 0.5), (2.0, 0.01), (2.0, 0.0001)] {
            let error = |share: &dyn Fn(&TileLuminances) -> f32| {
                let of_tile = |index: u64| {
                    let of = tile(edge, variance, index);
                    let share = share(&of);
                    let pixels = (0..64).map(|at| (at / 8, at % 8));
                    let error = pixels.map(|(y, x)| {
                        let [exact, smoothed] = of[y][x];
                        let truth = if x < 4 { 1.0 } else { 1.0 + edge };
                        (exact + share * (smoothed - exact) - truth).powi(2)
                    });
                    error.sum::<f32>()
                };
                (0..200).map(of_tile).sum::<f32>()
            };
            let share = |of: &TileLuminances| {
                let worth = worth(of, u64::MAX, samples);
                worth / (worth + samples as f32)
            };
            let (found, alone) = (error(&share), error(&|_| 0.0));
            let most = WORTH_MOST / (WORTH_MOST + samples as f32);
            let best = (0..=50).map(|at| error(&|_| most * at as f32 / 50.0)).fold(f32::INFINITY, f32::min);
            // Of an edge neighbours differ, too, which counts as noise: some of its blur stays where there is little.
            if variance >= 0.1 * edge * edge {
                assert!(
                    found < 1.01 * alone && found < 1.35 * best,
                    "{edge} {variance}: {found} {best} {alone}"
                );
            } else {
                assert!(found < 0.3 * error(&|_| 1.0), "{edge} {variance}: {found}");
            }
        }
    }

    #[test]
    fn the_mean_of_noise_is_worth_the_most_and_what_cannot_be_told_nothing() {
        // Neighbours that differ, round the mean that smoothed light has.
        let noisy = |part: f32| -> TileLuminances {
            std::array::from_fn(|y| {
                std::array::from_fn(|x| [3.0 * if (x + y) % 2 == 0 { 1.0 - part } else { 1.0 + part }, 3.0])
            })
        };
        assert_eq!(worth(&noisy(0.9), u64::MAX, 1), SHARE_MOST);
        assert_eq!(worth(&noisy(0.9), u64::MAX, 9), WORTH_MOST);
        assert_eq!(worth(&noisy(0.9), 0xff, 2), 0.0, "one row has seven pairs");
        assert_eq!(worth(&noisy(0.9), 0, 2), 0.0);
        assert_eq!(worth(&noisy(0.1), u64::MAX, 2), 0.0, "noise of a fiftieth of the mean's square");
        assert!((0.1..SHARE_MOST).contains(&worth(&noisy(0.2), u64::MAX, 1)));
        assert_eq!(worth(&[[[0.0; 2]; 8]; 8], u64::MAX, 2), 0.0);
        // All of the same sign: no noise is so.
        assert!(worth(&[[[2.0, 1.0]; 8]; 8], u64::MAX, 2) < 1e-3);
    }
}
