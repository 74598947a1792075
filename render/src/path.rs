//! `path`: all light, unbiased, on the exact mesh: the picture that others are measured by. J. Kajiya, "The rendering
//! equation" (1986).
//!
//! At each surface light is looked for in two ways, by light samples and by the bounce, which may meet a light by
//! itself. Either way counts with its share of the *power heuristic* (E. Veach and L. Guibas, "Optimally combining
//! sampling techniques for Monte Carlo rendering" (1995)), so that together each light counts once:
//!
//! ```text
//! share of the bounce = p_bounce^2 / (p_bounce^2 + (n_shadow * p_light)^2)
//! ```
//!
//! Invariants: 1. the shares of the two ways add up to 1 for every light that both can find, and points and suns,
//! which no bounce meets, are left to light samples; 2. rectangles shade nothing: a bounce counts all that it crosses.

use crate::integrator::{Integrator, Origin, Path, Stage};
use crate::light::LightSample;
use crate::material::{scatter, scatter_density};
use crate::math::{along, dot, mul_rgb, scale_rgb, to_f64};
use crate::sampler::Decision;
use crate::surface::Surface;
use crate::trace::{Hit, Ray};
use trex_store::Material;

/// The share of a light sample that a bounce could have been: one of `count`.
pub(crate) fn light_share(material: &Material, surface: &Surface, sample: &LightSample, count: u32) -> f32 {
    let bounce = scatter_density(material, surface.normal, surface.to_viewer, sample.direction);
    share(f64::from(count) * sample.density, bounce)
}

/// The power heuristic. An infinite density is one that no other way has.
fn share(own: f64, other: f64) -> f32 {
    let ratio = other / own;
    (1.0 / (1.0 + ratio * ratio)) as f32
}

impl Integrator<'_> {
    /// A bounce in a direction by chance.
    pub(crate) fn chance_bounce(&self, path: &mut Path, surface: &Surface) -> Stage {
        let material = &self.world.materials[surface.material as usize];
        let u = path.sampler.draw(Decision::Gather { vertex: path.vertex, index: 0, count: 1 });
        let Some(scatter) = scatter(material, surface.normal, surface.to_viewer, u) else {
            return Stage::Done;
        };
        path.throughput = mul_rgb(path.throughput, scatter.weight);
        if !path.survives() {
            return Stage::Done;
        }
        path.vertex += 1;
        path.origin = match scatter.density {
            None => Origin::Mirror,
            Some(density) => Origin::Scattered { from: *surface, density },
        };
        Stage::CRay(surface.ray_to(scatter.direction, f64::INFINITY, None))
    }

    /// The end of a bounce that light samples at `from` could have been.
    pub(crate) fn gathered(
        &self,
        path: &mut Path,
        ray: &Ray,
        hit: Option<Hit>,
        from: &Surface,
        density: f64,
    ) -> Stage {
        let lights = &self.world.lights;
        let from = &from.receiver(&self.world.materials);
        let count = f64::from(self.world.n_shadow);
        let mut gain = |radiance, light: f64| path.gain(scale_rgb(share(density, count * light), radiance));
        for (radiance, light) in lights.crossed(from, ray, hit.map_or(f64::INFINITY, |hit| hit.t)) {
            gain(radiance, light);
        }
        let Some(hit) = hit else {
            gain(lights.sky(), lights.sky_density(from, ray.direction));
            return Stage::Done;
        };
        let material = &self.world.materials[hit.material as usize];
        let cos = -dot(to_f64(hit.normal), ray.direction);
        if material.emits() && cos > 0.0 {
            let point = along(ray.origin, hit.t, ray.direction);
            gain(material.ke, lights.emitter_density(from, point, cos, material.ke));
        }
        self.lit(Surface::new(ray, &hit))
    }
}
