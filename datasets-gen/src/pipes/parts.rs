//! The parts of the plant and how each becomes triangles.
//!
//! Invariants: 1. `count` says exactly what `tessellate` appends; 2. positions are exact in f32, and a vertex
//! that triangles of a part share is computed once per ring place, so it is equal to the bit; 3. triangles are
//! counter-clockwise seen from outside; 4. at most [`Part::MAX_TRIANGLES`] a part up to [`MAX_DETAIL`].

use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, TAU};
use trex_store::TriangleBatch;

/// Finest tessellation.
pub(super) const MAX_DETAIL: u32 = 32;

/// One part: a shape and a material.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) shape: Shape,
    pub(super) material: u32,
}

/// What a part looks like. Lengths in metres, z up.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// A beam, a plate, a wall: twelve triangles at any detail.
    Block { lo: [f64; 3], hi: [f64; 3] },
    /// A rectangle that faces down: two triangles.
    Lamp { lo: [f64; 2], hi: [f64; 2], z: f64 },
    /// A straight pipe, without ends: long thin triangles.
    Pipe { from: [f64; 3], axis: usize, length: f64, radius: f64 },
    /// A pipe with ends: a flange, a rung, a pump body.
    Disc { from: [f64; 3], axis: usize, length: f64, radius: f64 },
    /// A quarter of a torus in the plane of `axes`, from `center + bend * axes[0]` to `center + bend * axes[1]`.
    Elbow { center: [f64; 3], axes: [[f64; 3]; 2], bend: f64, radius: f64 },
    /// A vessel along `axis` with domed ends.
    Tank { from: [f64; 3], axis: usize, length: f64, radius: f64 },
    /// A hexagonal head.
    Bolt { from: [f64; 3], axis: usize, size: f64 },
}

impl Part {
    /// More than any part makes at [`MAX_DETAIL`].
    pub(super) const MAX_TRIANGLES: u64 = 26_000;

    /// Triangles at `detail`.
    pub(super) fn count(&self, detail: u32) -> u64 {
        let detail = u64::from(detail);
        match self.shape {
            Shape::Block { .. } => 12,
            Shape::Lamp { .. } => 2,
            Shape::Pipe { .. } => 2 * around(detail) * (1 + detail / 4),
            Shape::Disc { .. } => 4 * around(detail),
            Shape::Elbow { .. } => 2 * around(detail) * (2 + detail),
            // The two outermost rings of a dome meet in a point: one triangle a sector instead of two.
            Shape::Tank { .. } => 2 * around(detail) * tank_rings(detail) - 2 * around(detail),
            Shape::Bolt { .. } => 18,
        }
    }

    /// Appends the triangles.
    pub(super) fn tessellate(&self, detail: u32, out: &mut TriangleBatch) {
        let detail = u64::from(detail);
        let mut pen = Pen { out, material: self.material };
        match self.shape {
            Shape::Block { lo, hi } => pen.block(lo, hi),
            Shape::Lamp { lo, hi, z } => {
                let [a, b] = [[lo[0], lo[1], z], [lo[0], hi[1], z]];
                pen.quad(a, b, [hi[0], hi[1], z], [hi[0], lo[1], z]);
            }
            Shape::Pipe { from, axis, length, radius } => {
                let rings = 1 + detail / 4;
                pen.turned(Revolution { from, axis, around: around(detail) }, rings, |ring| {
                    [radius, length * ring as f64 / rings as f64]
                });
            }
            Shape::Disc { from, axis, length, radius } => {
                let profile = [[0.0, 0.0], [radius, 0.0], [radius, length], [0.0, length]];
                pen.turned(Revolution { from, axis, around: around(detail) }, 3, |ring| {
                    profile[ring as usize]
                });
            }
            Shape::Bolt { from, axis, size } => {
                let profile = [[size, 0.0], [size, size], [0.0, size]];
                pen.turned(Revolution { from, axis, around: 6 }, 2, |ring| profile[ring as usize]);
            }
            Shape::Tank { from, axis, length, radius } => {
                let dome = 3 + detail;
                let rings = tank_rings(detail);
                pen.turned(Revolution { from, axis, around: around(detail) }, rings, |ring| {
                    let low = FRAC_PI_2 * ring as f64 / dome as f64;
                    let high = FRAC_PI_2 * (rings - ring) as f64 / dome as f64;
                    if ring == 0 || ring == rings {
                        [0.0, if ring == 0 { 0.0 } else { length }]
                    } else if ring <= dome {
                        [radius * low.sin(), 0.5 * radius * (1.0 - low.cos())]
                    } else if ring >= rings - dome {
                        [radius * high.sin(), length - 0.5 * radius * (1.0 - high.cos())]
                    } else {
                        let part = (ring - dome) as f64 / (rings - 2 * dome) as f64;
                        [radius, 0.5 * radius + (length - radius) * part]
                    }
                });
            }
            Shape::Elbow { center, axes, bend, radius } => pen.elbow(center, axes, [bend, radius], detail),
        }
    }
}

/// Sectors of a round part.
fn around(detail: u64) -> u64 {
    6 + 2 * detail
}

/// Rings of triangles of a tank: two domes and the shell.
fn tank_rings(detail: u64) -> u64 {
    2 * (3 + detail) + 1 + detail / 2
}

/// Where a body of revolution stands: the point on its axis, the axis (x, y or z), the count of sectors.
struct Revolution {
    from: [f64; 3],
    axis: usize,
    around: u64,
}

/// Appends triangles of one material.
struct Pen<'a> {
    out: &'a mut TriangleBatch,
    material: u32,
}

impl Pen<'_> {
    fn triangle(&mut self, corners: [[f64; 3]; 3]) {
        self.out.push(corners.map(|corner| corner.map(|value| f64::from(value as f32))), self.material);
    }

    fn quad(&mut self, a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) {
        self.triangle([a, b, c]);
        self.triangle([a, c, d]);
    }

    fn block(&mut self, lo: [f64; 3], hi: [f64; 3]) {
        let corner = |index: usize| std::array::from_fn(|axis| [lo, hi][index >> axis & 1][axis]);
        for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
            .map(|f| f.map(corner))
        {
            self.quad(face[0], face[1], face[2], face[3]);
        }
    }

    /// A body of revolution; `profile` gives `[radius, place along the axis]` for rings `0..=rings`, with the
    /// outside on the right hand of its way. Where a radius is 0 the ring is a point.
    fn turned(&mut self, turned: Revolution, rings: u64, profile: impl Fn(u64) -> [f64; 2]) {
        let [u, v] = [(turned.axis + 1) % 3, (turned.axis + 2) % 3];
        let point = |ring: [f64; 2], sector: u64| {
            let angle = TAU * (sector % turned.around) as f64 / turned.around as f64;
            let mut at = turned.from;
            at[turned.axis] += ring[1];
            at[u] += ring[0] * angle.cos();
            at[v] += ring[0] * angle.sin();
            at
        };
        for index in 0..rings {
            let [low, high] = [profile(index), profile(index + 1)];
            for sector in 0..turned.around {
                let [a, b] = [point(low, sector), point(low, sector + 1)];
                let [d, c] = [point(high, sector), point(high, sector + 1)];
                if low[0] > 0.0 {
                    self.triangle([a, b, c]);
                }
                if high[0] > 0.0 {
                    self.triangle([a, c, d]);
                }
            }
        }
    }

    fn elbow(&mut self, center: [f64; 3], axes: [[f64; 3]; 2], [bend, radius]: [f64; 2], detail: u64) {
        let (steps, around) = (2 + detail, around(detail));
        let (center, [p, q]) = (DVec3::from(center), axes.map(DVec3::from));
        let normal = p.cross(q);
        let point = |step: u64, sector: u64| -> [f64; 3] {
            let (turn, angle) = (step as f64 / steps as f64, TAU * (sector % around) as f64 / around as f64);
            // The ends are exact, so that they meet the pipes there.
            let [cos, sin] = match step {
                0 => [1.0, 0.0],
                step if step == steps => [0.0, 1.0],
                _ => [(FRAC_PI_2 * turn).cos(), (FRAC_PI_2 * turn).sin()],
            };
            let reach = bend + radius * angle.cos();
            (center + (p * cos + q * sin) * reach + normal * radius * angle.sin()).to_array()
        };
        for step in 0..steps {
            for sector in 0..around {
                let [a, b] = [point(step, sector), point(step + 1, sector)];
                let [d, c] = [point(step, sector + 1), point(step + 1, sector + 1)];
                self.quad(a, b, c, d);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> Vec<Shape> {
        let (from, axis) = ([1.0, 2.0, 3.0], 1);
        vec![
            Shape::Block { lo: [0.0; 3], hi: [1.0, 2.0, 3.0] },
            Shape::Lamp { lo: [0.0; 2], hi: [1.0; 2], z: 4.0 },
            Shape::Pipe { from, axis, length: 5.0, radius: 0.5 },
            Shape::Disc { from, axis, length: 0.2, radius: 0.5 },
            Shape::Elbow { center: from, axes: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]], bend: 1.0, radius: 0.3 },
            Shape::Tank { from, axis, length: 4.0, radius: 1.0 },
            Shape::Bolt { from, axis, size: 0.02 },
        ]
    }

    #[test]
    fn counts_are_exact_and_no_triangle_is_degenerate() {
        for shape in samples() {
            let part = Part { shape, material: 3 };
            for detail in [0, 1, 2, 5, 8, MAX_DETAIL] {
                let mut out = TriangleBatch::default();
                part.tessellate(detail, &mut out);
                assert_eq!(out.len() as u64, part.count(detail), "{part:?} at {detail}");
                assert!(part.count(detail) <= Part::MAX_TRIANGLES);
                assert!(out.corners.iter().all(|[a, b, c]| a != b && b != c && a != c), "{part:?}");
            }
        }
    }

    #[test]
    fn normals_point_outward() {
        for shape in samples() {
            let inner = match shape {
                Shape::Block { .. } => [0.5, 1.0, 1.5],
                Shape::Tank { .. } => [1.0, 4.0, 3.0],
                Shape::Disc { .. } => [1.0, 2.1, 3.0],
                Shape::Lamp { .. } => [0.5, 0.5, 5.0],
                // Their axes: a pipe has no ends, a bolt no bottom; each side still faces away from it.
                Shape::Pipe { .. } => [1.0, 4.5, 3.0],
                Shape::Bolt { .. } => [1.0, 2.01, 3.0],
                Shape::Elbow { .. } => continue,
            };
            let mut out = TriangleBatch::default();
            Part { shape: shape.clone(), material: 0 }.tessellate(2, &mut out);
            for [a, b, c] in &out.corners {
                let [u, v, w] = [b, c, &inner].map(|p| DVec3::from(*p) - DVec3::from(*a));
                assert!(u.cross(v).dot(w) < 0.0, "{shape:?}");
            }
        }
    }
}
