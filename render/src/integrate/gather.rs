//! Gather rays: their directions, for `photon` and `full-gi`; and what those of `photon` bring back from the voxels.
//!
//! ```text
//! surface -> gather ray -> leaf: irradiance * (Kd + Ks * albedo of its lobe) / pi   (emitters left out, as shadow
//!                                                                                    rays bring them)
//!                       -> nothing: the sky                                         (left out by the shadow rays)
//! ```
//!
//! Invariant: a gather ray asks the mesh for its beginning at most (`near = exact`), and units for the voxels that it
//! meets, so it can be blocked by few pages.

use super::context::RenderContext;
use super::g_scene::{GScene, Gathered};
use super::path_state::{GatherRay, Path, Stage};
use crate::sampler::Decision;
use crate::shading::surface::{HitPoint, SurfaceInteraction};
use crate::trace::{Answer, Tracer};
use glam::{DVec3, Vec3};

/// The direction of a gather ray, and what a radiance from there counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct GatherQuery {
    pub(super) direction: DVec3,
    pub(super) weight: Vec3,
}

impl RenderContext<'_> {
    /// One gather ray: through the voxels, or on its way through the mesh.
    pub(super) fn gather_step<T: Tracer>(
        &self,
        path: &mut Path,
        surface: &SurfaceInteraction,
        index: u32,
        tracer: &mut T,
    ) -> Answer<Stage> {
        if let Some(GatherQuery { direction, weight }) = self.gather_query(path, surface, index) {
            let Some(voxels) = self.g_scene() else {
                let (surface, ray) = (*surface, surface.ray_to(direction, f64::INFINITY, None));
                let gather = GatherRay { surface, index, ray, weight, mirrors: 0 };
                return Answer::Exact(Stage::GatherRay(gather));
            };
            let Answer::Exact(found) = self.gathered_along(voxels, surface, direction, tracer) else {
                return Answer::Blocked;
            };
            path.sample.rays.gather += found.rays;
            path.gain_indirect(weight * found.radiance);
        }
        Answer::Exact(self.after_gather_ray(*surface, index + 1))
    }

    /// Gather ray `index` of a surface; `None` where it could bring nothing.
    pub(super) fn gather_query(
        &self,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
    ) -> Option<GatherQuery> {
        let count = self.world.settings.n_gather;
        let u = path.sampler.draw(Decision::Gather { vertex: path.vertex, index, count });
        let sample = surface.bsdf(&self.world.materials).sample_rough([u[0], u[1], u[2]])?;
        let weight = 1.0 / count as f32 * sample.weight;
        (weight.max_element() > 0.0).then_some(GatherQuery { direction: sample.wi, weight })
    }

    /// Radiance that arrives at a surface from unit `direction`.
    fn gathered_along<T: Tracer>(
        &self,
        voxels: &GScene<'_>,
        surface: &SurfaceInteraction,
        direction: DVec3,
        tracer: &mut T,
    ) -> Answer<Gathered> {
        let world = self.world;
        if let Some(near) = voxels.near_length(surface, direction) {
            let ray = surface.ray_to(direction, near, None);
            match tracer.intersect(&ray) {
                Answer::Blocked => return Answer::Blocked,
                Answer::Exact(None) => {}
                Answer::Exact(Some(hit)) => {
                    let met = SurfaceInteraction::new(&ray, &HitPoint::from(&hit));
                    let radiance = voxels.leaving_surface(&met, self.material(&met)).unwrap_or(Vec3::ZERO);
                    return Answer::Exact(Gathered { radiance, rays: 1 });
                }
            }
        }
        match voxels.leave(surface, direction, f64::INFINITY, None) {
            Some(ray) => voxels.gather_finest(ray, &world.materials, world.lights.sky(), tracer),
            None => Answer::Exact(Gathered { radiance: Vec3::ZERO, rays: 0 }),
        }
    }
}
