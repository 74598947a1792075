//! `photon`: what is seen, lit by the lights, and by what photons brought to the voxels around. Paper, section 5.
//! Gather rays fetch it (`gather.rs`); perfect mirrors carry the view on, as in `direct`.

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{Path, Stage};
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;

/// Photon mapping on voxels: see the top of the file.
#[derive(Debug)]
pub(super) struct PhotonMapping;

impl Integrator for PhotonMapping {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        ctx.seen(path, ray, hit)
    }

    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        ctx.mirror_bounce(path, surface)
    }
}
