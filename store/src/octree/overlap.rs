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
//! Invariants: 1. no rounding: i32 or i64 where the triangle and the box are small enough for all products, else i128.

use std::ops::{Add, Mul, Neg, Sub};

/// Integers wide enough for the products at hand.
pub(super) trait Wide:
    Copy + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// `value`, which fits.
    fn of(value: i64) -> Self;
}
impl Wide for i32 {
    fn of(value: i64) -> i32 {
        debug_assert!(i32::try_from(value).is_ok(), "{value} is out of range");
        value as i32
    }
}
impl Wide for i64 {
    fn of(value: i64) -> i64 {
        value
    }
}
impl Wide for i128 {
    fn of(value: i64) -> i128 {
        i128::from(value)
    }
}

/// Greatest difference of coordinates, triangle and box together, for which i64 holds all products: normals are sums of
/// two products, the plane's value one of three products of those.
pub(super) const NARROW_REACH: i64 = 1 << 19;
const _: () = assert!(2 * 3 * (NARROW_REACH as i128).pow(3) < i64::MAX as i128);

/// True when i32 holds all products for triangles of which no two corners are further apart than `extent` along an
/// axis, and `reach` with the box: normals are at most two squares of the first, the plane's value six products of such
/// a square with the second, and what the box adds at its end a quarter of that.
pub(super) fn is_narrowest(extent: i64, reach: i64) -> bool {
    const MOST: i64 = 1 << 28;
    const _: () = assert!(MOST / 2 * 15 < i32::MAX as i64);
    reach < 1 << 14 && extent * extent * reach < MOST
}

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
        let edge = |i: usize, axis: usize| T::of(corner[(i + 1) % 3][axis] - corner[i][axis]);
        let other = |axis: usize| T::of(corner[2][axis] - corner[0][axis]);
        let normal = std::array::from_fn(|a| {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            edge(0, b) * other(c) - edge(0, c) * other(b)
        });
        let edges = AXES.map(|[a, b, away]| {
            let turned = normal[away] < T::of(0);
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

    /// Which boxes of a grid the triangle touches: bit `x + 4 y + 16 z` for the one of `side` from `origin` + `side`
    /// times (x, y, z). Only those of `range` are asked, first and last along each axis, at most 3: those that its box
    /// touches.
    pub(super) fn touched(&self, origin: [i64; 3], side: i64, range: [[usize; 2]; 3]) -> u64 {
        let (zero, wide) = (T::of(0), T::of(side));
        // Of a linear function, what each of four steps along an axis adds.
        let along = |axis: usize, factor: T, from: i64| {
            let (at, step) = (factor * T::of(origin[axis] - from), factor * wide);
            [at, at + step, at + step + step, at + step + step + step]
        };
        // Where all of the triangle is between two neighbouring planes of the grid.
        let is_slab: [bool; 3] = std::array::from_fn(|a| {
            let lo = origin[a] + range[a][0] as i64 * side;
            range[a][0] == range[a][1] && lo <= self.lo[a] && self.hi[a] <= lo + side
        });
        // In each projection, the squares within reach of the inner side of all edges: bit `inner + 4 outer`.
        let squares = |which: usize, is_turned: bool| {
            let [a, b, _] = AXES[which];
            if is_slab[a] || is_slab[b] {
                // A row of squares, of which it reaches both ends, and is nowhere else.
                return u64::MAX;
            }
            let lines = [0, 1, 2].map(|i| {
                let [na, nb] = self.edge[which][i];
                let reach =
                    if na > zero { na * wide } else { zero } + if nb > zero { nb * wide } else { zero };
                let [a, b] = [along(a, na, self.corner[i][a]), along(b, nb, self.corner[i][b])];
                let [inner, outer] = if is_turned { [b, a] } else { [a, b] };
                (inner, outer.map(|at| at + reach))
            });
            let mut squares = 0u64;
            let [first, last] = range[if is_turned { a } else { b }];
            for outer in first..=last {
                for inner in 0..4 {
                    let is_inside = |i: usize| u64::from(lines[i].0[inner] + lines[i].1[outer] >= zero);
                    squares |= (is_inside(0) & is_inside(1) & is_inside(2)) << (inner + 4 * outer);
                }
            }
            squares
        };
        let (xy, yz, xz) = (squares(0, false), squares(1, false), squares(2, true));
        let plane: [[T; 4]; 3] = std::array::from_fn(|a| along(a, self.normal[a], self.corner[0][a]));
        let [down, up] = [false, true].map(|is_up| {
            self.normal.iter().fold(zero, |sum, &n| if (n > zero) == is_up { sum + n * wide } else { sum })
        });
        let columns = (2u64 << range[0][1]) - (1 << range[0][0]);
        let mut bitmap = 0;
        for z in range[2][0]..=range[2][1] {
            for y in range[1][0]..=range[1][1] {
                let row = xy >> (4 * y) & xz >> (4 * z) & columns;
                if row == 0 || yz >> (y + 4 * z) & 1 == 0 {
                    continue;
                }
                let beside = plane[1][y] + plane[2][z];
                let (down, up) = (beside + down, beside + up);
                let is_cut =
                    |x: usize| u64::from(plane[0][x] + down <= zero) & u64::from(plane[0][x] + up >= zero);
                let cut = is_cut(0) | is_cut(1) << 1 | is_cut(2) << 2 | is_cut(3) << 3;
                bitmap |= (row & cut) << (4 * y + 16 * z);
            }
        }
        bitmap
    }

    fn plane_cuts(&self, lo: [i64; 3], side: i64) -> bool {
        let (zero, side) = (T::of(0), T::of(side));
        let (mut least, mut most) = (zero, zero);
        for a in 0..3 {
            let n = self.normal[a];
            let at = n * T::of(lo[a] - self.corner[0][a]);
            let across = n * side;
            least = least + at + if n < zero { across } else { zero };
            most = most + at + if n < zero { zero } else { across };
        }
        least <= zero && most >= zero
    }

    fn edges_reach(&self, lo: [i64; 3], side: i64) -> bool {
        let (zero, side) = (T::of(0), T::of(side));
        AXES.iter().zip(&self.edge).all(|(&[a, b, _], edges)| {
            edges.iter().enumerate().all(|(i, &[na, nb])| {
                let from = &self.corner[i];
                let at = na * T::of(lo[a] - from[a]) + nb * T::of(lo[b] - from[b]);
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

    /// Overlap by clipping in rationals: the triangle is cut by the six planes, what is left is not empty. Corners are
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
            prop_assert_eq!(Triangle::<i32>::new(corner).touches(lo, side), expected);
            prop_assert_eq!(Triangle::<i64>::new(corner).touches(lo, side), expected);
            prop_assert_eq!(Triangle::<i128>::new(corner).touches(lo, side), expected);
        }

        /// Against the boxes one by one.
        #[test]
        fn boxes_of_a_grid_are_asked_together(
            corner in corners(-9..10),
            origin in proptest::array::uniform3(-9i64..6),
            side in 1i64..6,
        ) {
            let narrow = Triangle::<i64>::new(corner);
            let mut expected = 0u64;
            for (i, place) in (0..64).map(|i| (i, [i & 3, i >> 2 & 3, i >> 4])) {
                let lo = std::array::from_fn(|a| origin[a] + place[a] * side);
                expected |= u64::from(narrow.touches(lo, side)) << i;
            }
            let range: [[i64; 2]; 3] = std::array::from_fn(|a| {
                let values = corner.map(|c| c[a] - origin[a]);
                // The one before, where it ends at the triangle's box.
                let first = (values.into_iter().min().unwrap() + side - 1).div_euclid(side) - 1;
                [first, values.into_iter().max().unwrap().div_euclid(side)]
            });
            if range.iter().all(|&[first, last]| first <= 3 && last >= 0) {
                let range = range.map(|ends| ends.map(|v| v.clamp(0, 3) as usize));
                prop_assert_eq!(narrow.touched(origin, side, range), expected);
                prop_assert_eq!(Triangle::<i32>::new(corner).touched(origin, side, range), expected);
                prop_assert_eq!(Triangle::<i128>::new(corner).touched(origin, side, range), expected);
            } else {
                prop_assert_eq!(expected, 0);
            }
        }

        /// Triangles and leaves just within the bound of i32, where a product too many would overflow: the leaf lies at
        /// an end of the triangle's box, or within it.
        #[test]
        fn the_narrowest_hold_all_products(
            extent in 2i64..640,
            ends in proptest::array::uniform3(proptest::array::uniform3(0.0f64..=1.0)),
            is_corner in proptest::bool::ANY,
            place in proptest::array::uniform3(0.0f64..=1.0),
        ) {
            let most = |reach: &i64| is_narrowest(extent, *reach);
            let reach = (1..16).rev().map(|bit| 1i64 << bit).fold(extent, |reach, step| {
                if most(&(reach + step)) { reach + step } else { reach }
            });
            prop_assert!(is_narrowest(extent, reach));
            let side = (reach - extent) / 4;
            prop_assume!(side > 0);
            let at = |part: f64| (if is_corner { part.round() } else { part } * extent as f64) as i64;
            let corner = ends.map(|corner| corner.map(at));
            // From a leaf that ends at the box to one that begins at its other end.
            let origin = place.map(|part| (part.round() * (extent + 4 * side) as f64) as i64 - 4 * side);
            let range = [[0, 3]; 3];
            let (narrowest, wide) = (Triangle::<i32>::new(corner), Triangle::<i128>::new(corner));
            for (x, y, z) in (0..64).map(|i| (i & 3, i >> 2 & 3, i >> 4)) {
                let lo = [origin[0] + x * side, origin[1] + y * side, origin[2] + z * side];
                prop_assert_eq!(narrowest.touches(lo, side), wide.touches(lo, side));
            }
            prop_assert_eq!(narrowest.touched(origin, side, range), wide.touched(origin, side, range));
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
