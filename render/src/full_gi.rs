//! `full-gi`: photon mapping on the exact mesh, without voxels: what `photon` is measured by. Shadow rays, mirrors and gather
//! rays meet the mesh; where a gather ray ends, the photons next to that place say what leaves it. H. W. Jensen, "Realistic
//! image synthesis using photon mapping" (2001), with final gathering.
//!
//! ```text
//! surface -> gather ray -> surface: photons next to it (emitters left out: shadow rays bring their light)
//!                       -> mirror: on, and from then on lamps count, which no shadow ray finds there
//!                       -> nothing: the sky                                  (left out by the shadow rays)
//! ```
//!
//! Left out is what points and suns bring to a place that is seen, over a mirror: no gather ray meets them.
//!
//! Invariants: 1. a retry asks one ray; 2. a gather ray follows [`MIRRORS_MAX`] mirrors at most, and what lies behind is dark.

use crate::integrator::{Integrator, Path, Stage};
use crate::math::{dot, max_rgb, mul_rgb, reflect, to_f64};
use crate::surface::Surface;
use crate::trace::{Answer, Ray, Tracer};
use crate::voxel::MIRRORS_MAX;

/// A gather ray on its way through the mesh: `index` of those that leave `surface`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GatherRay {
    pub(crate) surface: Surface,
    pub(crate) index: u32,
    pub(crate) ray: Ray,
    /// What a radiance at its end counts.
    pub(crate) weight: [f32; 3],
    /// Mirrors up to now.
    pub(crate) mirrors: u32,
}

impl Integrator<'_> {
    /// One ray of a gather ray's way.
    pub(crate) fn gather_ray_step<T: Tracer>(
        &self,
        path: &mut Path,
        gather: &GatherRay,
        tracer: &mut T,
    ) -> Answer<Stage> {
        let GatherRay { surface, index, ray, weight, mirrors } = *gather;
        let Answer::Exact(hit) = tracer.intersect(&ray) else { return Answer::Blocked };
        path.sample.rays.gather += 1;
        let done = Answer::Exact(self.after_gather_ray(surface, index + 1));
        let lights = &self.world.lights;
        let lamp = if mirrors > 0 { lights.seen(&ray, hit.map_or(f64::INFINITY, |hit| hit.t)) } else { None };
        let Some(hit) = hit.filter(|_| lamp.is_none()) else {
            path.gain_indirect(mul_rgb(weight, lamp.unwrap_or(lights.sky())));
            return done;
        };
        let material = &self.world.materials[hit.material as usize];
        if mirrors > 0 && dot(to_f64(hit.normal), ray.direction) < 0.0 {
            path.gain_indirect(mul_rgb(weight, material.ke));
        }
        let met = Surface::new(&ray, &hit);
        if let Some(photons) = self.photons {
            path.sample.look_ups += 1;
            path.gain_indirect(mul_rgb(weight, photons.radiance(&met, material, self.world.k_nearest)));
        }
        let weight = mul_rgb(weight, material.ks);
        if !material.mirror || mirrors == MIRRORS_MAX || max_rgb(weight) == 0.0 {
            return done;
        }
        let ray = met.ray_to(reflect(ray.direction, met.normal), f64::INFINITY, None);
        Answer::Exact(Stage::GatherRay(GatherRay { ray, weight, mirrors: mirrors + 1, ..*gather }))
    }
}
