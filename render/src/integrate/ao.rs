//! `ao`: ambient occlusion. White light from all sides on white surfaces; what stands nearer than the radius
//! (half of the model's diagonal, see [`crate::World::ao_radius`]) takes it away.
//!
//! ```text
//! primary ray -> hit -> n_shadow rays by the cosine, none longer than the radius: the share that meets nothing
//!             -> miss: 1
//! ```
//!
//! Where the file has voxels these rays are G-rays, else they go through the mesh. Materials and lights play no part.
//! S. Zhukov, A. Iones, G. Kronin, "An ambient light illumination model" (1998).

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{Path, ShadowQuery, Stage};
use crate::sampler::Decision;
use crate::sampling::cosine_direction;
use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::Ray;
use glam::Vec3;

/// Ambient occlusion: see the top of the file.
#[derive(Debug)]
pub(super) struct AmbientOcclusion;

impl Integrator for AmbientOcclusion {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        match hit {
            Some(hit) if ctx.n_shadow() > 0 => {
                Stage::Shadow { surface: SurfaceInteraction::new(ray, &hit.point), index: 0 }
            }
            Some(_) => Stage::Done,
            None => {
                path.gain(Vec3::ONE);
                Stage::Done
            }
        }
    }

    /// One ray of those that look around.
    fn shadow_query(
        &self,
        ctx: &RenderContext<'_>,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
    ) -> Option<ShadowQuery> {
        let count = ctx.n_shadow();
        let u = path.sampler.draw(Decision::Gather { vertex: 0, index, count });
        let direction = cosine_direction(surface.shading_normal, [u[0], u[1]]);
        // Below the plane of the triangle there is no sky.
        if direction.dot(surface.normal) <= 0.0 && surface.shading_normal != surface.normal {
            return None;
        }
        let light = Vec3::splat(1.0 / count as f32);
        Some(ShadowQuery { direction, distance: ctx.world.ao_radius, front: None, light })
    }

    fn shadow_kind(&self) -> RayKind {
        RayKind::Gather
    }

    fn bounce(&self, _: &RenderContext<'_>, _: &mut Path, _: &SurfaceInteraction) -> Stage {
        Stage::Done
    }
}
