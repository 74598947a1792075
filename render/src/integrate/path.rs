//! `path`: all light, unbiased, on the exact mesh: the picture that others are measured by. J. Kajiya, "The rendering
//! equation" (1986).
//!
//! At each surface light is looked for in two ways, by light samples and by the bounce, which may meet a light by
//! itself. Either way counts with its weight by the *power heuristic* (E. Veach and L. Guibas, "Optimally combining
//! sampling techniques for Monte Carlo rendering" (1995)), so that together each light counts once:
//!
//! ```text
//! mis_weight of the bounce = pdf_bounce^2 / (pdf_bounce^2 + (n_shadow * pdf_light)^2)
//! ```
//!
//! Normals of vertices shade what is seen, itself or in a mirror; a scattered ray meets planes, as photons do, since by
//! smooth normals light would lose a part at every bounce. What it meets in a mirror is shaded by normals again.
//!
//! Invariants: 1. the weights of the two ways add up to 1 for every light that both can find, and points and suns,
//! which no bounce meets, are left to light samples; 2. rectangles shade nothing: a bounce counts all that it crosses.

use super::Integrator;
use super::c_ray::CRayHit;
use super::context::RenderContext;
use super::path_state::{Origin, Path, ShadowQuery, Stage};
use crate::sampler::Decision;
use crate::shading::bsdf::Bsdf;
use crate::shading::light::LightSample;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;
use glam::{DVec3, Vec3};

/// Path tracing: see the top of the file.
#[derive(Debug)]
pub(super) struct PathTracing;

impl Integrator for PathTracing {
    fn c_ray_end(&self, ctx: &RenderContext<'_>, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        match path.origin {
            Origin::Scattered { from, pdf } => bounce_end(ctx, path, (ray, hit), (&from, pdf)),
            Origin::Camera | Origin::Mirror => ctx.seen(path, ray, hit),
        }
    }

    fn shadow_query(
        &self,
        ctx: &RenderContext<'_>,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
    ) -> Option<ShadowQuery> {
        ctx.light_query(path, surface, index, light_mis_weight)
    }

    /// A bounce in a direction by chance.
    fn bounce(&self, ctx: &RenderContext<'_>, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        let u = path.sampler.draw(Decision::Gather { vertex: path.vertex, index: 0, count: 1 });
        let Some(sample) = surface.bsdf(&ctx.world.materials).sample(u) else { return Stage::Done };
        path.throughput *= sample.weight;
        if !path.survives(sample.pdf.is_none()) {
            return Stage::Done;
        }
        path.vertex += 1;
        path.origin = match sample.pdf {
            None => Origin::Mirror,
            Some(pdf) => Origin::Scattered { from: *surface, pdf },
        };
        Stage::CRay(surface.ray_to(sample.wi, f64::INFINITY, None))
    }
}

/// The weight of a light sample, one of `count`, that a bounce could have been.
fn light_mis_weight(bsdf: &Bsdf<'_>, sample: &LightSample, count: u32) -> f32 {
    mis_weight(f64::from(count) * sample.pdf, bsdf.pdf(sample.wi))
}

/// The power heuristic. An infinite density is one that no other way has.
fn mis_weight(own: f64, other: f64) -> f32 {
    let ratio = other / own;
    (1.0 / (1.0 + ratio * ratio)) as f32
}

/// The end of a bounce that light samples at `from` could have been.
fn bounce_end(
    ctx: &RenderContext<'_>,
    path: &mut Path,
    (ray, hit): (&Ray, Option<CRayHit>),
    (from, pdf): (&SurfaceInteraction, f64),
) -> Stage {
    let lights = &ctx.world.lights;
    let from = &from.shading_point(&ctx.world.materials);
    let count = f64::from(ctx.n_shadow());
    let mut gain = |radiance: Vec3, light: f64| path.gain(mis_weight(pdf, count * light) * radiance);
    for (radiance, light) in lights.crossed(from, ray, hit.map_or(f64::INFINITY, |hit| hit.point.t)) {
        gain(radiance, light);
    }
    let Some(CRayHit { point: hit, .. }) = hit else {
        gain(lights.sky(), lights.sky_pdf(from, DVec3::from(ray.direction)));
        return Stage::Done;
    };
    let material = &ctx.world.materials[hit.material as usize];
    let cos = -hit.normal.as_dvec3().dot(DVec3::from(ray.direction));
    if material.emits() && cos > 0.0 {
        let radiance = Vec3::from(material.ke);
        gain(radiance, lights.emitter_pdf(from, (ray, hit.t), cos));
    }
    ctx.lit(SurfaceInteraction::new(ray, &hit).unseen(&ctx.world.materials))
}
