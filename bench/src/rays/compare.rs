//! Two claims about a closest hit, settled in f64.
//!
//! ```text
//! same triangle, or t within the tolerance                 same
//! else the nearer claim is put to the test on its own triangle, f64, integers of the lattice:
//!     clearly inside    the farther claim overlooked it      theirs_wrong or ours_wrong
//!     clearly outside   the nearer claim made it up          ours_wrong or theirs_wrong
//!     between           at an edge, or where the ray starts  undecided
//! ```
//!
//! The tolerance is what f32 coordinates leave: 2^-21 of the largest one.

use super::contender::RayAnswer;
use super::mesh::decode;
use super::sets::{BenchRay, RaySet};
use serde::Serialize;
use trex_store::PageFile;

/// How often two agree about the closest hit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Agreement {
    /// Rays with the same triangle, no hit by both, or two triangles at the same place.
    pub same_count: usize,
    /// At an edge or at the ray's start, within the tolerance: both may be right.
    pub undecided_count: usize,
    /// f64 says that ours is wrong beyond the tolerance.
    pub ours_wrong_count: usize,
    /// f64 says that theirs is.
    pub theirs_wrong_count: usize,
}

impl Agreement {
    /// Counts `other` too.
    pub fn add(&mut self, other: &Agreement) {
        self.same_count += other.same_count;
        self.undecided_count += other.undecided_count;
        self.ours_wrong_count += other.ours_wrong_count;
        self.theirs_wrong_count += other.theirs_wrong_count;
    }
}

/// Compares the closest hits of a set, ray by ray.
pub(super) fn closest(file: &PageFile, set: &RaySet, ours: &[RayAnswer], theirs: &[RayAnswer]) -> Agreement {
    let mut agreement = Agreement::default();
    let largest = file.superblock().lattice_bounds[1].into_iter().max().unwrap_or(1).max(1) as f64;
    let tolerance = largest * 2f64.powi(-21);
    let mut mesh = None;
    for ((ray, ours), theirs) in set.rays.iter().zip(ours).zip(theirs) {
        let length = ray.direction.iter().map(|d| f64::from(*d).powi(2)).sum::<f64>().sqrt();
        let apart = (f64::from(ours.t) - f64::from(theirs.t)).abs() * length;
        if ours.triangle == theirs.triangle || apart <= tolerance {
            agreement.same_count += 1;
            continue;
        }
        let triangles = mesh.get_or_insert_with(|| decode(file).expect("the file was read before"));
        let ours_is_nearer = ours.t < theirs.t;
        let nearer = if ours_is_nearer { ours } else { theirs };
        match place(ray, &triangles[nearer.triangle as usize], tolerance) {
            Place::Between => agreement.undecided_count += 1,
            place if (place == Place::Inside) == ours_is_nearer => agreement.theirs_wrong_count += 1,
            _ => agreement.ours_wrong_count += 1,
        }
    }
    agreement
}

/// Where a ray passes a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Inside,
    Outside,
    Between,
}

/// Möller and Trumbore in f64. Within `tolerance` (lattice steps) of an edge or of the ray's start: between.
fn place(ray: &BenchRay, triangle: &[[i32; 3]; 3], tolerance: f64) -> Place {
    let [a, b, c] = triangle.map(|corner| corner.map(f64::from));
    let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
    let (ab, ac) = (sub(b, a), sub(c, a));
    let p = cross(direction, ac);
    let determinant = dot(ab, p);
    let normal = cross(ab, ac);
    let (length, area) = (dot(direction, direction).sqrt(), dot(normal, normal).sqrt());
    if determinant == 0.0 || area == 0.0 {
        return Place::Between;
    }
    let from_a = sub(origin, a);
    let q = cross(from_a, ab);
    let (u, v, t) = (dot(from_a, p) / determinant, dot(direction, q) / determinant, dot(ac, q) / determinant);
    // Seen along the ray the triangle is flattened by the cosine, and so are its heights.
    let cosine = (determinant / (area * length)).abs();
    let longest = [ab, ac, sub(c, b)].iter().map(|edge| dot(*edge, *edge).sqrt()).fold(0.0, f64::max);
    let margin = u.min(v).min(1.0 - u - v) * area / longest * cosine;
    let margin = margin.min(t * length);
    match margin {
        inside if inside > tolerance => Place::Inside,
        outside if outside < -tolerance => Place::Outside,
        _ => Place::Between,
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_told_apart() {
        let triangle = [[0, 0, 100], [1000, 0, 100], [0, 1000, 100]];
        for (x, y, z, expected) in [
            (200.0, 200.0, 0.0, Place::Inside),
            (-200.0, 200.0, 0.0, Place::Outside),
            (0.25, 200.0, 0.0, Place::Between),
            (200.0, 200.0, 100.0, Place::Between),
            (200.0, 200.0, 200.0, Place::Outside),
        ] {
            let ray = BenchRay { origin: [x, y, z], direction: [0.0, 0.0, 2.0], t_max: f32::INFINITY };
            assert_eq!(place(&ray, &triangle, 1.0), expected, "{ray:?}");
        }
    }
}
