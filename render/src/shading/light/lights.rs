//! `Lights`: all that gives light in a scene, as one list of sources, and which of them a ray sees.
//!
//! Invariants: 1. rectangles and emitters give light on one side only; 2. rectangles are seen by C-rays and shade nothing:
//! they are no part of the model.

use super::emitter::{Emitter, Emitters};
use super::scene_light::Light;
use crate::math::arrays::{add_rgb, along, cross, dot, ground_axes, scale, sub};
use crate::trace::Ray;
use trex_store::{Material, Result};

/// Where the sun of models without lights stands: towards it along (right, up, front). To the left of the default
/// camera and behind it, 30 degrees high, so that relief throws shadows.
pub(super) const DEFAULT_SUN_TOWARDS: [f64; 3] = [-0.75, 0.5, 0.433];
/// Its irradiance on a surface that faces it: warm. With [`DEFAULT_SKY_RADIANCE`] a lit surface of Kd 0.7 stays
/// below 1.
pub(super) const DEFAULT_SUN_IRRADIANCE: [f32; 3] = [3.3, 2.85, 2.25];
/// Radiance of the sky of models without lights: bluish, an eighth of the sun's light on level ground.
pub(super) const DEFAULT_SKY_RADIANCE: [f32; 3] = [0.2, 0.27, 0.4];

/// All that gives light in a scene.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Points, suns and rectangles.
    lights: Vec<Light>,
    emitters: Emitters,
    sky: [f32; 3],
    sky_by: SkyBy,
}

/// Which rays bring the sky's light to a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkyBy {
    /// Light samples, as any light's.
    LightSamples,
    /// Gather rays that leave the model; light samples leave it out.
    GatherRays,
}

/// What gives light, one of a list.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source<'a> {
    Light(&'a Light),
    /// All emissive triangles of the model.
    Emitters(&'a Emitters),
    /// The radiance of all skies together.
    Sky([f32; 3]),
}

impl Lights {
    /// The lights of a scene and those of the model. Where neither has any: a sun, fixed in the model whose unit
    /// up is `up`, and a constant sky.
    ///
    /// # Errors
    /// As [`Light::check`], at `light[index]`.
    ///
    /// # Panics
    /// When an emitter names a material that is not there.
    pub fn new(
        lights: &[Light],
        emitters: &[Emitter],
        materials: &[Material],
        up: [f64; 3],
    ) -> Result<Lights> {
        for (index, light) in lights.iter().enumerate() {
            light.check(&format!("light[{index}]"))?;
        }
        let emitters = Emitters::new(emitters, materials);
        let defaults = default_lights(up);
        let lights = if lights.is_empty() && emitters.is_empty() { &defaults[..] } else { lights };
        let mut all = Lights { lights: vec![], emitters, sky: [0.0; 3], sky_by: SkyBy::LightSamples };
        for light in lights {
            match *light {
                Light::Sky { radiance } => all.sky = add_rgb(all.sky, radiance),
                _ => all.lights.push(*light),
            }
        }
        Ok(all)
    }

    /// These lights, with the sky brought by other rays.
    pub fn with_sky_by(self, sky_by: SkyBy) -> Lights {
        Lights { sky_by, ..self }
    }

    /// Radiance from where nothing is hit.
    pub fn sky(&self) -> [f32; 3] {
        self.sky
    }

    /// Radiance of the nearest rectangle that `ray` meets on its front before `t_max`.
    pub fn seen(&self, ray: &Ray, t_max: f64) -> Option<[f32; 3]> {
        let mut nearest = (t_max, None);
        for light in &self.lights {
            if let Light::Rect { corner, edge_u, edge_v, radiance } = *light
                && let Some(t) = rect_hit(ray, corner, edge_u, edge_v)
                && t < nearest.0
            {
                nearest = (t, Some(radiance));
            }
        }
        nearest.1
    }

    /// All sources, in the order in which they are picked.
    pub(super) fn sources(&self) -> impl Iterator<Item = Source<'_>> {
        let emitters = (!self.emitters.is_empty()).then_some(Source::Emitters(&self.emitters));
        self.lights.iter().map(Source::Light).chain(emitters).chain([Source::Sky(self.sky)])
    }

    /// The sources that light samples go to.
    pub(super) fn sampled_sources(&self) -> impl Iterator<Item = Source<'_>> {
        let is_sampled = |source: &Source<'_>| match source {
            Source::Sky(_) => self.sky_by == SkyBy::LightSamples,
            _ => true,
        };
        self.sources().filter(is_sampled)
    }

    /// The rectangles whose front `ray` crosses before `t_max`, and where.
    pub(super) fn rects_crossed(&self, ray: &Ray, t_max: f64) -> impl Iterator<Item = (&Light, f64)> {
        self.lights.iter().filter_map(move |light| {
            let Light::Rect { corner, edge_u, edge_v, .. } = *light else { return None };
            Some((light, rect_hit(ray, corner, edge_u, edge_v).filter(|&t| t < t_max)?))
        })
    }

    /// The emissive triangles.
    pub(super) fn emitters(&self) -> &Emitters {
        &self.emitters
    }
}

/// Where `ray` meets the front of a parallelogram.
fn rect_hit(ray: &Ray, corner: [f64; 3], edge_u: [f64; 3], edge_v: [f64; 3]) -> Option<f64> {
    let normal = cross(edge_u, edge_v);
    let approach = dot(ray.direction, normal);
    if approach >= 0.0 {
        return None;
    }
    let t = dot(sub(corner, ray.origin), normal) / approach;
    let from_corner = sub(along(ray.origin, t, ray.direction), corner);
    let squared = dot(normal, normal);
    let u = dot(cross(from_corner, edge_v), normal) / squared;
    let v = dot(cross(edge_u, from_corner), normal) / squared;
    (t > 0.0 && (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v)).then_some(t)
}

fn default_lights(up: [f64; 3]) -> [Light; 2] {
    let (right, front) = ground_axes(up);
    let [x, y, z] = DEFAULT_SUN_TOWARDS;
    let towards = along(along(scale(x, right), y, up), z, front);
    [
        Light::Directional { direction: scale(-1.0, towards), irradiance: DEFAULT_SUN_IRRADIANCE },
        Light::Sky { radiance: DEFAULT_SKY_RADIANCE },
    ]
}
