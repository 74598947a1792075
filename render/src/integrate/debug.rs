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
use super::g_batch::GBatch;
use super::g_scene::GScene;
use super::path_state::{Path, Stage};
use super::{CRays, Integrator};
use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::{Answer, Ray};
use crate::voxel::{GAnswer, GKind};
use glam::{DVec3, Vec3};
use trex_film::mix;

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
            let cos = hit.point.shading_normal.as_dvec3().dot(DVec3::from(ray.direction)).abs() as f32;
            (0.3 + 0.7 * cos) * Vec3::from(colour)
        }));
        Stage::Done
    }

    fn bounce(&self, _: &RenderContext<'_>, _: &mut Path, _: &SurfaceInteraction) -> Stage {
        Stage::Done
    }
}

impl RenderContext<'_> {
    /// Asks what a ray from the camera meets in the upper octree, or in the finest voxels.
    pub(super) fn ask_shown(&self, ray: &Ray, c_rays: CRays, batch: &mut GBatch) -> Stage {
        let kind = if c_rays == CRays::Upper { GKind::Far } else { GKind::Gather };
        let (asked, _) = self.shown_scene().g_ray(ray, kind, 0.0);
        Stage::TakeShown { ray: *ray, place: batch.push(asked) }
    }

    /// Shows what a ray from the camera has met.
    pub(super) fn take_shown(&self, path: &mut Path, answer: &GAnswer) -> Answer<Stage> {
        if answer.is_blocked() {
            return Answer::Blocked;
        }
        path.sample.rays.count(RayKind::Gather);
        path.sample.meets_model = answer.outcome == GAnswer::MET;
        path.gain(match answer.outcome {
            GAnswer::MET => {
                let (material, colour) = self.world.voxel_material(answer.material);
                let albedo = colour * Vec3::from(material.kd) + Vec3::from(material.ks);
                FACE_SHADE[answer.axis as usize] * albedo
            }
            _ => BACKGROUND,
        });
        Answer::Exact(Stage::Done)
    }

    fn shown_scene(&self) -> &GScene<'_> {
        self.voxels.as_ref().expect("the debug integrators have voxels")
    }
}
