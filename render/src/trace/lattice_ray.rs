//! A ray moved into the lattice: origin split into an integer and a fraction, direction scaled, shear set up.
//!
//! ```text
//! model:   p = origin + t * direction
//! lattice: q = (p - lattice origin) / step = entry + (t_model / step * scale - t_entry) * (direction / scale)
//! ```
//!
//! The ray is moved to where it enters the model's box before anything is rounded to f32, so that what the
//! kernels see are short numbers whatever the camera's distance.
//!
//! Invariants: 1. `entry = cell + fraction` exactly in f64, `|fraction| <= 1`; 2. the longest component of the
//! direction is 1; 3. the entry lies outside of all geometry or is the ray's own origin: no hit has t < 0 by the move.

use super::Ray;
use glam::{DVec2, DVec3};
use std::ops::Range;
use trex_store::PageFile;
use trex_store::geom::Lattice;

/// The part of a model that rays need: the lattice and the box.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeFrame {
    /// Model position of lattice point 0.
    pub(super) origin: DVec3,
    step: f64,
    /// Inverse of `step`, a power of two: exact.
    pub(super) inverse_step: f64,
    /// Lattice steps from 0 to the end of the lattice.
    side: f64,
    pub(super) lo: DVec3,
    pub(super) hi: DVec3,
    /// Lattice shift of node origins.
    pub(super) node_shift: u32,
    /// Distance that box planes move outward, lattice steps, so that rounding in the node test loses no hit.
    pub(super) slack: f64,
    /// Error of a kernel's t that may decide: half of what a hit may be off, lattice steps.
    pub(super) blur: f64,
}

/// Steps around the box that the entry stays away from it, and that kernels look beyond the end; at least, see `FAR`.
const MARGIN: f64 = 2.0;
/// Share of the largest coordinate of a ray's origin that the entry stays away from the box: more than what the way
/// there is rounded by (origin, difference, inverse, two products, sum: half an ulp each, six of eight). On a lattice
/// of 40 bits it is more than `MARGIN` from 2^11 sizes on.
const FAR: f64 = 1.0 / (1u64 << 50) as f64;

/// A component below this moves the ray by nothing on its way through any lattice, and its inverse may be infinite.
pub(super) const STILL: f64 = 1e-250;

/// A ray in lattice units, from its entry on.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeRay {
    /// Integer part of the entry.
    pub(super) cell: [i64; 3],
    /// Fraction of the entry.
    pub(super) fraction: [f64; 3],
    /// Longest component 1 or -1.
    pub(super) direction: [f64; 3],
    pub(super) shear: Shear,
}

/// Which part of a ray counts: t from its entry on, in lattice units; and what that is on the ray itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    /// Where the ray leaves the box or ends, and a margin for the rounding of the kernels' t.
    pub(super) t_max: f64,
    /// End of the ray itself; what was refined is compared with this.
    pub(super) t_end: f64,
    /// The same, rounded down, for kernels.
    pub(super) t_sure: f32,
    /// Model t = (t + t_entry) * t_scale.
    pub(super) t_entry: f64,
    pub(super) t_scale: f64,
}

/// A triangle that a ray meets, as f64 tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RefinedHit {
    /// Lattice t of the entry's ray.
    pub(super) t: f64,
    /// The triangle's normal, as long as twice its area.
    pub(super) normal: [f64; 3],
    /// Greatest component of the two edges at its first corner, lattice steps.
    pub(super) size: f64,
    /// Weights of its corners at the hit, of one sign and not all 0; they are still to be divided by their sum.
    pub(super) weights: [f64; 3],
}

impl LatticeFrame {
    /// The frame of a page file.
    pub(super) fn new(file: &PageFile) -> LatticeFrame {
        let block = file.superblock();
        LatticeFrame::around(&block.lattice, block.lattice_bounds, block.lattice_bits, block.node_shift)
    }

    /// The frame of a box of a lattice that has so many bits.
    fn around(lattice: &Lattice, [lo, hi]: [[i64; 3]; 2], bits: u32, node_shift: u32) -> LatticeFrame {
        // Below 24 bits the node test runs in f32 and its error is below 6 x 2^-24 of the lattice's side, above
        // in f64 with 6 x 2^-53; doubled.
        let side = (1u64 << bits) as f64;
        let is_narrow = bits <= trex_store::layout::NARROW_BITS;
        let ulp = if is_narrow { 2f64.powi(-24) } else { 2f64.powi(-53) };
        LatticeFrame {
            origin: lattice.origin.into(),
            step: lattice.step(),
            inverse_step: 1.0 / lattice.step(),
            side,
            lo: lo.map(|q| q as f64).into(),
            hi: hi.map(|q| q as f64).into(),
            node_shift,
            slack: 12.0 * ulp * side,
            blur: 4.0 * ulp * side,
        }
    }

    /// The frame of a lattice of so many bits, sides of 16, around a box.
    #[cfg(test)]
    pub(super) fn of_box(lo: [i64; 3], hi: [i64; 3], bits: u32) -> LatticeFrame {
        let lattice = Lattice { origin: [0.0; 3], exponent: 4 - bits as i32 };
        LatticeFrame::around(&lattice, [lo, hi], bits, 0)
    }

    /// Length of a lattice step, model units.
    pub(super) fn step(&self) -> f64 {
        self.step
    }

    /// How far the entry of a ray stays away from the box, lattice steps; `far` is the largest coordinate of its
    /// origin. `None` where that is more than the model.
    #[inline(always)]
    pub(super) fn margin(&self, far: f64) -> Option<f64> {
        let margin = MARGIN.max(far * FAR);
        (margin <= self.side.max(MARGIN)).then_some(margin)
    }

    /// Moves a ray to the lattice, and gives the inverse of each component of its direction; `None` when it misses the
    /// model's box, or comes from so far that its rounding is larger than the model.
    #[inline(always)]
    pub(super) fn enter(&self, ray: &Ray) -> Option<(Span, LatticeRay, [f64; 3])> {
        let direction = DVec3::from(ray.direction);
        let longest = direction.abs().max_element();
        let from = (DVec3::from(ray.origin) - self.origin) * self.inverse_step;
        if !(longest > 0.0 && direction.is_finite() && from.is_finite()) {
            return None;
        }
        let inverse = longest / direction;
        let direction = direction / longest;
        let margin = self.margin(from.abs().max_element())?;
        let t_end = ray.t_max * self.inverse_step * longest;
        let (mut t_in, mut t_out) = (0.0f64, t_end);
        for axis in 0..3 {
            if direction[axis].abs() < STILL {
                if from[axis] < self.lo[axis] - margin || from[axis] > self.hi[axis] + margin {
                    return None;
                }
                continue;
            }
            let a = (self.lo[axis] - margin - from[axis]) * inverse[axis];
            let b = (self.hi[axis] + margin - from[axis]) * inverse[axis];
            t_in = t_in.max(a.min(b));
            t_out = t_out.min(a.max(b));
        }
        // Half of the margin pays for the rounding of t_in.
        if t_in > t_out + margin / 2.0 {
            return None;
        }
        let entry = from + t_in * direction;
        let (cell, direction) = (entry.floor(), direction.to_array());
        let ray = LatticeRay {
            cell: cell.to_array().map(|v| v as i64),
            fraction: (entry - cell).to_array(),
            direction,
            shear: Shear::new(direction),
        };
        Some((self.span(t_in..t_out, t_end, longest), ray, inverse.to_array()))
    }

    /// What counts of a ray that goes through the box at `inside` and ends at `t_end`; the longest component of its
    /// direction is `longest`.
    #[inline(always)]
    pub(super) fn span(&self, inside: Range<f64>, t_end: f64, longest: f64) -> Span {
        Span {
            t_max: (inside.end - inside.start).max(0.0) + MARGIN,
            t_end: t_end - inside.start,
            t_sure: ((t_end - inside.start) as f32).next_down(),
            t_entry: inside.start,
            t_scale: self.step / longest,
        }
    }
}

impl Span {
    /// Model t of a lattice t.
    pub(super) fn model_t(&self, t: f64) -> f64 {
        (t + self.t_entry) * self.t_scale
    }

    /// True when a t that was refined lies on the ray: neither behind its start nor behind its end.
    #[inline(always)]
    pub(super) fn holds(&self, t: f64) -> bool {
        (0.0..=self.t_end).contains(&t)
    }
}

impl LatticeRay {
    /// A lattice vertex as seen from the entry; exact but for the fraction.
    fn seen_from_entry(&self, q: [i64; 3]) -> DVec3 {
        let from_cell: [f64; 3] = std::array::from_fn(|a| (q[a] - self.cell[a]) as f64);
        DVec3::from(from_cell) - DVec3::from(self.fraction)
    }

    /// Where a lattice vertex lies beside the ray: in the plane across it that the shear makes.
    pub(super) fn beside(&self, q: [i64; 3]) -> DVec2 {
        self.shear.apply(self.seen_from_entry(q)).truncate()
    }

    /// A triangle that a kernel has reported, in f64. Where the ray passes beside it (the kernel's rounding, at an
    /// edge): at the point of its edges that is nearest to the ray.
    #[inline(never)]
    pub(super) fn refine(&self, q: [[i64; 3]; 3]) -> RefinedHit {
        let n = normal(q);
        let edges = (0..3).flat_map(|a| [q[1][a] - q[0][a], q[2][a] - q[0][a]]);
        let size = edges.fold(0.0f64, |most, x| most.max(x.abs() as f64));
        let (t, weights) = self.place_on(q, n);
        RefinedHit { t, normal: n.to_array(), size, weights }
    }

    /// t on a triangle whose normal is `n`, and the weights of its corners there.
    fn place_on(&self, q: [[i64; 3]; 3], n: DVec3) -> (f64, [f64; 3]) {
        let seen = q.map(|q| self.seen_from_entry(q));
        let [a, b, c] = seen.map(|p| self.shear.apply(p));
        let [u, v, w] = [(c, b), (a, c), (b, a)].map(|(f, g)| f.truncate().perp_dot(g.truncate()));
        let across = n.dot(self.direction.into());
        let is_inside = [u, v, w].iter().all(|&x| x >= 0.0) || [u, v, w].iter().all(|&x| x <= 0.0);
        // From the plane: weights of a needle's corners would be off by any share.
        let (near, far) = (a.z.min(b.z).min(c.z), a.z.max(b.z).max(c.z));
        let on_plane = (across != 0.0 && is_inside).then(|| (n.dot(seen[0]) / across).clamp(near, far));
        match on_plane {
            Some(t) if u + v + w != 0.0 => (t, [u, v, w]),
            on_plane => {
                let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(from, to)| nearest_to_axis(from, to));
                let weights = |at: usize, along: f64| {
                    let mut weights = [0.0; 3];
                    (weights[at], weights[(at + 1) % 3]) = (1.0 - along, along);
                    weights
                };
                let mut best = (ab, 0);
                for (next, at) in [(bc, 1), (ca, 2)] {
                    if next.squared < best.0.squared {
                        best = (next, at);
                    }
                }
                let (nearest, at) = best;
                (on_plane.unwrap_or(nearest.z), weights(at, nearest.along))
            }
        }
    }
}

/// The normal of a lattice triangle, as long as twice its area: exact but for one rounding, however thin it is.
fn normal(q: [[i64; 3]; 3]) -> DVec3 {
    let edge = |i: usize| -> [i64; 3] { std::array::from_fn(|a| q[i][a] - q[0][a]) };
    let (e, f) = (edge(1), edge(2));
    let axes = [(1, 2), (2, 0), (0, 1)];
    // Products of edges of up to 30 bits and their difference fit 64 bits.
    if e.iter().chain(&f).all(|x| x.unsigned_abs() >> 30 == 0) {
        return axes.map(|(a, b)| (e[a] * f[b] - e[b] * f[a]) as f64).into();
    }
    let product = |x: i64, y: i64| i128::from(x) * i128::from(y);
    axes.map(|(a, b)| (product(e[a], f[b]) - product(e[b], f[a])) as f64).into()
}

/// The point of a segment that is nearest to the z axis.
struct AxisPoint {
    /// Squared distance from the axis.
    squared: f64,
    z: f64,
    /// Share of the segment before it.
    along: f64,
}

/// The point of a segment that is nearest to the z axis.
fn nearest_to_axis(from: DVec3, to: DVec3) -> AxisPoint {
    let way = to - from;
    let across = way.truncate();
    let squared = across.length_squared();
    let along = -from.truncate().dot(across) / squared;
    // A segment along the axis: its nearer end.
    let along = if squared > 0.0 { along.clamp(0.0, 1.0) } else { f64::from(u8::from(way.z < 0.0)) };
    let nearest = from + along * way;
    AxisPoint { squared: nearest.truncate().length_squared(), z: nearest.z, along }
}

/// The shear that turns the ray into the z axis (Woop, Benthin, Wald: "Watertight ray/triangle intersection",
/// JCGT 2013).
#[derive(Clone, Copy, Debug)]
pub(super) struct Shear {
    pub(super) k: [usize; 3],
    pub(super) s: [f64; 3],
}

impl Shear {
    /// The shear of a direction whose longest component is 1 or -1.
    #[inline(always)]
    pub(super) fn new(direction: [f64; 3]) -> Shear {
        let kz = (0..3).fold(0, |best, a| if direction[a].abs() > direction[best].abs() { a } else { best });
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        if direction[kz] < 0.0 {
            std::mem::swap(&mut kx, &mut ky);
        }
        // 1 or -1: its own inverse.
        let dz = direction[kz];
        Shear { k: [kx, ky, kz], s: [direction[kx] * dz, direction[ky] * dz, dz] }
    }

    fn apply(&self, p: DVec3) -> DVec3 {
        let z = p[self.k[2]];
        DVec3::new(p[self.k[0]] - self.s[0] * z, p[self.k[1]] - self.s[1] * z, self.s[2] * z)
    }
}
