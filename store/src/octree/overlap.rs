//! Does a triangle touch a box? Exact, in integers: the separating axes of triangle and box.
//! M. Schwarz and H.-P. Seidel, "Fast parallel surface and solid voxelization on GPUs", ACM TOG 29 (2010), section 3.
//!
//! ```text
//! boxes overlap, the plane passes between the box's two corners along the normal, and in each of the three axis
//! projections the box reaches to the inner side of all three edges
//! ```
//!
//! Coordinates are *half-steps*: twice the lattice step from the cube's corner, plus one, so that vertices are odd and
//! boundaries of voxels even. Needles and points (all corners on a line) are answered rightly, too: their edges then
//! bound a slab from both sides.
//!
//! Invariants: 1. no rounding: i64 where the triangle and the box are small enough for all products, else i128.

use std::ops::{Add, Mul, Neg, Sub};

/// Integers wide enough for the products at hand.
pub(super) trait Wide:
    Copy
    + PartialOrd
    + From<i64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Neg<Output = Self>
{
}
impl Wide for i64 {}
impl Wide for i128 {}

/// Greatest difference of coordinates, triangle and box together, for which i64 holds all products: normals are sums of
/// two products, the plane's value one of three products of those.
pub(super) const NARROW_REACH: i64 = 1 << 19;
const _: () = assert!(2 * 3 * (NARROW_REACH as i128).pow(3) < i64::MAX as i128);

/// A triangle made ready.
pub(super) struct Triangle<T> {
    corner: [[i64; 3]; 3],
    lo: [i64; 3],
    hi: [i64; 3],
    normal: [T; 3],
    /// Per projection and edge: the inner normal within the projection's two axes.
    edge: [[[T; 2]; 3]; 3],
}

/// The axes of each projection; the third one is projected away.
const AXES: [[usize; 3]; 3] = [[0, 1, 2], [1, 2, 0], [2, 0, 1]];

impl<T: Wide> Triangle<T> {
    pub(super) fn new(corner: [[i64; 3]; 3]) -> Triangle<T> {
        let edge = |i: usize, axis: usize| T::from(corner[(i + 1) % 3][axis] - corner[i][axis]);
        let other = |axis: usize| T::from(corner[2][axis] - corner[0][axis]);
        let normal = std::array::from_fn(|a| {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            edge(0, b) * other(c) - edge(0, c) * other(b)
        });
        let edges = AXES.map(|[a, b, away]| {
            let turned = normal[away] < T::from(0);
            std::array::from_fn(|i| {
                let inner = [-edge(i, b), edge(i, a)];
                if turned { inner.map(|v| -v) } else { inner }
            })
        });
        let least = |a: usize| corner.iter().map(|c| c[a]).min().expect("three corners");
        let most = |a: usize| corner.iter().map(|c| c[a]).max().expect("three corners");
        Triangle { corner, lo: [0, 1, 2].map(least), hi: [0, 1, 2].map(most), normal, edge: edges }
    }

    /// True when the triangle touches the box from `lo` to `lo + side`, boundaries included.
    pub(super) fn touches(&self, lo: [i64; 3], side: i64) -> bool {
        (0..3).all(|a| self.lo[a] <= lo[a] + side && lo[a] <= self.hi[a])
            && self.plane_cuts(lo, side)
            && self.edges_reach(lo, side)
    }

    fn plane_cuts(&self, lo: [i64; 3], side: i64) -> bool {
        let (zero, side) = (T::from(0), T::from(side));
        let (mut least, mut most) = (zero, zero);
        for a in 0..3 {
            let n = self.normal[a];
            let at = n * T::from(lo[a] - self.corner[0][a]);
            let across = n * side;
            least = least + at + if n < zero { across } else { zero };
            most = most + at + if n < zero { zero } else { across };
        }
        least <= zero && most >= zero
    }

    fn edges_reach(&self, lo: [i64; 3], side: i64) -> bool {
        let (zero, side) = (T::from(0), T::from(side));
        AXES.iter().zip(&self.edge).all(|(&[a, b, _], edges)| {
            edges.iter().enumerate().all(|(i, &[na, nb])| {
                let from = &self.corner[i];
                let at = na * T::from(lo[a] - from[a]) + nb * T::from(lo[b] - from[b]);
                let reach = |n: T| if n > zero { n * side } else { zero };
                at + reach(na) + reach(nb) >= zero
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same by clipping in rationals: the triangle is cut by the six planes, what is left is not empty. Corners are
    /// fractions over a common weight, i128.
    fn clipped(corner: [[i64; 3]; 3], lo: [i64; 3], side: i64) -> bool {
        // A point (x, y, z, w) stands for (x, y, z) / w with w > 0.
        let mut polygon: Vec<[i128; 4]> =
            corner.iter().map(|c| [c[0] as i128, c[1] as i128, c[2] as i128, 1]).collect();
        for a in 0..3 {
            for (sign, bound) in [(1i128, lo[a] as i128), (-1, (lo[a] + side) as i128)] {
                let inside = |p: &[i128; 4]| sign * (p[a] - bound * p[3]);
                let mut left = Vec::new();
                for (i, p) in polygon.iter().enumerate() {
                    let next = &polygon[(i + 1) % polygon.len()];
                    let (d, e) = (inside(p), inside(next));
                    if d >= 0 {
                        left.push(*p);
                    }
                    if d > 0 && e < 0 || d < 0 && e > 0 {
                        // d / w_p and e / w_next are the distances; the cut is at next * d - p * e over d - e.
                        let cut: [i128; 4] = std::array::from_fn(|k| p[k] * e.abs() + next[k] * d.abs());
                        let divisor = cut.iter().fold(0i128, |g, &v| gcd(g, v.abs())).max(1);
                        left.push(cut.map(|v| v / divisor));
                    }
                }
                polygon = left;
                if polygon.is_empty() {
                    return false;
                }
            }
        }
        true
    }

    fn gcd(a: i128, b: i128) -> i128 {
        if b == 0 { a } else { gcd(b, a % b) }
    }

    fn corners(range: std::ops::Range<i64>) -> impl Strategy<Value = [[i64; 3]; 3]> {
        proptest::array::uniform3(proptest::array::uniform3(range))
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]

        #[test]
        fn touching_is_what_clipping_leaves(
            corner in corners(-9..10),
            lo in proptest::array::uniform3(-8i64..8),
            side in 0i64..8,
        ) {
            let expected = clipped(corner, lo, side);
            prop_assert_eq!(Triangle::<i64>::new(corner).touches(lo, side), expected);
            prop_assert_eq!(Triangle::<i128>::new(corner).touches(lo, side), expected);
        }

        #[test]
        fn large_ones_too(
            corner in corners(-200_000..200_000),
            lo in proptest::array::uniform3(-100_000i64..100_000),
            side in 0i64..60_000,
        ) {
            prop_assert_eq!(Triangle::<i128>::new(corner).touches(lo, side), clipped(corner, lo, side));
        }
    }
}
