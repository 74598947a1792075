//! The plain kernels: one lane after the other, in f32 or f64. In f32 every operation is the one that `avx2.rs`
//! does, in the same order, so that both give the same bits.

use super::Ray;
use super::kernel::{Kernel, Lanes, TrianglesMet};
use super::lattice_ray::{LatticeFrame, LatticeRay, RefinedHit, Span};
use trex_store::cluster::{ChildBoxes, ClusterView};
use trex_store::layout::{CLUSTER_LEAVES, LEAF_TRIANGLES, NODE_WIDTH};

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
    /// The nearest number to `value`.
    fn from_f64(value: f64) -> Self;
    /// The nearest number to `value`.
    fn from_i64(value: i64) -> Self;
    /// The value as f32, not above it; for what is not negative.
    fn below(self) -> f32;
    fn fused(self, factor: Self, addend: Self) -> Self;
    fn least(self, other: Self) -> Self;
    fn most(self, other: Self) -> Self;
}

macro_rules! real {
    ($real:ty, $tiny:expr, $below:expr) => {
        impl Real for $real {
            const ZERO: $real = 0.0;
            const FAR: $real = 1.0 + 8.0 * <$real>::EPSILON;
            const TINY: f64 = $tiny;
            const VOLUME: f64 = 64.0 * <$real>::EPSILON as f64;
            fn from_f64(value: f64) -> $real {
                value as $real
            }
            fn from_i64(value: i64) -> $real {
                value as $real
            }
            fn below(self) -> f32 {
                $below(self)
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

real!(f32, 1e-25, |value: f32| value);
real!(f64, 1e-250, |value: f64| (value as f32).next_down().max(0.0));

/// A ray set up for the plain kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scalar<T> {
    pub(super) ray: LatticeRay,
    pub(super) fraction: [T; 3],
    pub(super) slabs: Slabs<T>,
    pub(super) s: [T; 3],
    pub(super) node_shift: u32,
    pub(super) blur: T,
}

/// A ray as box tests see it: `t = plane * inverse + start`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs<T> {
    pub(super) inverse: [T; 3],
    /// Start for the planes where the ray enters, moved outward by the slack.
    pub(super) start_near: [T; 3],
    /// Start for the planes where it leaves.
    pub(super) start_far: [T; 3],
    pub(super) negative: [bool; 3],
}

/// Boxes with planes `q * scale + lo` and `q * scale + hi`, lattice steps from the ray's cell.
struct Boxes<'a, Q> {
    /// The q of lower planes, then those of upper ones, per axis.
    planes: [[&'a [Q]; 3]; 2],
    lo: [i64; 3],
    hi: [i64; 3],
    scale: [i64; 3],
}

impl<T: Real> Slabs<T> {
    fn new(frame: &LatticeFrame, ray: &LatticeRay, inverse: [f64; 3]) -> Slabs<T> {
        let inverse = std::array::from_fn(|a| {
            let d = ray.direction[a];
            T::from_f64(if d.abs() < T::TINY { (1.0 / T::TINY).copysign(d) } else { inverse[a] })
        });
        let negative = ray.direction.map(f64::is_sign_negative);
        let start = |slack: f64| {
            std::array::from_fn(|a| {
                let outward = if negative[a] { -slack } else { slack };
                (T::ZERO - T::from_f64(ray.fraction[a] + outward)) * inverse[a]
            })
        };
        Slabs { inverse, start_near: start(frame.slack), start_far: start(-frame.slack), negative }
    }

    /// Tests `count` boxes: those that the ray meets before `t_max`, and where.
    fn meet<Q: Copy + Into<i64>, const N: usize>(
        &self,
        boxes: &Boxes<'_, Q>,
        count: usize,
        t_max: f32,
    ) -> Lanes<N> {
        let Boxes { planes, lo, hi, scale } = boxes;
        let mut lanes = Lanes { mask: 0, t: [0.0; N] };
        for i in 0..count {
            let (mut near, mut far) = (T::ZERO, T::from_f64(f64::INFINITY));
            for a in 0..3 {
                let step = T::from_i64(scale[a]) * self.inverse[a];
                let t = |plane: Q, base: i64, start: T| {
                    T::from_i64(plane.into()).fused(step, T::from_i64(base).fused(self.inverse[a], start))
                };
                let (lower, upper) = ((planes[0][a][i], lo[a]), (planes[1][a][i], hi[a]));
                let (enter, leave) = if self.negative[a] { (upper, lower) } else { (lower, upper) };
                near = t(enter.0, enter.1, self.start_near[a]).most(near);
                far = t(leave.0, leave.1, self.start_far[a]).least(far);
            }
            lanes.t[i] = near.below();
            lanes.mask |= u32::from(near <= far * T::FAR && lanes.t[i] <= t_max) << i;
        }
        lanes
    }
}

impl<T: Real> Kernel for Scalar<T> {
    fn enter(frame: &LatticeFrame, ray: &Ray) -> Option<(Span, Scalar<T>)> {
        let (span, ray, inverse) = frame.enter(ray)?;
        let kernel = Scalar {
            ray,
            fraction: ray.fraction.map(T::from_f64),
            slabs: Slabs::new(frame, &ray, inverse),
            s: ray.shear.s.map(T::from_f64),
            node_shift: frame.node_shift,
            blur: T::from_f64(frame.blur),
        };
        Some((span, kernel))
    }

    fn node(&self, node: &ChildBoxes, t_max: f32) -> Lanes<NODE_WIDTH> {
        let base = std::array::from_fn(|a| (i64::from(node.origin[a]) << self.node_shift) - self.ray.cell[a]);
        let scale = node.exponent.map(|e| 1 << (u32::from(e) + self.node_shift));
        let count = usize::from(node.child_count).min(NODE_WIDTH);
        let planes = [node.lo.each_ref().map(|row| &row[..]), node.hi.each_ref().map(|row| &row[..])];
        self.slabs.meet(&Boxes { planes, lo: base, hi: base, scale }, count, t_max)
    }

    fn leaf_boxes(&self, cluster: &ClusterView<'_>, t_max: f32) -> Lanes<CLUSTER_LEAVES> {
        let (base, [x, y, z, upper @ ..]) = (cluster.base(), cluster.leaf_planes());
        let scale = cluster.leaf_shift().map(|shift| 1 << shift);
        let lo = std::array::from_fn(|a| base[a] - self.ray.cell[a]);
        // Upper planes are cells: no vertex lies beyond the last step of one.
        let hi = std::array::from_fn(|a| lo[a] + scale[a] - 1);
        let boxes = Boxes { planes: [[x, y, z], upper], lo, hi, scale };
        self.slabs.meet(&boxes, cluster.leaf_count(), t_max)
    }

    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, (t_max, t_sure): (f32, f32)) -> TrianglesMet {
        let [t_max, t_sure] = [t_max, t_sure].map(|t| T::from_f64(t.into()));
        let corners = cluster.leaf_corners(leaf);
        let mut all = TrianglesMet { met: 0, sure: 0 };
        for i in 0..LEAF_TRIANGLES {
            let [a, b, c] = std::array::from_fn(|corner| {
                let q = cluster.vertex(usize::from(corners[corner][i]));
                let p: [T; 3] =
                    std::array::from_fn(|x| T::from_i64(q[x] - self.ray.cell[x]) - self.fraction[x]);
                let k = self.ray.shear.k;
                let z = p[k[2]];
                let shear = |x: usize| (T::ZERO - self.s[x]).fused(z, p[k[x]]);
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
            if !(inside && !flat && far >= zero && near <= t_max) {
                continue;
            }
            let volume = Volume::new([a, b, c], uvw, self.blur);
            all.met |= u32::from(!volume.is_surely_off(t_max)) << i;
            all.sure |= u32::from(!volume.is_surely_off(t_max) && volume.is_surely_before(t_sure)) << i;
        }
        all
    }

    fn refine(&self, cluster: &ClusterView<'_>, leaf: usize, place: usize) -> RefinedHit {
        self.ray.refine(cluster.triangle(leaf, place))
    }
}

/// Where a ray meets the plane of a triangle: t is the volume over the area.
struct Volume<T> {
    /// Twice the area across the ray.
    area: T,
    /// t times that.
    volume: T,
    /// The error of the volume, at most.
    error: T,
    /// The area times half of what t may be off.
    blurred: T,
}

impl<T: Real> Volume<T> {
    fn new([a, b, c]: [[T; 3]; 3], [u, v, w]: [T; 3], blur: T) -> Volume<T> {
        let zero = T::ZERO;
        let (sum, volume) = (u + v + w, u * a[2] + v * b[2] + w * c[2]);
        let (area, volume) = if sum < zero { (zero - sum, zero - volume) } else { (sum, volume) };
        let size = [a, b, c].as_flattened().iter().fold(zero, |most, &x| most.most(x).most(zero - x));
        Volume { area, volume, error: T::from_f64(T::VOLUME) * size * size * size, blurred: blur * area }
    }

    /// True when t is not off by more than it may be.
    fn is_sharp(&self) -> bool {
        self.error <= self.blurred
    }

    /// True when `0 <= t <= t_max` fails by more than t is wrong by, or by anything where that is next to nothing.
    fn is_surely_off(&self, t_max: T) -> bool {
        let least = if self.is_sharp() { T::ZERO } else { self.error };
        self.volume < T::ZERO - least || self.volume - t_max * self.area > least
    }

    /// True when `0 <= t <= t_max` holds by more than t is wrong by.
    fn is_surely_before(&self, t_max: T) -> bool {
        self.is_sharp() && self.volume >= self.blurred && t_max * self.area - self.volume >= self.blurred
    }
}

/// The part of a product that rounding takes.
fn lost<T: Real>(p: T, q: T) -> T {
    p.fused(q, T::ZERO - p * q)
}
