//! Cameras at the ends of the range of their angle: what the centre and the corners of the picture see, against the
//! oracle in f64.
//!
//! The bound is that of `extremes.rs`, and once more 2^-49 of the largest coordinate for the oracle's own rounding.

use super::shapes::{cube_surface, placed, star};
use super::{TraceCase, exact, norm};
use crate::command::said;
use crate::oracle::mesh::{OracleMesh, cross, distance, dot, sub};
use crate::random::Random;
use crate::support::Mesh;
use trex_render::{Camera, Fov, Hit, Ray, Tracer};
use trex_store::build::Precision;

/// Width and height, pixels.
const RESOLUTION: [u32; 2] = [64, 48];

/// Cameras of this angle: one that frames the model, one in its middle, and many that its
/// middle more than fills.
fn cameras(model: &TraceCase, degrees: f64) -> Vec<Camera> {
    let bounds = model.built.file.superblock().bounds;
    let framing = Camera::framing(&bounds, RESOLUTION, None, Some(Fov::X(degrees)));
    let away = 0.2 * bounds.extent() / (0.5 * degrees).to_radians().tan() + bounds.extent();
    let center = bounds.center();
    let from = |direction: [f64; 3], distance: f64| Camera {
        position: std::array::from_fn(|a| center[a] + distance * direction[a]),
        ..framing
    };
    let slant = [2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0];
    let mut cameras = vec![framing, from(slant, 0.01 * bounds.extent())];
    for i in 0..16 {
        let away = away * (1.0 + f64::from(i) / 11.0);
        cameras.extend([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], slant].map(|direction| from(direction, away)));
    }
    cameras
}

fn check(name: &str, shape: &mut Mesh, precision: Precision) {
    let model = TraceCase::of(shape, precision);
    let oracle = OracleMesh::new(model.built.decode());
    let step = model.step();
    let (mut hits, mut worst) = (0, 0.0f64);
    for degrees in [0.001, 40.0, 179.0] {
        for camera in cameras(&model, degrees) {
            let projection = camera.project(RESOLUTION).unwrap();
            let [width, height] = RESOLUTION.map(f64::from);
            for (x, y) in [0.5, 0.5 * width, width - 0.5]
                .into_iter()
                .flat_map(|x| [0.5, 0.5 * height, height - 0.5].map(|y| (x, y)))
            {
                let ray: Ray = projection.ray(x, y);
                let theirs = oracle.closest(ray.origin, ray.direction, f64::INFINITY);
                for arithmetic in model.arithmetics() {
                    let context =
                        format!("{name}, {arithmetic:?}, {degrees} degrees, pixel {x} {y}: {ray:?}");
                    let ours = exact(model.tracer(arithmetic).intersect(&ray));
                    let t = theirs.map_or(0.0, |hit| hit.t);
                    let reach = (norm(ray.origin) + t) / step;
                    let bound = (model.bound(arithmetic, &ray, t) + 2f64.powi(-49) * reach) * step;
                    // Ours lies on its triangle, and nothing that is clear of edges lies before it.
                    let beside = ours.as_ref().map_or(0.0, |hit| off(&oracle, &ray, hit) / bound);
                    assert!(beside <= 1.0, "{beside} of the bound beside its triangle: {ours:?}, {context}");
                    let overlooked = theirs.is_some_and(|theirs| {
                        let corners = &oracle.triangles[theirs.triangle];
                        let n = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
                        let cosine = dot(n, ray.direction).abs() / norm(n);
                        let clear = theirs.least_weight * norm(n) / size(corners) * cosine > bound;
                        clear && ours.as_ref().is_none_or(|ours| theirs.t + bound / cosine < ours.t)
                    });
                    assert!(!overlooked, "ours {ours:?}, oracle {theirs:?}, {context}");
                    (hits, worst) = (hits + usize::from(ours.is_some()), worst.max(beside));
                }
            }
        }
    }
    said(&format!("{name}, {precision:?}: {hits} pixels hit, {worst:.3} of the bound"));
    assert!(hits >= 60, "{name}: {hits}");
}

/// How far a hit lies beside its triangle.
fn off(oracle: &OracleMesh, ray: &Ray, hit: &Hit) -> f64 {
    let point = std::array::from_fn(|a| ray.origin[a] + hit.t * ray.direction[a]);
    distance(&oracle.triangles[hit.triangle as usize], point)
}

/// The longest edge of a triangle.
fn size(t: &[[f64; 3]; 3]) -> f64 {
    (0..3).map(|i| norm(std::array::from_fn(|a| t[i][a] - t[(i + 1) % 3][a]))).fold(0.0, f64::max)
}

#[test]
fn the_narrowest_and_the_widest_picture_show_the_model() {
    let far = (1i64 << 30) as f64;
    for (origin, unit) in [([0.0; 3], 1.0 / far), ([1e7, -1e7, 1e7], 1e3 / far)] {
        for precision in [Precision::GridBits(16), Precision::GridBits(24), Precision::GridBits(40)] {
            check("star", &mut placed("star", &star(12, far), origin, unit), precision);
            let cube = cube_surface(2, |q| q.map(|x| x << 30));
            check("cube", &mut placed("cube", &cube, origin, unit), precision);
        }
    }
}

/// From far away a ray comes to the box of the model by a step that is itself rounded to many lattice steps. It has to
/// stop short of the box by more than that, or it begins behind the first wall and goes through the model.
#[test]
fn the_first_wall_is_met_from_any_distance() {
    let mut cube = placed("cube", &cube_surface(2, |q| q.map(|x| x << 30)), [0.0; 3], 2f64.powi(-30));
    let model = TraceCase::of(&mut cube, Precision::GridBits(40));
    let mut tracer = model.tracer(model.arithmetics()[0]);
    let mut rng = Random::seeded(7);
    let (mut worst, mut count) = (0.0f64, 0);
    for doublings in 1..40 {
        let distance = 2f64.powi(doublings) * (1.0 + rng.unit());
        for axis in 0..3 {
            for _ in 0..50 {
                let mut target = [(); 3].map(|()| 0.5 + rng.unit());
                target[axis] = 0.0;
                let mut origin = target.map(|x| x + 6.0 * distance * (rng.unit() - 0.5));
                origin[axis] = -distance;
                let way = sub(target, origin);
                let ray = Ray { origin, direction: way.map(|x| x / norm(way)), t_max: f64::INFINITY };
                // Where the numbers of the ray put it, the wall is met if that is not beside it.
                let t = distance / ray.direction[axis];
                let bound = model.bound(model.arithmetics()[0], &ray, t) * model.step() / ray.direction[axis];
                let hit = exact(tracer.intersect(&ray));
                let off = hit.map_or(f64::INFINITY, |hit| (hit.t - t).abs() / bound);
                assert!(off <= 1.0, "{off} of the bound at {doublings}: {hit:?}, wall at {t}, {ray:?}");
                (worst, count) = (worst.max(off), count + 1);
            }
        }
    }
    said(&format!("{count} rays from up to 2^40 sizes away meet the first wall, {worst:.3} of the bound"));
}
