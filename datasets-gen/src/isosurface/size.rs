//! How many cells give the triangles that were asked for.
//!
//! ```text
//!   small: count exactly, correct the sides, keep the best;  large: count the same layer at 256 to 511 cells
//!   a side, which has the same large shapes, and extrapolate what the finer levels add
//! ```
//!
//! Invariants: 1. the answer depends on count and seed only; 2. what is answered for a small size is exact,
//! for a large one within 1 % (measured: see `GROWTH`).

use super::{Layer, ROOT_CELLS, Scratch};
use crate::Spec;
use crate::pool::Pool;
use crate::stream::Recipe;
use rayon::iter::{ParallelBridge, ParallelIterator};
use std::collections::HashMap;
use std::sync::Arc;
use trex_store::{Interrupt, Result};

/// A resolution and what it makes.
pub(super) struct Size {
    /// Finest cells along x and y.
    pub(super) cells: [u64; 2],
    pub(super) triangle_count: u64,
}

/// Layers of more cells a side are extrapolated: counting this many takes a third of a second.
const MOST_COUNTED_SIDE: u64 = 511;
/// Triangles per column of cells, roughly, to start from.
const TYPICAL_PER_COLUMN: f64 = 15.0;
/// How much the triangles per column grow from a layer of level 2, 3, ... (see [`Layer::level_of`]) to one of twice
/// its side, in parts, where the level begins; beyond the table each is `GROWTH_DECAY` times the last. From `calibrate`
/// below, 256 to 4096 cells a side; no growth is off by more than 0.15 %. Depends on the field: calibrate again when
/// that changes.
const GROWTH: [f64; 5] = [0.0625, 0.0369, 0.0222, 0.0146, 0.0098];
const GROWTH_DECAY: f64 = 0.7;
/// Within a level, growth falls with this power of the side.
const GROWTH_POWER: f64 = -1.15;
/// Below this side a step of one cell is coarse, so sides are chosen from all pairs nearby.
const SMALL_SIDE: u64 = 160;
/// Relative error that ends the search of a counted size.
const GOOD_ENOUGH: f64 = 0.004;
/// Most pairs of sides that are counted, the likeliest first.
const MOST_TRIALS: usize = 24;
/// Rounds of counting and choosing again before the search.
const ROUNDS: usize = 4;

/// Chooses the resolution for `spec`.
///
/// # Errors
/// `Code::Interrupted`.
pub(super) fn choose(spec: &Spec, pool: &Pool, interrupt: &Interrupt) -> Result<Size> {
    let asked = spec.triangles as f64;
    let mut counts = LayerCounts { seed: spec.seed, pool, interrupt, known: HashMap::new() };
    let mut per_column = TYPICAL_PER_COLUMN;
    // A layer's density changes by a twentieth while its side doubles, by more where it is small: this settles it.
    for _ in 0..ROUNDS {
        let side = (asked / per_column).sqrt().round() as u64;
        per_column = counts.density(side)?;
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
        let size = Size { cells, triangle_count: counts.triangles(cells)? };
        if best.as_ref().is_none_or(|best| error(&size) < error(best)) {
            best = Some(size);
        }
        if best.as_ref().is_some_and(|best| error(best) < GOOD_ENOUGH) {
            break;
        }
    }
    Ok(best.expect("there is a pair"))
}

/// Layers of one seed, each counted once: the search comes back to the same sides.
struct LayerCounts<'a> {
    seed: u64,
    pool: &'a Pool,
    interrupt: &'a Interrupt,
    known: HashMap<[u64; 2], u64>,
}

impl LayerCounts<'_> {
    /// Triangles of a layer.
    fn triangles(&mut self, cells: [u64; 2]) -> Result<u64> {
        if let Some(&count) = self.known.get(&cells) {
            return Ok(count);
        }
        let count = count(self.seed, cells, self.pool, self.interrupt)?;
        self.known.insert(cells, count);
        Ok(count)
    }

    /// Triangles per column of a square layer: counted, or counted small and extrapolated.
    fn density(&mut self, side: u64) -> Result<f64> {
        let mut halvings = 0;
        while side >> halvings > MOST_COUNTED_SIDE {
            halvings += 1;
        }
        let counted = (side as f64 / (1u64 << halvings) as f64).round().min(MOST_COUNTED_SIDE as f64) as u64;
        let columns = (counted * counted) as f64;
        // How far into its level the layer is, 1 to 2: the same at all its halvings.
        let part = counted as f64 / (ROOT_CELLS << Layer::level_of(counted)) as f64;
        let growth = |halving: u32| {
            let above = Layer::level_of(counted) + halving - 2;
            let last = GROWTH.len() as u32 - 1;
            let begin =
                GROWTH[above.min(last) as usize] * GROWTH_DECAY.powi(above.saturating_sub(last) as i32);
            1.0 + begin * part.powf(GROWTH_POWER)
        };
        let per_column = self.triangles([counted; 2])? as f64 / columns;
        Ok(per_column * (0..halvings).map(growth).product::<f64>())
    }
}

/// Counts the triangles of a layer exactly.
pub(super) fn count(seed: u64, cells: [u64; 2], pool: &Pool, interrupt: &Interrupt) -> Result<u64> {
    let layer = Arc::new(Layer::new(seed, cells, pool));
    let tasks = layer.clone().tasks();
    let sum = pool.install(|| {
        tasks
            .par_bridge()
            .take_any_while(|_| !interrupt.is_raised())
            .map_init(Scratch::default, |scratch, node| layer.count(&node, scratch))
            .sum()
    });
    interrupt.check()?;
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prints the table behind `GROWTH`.
    #[test]
    #[ignore = "prints a calibration, checks nothing"]
    #[allow(clippy::print_stdout)]
    fn calibrate() {
        let pool = Pool::new(&Spec::parse("gen:isosurface:1M").unwrap(), 2).unwrap();
        let interrupt = Interrupt::default();
        for seed in 1..=2 {
            for m in [256u64, 320, 383, 384, 420, 511] {
                let mut last = 0.0;
                for k in 0..4 {
                    let side = m << k;
                    let now = std::time::Instant::now();
                    let per_column =
                        count(seed, [side; 2], &pool, &interrupt).unwrap() as f64 / (side * side) as f64;
                    println!("{seed} {side:6} {per_column:.5} {:.5} {:?}", per_column / last, now.elapsed());
                    last = per_column;
                }
            }
        }
    }
}
