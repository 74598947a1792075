//! `full-gi`: photon mapping on the exact mesh, without voxels: what `photon` is measured by. Shadow rays, mirrors
//! and gather rays meet the mesh; where a gather ray ends, the photons next to that place say what leaves it. H. W.
//! Jensen, "Realistic image synthesis using photon mapping" (2001), with final gathering.
//!
//! ```text
//! surface -> gather ray -> surface: photons next to it (emitters left out: shadow rays bring their light)
//!                       -> mirror: on, and from then on lamps count, which no shadow ray finds there
//!                       -> nothing: the sky                                  (left out by the shadow rays)
//! ```
//!
//! Left out is what points and suns bring to a place that is seen, over a mirror: no gather ray meets them.
//!
//! Invariant: a retry asks one ray.

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{GatherRay, Path, Stage};
use crate::shading::surface::{HitPoint, SurfaceInteraction};
use crate::stats::RayKind;
use crate::trace::{Answer, Ray, Tracer};
use glam::DVec3;

/// Photon mapping on the exact mesh: see the top of the file.
#[derive(Debug)]
pub(super) struct FullGi;

impl Integrator for FullGi {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        ctx.seen(path, ray, hit)
    }

    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        ctx.mirror_bounce(path, surface)
    }
}

impl RenderContext<'_> {
    /// One ray of a gather ray's way.
    pub(super) fn gather_ray_step<T: Tracer>(
        &self,
        path: &mut Path,
        gather: &GatherRay,
        tracer: &mut T,
    ) -> Answer<Stage> {
        let GatherRay { surface, index, ray, weight, mut mirrors } = *gather;
        let arriving = weight * mirrors.throughput;
        let Answer::Exact(hit) = tracer.intersect_shaded(&ray) else { return Answer::Blocked };
        let hit = hit.map(|shaded| HitPoint::from(&shaded));
        path.sample.rays.count(RayKind::Gather);
        let done = Answer::Exact(self.after_gather_ray(surface, index + 1));
        let lights = &self.world.lights;
        let lamp = mirrors.lamp(lights, &ray, hit.map_or(f64::INFINITY, |hit| hit.t));
        let Some(hit) = hit.filter(|_| lamp.is_none()) else {
            path.gain_indirect(arriving * lamp.unwrap_or(lights.sky()));
            return done;
        };
        let (material, direction) =
            (&self.world.materials[hit.material as usize], DVec3::from(ray.direction));
        let is_front = hit.normal.as_dvec3().dot(direction) < 0.0;
        path.gain_indirect(arriving * mirrors.emitted(material, is_front));
        let met = SurfaceInteraction::new(&ray, &hit).unseen(&self.world.materials);
        if let Some(photons) = self.photon_tree {
            path.sample.look_ups += 1;
            let k_nearest = self.world.settings.k_nearest;
            path.gain_indirect(arriving * photons.radiance(&met, &self.world.materials, k_nearest));
        }
        if !mirrors.follow(&ray, material) {
            return done;
        }
        let ray = met.ray_to(met.mirrored(), f64::INFINITY, None);
        Answer::Exact(Stage::GatherRay(GatherRay { ray, mirrors, ..*gather }))
    }
}
