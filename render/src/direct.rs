//! `direct`: what is seen, lit by the lights; perfect mirrors carry the view on. All of their reflectance goes with
//! the mirror ray, so that without roulette a picture of mirrors has no noise.

use crate::integrator::{Integrator, Origin, Path, Stage};
use crate::math::{mul_rgb, reflect, scale};
use crate::surface::Surface;

impl Integrator<'_> {
    /// The mirror ray, if the surface is a mirror.
    pub(crate) fn mirror_bounce(&self, path: &mut Path, surface: &Surface) -> Stage {
        let material = &self.world.materials[surface.material as usize];
        if !material.mirror {
            return Stage::Done;
        }
        path.throughput = mul_rgb(path.throughput, material.ks);
        if !path.survives() {
            return Stage::Done;
        }
        path.vertex += 1;
        path.origin = Origin::Mirror;
        let direction = reflect(scale(-1.0, surface.to_viewer), surface.normal);
        Stage::CRay(surface.ray_to(direction, f64::INFINITY, None))
    }
}
