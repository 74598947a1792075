//! Binned SAH splits (Wald, "On fast construction of SAH-based bounding volume hierarchies", 2007). A primitive costs
//! what its leaf does: leaves count, not triangles. The cut moves to a multiple of the cluster or leaf size where that
//! costs next to nothing.
//!
//! Boxes have a fourth number, which means nothing: so a box is two vectors of four, and the compiler takes it as such.
//!
//! Invariants: 1. both sides get at least one primitive; 2. from a depth of [`FREE_DEPTH`] on both get half, so
//! that depth stays below [`crate::layout::TREE_DEPTH`]; 3. equal keys are distinguished by index: the result
//! does not depend on the order of the input slice.

use crate::cluster::LatticeBox;

/// A primitive of the tree: its box in f32 (for costs only) and what it stands for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prim {
    lo: Four,
    hi: Four,
    pub(crate) index: u32,
}

/// x, y, z, and a number that means nothing.
type Four = [f32; 4];

impl Prim {
    pub(crate) fn new(exact: &LatticeBox, origin: [i64; 3], index: u32) -> Prim {
        let relative = |at: &[i64; 3]| [0, 1, 2, 2].map(|a: usize| (at[a] - origin[a]) as f32);
        Prim { lo: relative(&exact.lo), hi: relative(&exact.hi), index }
    }

    /// Twice the centre.
    #[inline(always)]
    fn keys(&self) -> Four {
        std::array::from_fn(|a| self.lo[a] + self.hi[a])
    }

    /// A number that is ordered as the keys of an axis are, then as the indices.
    #[inline(always)]
    fn rank(&self, axis: usize) -> u64 {
        let bits = (self.lo[axis] + self.hi[axis]).to_bits() as i32;
        // Those below zero are ordered the other way round.
        let ordered = (bits ^ ((bits >> 31) as u32 >> 1) as i32) as u32 ^ 1 << 31;
        u64::from(ordered) << 32 | u64::from(self.index)
    }
}

const BINS: usize = 16;

/// Depth of the binary tree from which on sides are halves: 2^32 primitives are deeper by 32 at most.
const FREE_DEPTH: usize = 24;
const _: () = assert!(FREE_DEPTH + 32 < crate::layout::TREE_DEPTH);

/// What cuts beside a multiple of the quantum may cost, over the cheapest. Lost: areas at the multiple itself as those
/// beside it say, where cuts are far apart (5M triangles of CAD take 8 % more on disk, as clusters join what does not
/// touch), and half of a side's cost in whole clusters (18 %).
const QUANTUM_COST: f32 = 1.03;

/// How a range is to be split.
#[derive(Clone, Copy)]
pub(crate) struct Rule {
    /// Primitives that cost as one: those of a leaf; a power of two.
    pub(crate) leaf: usize,
    /// The left side is better a multiple of this.
    pub(crate) quantum: usize,
    /// Splits above this one.
    pub(crate) depth: usize,
}

/// Splits, and the memory that they share.
#[derive(Default)]
pub(crate) struct Splitter {
    ranks: Vec<u64>,
}

/// Where to cut: the bins of an axis.
struct Cut {
    axis: usize,
    bins: Binning,
    counts: [usize; BINS],
    /// Primitives before the cheapest boundary.
    left: usize,
}

impl Splitter {
    /// Reorders `prims` and cuts them in two: gives the count of the left side. At least two primitives.
    pub(crate) fn split(&mut self, prims: &mut [Prim], rule: Rule) -> usize {
        let n = prims.len();
        assert!(n >= 2 && rule.leaf.is_power_of_two());
        let best = best_cut(prims, rule);
        let mut cut = best.as_ref().map_or(n / 2, |best| best.left);
        if rule.depth >= FREE_DEPTH {
            cut = n / 2;
        }
        let cut = cut.clamp(1, n - 1);
        let axis = best.as_ref().map_or(0, |best| best.axis);
        let pivot = self.rank_at(prims, cut, best.as_ref());
        let mut left = 0;
        for i in 0..n {
            // No branch: each goes behind those of the left side, and stays there if it is one.
            let is_left = prims[i].rank(axis) < pivot;
            prims.swap(i, left);
            left += usize::from(is_left);
        }
        debug_assert_eq!(left, cut, "ranks differ");
        cut
    }

    /// The rank that `cut` others are below: that of one in the bin that the cut goes through.
    fn rank_at(&mut self, prims: &[Prim], cut: usize, best: Option<&Cut>) -> u64 {
        self.ranks.clear();
        let Some(Cut { axis, bins, counts, .. }) = best else {
            self.ranks.extend(prims.iter().map(|prim| prim.rank(0)));
            return *self.ranks.select_nth_unstable(cut).1;
        };
        let (mut bin, mut before) = (0, 0);
        while before + counts[bin] <= cut {
            before += counts[bin];
            bin += 1;
        }
        for prim in prims {
            if bins.one(prim.keys()[*axis], *axis) == bin {
                self.ranks.push(prim.rank(*axis));
            }
        }
        *self.ranks.select_nth_unstable(cut - before).1
    }
}

/// From keys to bins. A greater key is never in a lower bin.
#[derive(Clone, Copy)]
struct Binning {
    lo: Four,
    scale: Four,
}

impl Binning {
    #[inline(always)]
    fn each(&self, keys: Four) -> [usize; 3] {
        [self.one(keys[0], 0), self.one(keys[1], 1), self.one(keys[2], 2)]
    }

    /// Rounds down by arithmetic alone, exact for what an f32 from 0 to [`BINS`] can be: casts check for what cannot
    /// be here.
    #[inline(always)]
    fn one(&self, key: f32, axis: usize) -> usize {
        const HALF: f64 = 0.5 - 1.0 / (1u64 << 30) as f64;
        const INTEGERS: f64 = (3u64 << 51) as f64;
        let place = f64::from((key - self.lo[axis]) * self.scale[axis]) - HALF + INTEGERS;
        (place.to_bits() as u32 as usize).min(BINS - 1)
    }
}

/// The cheapest bin boundary, or a multiple of the quantum beside it; `None` when all centres are equal.
fn best_cut(prims: &[Prim], rule: Rule) -> Option<Cut> {
    let (mut lo, mut hi) = (Bin::EMPTY.lo, Bin::EMPTY.hi);
    for prim in prims {
        let keys = prim.keys();
        (lo, hi) = (least(lo, keys), most(hi, keys));
    }
    let scale = std::array::from_fn(|a| {
        let width = hi[a] - lo[a];
        if width > 0.0 { BINS as f32 * (1.0 - 1e-6) / width } else { 0.0 }
    });
    let binning = Binning { lo, scale };
    let mut bins = [[Bin::EMPTY; BINS]; 3];
    for prim in prims {
        let [x, y, z] = binning.each(prim.keys());
        for (bins, bin) in bins.iter_mut().zip([x, y, z]) {
            bins[bin].add(prim);
        }
    }
    let mut best: Option<(usize, Boundary, [Boundary; BINS])> = None;
    for axis in (0..3).filter(|&axis| scale[axis] > 0.0) {
        let boundaries = boundaries(&bins[axis], rule.leaf.ilog2());
        for &boundary in &boundaries[1..] {
            if boundary.left > 0
                && boundary.left < prims.len()
                && best.is_none_or(|best| boundary.cost < best.1.cost)
            {
                best = Some((axis, boundary, boundaries));
            }
        }
    }
    best.map(|(axis, best, all)| Cut {
        axis,
        bins: binning,
        counts: bins[axis].map(|bin| bin.count),
        left: at_quantum(prims.len(), best, &all, rule.quantum).unwrap_or(best.left),
    })
}

/// The cost of a cut before a bin, and how many primitives are left of it.
#[derive(Clone, Copy)]
struct Boundary {
    left: usize,
    cost: f32,
}

/// The cuts before each bin; before the first there is none.
fn boundaries(bins: &[Bin; BINS], leaf_bits: u32) -> [Boundary; BINS] {
    let mut all = [Boundary { left: 0, cost: f32::INFINITY }; BINS];
    let mut right = Bin::EMPTY;
    for i in (1..BINS).rev() {
        right.join(&bins[i]);
        all[i].cost = right.cost(leaf_bits);
    }
    let mut left = Bin::EMPTY;
    for i in 1..BINS {
        left.join(&bins[i - 1]);
        all[i].left = left.count;
        all[i].cost += left.cost(leaf_bits);
    }
    all
}

/// The multiple of the quantum that is nearest to the best cut, where the cuts on both sides of it cost little more.
fn at_quantum(n: usize, best: Boundary, all: &[Boundary; BINS], quantum: usize) -> Option<usize> {
    if n <= quantum {
        return None;
    }
    let last = (n - 1) / quantum * quantum;
    let cut = ((best.left + quantum / 2) / quantum * quantum).clamp(quantum, last);
    let before = all[1..].iter().rev().find(|boundary| boundary.left <= cut);
    let behind = all[1..].iter().find(|boundary| boundary.left >= cut);
    let is_cheap = |boundary: Option<&Boundary>| {
        boundary.is_some_and(|b| b.left > 0 && b.left < n && b.cost <= best.cost * QUANTUM_COST)
    };
    (is_cheap(before) && is_cheap(behind)).then_some(cut)
}

#[derive(Clone, Copy)]
struct Bin {
    lo: Four,
    hi: Four,
    count: usize,
}

impl Bin {
    const EMPTY: Bin = Bin { lo: [f32::INFINITY; 4], hi: [f32::NEG_INFINITY; 4], count: 0 };

    #[inline(always)]
    fn add(&mut self, prim: &Prim) {
        (self.lo, self.hi) = (least(self.lo, prim.lo), most(self.hi, prim.hi));
        self.count += 1;
    }

    #[inline(always)]
    fn join(&mut self, other: &Bin) {
        (self.lo, self.hi) = (least(self.lo, other.lo), most(self.hi, other.hi));
        self.count += other.count;
    }

    /// Half of the area of the box, times the leaves of 2^`leaf_bits` that it takes.
    fn cost(&self, leaf_bits: u32) -> f32 {
        if self.count == 0 {
            return 0.0;
        }
        let [x, y, z, _]: Four = std::array::from_fn(|a| self.hi[a] - self.lo[a]);
        (x * y + y * z + z * x) * ((self.count + (1 << leaf_bits) - 1) >> leaf_bits) as f32
    }
}

// Comparisons, where `f32::min` would ask for NaN: one instruction for all four.

#[inline(always)]
fn least(a: Four, b: Four) -> Four {
    std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
}

#[inline(always)]
fn most(a: Four, b: Four) -> Four {
    std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bins_are_rounded_down() {
        let binning = Binning { lo: [0.0; 4], scale: [1.0; 4] };
        for whole in 0..BINS {
            let key = whole as f32;
            assert_eq!(binning.one(key, 0), whole);
            assert_eq!(binning.one(key.next_up(), 1), whole);
            assert_eq!(binning.one(key + 0.5, 2), whole);
            assert_eq!(binning.one((key + 1.0).next_down(), 0), whole);
        }
        assert_eq!(binning.one(BINS as f32, 0), BINS - 1);
    }

    proptest! {
        /// Against a sort by centre, then index, along the axis that tells the sides apart.
        #[test]
        fn the_left_side_has_the_least(
            corners in proptest::collection::vec(proptest::array::uniform3(-40i64..40), 2..300),
            depth in prop_oneof![Just(0), Just(FREE_DEPTH)],
        ) {
            let boxed = |(i, lo): (usize, &[i64; 3])| {
                let exact = LatticeBox { lo: *lo, hi: lo.map(|v| v + (i % 7) as i64) };
                Prim::new(&exact, [-3; 3], i as u32)
            };
            let mut prims: Vec<_> = corners.iter().enumerate().map(boxed).collect();
            let cut = Splitter::default().split(&mut prims, Rule { leaf: 8, quantum: 8, depth });
            prop_assert!(cut > 0 && cut < prims.len());
            prop_assert!(depth < FREE_DEPTH || cut == prims.len() / 2);
            let mut indices: Vec<_> = prims.iter().map(|prim| prim.index).collect();
            indices.sort_unstable();
            prop_assert!(indices.iter().enumerate().all(|(i, &index)| i == index as usize));
            let left_is_least = |axis: usize| {
                let key = |prim: &Prim| {
                    let [lo, size] = [corners[prim.index as usize][axis], i64::from(prim.index % 7)];
                    (2 * lo + size, prim.index)
                };
                let most = prims[..cut].iter().map(key).max();
                most < prims[cut..].iter().map(key).min()
            };
            prop_assert!((0..3).any(left_is_least));
        }
    }
}
