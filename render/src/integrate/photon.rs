//! `photon`: what is seen, lit by the lights, and by what photons brought to the voxels around. Paper, section 5.
//! Gather rays fetch it (`gather.rs`); perfect mirrors carry the view on, as in `direct`. What points and suns bring
//! over mirrors is read off the facets themselves, where it is asked for.

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{Path, Stage};
use crate::sampler::Decision;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;

/// Photon mapping on voxels: see the top of the file.
#[derive(Debug)]
pub(super) struct PhotonMapping;

impl Integrator for PhotonMapping {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        let stage = ctx.seen(path, ray, hit);
        if let Stage::Shadow { surface, .. } | Stage::Gather { surface, .. } = &stage
            && let Some(scene) = ctx.g_scene()
        {
            let [u, v, ..] = path.sampler.draw(Decision::Caustics(path.vertex));
            let caustics = scene.caustics(surface, ctx.material(surface), [u, v]);
            path.gain(caustics.unwrap_or_default());
        }
        stage
    }

    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        ctx.mirror_bounce(path, surface)
    }
}
