//! The plain kernels: one lane after the other, in f32 or f64. In f32 every operation is the one that `avx2.rs`
//! does, in the same order, so that both give the same bits.

use super::kernel::{Kernel, Lanes};
use super::ray::{Frame, LatticeRay};
use trex_store::cluster::{ClusterView, Node};
use trex_store::layout::{LEAF_TRIANGLES, NODE_WIDTH};

/// f32 or f64.
pub(super) trait Real:
    Copy
    + PartialOrd
    + Into<f64>
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
{
    const ZERO: Self;
    /// Factor on the far side of a slab: more than the relative error of the near and the far t together.
    const FAR: Self;
    /// Least size of a direction component in the slab test; its inverse does not overflow with 40-bit planes.
    const TINY: f64;
    /// Error of a triangle's volume (t times twice its area across the ray), as a share of the cube of its largest
    /// coordinate: 3 x 28 for three products of edge functions, each wrong by 24, and depths, 18 for sums; rounded up.
    const VOLUME: f64;
    fn of(value: f64) -> Self;
    fn of_int(value: i64) -> Self;
    fn up(value: f64) -> Self;
    fn fused(self, factor: Self, addend: Self) -> Self;
    fn least(self, other: Self) -> Self;
    fn most(self, other: Self) -> Self;
}

macro_rules! real {
    ($real:ty, $tiny:expr) => {
        impl Real for $real {
            const ZERO: $real = 0.0;
            const FAR: $real = 1.0 + 8.0 * <$real>::EPSILON;
            const TINY: f64 = $tiny;
            const VOLUME: f64 = 64.0 * <$real>::EPSILON as f64;
            fn of(value: f64) -> $real {
                value as $real
            }
            fn of_int(value: i64) -> $real {
                value as $real
            }
            fn up(value: f64) -> $real {
                (value as $real).next_up()
            }
            fn fused(self, factor: $real, addend: $real) -> $real {
                self.mul_add(factor, addend)
            }
            fn least(self, other: $real) -> $real {
                if self < other { self } else { other }
            }
            fn most(self, other: $real) -> $real {
                if self > other { self } else { other }
            }
        }
    };
}

real!(f32, 1e-25);
real!(f64, 1e-250);

/// A ray set up for the plain kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scalar<T> {
    pub(super) cell: [i64; 3],
    pub(super) fraction: [T; 3],
    /// Fraction plus and minus the slack: for lower and upper planes.
    pub(super) fraction_lo: [T; 3],
    pub(super) fraction_hi: [T; 3],
    pub(super) inverse: [T; 3],
    pub(super) negative: [bool; 3],
    pub(super) k: [usize; 3],
    pub(super) s: [T; 3],
    pub(super) node_shift: u32,
    pub(super) blur: T,
}

impl<T: Real> Scalar<T> {
    /// t of a plane: `(base + q * scale) * inverse`, as one fused step.
    fn slabs(
        &self,
        lo: [[u8; 8]; 3],
        hi: [[u8; 8]; 3],
        lo_base: [T; 3],
        hi_base: [T; 3],
        scale: [T; 3],
    ) -> [(T, T); 8] {
        std::array::from_fn(|i| {
            let (mut near, mut far) = (T::ZERO, T::of(f64::INFINITY));
            for a in 0..3 {
                let step = scale[a] * self.inverse[a];
                let t_lo = T::of_int(i64::from(lo[a][i])).fused(step, lo_base[a] * self.inverse[a]);
                let t_hi = T::of_int(i64::from(hi[a][i])).fused(step, hi_base[a] * self.inverse[a]);
                let (t_near, t_far) = if self.negative[a] { (t_hi, t_lo) } else { (t_lo, t_hi) };
                near = t_near.most(near);
                far = t_far.least(far);
            }
            (near, far * T::FAR)
        })
    }

    fn answer(slabs: [(T, T); 8], count: usize, t_max: T) -> Lanes<T> {
        let mut lanes = Lanes { mask: 0, t: slabs.map(|(near, _)| near) };
        for (i, (near, far)) in slabs.into_iter().enumerate().take(count) {
            lanes.mask |= u32::from(near <= far && near <= t_max) << i;
        }
        lanes
    }
}

impl<T: Real> Kernel for Scalar<T> {
    type T = T;

    fn new(frame: &Frame, ray: &LatticeRay) -> Scalar<T> {
        let slab_direction = ray.direction.map(|d| if d.abs() < T::TINY { T::TINY.copysign(d) } else { d });
        Scalar {
            cell: ray.cell,
            fraction: ray.fraction.map(T::of),
            fraction_lo: ray.fraction.map(|f| T::of(f + frame.slack)),
            fraction_hi: ray.fraction.map(|f| T::of(f - frame.slack)),
            inverse: slab_direction.map(|d| T::of(1.0 / d)),
            negative: ray.direction.map(f64::is_sign_negative),
            k: ray.shear.k,
            s: ray.shear.s.map(T::of),
            node_shift: frame.node_shift,
            blur: T::of(frame.blur),
        }
    }

    fn t_end(t: f64) -> T {
        T::up(t)
    }

    fn node(&self, node: &Node, t_max: T) -> Lanes<T> {
        let relative: [i64; 3] =
            std::array::from_fn(|a| (i64::from(node.origin[a]) << self.node_shift) - self.cell[a]);
        let lo_base = std::array::from_fn(|a| T::of_int(relative[a]) - self.fraction_lo[a]);
        let hi_base = std::array::from_fn(|a| T::of_int(relative[a]) - self.fraction_hi[a]);
        let scale = node.exponent.map(|e| T::of_int(1 << (u32::from(e) + self.node_shift)));
        let slabs = self.slabs(node.lo, node.hi, lo_base, hi_base, scale);
        Scalar::answer(slabs, usize::from(node.child_count).min(NODE_WIDTH), t_max)
    }

    fn leaf_boxes(&self, cluster: &ClusterView<'_>, half: usize, t_max: T) -> Lanes<T> {
        let (base, shift, boxes) = (cluster.base(), cluster.leaf_shift(), cluster.leaf_boxes());
        let eight = |row: usize| std::array::from_fn(|i| boxes[row][8 * half + i]);
        let relative: [i64; 3] = std::array::from_fn(|a| base[a] - self.cell[a]);
        let lo_base = std::array::from_fn(|a| T::of_int(relative[a]) - self.fraction_lo[a]);
        // Upper planes are cells: their far side is one cell on.
        let hi_base = std::array::from_fn(|a| T::of_int(relative[a] + (1 << shift[a])) - self.fraction_hi[a]);
        let scale = shift.map(|s| T::of_int(1 << s));
        let (lo, hi) = (std::array::from_fn(eight), std::array::from_fn(|a| eight(3 + a)));
        let slabs = self.slabs(lo, hi, lo_base, hi_base, scale);
        Scalar::answer(slabs, cluster.leaf_count().saturating_sub(8 * half).min(8), t_max)
    }

    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, t_max: T) -> u32 {
        let corners = cluster.leaf_corners(leaf);
        let mut mask = 0;
        for i in 0..LEAF_TRIANGLES {
            let [a, b, c] = std::array::from_fn(|corner| {
                let q = cluster.vertex(usize::from(corners[corner][i]));
                let p: [T; 3] = std::array::from_fn(|x| T::of_int(q[x] - self.cell[x]) - self.fraction[x]);
                let z = p[self.k[2]];
                let shear = |x: usize| (T::ZERO - self.s[x]).fused(z, p[self.k[x]]);
                [shear(0), shear(1), self.s[2] * z]
            });
            let zero = T::ZERO;
            let mut uvw = [(c, b), (a, c), (b, a)].map(|(p, q)| p[0] * q[1] - p[1] * q[0]);
            if uvw.iter().all(|&x| x == zero) {
                uvw = [(c, b), (a, c), (b, a)].map(|(p, q)| lost(p[0], q[1]) - lost(p[1], q[0]));
            }
            let inside = uvw.iter().all(|&x| x >= zero) || uvw.iter().all(|&x| x <= zero);
            let flat = uvw.iter().all(|&x| x == zero);
            let (near, far) = (a[2].least(b[2]).least(c[2]), a[2].most(b[2]).most(c[2]));
            let met = inside && !flat && far >= zero && near <= t_max;
            mask |= u32::from(met && !self.is_surely_off([a, b, c], uvw, t_max)) << i;
        }
        mask
    }
}

impl<T: Real> Scalar<T> {
    /// Whether `0 <= t <= t_max` fails by more than t is wrong by, or by anything where that is next to nothing.
    fn is_surely_off(&self, [a, b, c]: [[T; 3]; 3], [u, v, w]: [T; 3], t_max: T) -> bool {
        let zero = T::ZERO;
        let (sum, volume) = (u + v + w, u * a[2] + v * b[2] + w * c[2]);
        let (sum, volume) = if sum < zero { (zero - sum, zero - volume) } else { (sum, volume) };
        let size = [a, b, c].as_flattened().iter().fold(zero, |most, &x| most.most(x).most(zero - x));
        let error = T::of(T::VOLUME) * size * size * size;
        let least = if error <= self.blur * sum { zero } else { error };
        volume < zero - least || volume - t_max * sum > least
    }
}

/// What rounding takes from a product.
fn lost<T: Real>(p: T, q: T) -> T {
    p.fused(q, T::ZERO - p * q)
}
