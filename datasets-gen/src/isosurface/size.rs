//! How many cells give the triangles that were asked for.
//!
//! ```text
//!   small: count exactly, correct the sides, keep the best;  large: count the same layer at 512 to 1023 cells
//!   a side, which has the same large shapes, and extrapolate what the finer levels add
//! ```
//!
//! Invariants: 1. the answer depends on count and seed only; 2. what is answered for a small size is exact,
//! for a large one within 1 % (measured: see `GROWTH_AT_512`).

use super::{Layer, Scratch};
use crate::stream::Recipe;
use crate::{GenOptions, Spec};
use std::sync::{Arc, Mutex};
use trex_store::Result;

/// A resolution and what it makes.
pub(super) struct Size {
    /// Finest cells along x and y.
    pub(super) cells: [u64; 2],
    pub(super) triangle_count: u64,
}

/// Layers of more cells a side are extrapolated: counting this many takes a fifth of a second.
const MOST_COUNTED_SIDE: u64 = 511;
/// Triangles per column of cells, roughly, to start from.
const TYPICAL_PER_COLUMN: f64 = 8.5;
/// A layer of twice 512 cells a side has this much more triangles per column, in parts; at `s` cells it is
/// `(s / 512)^-GROWTH_DECAY` of that. Shape from `calibrate` below (three seeds, three phases, 256 to 8192
/// cells), height fitted to streams: of seven from 7M to 100M triangles the worst is off by 0.32 %. Depends on
/// the field's `BUMP_SLOPE`: calibrate again when that changes.
const GROWTH_AT_512: f64 = 0.0081;
const GROWTH_DECAY: f64 = 0.6;
/// Below this side a step of one cell is coarse, so sides are chosen from all pairs nearby.
const SMALL_SIDE: u64 = 160;
/// Relative error that ends the search of a counted size.
const GOOD_ENOUGH: f64 = 0.004;
/// Most pairs of sides that are counted, the likeliest first.
const MOST_TRIALS: usize = 10;

/// Chooses the resolution for `spec`.
///
/// # Errors
/// `Code::Interrupted`.
pub(super) fn choose(spec: &Spec, options: &GenOptions) -> Result<Size> {
    let asked = spec.triangles as f64;
    let mut per_column = TYPICAL_PER_COLUMN;
    // A layer's density changes by a tenth while its side doubles: two rounds settle it.
    for _ in 0..2 {
        let side = (asked / per_column).sqrt().round() as u64;
        per_column = density(spec.seed, side, options)?;
    }
    let side = (asked / per_column).sqrt().round() as u64;
    if side > MOST_COUNTED_SIDE {
        let triangle_count = (per_column * (side * side) as f64).round() as u64;
        return Ok(Size { cells: [side; 2], triangle_count });
    }
    let reach = if side < SMALL_SIDE { 3 } else { 1 };
    let mut pairs: Vec<[u64; 2]> =
        (side - reach..=side + reach).flat_map(|x| (x..=side + reach).map(move |y| [x, y])).collect();
    // The likeliest first; ties by the pair, so that the order is one.
    pairs.sort_by_key(|&[x, y]| (((x * y) as f64 * per_column - asked).abs() as u64, x, y));
    let mut best: Option<Size> = None;
    let error = |size: &Size| (size.triangle_count as f64 / asked - 1.0).abs();
    for cells in pairs.into_iter().take(MOST_TRIALS) {
        let size = Size { cells, triangle_count: count(spec.seed, cells, options)? };
        if best.as_ref().is_none_or(|best| error(&size) < error(best)) {
            best = Some(size);
        }
        if best.as_ref().is_some_and(|best| error(best) < GOOD_ENOUGH) {
            break;
        }
    }
    Ok(best.expect("there is a pair"))
}

/// Triangles per column of a square layer: counted, or counted small and extrapolated.
fn density(seed: u64, side: u64, options: &GenOptions) -> Result<f64> {
    let mut halvings = 0;
    while side >> halvings > MOST_COUNTED_SIDE {
        halvings += 1;
    }
    let counted = (side as f64 / (1u64 << halvings) as f64).round().min(MOST_COUNTED_SIDE as f64) as u64;
    let columns = (counted * counted) as f64;
    let growth = |level: i32| {
        let side = f64::from(1 << level) * counted as f64;
        1.0 + GROWTH_AT_512 * (side / 512.0).powf(-GROWTH_DECAY)
    };
    Ok(count(seed, [counted; 2], options)? as f64 / columns * (0..halvings).map(growth).product::<f64>())
}

/// Counts the triangles of a layer exactly.
pub(super) fn count(seed: u64, cells: [u64; 2], options: &GenOptions) -> Result<u64> {
    let layer = Arc::new(Layer::new(seed, cells, options.threads));
    let tasks = Mutex::new(layer.clone().tasks());
    let run = || {
        let mut scratch = Scratch::default();
        let mut sum = 0;
        loop {
            let next = tasks.lock().expect("no worker panicked").next();
            match next {
                Some(node) if !options.interrupt.is_raised() => sum += layer.count(&node, &mut scratch),
                _ => return sum,
            }
        }
    };
    let sum = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.threads.clamp(1, 16)).map(|_| scope.spawn(run)).collect();
        workers.into_iter().map(|worker| worker.join().expect("counting does not panic")).sum()
    });
    options.interrupt.check()?;
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prints the table behind `GROWTH_AT_512`.
    #[test]
    #[ignore = "prints a calibration, checks nothing"]
    #[allow(clippy::print_stdout)]
    fn calibrate() {
        let options = GenOptions { threads: 2, ..GenOptions::default() };
        for seed in 1..=3 {
            for m in [256u64, 362, 511] {
                let mut last = 0.0;
                for k in 0..5 {
                    let side = m << k;
                    let now = std::time::Instant::now();
                    let per_column = count(seed, [side; 2], &options).unwrap() as f64 / (side * side) as f64;
                    println!("{seed} {side:6} {per_column:.5} {:.5} {:?}", per_column / last, now.elapsed());
                    last = per_column;
                }
            }
        }
    }
}
