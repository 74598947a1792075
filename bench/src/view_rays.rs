//! Rays of one picture of a whole model, for benches and for counts: from the camera, and from what these meet to a
//! sun.

use trex_render::{Answer, Camera, Ray, Tracer};
use trex_store::PageFile;

/// Where the sun is: of unit length, along no axis.
pub const SUN: [f64; 3] = [0.36, 0.8, 0.48];
/// How far off their surface shadow rays begin, diagonals of the model.
const OFF: f64 = 1e-6;

/// A ray through each pixel of a square picture of the whole model, along rows.
///
/// # Panics
/// For a picture without pixels.
pub fn camera_rays(file: &PageFile, side_pixels: u32) -> Vec<Ray> {
    let size = [side_pixels; 2];
    let camera = Camera::framing(&file.superblock().bounds, size, None, None);
    let projection = camera.project(size).expect("a picture");
    let pixels = (0..side_pixels).flat_map(|y| (0..side_pixels).map(move |x| [x, y]));
    pixels.map(|[x, y]| projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)).collect()
}

/// Rays towards [`SUN`] from the surfaces that `rays` meet, just off them on the side that is seen.
pub fn shadow_rays(file: &PageFile, mesh: &mut impl Tracer, rays: &[Ray]) -> Vec<Ray> {
    let off = OFF * file.superblock().bounds.diagonal();
    let shadow = |ray: &Ray| {
        let Answer::Exact(Some(hit)) = mesh.intersect(ray) else { return None };
        let towards = (0..3).map(|a| f64::from(hit.normal[a]) * ray.direction[a]).sum::<f64>();
        let at = |a: usize| {
            ray.origin[a] + hit.t * ray.direction[a] - off * towards.signum() * f64::from(hit.normal[a])
        };
        Some(Ray { origin: [at(0), at(1), at(2)], direction: SUN, t_max: f64::INFINITY })
    };
    rays.iter().filter_map(shadow).collect()
}
