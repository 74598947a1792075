//! Integrators: how light is computed, one module each behind one trait.
//!
//! ```text
//! primary ray -> hit --direct--> n_shadow shadow rays -> mirror? -> mirror ray -> hit -> ...
//!             |      --path----> n_shadow shadow rays -> a bounce by chance    -> hit -> ...
//!             |      --photon--> n_shadow shadow rays -> n_gather gather rays -> mirror? -> ...   (`full-gi` alike)
//!             |      --ao------> n_shadow rays by the cosine
//!             -> miss: sky
//! ```

mod ao;
mod c_ray;
mod context;
mod debug;
mod direct;
mod final_gather;
mod g_batch;
mod g_rays;
mod g_scene;
mod gather;
mod gather_leg;
mod lod;
mod mesh_rays;
mod mirrors;
mod path;
mod path_state;
mod photon;
mod roulette;
mod sample_integrator;
mod together;

pub(crate) use context::RenderContext;
pub(crate) use g_batch::{GBatches, RAYS_ASKED_MAX, RayNeeds, rays_asked};
pub(crate) use path_state::{Path, Sample};
pub(crate) use sample_integrator::{SampleIntegrator, Step};
pub(crate) use together::Together;

use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::Ray;
use c_ray::CRayHit;
use path_state::{ShadowQuery, Stage};

/// The form of the model that answers the rays from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CRays {
    /// The mesh, and behind the cut of the footprint rule the voxels.
    Mesh,
    /// The upper octree, drawn as it is.
    Upper,
    /// The finest voxels, drawn as they are.
    Finest,
}

/// One way to compute light: what follows where a ray has ended. It asks no ray itself.
trait Integrator: Sync + std::fmt::Debug {
    /// The form of the model that answers the rays from the camera.
    fn c_rays(&self) -> CRays {
        CRays::Mesh
    }

    /// The stage after the end of a C-ray.
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage;

    /// The question of shadow ray `index` of a surface; `None` where it could bring nothing.
    fn shadow_query(
        &self,
        ctx: &RenderContext<'_>,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
    ) -> Option<ShadowQuery> {
        ctx.light_query(path, surface, index, |_, _, _| 1.0)
    }

    /// The kind that shadow rays are counted as.
    fn shadow_kind(&self) -> RayKind {
        RayKind::Shadow
    }

    /// The stage at a surface when its shadow and gather rays are answered.
    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage;
}

#[cfg(test)]
mod tests;
