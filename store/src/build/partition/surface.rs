//! How many leaf voxels there will be, before there are any: what their resolution is chosen by.
//!
//! ```text
//! triangle, for each resolution:   over 64 leaves by its shadows on the planes of the axes, added  -> so many
//!                                  smaller -> points on it, two a leaf -> distinct leaves of theirs, plus a fifth
//! ```
//!
//! Area alone guesses too many where a leaf holds several sheets or a thin tube: 2.3 times for `gen:pipes:20M` at
//! 256, with 1.5 leaves a square. A table of all leaves would take 128 MiB at 1024; the sketches take 12 KiB, and
//! their standard error is 1.04 / sqrt(4096) = 1.6 % (Flajolet et al., "HyperLogLog", 2007).
//!
//! Invariant: the guess depends on the stream of triangles alone.

use crate::build::scan::{Grid, Scan};
use crate::octree::{Refinement, VoxelGrid};

/// The resolutions that are chosen from.
pub(crate) const RESOLUTIONS: [u32; 3] = [256, 512, 1024];
/// Leaves that hold surface over those that hold one of the points.
const LEAVES_PER_MARK: f64 = 1.2;
/// Points per leaf, and leaves up to which a triangle gets some.
const POINTS_PER_LEAF: f64 = 2.0;
const LEAVES_MOST: f64 = 64.0;

/// How much surface there is.
pub(crate) struct Surface {
    counters: [Counter; RESOLUTIONS.len()],
    /// Shadows of triangles that lie across an axis, squares of the lattice step.
    flat: f64,
}

/// What [`Surface::parts`] gives beside the sketches: large and small of each resolution, and flat, as bits.
pub(crate) type SurfaceSums = [u64; 2 * RESOLUTIONS.len() + 1];

/// At one resolution.
struct Counter {
    /// Lattice steps along a leaf, about: the bounds may be a hint. And leaves along a step.
    leaf_steps: f64,
    per_step: f64,
    /// Shadows of triangles without points, and of those with, squares of the lattice step.
    large: f64,
    small: f64,
    sketch: Sketch,
}

impl Surface {
    /// None yet.
    pub(crate) fn new(scan: &Scan, grid: &Grid) -> Surface {
        let [lo, hi] = [scan.bounds.lo, scan.bounds.hi].map(|corner| grid.lattice.snap(corner));
        let counters = RESOLUTIONS.map(|resolution| {
            let leaf_steps = VoxelGrid::from_bounds(lo, hi, resolution, Refinement::None).leaf_steps() as f64;
            let per_step = 1.0 / leaf_steps;
            Counter { leaf_steps, per_step, large: 0.0, small: 0.0, sketch: Sketch::default() }
        });
        Surface { counters, flat: 0.0 }
    }

    pub(crate) fn add(&mut self, q: &[[i64; 3]; 3]) {
        let by_axis = shadows(q);
        let shadows = by_axis.iter().sum::<f64>();
        if by_axis.contains(&shadows) {
            self.flat += shadows;
        }
        let corner = q[0].map(|v| v as f64);
        for counter in &mut self.counters {
            let per_step = counter.per_step;
            let leaves = shadows * (per_step * per_step);
            if leaves > LEAVES_MOST {
                counter.large += shadows;
                continue;
            }
            counter.small += shadows;
            counter.sketch.add(corner.map(|x| (x * per_step) as i64));
            for index in 1..=(POINTS_PER_LEAF * leaves) as u32 {
                counter.sketch.add(point(q, index).map(|x| (x * per_step) as i64));
            }
        }
    }

    /// Sums, as bits, and registers of the sketches, one resolution after the other: what [`Self::restore`] takes.
    pub(crate) fn parts(&self) -> (SurfaceSums, Vec<u8>) {
        let mut sums = [self.flat.to_bits(); 2 * RESOLUTIONS.len() + 1];
        for (sums, counter) in sums.chunks_exact_mut(2).zip(&self.counters) {
            sums.copy_from_slice(&[counter.large, counter.small].map(f64::to_bits));
        }
        let registers = self.counters.iter().flat_map(|counter| &counter.sketch.registers);
        (sums, registers.copied().collect())
    }

    /// Puts back what [`Self::parts`] gave; false for what it cannot have given.
    pub(crate) fn restore(&mut self, sums: SurfaceSums, registers: &[u8]) -> bool {
        let sums = sums.map(f64::from_bits);
        let is_whole = registers.len() == RESOLUTIONS.len() << REGISTER_BITS;
        if !is_whole
            || !sums.iter().all(|sum| sum.is_finite() && *sum >= 0.0)
            || registers.iter().any(|&r| r > REGISTER_MOST)
        {
            return false;
        }
        let each = registers.chunks_exact(1 << REGISTER_BITS).zip(sums.chunks_exact(2));
        for (counter, (registers, sums)) in self.counters.iter_mut().zip(each) {
            (counter.large, counter.small) = (sums[0], sums[1]);
            counter.sketch.registers.copy_from_slice(registers);
        }
        self.flat = sums[2 * RESOLUTIONS.len()];
        true
    }

    /// The share of the surface that lies across an axis, by its shadows; 0 of none.
    pub(crate) fn flat_share(&self) -> f64 {
        let all = self.counters[0].large + self.counters[0].small;
        if all > 0.0 { self.flat / all } else { 0.0 }
    }

    /// The number of leaves at `RESOLUTIONS[which]`, about, where they have so many lattice steps.
    pub(crate) fn leaf_count(&self, which: usize, leaf_steps: i64) -> f64 {
        let counter = &self.counters[which];
        let leaves = |shadows: f64| shadows / (leaf_steps as f64).powi(2);
        let marked = leaves(counter.sketch.count() * counter.leaf_steps * counter.leaf_steps);
        leaves(counter.large) + (LEAVES_PER_MARK * marked).min(leaves(counter.small))
    }
}

/// A point of a triangle: the first is a corner, the others are spread evenly (M. Roberts' R2 sequence, folded).
fn point(q: &[[i64; 3]; 3], index: u32) -> [f64; 3] {
    const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];
    let [u, v] = STEPS.map(|step| (f64::from(index) * step).fract());
    let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
    std::array::from_fn(|a| {
        let [from, to, other] = [0, 1, 2].map(|corner| q[corner][a] as f64);
        from + u * (to - from) + v * (other - from)
    })
}

/// Areas of the shadows on the three planes of the axes, squares of the lattice step: a plane meets as many voxels of
/// side 1 as they are together (one a square where it lies across an axis, 1.7 across a diagonal).
fn shadows(q: &[[i64; 3]; 3]) -> [f64; 3] {
    let edge = |i: usize, a: usize| (q[i][a] - q[0][a]) as f64;
    let twice = |a: usize, b: usize| (edge(1, a) * edge(2, b) - edge(1, b) * edge(2, a)).abs();
    [twice(1, 2), twice(2, 0), twice(0, 1)].map(|twice| 0.5 * twice)
}

/// Bits of a register's number, and its greatest value.
const REGISTER_BITS: u32 = 12;
const REGISTER_MOST: u8 = (u64::BITS - REGISTER_BITS + 1) as u8;

/// Counts distinct places.
struct Sketch {
    /// By the first bits of the hash: the most zeros that came behind them, plus one.
    registers: Vec<u8>,
    /// The place that came last: neighbours often share one.
    last: u64,
}

impl Default for Sketch {
    fn default() -> Sketch {
        Sketch { registers: vec![0; 1 << REGISTER_BITS], last: u64::MAX }
    }
}

impl Sketch {
    fn add(&mut self, [x, y, z]: [i64; 3]) {
        let place = (x << 42 ^ y << 21 ^ z) as u64;
        if self.last == place {
            return;
        }
        self.last = place;
        // The finisher of SplitMix64.
        let mut hash = place;
        hash = (hash ^ hash >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        hash = (hash ^ hash >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        hash ^= hash >> 31;
        let register = &mut self.registers[(hash >> (64 - REGISTER_BITS)) as usize];
        let zeros = (hash << REGISTER_BITS | 1).leading_zeros() as u8;
        *register = (*register).max(zeros + 1);
    }

    fn count(&self) -> f64 {
        let size = self.registers.len() as f64;
        let alpha = 0.7213 / (1.0 + 1.079 / size);
        let sum: f64 = self.registers.iter().map(|&zeros| 0.5f64.powi(i32::from(zeros))).sum();
        let empty = self.registers.iter().filter(|&&register| register == 0).count() as f64;
        let raw = alpha * size * size / sum;
        if raw <= 2.5 * size && empty > 0.0 { size * (size / empty).ln() } else { raw }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn the_sketch_counts_distinct_places() {
        for side in [2u64, 9, 40, 150] {
            let (mut sketch, mut seen) = (Sketch::default(), HashSet::new());
            for i in 0..3 * side.pow(3) {
                let place = [i * i % side, i / 3 % side, i / 7 % (2 * side)].map(|v| v as i64);
                sketch.add(place);
                seen.insert(place);
            }
            let ratio = sketch.count() / seen.len() as f64;
            assert!((ratio - 1.0).abs() < 0.06, "{side}: {} places, {ratio} of them counted", seen.len());
        }
    }
}
