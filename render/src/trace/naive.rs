//! `NaiveMesh`: every ray against every triangle, in f64. The oracle of the paged tracer and its double in tests.
//!
//! T. Möller and B. Trumbore, "Fast, minimum storage ray/triangle intersection" (1997).
//! Invariants: 1. it never answers Blocked; 2. triangles are hit from both sides; 3. of equal hits the lower
//! triangle index wins, as `Tracer` asks of everybody who wants to be compared.

use super::PagedTracer;
use super::{Answer, Hit, Ray, Tracer};
use crate::math::unit;
use glam::DVec3;
use std::sync::Arc;
use std::time::Duration;

/// Rounding of the hit point in ulps of its largest operand: a few operations, doubled.
const ERROR_ULPS: f64 = 32.0;

/// A mesh in memory, traced by brute force. Clones share the triangles.
#[derive(Clone, Debug)]
pub struct NaiveMesh {
    triangles: Arc<[NaiveTriangle]>,
}

/// One triangle of a [`NaiveMesh`].
#[derive(Clone, Copy, Debug)]
pub struct NaiveTriangle {
    /// Corners, counter-clockwise seen from the side of the normal; model units.
    pub corners: [[f64; 3]; 3],
    /// Index into the materials.
    pub material: u32,
}

/// Where a ray meets a triangle: `t` on the ray; weights of its second and third corner.
#[derive(Clone, Copy)]
struct NaiveHit {
    t: f64,
    u: f64,
    v: f64,
}

impl NaiveMesh {
    /// A mesh of these triangles; a hit names them by their index. Degenerate ones are never hit.
    pub fn new(triangles: Vec<NaiveTriangle>) -> NaiveMesh {
        NaiveMesh { triangles: triangles.into() }
    }

    /// The triangles, as given.
    pub fn triangles(&self) -> &[NaiveTriangle] {
        &self.triangles
    }

    /// Closest hit of `ray` among the triangles with index in `range`.
    ///
    /// # Panics
    /// When `range` reaches beyond the triangles.
    pub fn closest(&self, ray: &Ray, range: std::ops::Range<usize>) -> Option<Hit> {
        let mut best: Option<(NaiveHit, usize)> = None;
        for index in range {
            let t_max = best.map_or(ray.t_max, |(nearest, _)| nearest.t);
            if let Some(hit) = self.triangles[index].hit(ray, t_max)
                && best.is_none_or(|(nearest, _)| hit.t < nearest.t)
            {
                best = Some((hit, index));
            }
        }
        best.map(|(hit, index)| self.hit_at(ray, hit, index))
    }

    fn hit_at(&self, ray: &Ray, NaiveHit { t, u, v }: NaiveHit, index: usize) -> Hit {
        let triangle = &self.triangles[index];
        let normal = unit(triangle.cross()).expect("a degenerate triangle was hit");
        let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
        let magnitude = origin.length().max(ray.at(t).length()).max(t * direction.length());
        let normal = normal.as_vec3().to_array();
        Hit {
            t,
            triangle: index as u32,
            page: 0,
            material: triangle.material,
            barycentric: [1.0 - u - v, u, v].map(|weight| weight as f32),
            normal,
            error: ERROR_ULPS * f64::EPSILON * magnitude,
        }
    }
}

impl NaiveTriangle {
    /// The normal, as long as twice the area.
    fn cross(&self) -> DVec3 {
        let [a, b, c] = self.corners.map(DVec3::from);
        (b - a).cross(c - a)
    }

    /// The hit, if the ray meets the triangle at `0 <= t <= t_max`.
    fn hit(&self, ray: &Ray, t_max: f64) -> Option<NaiveHit> {
        let [a, b, c] = self.corners.map(DVec3::from);
        let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
        let (ab, ac) = (b - a, c - a);
        let p = direction.cross(ac);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let from_a = origin - a;
        let q = from_a.cross(ab);
        let u = from_a.dot(p) / determinant;
        let v = direction.dot(q) / determinant;
        let t = ac.dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0 && t <= t_max).then_some(NaiveHit { t, u, v })
    }
}

impl Tracer for NaiveMesh {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        Answer::Exact(self.closest(ray, 0..self.triangles.len()))
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        Answer::Exact(self.triangles.iter().any(|triangle| triangle.hit(ray, ray.t_max).is_some()))
    }
}

impl PagedTracer for NaiveMesh {
    fn begin_tile(&mut self) {}

    fn request_missing(&mut self) -> usize {
        0
    }

    fn wait(&mut self, _longest: Duration) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(z: f64) -> NaiveTriangle {
        NaiveTriangle { corners: [[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]], material: 0 }
    }

    #[test]
    fn the_nearest_wins_and_the_ends_count() {
        let mut mesh = NaiveMesh::new(vec![triangle(3.0), triangle(2.0)]);
        let mut ray = Ray { origin: [0.25, 0.25, 0.0], direction: [0.0, 0.0, 1.0], t_max: f64::INFINITY };
        let Answer::Exact(Some(hit)) = mesh.intersect(&ray) else { panic!("no hit") };
        assert_eq!((hit.t, hit.triangle, hit.normal), (2.0, 1, [0.0, 0.0, 1.0]));
        for (t_max, hit) in [(1.999, false), (2.0, true)] {
            ray.t_max = t_max;
            assert_eq!(mesh.occluded(&ray), Answer::Exact(hit));
        }
        ray.origin[0] = 0.8;
        assert_eq!(mesh.occluded(&ray), Answer::Exact(false));
    }
}
