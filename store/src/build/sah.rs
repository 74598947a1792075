//! Binned SAH splits that leave whole clusters (Wald, "On fast construction of SAH-based bounding volume
//! hierarchies", 2007), with the cut moved to a multiple of the cluster or leaf size.
//!
//! Invariants: 1. both sides get at least one primitive; 2. no side gets less than 1/8 (where the quantum
//! allows), so depth stays below [`crate::layout::TREE_DEPTH`]; 3. equal keys are told apart by index: the result does not depend
//! on the order of the input slice.

use crate::cluster::LatticeBox;

/// A primitive of the tree: its box in f32 (for costs only) and what it stands for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prim {
    pub(super) lo: [f32; 3],
    pub(super) hi: [f32; 3],
    pub(super) index: u32,
}

impl Prim {
    pub(super) fn of(exact: &LatticeBox, origin: [i64; 3], index: u32) -> Prim {
        Prim {
            lo: std::array::from_fn(|a| (exact.lo[a] - origin[a]) as f32),
            hi: std::array::from_fn(|a| (exact.hi[a] - origin[a]) as f32),
            index,
        }
    }

    /// Twice the centre.
    fn key(&self, axis: usize) -> f32 {
        self.lo[axis] + self.hi[axis]
    }
}

const BINS: usize = 16;

/// Reorders `prims` and cuts them in two; the left side has a multiple of `quantum` where more than one quantum
/// is there. At least two primitives.
pub(super) fn split(prims: &mut [Prim], quantum: usize) -> usize {
    let n = prims.len();
    assert!(n >= 2);
    let (axis, wanted) = best_cut(prims).unwrap_or((0, n / 2));
    let balanced = wanted.clamp(n / 8, n - n / 8);
    let cut = if n > quantum {
        let last = (n - 1) / quantum * quantum;
        ((balanced + quantum / 2) / quantum * quantum).clamp(quantum, last)
    } else {
        balanced.clamp(1, n - 1)
    };
    prims.select_nth_unstable_by(cut, |a, b| a.key(axis).total_cmp(&b.key(axis)).then(a.index.cmp(&b.index)));
    cut
}

/// Axis and left count of the cheapest bin boundary; `None` when all centres are equal.
fn best_cut(prims: &[Prim]) -> Option<(usize, usize)> {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for prim in prims {
        for axis in 0..3 {
            lo[axis] = lo[axis].min(prim.key(axis));
            hi[axis] = hi[axis].max(prim.key(axis));
        }
    }
    let scale: [f32; 3] = std::array::from_fn(|a| {
        let width = hi[a] - lo[a];
        if width > 0.0 { BINS as f32 * (1.0 - 1e-6) / width } else { 0.0 }
    });
    let mut bins = [[Bin::EMPTY; BINS]; 3];
    for prim in prims {
        for axis in 0..3 {
            let bin = ((prim.key(axis) - lo[axis]) * scale[axis]) as usize;
            bins[axis][bin.min(BINS - 1)].add(prim);
        }
    }
    let mut best = (f32::INFINITY, None);
    for axis in (0..3).filter(|&axis| scale[axis] > 0.0) {
        let mut right_cost = [0.0; BINS];
        let mut right = Bin::EMPTY;
        for i in (1..BINS).rev() {
            right.join(&bins[axis][i]);
            right_cost[i] = right.cost();
        }
        let mut left = Bin::EMPTY;
        for i in 1..BINS {
            left.join(&bins[axis][i - 1]);
            let cost = left.cost() + right_cost[i];
            if left.count > 0 && left.count < prims.len() && cost < best.0 {
                best = (cost, Some((axis, left.count)));
            }
        }
    }
    best.1
}

#[derive(Clone, Copy)]
struct Bin {
    lo: [f32; 3],
    hi: [f32; 3],
    count: usize,
}

impl Bin {
    const EMPTY: Bin = Bin { lo: [f32::INFINITY; 3], hi: [f32::NEG_INFINITY; 3], count: 0 };

    fn add(&mut self, prim: &Prim) {
        for axis in 0..3 {
            self.lo[axis] = self.lo[axis].min(prim.lo[axis]);
            self.hi[axis] = self.hi[axis].max(prim.hi[axis]);
        }
        self.count += 1;
    }

    fn join(&mut self, other: &Bin) {
        for axis in 0..3 {
            self.lo[axis] = self.lo[axis].min(other.lo[axis]);
            self.hi[axis] = self.hi[axis].max(other.hi[axis]);
        }
        self.count += other.count;
    }

    fn cost(&self) -> f32 {
        if self.count == 0 {
            return 0.0;
        }
        let [x, y, z]: [f32; 3] = std::array::from_fn(|a| self.hi[a] - self.lo[a]);
        (x * y + y * z + z * x) * self.count as f32
    }
}
