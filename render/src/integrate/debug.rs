//! `debug-upper`, `debug-lower`, `debug-occluders`, `debug-pages`: what the other integrators work with, drawn.
//! Paper, Fig. 4.
//!
//! ```text
//! debug-upper      the leaves of the octree as cubes     shade by the face that is seen
//! debug-lower      the finest leaves, of its units
//! debug-occluders  the subvoxels of their bitmaps
//! debug-pages      the mesh, a colour per page           shade by the cosine to the viewer
//! ```

use super::c_ray::{CRayHit, Form};
use super::context::RenderContext;
use super::path_state::{Path, Stage};
use super::{CRays, Integrator};
use crate::sampler::mix;
use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::{Answer, Ray, Tracer};
use glam::{DVec3, Vec3};

/// Share of light on faces across x, y and z.
const FACE_SHADE: [f32; 3] = [0.6, 1.0, 0.8];
/// Radiance behind the model.
const BACKGROUND: Vec3 = Vec3::splat(0.05);

/// The voxels as they are: C-rays are asked of them.
#[derive(Debug)]
pub(super) struct DebugVoxels(pub(super) CRays);

/// The pages of the mesh.
#[derive(Debug)]
pub(super) struct DebugPages;

impl Integrator for DebugVoxels {
    fn c_rays(&self) -> CRays {
        self.0
    }

    /// Ends the path: only rays through the centres of pixels, for layers, meet the mesh.
    fn c_ray_end(&self, _: &RenderContext<'_>, _: &mut Path, _: &Ray, _: Option<CRayHit>) -> Stage {
        Stage::Done
    }

    fn bounce(&self, _: &RenderContext<'_>, _: &mut Path, _: &SurfaceInteraction) -> Stage {
        Stage::Done
    }
}

impl Integrator for DebugPages {
    fn c_ray_end(&self, _: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        path.gain(hit.map_or(BACKGROUND, |hit| {
            let page = match hit.form {
                Form::Mesh { page, .. } => page,
                Form::Voxel => u32::MAX,
            };
            let hash = mix(u64::from(page));
            let colour = [0, 16, 32].map(|shift| 0.25 + 0.75 * (hash >> shift & 0xffff) as f32 / 65535.0);
            let cos = hit.point.normal.as_dvec3().dot(DVec3::from(ray.direction)).abs() as f32;
            (0.3 + 0.7 * cos) * Vec3::from(colour)
        }));
        Stage::Done
    }

    fn bounce(&self, _: &RenderContext<'_>, _: &mut Path, _: &SurfaceInteraction) -> Stage {
        Stage::Done
    }
}

impl RenderContext<'_> {
    /// A ray from the camera through the upper octree.
    pub(super) fn upper_shown(&self, path: &mut Path, ray: &Ray) -> Stage {
        let voxels = self.voxels.expect("the debug integrators have voxels").voxels;
        path.sample.rays.count(RayKind::Gather);
        path.gain(match voxels.intersect(ray) {
            None => BACKGROUND,
            Some(hit) => self.face_shown(voxels.octree().material(hit.leaf as usize), hit.axis),
        });
        Stage::Done
    }

    /// A ray from the camera through units, where there are any.
    pub(super) fn finest_shown<T: Tracer>(
        &self,
        path: &mut Path,
        ray: &Ray,
        tracer: &mut T,
    ) -> Answer<Stage> {
        let Some(lower) = self.voxels.and_then(|voxels| voxels.lower) else {
            return Answer::Exact(self.upper_shown(path, ray));
        };
        let pages = &mut tracer.lend_pages();
        let Answer::Exact(found) = lower.intersect(ray, pages) else { return Answer::Blocked };
        path.sample.rays.count(RayKind::Gather);
        path.gain(match found {
            None => BACKGROUND,
            Some(hit) => self.face_shown(lower.material(&hit, pages), hit.upper.axis),
        });
        Answer::Exact(Stage::Done)
    }

    fn face_shown(&self, material: u16, axis: usize) -> Vec3 {
        let material = &self.world.materials[usize::from(material)];
        FACE_SHADE[axis] * (Vec3::from(material.kd) + Vec3::from(material.ks))
    }
}
