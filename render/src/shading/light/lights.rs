//! `Lights`: all that gives light in a scene, as one list of sources, and which of them a ray sees.
//!
//! Invariants: 1. rectangles and emitters give light on one side only; 2. rectangles are seen by C-rays and shade
//! nothing: they are no part of the model.

use super::emitter::{Emitter, Emitters};
use super::scene_light::Light;
use crate::math::{ground_axes, unit};
use crate::trace::Ray;
use glam::{DVec3, Vec3};
use trex_store::{Material, Result};

/// Direction towards the sun of models without lights, along (right, up, front). To the left of the default camera
/// and behind it, 30 degrees high, so that relief throws shadows.
pub(super) const DEFAULT_SUN_TOWARDS: DVec3 = DVec3::new(-0.75, 0.5, 0.433);
/// Irradiance of that sun on a surface that faces it: warm. With [`DEFAULT_SKY_RADIANCE`] a lit surface of Kd 0.7
/// stays below 1.
pub(super) const DEFAULT_SUN_IRRADIANCE: [f32; 3] = [3.3, 2.85, 2.25];
/// Radiance of the sky of models without lights: bluish, an eighth of the sun's light on level ground.
pub(super) const DEFAULT_SKY_RADIANCE: [f32; 3] = [0.2, 0.27, 0.4];

/// The sources of light in a scene, those of the model included.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Points, suns and rectangles.
    lights: Vec<Light>,
    emitters: Emitters,
    sky: Vec3,
    /// The sun and the sky of models without lights are among them.
    has_defaults: bool,
}

/// The rays that bring the sky's light to a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SkyBy {
    /// Light samples, as any light's.
    LightSamples,
    /// Gather rays that leave the model; light samples leave it out.
    GatherRays,
}

/// One source of light.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source<'a> {
    /// A point: see [`Light::Point`].
    Point { position: DVec3, intensity: Vec3 },
    /// A sun: see [`Light::Directional`].
    Directional { direction: DVec3, irradiance: Vec3 },
    /// A rectangle: see [`Light::Rect`].
    Rect { corner: DVec3, edge_u: DVec3, edge_v: DVec3, radiance: Vec3 },
    /// The emissive triangles of the model, together.
    Emitters(&'a Emitters),
    /// The radiance of all skies together.
    Sky(Vec3),
}

impl From<&Light> for Source<'_> {
    #[inline]
    fn from(light: &Light) -> Self {
        match *light {
            Light::Point { position, intensity } => {
                Source::Point { position: position.into(), intensity: intensity.into() }
            }
            Light::Directional { direction, irradiance } => {
                Source::Directional { direction: direction.into(), irradiance: irradiance.into() }
            }
            Light::Rect { corner, edge_u, edge_v, radiance } => {
                let [corner, edge_u, edge_v] = [corner, edge_u, edge_v].map(DVec3::from);
                Source::Rect { corner, edge_u, edge_v, radiance: radiance.into() }
            }
            Light::Sky { radiance } => Source::Sky(radiance.into()),
        }
    }
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
    pub(crate) fn new(
        lights: &[Light],
        emitters: &[Emitter],
        materials: &[Material],
        up: DVec3,
    ) -> Result<Lights> {
        for (index, light) in lights.iter().enumerate() {
            light.check(&format!("light[{index}]"))?;
        }
        let emitters = Emitters::new(emitters, materials);
        let defaults = default_lights(up);
        let has_defaults = lights.is_empty() && emitters.is_empty();
        let mut all = Lights { lights: vec![], emitters, sky: Vec3::ZERO, has_defaults };
        all.add(if has_defaults { &defaults } else { lights });
        Ok(all)
    }

    /// Lights as these, with the sun and the sky of models without lights beside them, once.
    pub(crate) fn with_sun_and_sky(mut self, up: DVec3) -> Lights {
        if !std::mem::replace(&mut self.has_defaults, true) {
            self.add(&default_lights(up));
        }
        self
    }

    fn add(&mut self, lights: &[Light]) {
        for light in lights {
            match *light {
                Light::Sky { radiance } => self.sky += Vec3::from(radiance),
                _ => self.lights.push(*light),
            }
        }
    }

    /// Radiance from where nothing is hit, linear RGB.
    pub(crate) fn sky(&self) -> Vec3 {
        self.sky
    }

    /// Radiance of the nearest rectangle that `ray` meets on its front before `t_max`.
    pub(crate) fn seen(&self, ray: &Ray, t_max: f64) -> Option<Vec3> {
        self.rect_seen(ray, |t, _| t < t_max)
    }

    /// As [`Lights::seen`], of a ray through voxels that ends at the first of them: a rectangle is seen behind that
    /// voxel, too, if the voxel is less than `clearance` of its normal above it.
    pub(crate) fn seen_in_voxels(
        &self,
        ray: &Ray,
        end: f64,
        clearance: impl Fn(DVec3) -> f64,
    ) -> Option<Vec3> {
        self.rect_seen(ray, |t, normal| is_before(t, normal, (ray, end), &clearance))
    }

    /// Radiance of the nearest emitter that a ray sees which ends at the first voxel: voxels hold the surface of the
    /// emitter, and of what is less than `clearance` of its normal above it.
    pub(crate) fn emitted_in_voxels(&self, ray: &Ray, end: f64, clearance: impl Fn(DVec3) -> f64) -> Vec3 {
        self.emitters.seen(ray, |t, normal| is_before(t, normal, (ray, end), &clearance))
    }

    /// Radiance of the nearest rectangle whose front `ray` meets, of those that `is_met` takes: it hears the
    /// parameter and the unit normal.
    fn rect_seen(&self, ray: &Ray, is_met: impl Fn(f64, DVec3) -> bool) -> Option<Vec3> {
        let mut nearest = (f64::INFINITY, None);
        for light in &self.lights {
            if let Light::Rect { corner, edge_u, edge_v, radiance } = *light
                && let Some(t) = rect_hit(ray, [corner, edge_u, edge_v])
                && t < nearest.0
                && let Some(normal) = unit(DVec3::from(edge_u).cross(edge_v.into()))
                && is_met(t, normal)
            {
                nearest = (t, Some(radiance.into()));
            }
        }
        nearest.1
    }

    /// The sources, in the order in which they are picked.
    pub(super) fn sources(&self) -> impl Iterator<Item = Source<'_>> {
        let emitters = (!self.emitters.is_empty()).then_some(Source::Emitters(&self.emitters));
        self.lights.iter().map(Source::from).chain(emitters).chain([Source::Sky(self.sky)])
    }

    /// The sources that light samples go to, where the sky's light comes by `sky_by`.
    pub(super) fn sampled_sources(&self, sky_by: SkyBy) -> impl Iterator<Item = Source<'_>> {
        let has_sky = sky_by == SkyBy::LightSamples;
        self.sources().filter(move |source| has_sky || !matches!(source, Source::Sky(_)))
    }

    /// The rectangles whose front `ray` crosses before `t_max`, and at which parameter.
    pub(super) fn rects_crossed(&self, ray: &Ray, t_max: f64) -> impl Iterator<Item = (Source<'_>, f64)> {
        self.lights.iter().filter_map(move |light| {
            let Light::Rect { corner, edge_u, edge_v, .. } = *light else { return None };
            Some((Source::from(light), rect_hit(ray, [corner, edge_u, edge_v]).filter(|&t| t < t_max)?))
        })
    }

    /// The emissive triangles.
    pub(super) fn emitters(&self) -> &Emitters {
        &self.emitters
    }
}

/// True when a ray that ends at `end` has come as far as a lamp that it meets at `t`, or less than the clearance of
/// its normal above it: where shadow rays to the lamp end.
fn is_before(t: f64, normal: DVec3, (ray, end): (&Ray, f64), clearance: impl Fn(DVec3) -> f64) -> bool {
    let height = (end - t) * DVec3::from(ray.direction).dot(normal);
    t <= end || height <= clearance(normal)
}

/// Parameter at which `ray` meets the front of a parallelogram, given by a corner and the two edges from there.
fn rect_hit(ray: &Ray, rect: [[f64; 3]; 3]) -> Option<f64> {
    let [corner, edge_u, edge_v] = rect.map(DVec3::from);
    let normal = edge_u.cross(edge_v);
    let approach = DVec3::from(ray.direction).dot(normal);
    if approach >= 0.0 {
        return None;
    }
    let t = (corner - DVec3::from(ray.origin)).dot(normal) / approach;
    let from_corner = ray.at(t) - corner;
    let squared = normal.length_squared();
    let u = from_corner.cross(edge_v).dot(normal) / squared;
    let v = edge_u.cross(from_corner).dot(normal) / squared;
    (t > 0.0 && (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v)).then_some(t)
}

fn default_lights(up: DVec3) -> [Light; 2] {
    let (right, front) = ground_axes(up);
    let DVec3 { x, y, z } = DEFAULT_SUN_TOWARDS;
    let towards = x * right + y * up + z * front;
    [
        Light::Directional { direction: (-towards).to_array(), irradiance: DEFAULT_SUN_IRRADIANCE },
        Light::Sky { radiance: DEFAULT_SKY_RADIANCE },
    ]
}
