//! Rays from inside of a closed mesh.

use super::exact;
use crate::oracle::mesh::{OracleMesh, moeller_trumbore};
use crate::random::Random;
use crate::support::build_spec;
use trex_render::{AllResident, PagedMesh, Ray, Tracer};

/// No ray from inside of a closed mesh gets out, aimed anywhere or exactly at vertices and edges.
#[test]
fn no_ray_leaks_out_of_a_closed_mesh() {
    no_leaks("gen:scan:100k:2", 300_000);
}

pub(super) fn no_leaks(spec: &str, ray_count: usize) {
    let built = build_spec(spec);
    let triangles = built.decode();
    let oracle = OracleMesh::new(triangles);
    let resident = AllResident::load(&built.file);
    let mut tracer = PagedMesh::new(&built.file, &resident);
    let bounds = built.file.superblock().bounds;
    let mut rng = Random::seeded(5);
    // A point is inside when a ray crosses the surface an odd number of times, counted by the oracle.
    let inside = |p: [f64; 3]| {
        let d = [0.5773, 0.5774, 0.5772];
        oracle.triangles.iter().filter(|t| moeller_trumbore(t, p, d).is_some_and(|(t, _)| t > 0.0)).count()
            % 2
            == 1
    };
    let mut origins = Vec::new();
    while origins.len() < 10 {
        let p = rng.point(bounds.lo, bounds.hi);
        if inside(p) {
            origins.push(p);
        }
    }
    for i in 0..ray_count {
        let origin = origins[i % origins.len()];
        let t = &oracle.triangles[rng.bits() as usize % oracle.triangles.len()];
        let target = match i % 3 {
            0 => t[0],
            1 => std::array::from_fn(|a| 0.5 * (t[0][a] + t[1][a])),
            _ => std::array::from_fn(|a| origin[a] + [1.0, 0.3, -0.2][(a + i) % 3] * (rng.unit() - 0.5)),
        };
        let direction: [f64; 3] = std::array::from_fn(|a| target[a] - origin[a]);
        let ray = Ray { origin, direction, t_max: f64::INFINITY };
        assert!(exact(tracer.intersect(&ray)).is_some(), "a leak: {ray:?}");
    }
}
