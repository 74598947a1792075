//! Views that the model fills: what a scenario measures is the model, not the sky beside it.
//!
//! Invariant: a view is a function of the model's voxels, the view that it began with, and the picture's sides.

use super::vector::along;
use trex_render::{Camera, Ray, VoxelScene};

/// Share of the rays of a view that are to meet voxels: above the four fifths of the picture that the mesh is to cover,
/// as voxels close gaps that the mesh has.
const FILLED: f64 = 0.9;
/// Rays across and down a picture, and how many of those that meet the model are aims.
const RAYS: u32 = 20;
const AIMS: usize = 36;
/// Steps on the way to the surface.
const STEPS: u32 = 24;

/// Rays of `camera`, row by row.
fn rays(camera: &Camera, resolution: [u32; 2]) -> Option<impl Iterator<Item = Ray>> {
    let projection = camera.project(resolution).ok()?;
    let [width, height] = resolution.map(f64::from);
    let at = move |index: u32| (f64::from(index) + 0.5) / f64::from(RAYS);
    Some((0..RAYS * RAYS).map(move |i| projection.ray(at(i % RAYS) * width, at(i / RAYS) * height)))
}

/// The share of the view that is not empty.
fn coverage(camera: &Camera, voxels: &VoxelScene<'_>, resolution: [u32; 2]) -> f64 {
    let Some(rays) = rays(camera, resolution) else { return 0.0 };
    rays.filter(|ray| voxels.intersect(ray).is_some()).count() as f64 / f64::from(RAYS * RAYS)
}

/// True for a view that is filled.
pub(super) fn is_filled(camera: &Camera, voxels: &VoxelScene<'_>, resolution: [u32; 2]) -> bool {
    coverage(camera, voxels, resolution) >= FILLED
}

/// `camera`, as near as it has to come for the model to fill its picture, on the way to a surface that it sees; the
/// fullest of those that were tried where none is full.
pub(super) fn filled(camera: &Camera, voxels: &VoxelScene<'_>, resolution: [u32; 2]) -> Camera {
    let mut best = (coverage(camera, voxels, resolution), *camera);
    let met = |ray: Ray| Some((voxels.intersect(&ray)?.t, ray.direction));
    let aims: Vec<(f64, [f64; 3])> = rays(camera, resolution).into_iter().flatten().filter_map(met).collect();
    let every = aims.len().div_ceil(AIMS).max(1);
    for step in 1..STEPS {
        if best.0 >= FILLED {
            break;
        }
        for &(distance, direction) in aims.iter().step_by(every) {
            let position = along(camera.position, distance * f64::from(step) / f64::from(STEPS), direction);
            let target = along(camera.position, distance, direction);
            let nearer = Camera { position, target, ..*camera };
            let share = coverage(&nearer, voxels, resolution);
            if share > best.0 {
                best = (share, nearer);
            }
        }
    }
    best.1
}
