//! Gather rays: their directions, for `photon` and `full-gi`; and what those of `photon` bring back from the voxels.
//!
//! ```text
//! surface -> gather ray -> leaf: irradiance * (Kd + Ks * albedo of its lobe) / pi   (emitters left out, as shadow
//!                                                                                    rays bring them)
//!                       -> mirror: on, and from then on lamps count (`mirrors.rs`)
//!                       -> nothing: the sky                                         (left out by the shadow rays)
//! ```
//!
//! Invariant: a gather ray asks the mesh at most for its beginning at the surface and at mirrors that it met so
//! (`near = exact`), and units for the voxels that it meets, so it can be blocked by few pages.

use super::context::RenderContext;
use super::g_scene::{GScene, NearMesh};
use super::gather_leg::GatherYield;
use super::mirrors::Mirrors;
use super::path_state::{GatherRay, Path, Stage};
use crate::sampler::Decision;
use crate::shading::surface::{HitPoint, SurfaceInteraction};
use crate::trace::{Answer, Ray, Tracer};
use glam::{DVec3, Vec3};

/// The direction of a gather ray, and what a radiance from there counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct GatherQuery {
    pub(super) direction: DVec3,
    pub(super) weight: Vec3,
}

impl RenderContext<'_> {
    /// One gather ray, on its way through the mesh.
    pub(super) fn gather_step(&self, path: &Path, surface: &SurfaceInteraction, index: u32) -> Stage {
        let Some(GatherQuery { direction, weight }) = self.gather_query(path, surface, index) else {
            return self.after_gather_ray(*surface, index + 1);
        };
        let (surface, ray) = (*surface, surface.ray_to(direction, f64::INFINITY, None));
        Stage::GatherRay(GatherRay { surface, index, ray, weight, mirrors: Mirrors::NONE })
    }

    /// Gather ray `index` of a surface; `None` where it could bring nothing.
    pub(super) fn gather_query(
        &self,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
    ) -> Option<GatherQuery> {
        let count = self.n_gather();
        let u = path.sampler.draw(Decision::Gather { vertex: path.vertex, index, count });
        let sample = surface.bsdf(&self.world.materials).sample_rough([u[0], u[1], u[2]])?;
        let weight = 1.0 / count as f32 * sample.weight;
        (weight.max_element() > 0.0).then_some(GatherQuery { direction: sample.wi, weight })
    }

    /// The part of a gather ray that the mesh answers, with `near = exact`, over mirrors there: what it has brought,
    /// the mirrors behind it, and the ray on through the voxels, unless it has ended.
    pub(super) fn gathered_near<T: Tracer>(
        &self,
        voxels: &GScene<'_>,
        (surface, mut near_mesh): (&SurfaceInteraction, Option<NearMesh>),
        mut direction: DVec3,
        tracer: &mut T,
    ) -> Answer<(GatherYield, Mirrors, Option<Ray>)> {
        let mut mirrors = voxels.no_mirrors();
        let (world, mut surface) = (self.world, *surface);
        let mut gathered = GatherYield::NOTHING;
        while let Some(near) = near_mesh {
            let length = near.length(direction);
            let ray = surface.ray_to(direction, length, None);
            let Answer::Exact(hit) = tracer.intersect_shaded(&ray) else { return Answer::Blocked };
            let hit = hit.map(|hit| HitPoint::from(&hit));
            let lamp = mirrors.lamp(&world.lights, &ray, hit.map_or(length, |hit| hit.t));
            if let Some(radiance) = lamp {
                gathered.add(mirrors.throughput * radiance);
                return Answer::Exact((gathered, mirrors, None));
            }
            let Some(hit) = hit else { break };
            let met = SurfaceInteraction::new(&ray, &hit);
            let material = self.material(&met);
            let is_front = hit.normal.as_dvec3().dot(direction) < 0.0;
            let brought = voxels.leaving_surface(&met, material).unwrap_or(Vec3::ZERO);
            gathered.add(mirrors.throughput * (brought + mirrors.emitted(material, is_front)));
            if !mirrors.follow(&ray, material) {
                return Answer::Exact((gathered, mirrors, None));
            }
            direction = met.mirrored();
            surface = met;
            near_mesh = voxels.near_mesh(&surface);
        }
        let near = near_mesh.map(|near| near.length(direction));
        let rest = voxels.leave(&surface, direction, near, (f64::INFINITY, None));
        Answer::Exact((gathered, mirrors, rest))
    }
}
