//! Hits on the paged mesh against the triangles that went into the build.

use super::{F32_BOUND, exact, point, random_rays, triangle_size};
use crate::command::said;
use crate::oracle::mesh::{OracleMesh, cross, distance, dot, sub};
use crate::support::{build_options, build_source, source};
use trex_render::{AllResident, PagedMesh, Ray, Tracer};
use trex_store::{TriangleBatch, TriangleSource};

/// Hits against the input's own triangles: snapping moves a surface by at most the stated bound, so along a ray by
/// bound / cos(theta). Rays that come close to an edge of the input may meet another triangle, and are left out.
pub(super) fn check_against_the_input(source: &mut dyn TriangleSource, ray_count: usize) {
    let mut triangles = Vec::new();
    let mut batch = TriangleBatch::default();
    while source.next_batch(&mut batch).unwrap() {
        triangles.extend(batch.corners.iter().filter(|c| triangle_size(c) > 0.0).copied());
    }
    source.rewind().unwrap();
    let name = source.name();
    let built = build_source(source, &build_options());
    let oracle = OracleMesh::new(triangles);
    let resident = AllResident::load(&built.file);
    let mut tracer = PagedMesh::new(&built.file, &resident);
    let block = built.file.superblock();
    let extent = block.bounds.diagonal();
    // A vertex moves by at most the bound on each axis.
    let moved = 3f64.sqrt() * block.error_bound;
    let (mut compared, mut worst, mut left_out) = (0, 0.0f64, 0);
    for ray in random_rays(&built, ray_count, 77) {
        let Some(theirs) = oracle.closest(ray.origin, ray.direction, f64::INFINITY) else { continue };
        let triangle = &oracle.triangles[theirs.triangle];
        let n = cross(sub(triangle[1], triangle[0]), sub(triangle[2], triangle[0]));
        let cos = (dot(n, ray.direction) / dot(n, n).sqrt()).abs();
        let bound = moved / cos + extent * F32_BOUND + 1e-14 * dot(ray.origin, ray.origin).sqrt();
        // Slivers turn when their corners move; rays at edges and in front of near surfaces have two answers.
        if theirs.least_weight * triangle_size(triangle) < 4.0 * moved / cos
            || triangle_size(triangle) < 16.0 * moved
        {
            left_out += 1;
            continue;
        }
        // A ray that begins on a surface may find itself on its other side after the snap, with nothing ahead.
        if theirs.t * cos <= moved {
            left_out += 1;
            continue;
        }
        let before = oracle.closest(point(&ray, theirs.t + 1e-9 * extent), ray.direction, 3.0 * bound);
        let Some(ours) = exact(tracer.intersect(&ray)) else {
            panic!("{name}: {ray:?} hits {theirs:?} and ours misses")
        };
        let apart = (ours.t - theirs.t).abs();
        let ours_cos = dot(ours.normal.map(f64::from), ray.direction).abs();
        if ours.t * ours_cos <= moved {
            left_out += 1;
            continue;
        }
        // An edge of something in front, just missed by the input's ray, may answer.
        if apart > bound && ours.t < theirs.t && near_an_edge(&oracle, &ray, ours.t, moved / cos)
            || before.is_some()
        {
            left_out += 1;
            continue;
        }
        assert!(apart <= bound, "{name}: {apart:e} apart, bound {bound:e}: {ray:?}, {ours:?}, {theirs:?}");
        worst = worst.max(apart / bound);
        compared += 1;
    }
    said(&format!(
        "{name}: {compared} rays compared, {left_out} at edges left out, worst {worst:.3} of bound / cos"
    ));
    assert!(compared * 10 > ray_count, "{name}: only {compared} rays could be compared, {left_out} left out");
}

/// True when the ray passes a triangle of the input within `reach` around `t`.
fn near_an_edge(oracle: &OracleMesh, ray: &Ray, t: f64, reach: f64) -> bool {
    let p = point(ray, t);
    oracle.triangles.iter().any(|triangle| distance(triangle, p) <= 4.0 * reach)
}

#[test]
fn hits_lie_within_the_bound_of_the_input() {
    for spec in ["gen:isosurface:50k:9", "gen:pipes:50k:9", "gen:scan:50k:9"] {
        check_against_the_input(&mut *source(spec), 20_000);
    }
}
