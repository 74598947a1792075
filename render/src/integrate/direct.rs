//! `direct`: what is seen, lit by the lights; perfect mirrors carry the view on.

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{Path, Stage};
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;

/// Direct light: see the top of the file.
#[derive(Debug)]
pub(super) struct Direct;

impl Integrator for Direct {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        ctx.seen(path, ray, hit)
    }

    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        ctx.mirror_bounce(path, surface)
    }
}
