//! `Lights`: what gives light, and a light sample for a surface point.
//!
//! One sample picks one source, in proportion to an estimate of what it could bring (its intensity and distance,
//! shadows not asked), then a point on it. The sky is a source like the others, drawn by what the surface scatters, so
//! that scans are lit by sun and sky alike and shiny materials show no sparks.
//!
//! Invariants: 1. the estimate is positive wherever a source brings light, so the mean of the samples is right;
//! 2. a sample is drawn on the side of the surface that its normal shows; 3. rectangles and emitters give light
//! on one side only; 4. rectangles are seen by C-rays and shade nothing: they are no part of the model.

mod emit;

use crate::camera::ground_axes;
use crate::emitter::{Emitter, Emitters, brightness};
use crate::material::{rough_density, scatter_rough};
use crate::math::{add_rgb, along, basis, cross, dot, length, scale, scale_rgb, sub, unit};
use crate::trace::Ray;
use std::f64::consts::{PI, TAU};
use trex_store::{Code, Error, Material, Result};

pub(crate) use emit::PhotonSources;

/// Where the sun of models without lights stands: towards it along (right, up, front). To the left of the default
/// camera and behind it, 30 degrees high, so that relief throws shadows.
const DEFAULT_SUN_TOWARDS: [f64; 3] = [-0.75, 0.5, 0.433];
/// Its irradiance on a surface that faces it: warm. With [`DEFAULT_SKY_RADIANCE`] a lit surface of Kd 0.7 stays
/// below 1.
const DEFAULT_SUN_IRRADIANCE: [f32; 3] = [3.3, 2.85, 2.25];
/// Radiance of the sky of models without lights: bluish, an eighth of the sun's light on level ground.
const DEFAULT_SKY_RADIANCE: [f32; 3] = [0.2, 0.27, 0.4];

/// A light of the scene. Emissive triangles of the model are not among these: see [`Emitter`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// A point that shines alike in all directions.
    Point {
        /// Where, model units.
        position: [f64; 3],
        /// Radiant intensity, W/sr in linear RGB: irradiance = intensity * cos / distance^2.
        intensity: [f32; 3],
    },
    /// A sun: parallel rays from infinitely far.
    Directional {
        /// Which way the light travels; any length.
        direction: [f64; 3],
        /// Irradiance on a surface that faces it, W/m^2 in linear RGB.
        irradiance: [f32; 3],
    },
    /// A parallelogram that shines from the side of `edge_u x edge_v`.
    Rect {
        /// A corner, model units.
        corner: [f64; 3],
        /// From the corner to the next one.
        edge_u: [f64; 3],
        /// From the corner to the one on the other side.
        edge_v: [f64; 3],
        /// Radiance that leaves the front.
        radiance: [f32; 3],
    },
    /// The same radiance from every direction in which nothing is hit. Several add up.
    Sky {
        /// Radiance.
        radiance: [f32; 3],
    },
}

/// Where light is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Receiver<'a> {
    /// Point on the surface, model units.
    pub point: [f64; 3],
    /// Unit normal on the side that is looked at.
    pub normal: [f64; 3],
    /// Unit direction to where it is looked at from.
    pub to_viewer: [f64; 3],
    /// What the surface is made of.
    pub material: &'a Material,
}

/// One light sample, not yet tested for shadow.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction to the light; above the surface.
    pub direction: [f64; 3],
    /// Distance to the light, model units; infinite for sun and sky.
    pub distance: f64,
    /// Unit normal of the light's front where it is a surface.
    pub front: Option<[f64; 3]>,
    /// Radiance over density: `bsdf * cos * weight` estimates the radiance returned.
    pub weight: [f32; 3],
    /// Density of the direction, per solid angle; infinite for points and suns.
    pub density: f64,
}

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

/// The sources in the order in which they are picked.
#[derive(Clone, Copy)]
enum Source<'a> {
    Light(&'a Light),
    Emitters(&'a Emitters),
    Sky([f32; 3]),
}

impl Light {
    /// # Errors
    /// [`Code::SceneFormat`] at `place` (the name of the light): numbers that are not finite or, for light,
    /// negative; a direction of length 0; a rectangle without an area.
    pub fn check(&self, place: &str) -> Result<()> {
        let bad = |what: &str, numbers: String, next: &str| {
            Err(Error::new(Code::SceneFormat, what).at_place(place).numbers(numbers).next(next))
        };
        let (light, vectors): ([f32; 3], [[f64; 3]; 3]) = match *self {
            Light::Point { position, intensity } => (intensity, [position, [0.0; 3], [0.0; 3]]),
            Light::Directional { direction, irradiance } => (irradiance, [direction, [0.0; 3], [0.0; 3]]),
            Light::Rect { corner, edge_u, edge_v, radiance } => (radiance, [corner, edge_u, edge_v]),
            Light::Sky { radiance } => (radiance, [[0.0; 3]; 3]),
        };
        if light.iter().any(|x| !x.is_finite() || *x < 0.0) {
            return bad(
                "a light that gives no proper amount",
                format!("{light:?}"),
                "give finite numbers >= 0",
            );
        }
        if vectors.as_flattened().iter().any(|x| !x.is_finite()) {
            return bad("a light that is nowhere", format!("{vectors:?}"), "give finite numbers");
        }
        match *self {
            Light::Directional { direction, .. } if unit(direction).is_none() => bad(
                "a light without a direction",
                format!("{direction:?}"),
                "give a direction that is not zero",
            ),
            Light::Rect { edge_u, edge_v, .. } if unit(cross(edge_u, edge_v)).is_none() => {
                let numbers = format!("edge_u {edge_u:?}, edge_v {edge_v:?}");
                bad("a rectangle without an area", numbers, "give two edges that are not parallel")
            }
            _ => Ok(()),
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

    /// The same lights, with the sky brought by these rays.
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

    /// A light sample for `at` from four numbers in [0, 1); `None` when it can bring nothing (which counts as a
    /// sample of zero).
    pub fn sample(&self, at: &Receiver<'_>, u: [f32; 4]) -> Option<LightSample> {
        let total: f64 = self.sources().map(|source| source.estimate(at)).sum();
        if total <= 0.0 || !total.is_finite() {
            return None;
        }
        let mut left = f64::from(u[0]) * total;
        let mut picked = None;
        for source in self.sources() {
            let estimate = source.estimate(at);
            if estimate > 0.0 {
                picked = Some((source, estimate / total));
                left -= estimate;
                if left < 0.0 {
                    break;
                }
            }
        }
        let (source, share) = picked?;
        let mut sample = source.sample(at, [u[1], u[2], u[3]])?;
        sample.weight = scale_rgb((1.0 / share) as f32, sample.weight);
        sample.density *= share;
        (dot(sample.direction, at.normal) > 0.0).then_some(sample)
    }

    /// Radiance of all rectangles whose front `ray` crosses before `t_max`, and the density (per solid angle) with
    /// which [`Lights::sample`] for `at` draws that way.
    pub(crate) fn crossed(
        &self,
        at: &Receiver<'_>,
        ray: &Ray,
        t_max: f64,
    ) -> impl Iterator<Item = ([f32; 3], f64)> {
        self.lights.iter().filter_map(move |light| {
            let Light::Rect { corner, edge_u, edge_v, radiance } = *light else { return None };
            let t = rect_hit(ray, corner, edge_u, edge_v).filter(|&t| t < t_max)?;
            let to = sub(along(ray.origin, t, ray.direction), at.point);
            // |cross| is the area, so that the cosine and the density per area leave one factor.
            let facing = -dot(ray.direction, cross(edge_u, edge_v));
            Some((radiance, self.share(at, &Source::Light(light)) * dot(to, to) / facing))
        })
    }

    /// Density (per solid angle) with which [`Lights::sample`] for `at` draws the sky in unit `direction`.
    pub(crate) fn sky_density(&self, at: &Receiver<'_>, direction: [f64; 3]) -> f64 {
        self.share(at, &Source::Sky(self.sky))
            * rough_density(at.material, at.normal, at.to_viewer, direction)
    }

    /// The same for `point` on an emitter of this radiance that is seen with cosine `cos` > 0.
    pub(crate) fn emitter_density(
        &self,
        at: &Receiver<'_>,
        point: [f64; 3],
        cos: f64,
        radiance: [f32; 3],
    ) -> f64 {
        let to = sub(point, at.point);
        let per_area = self.emitters.density(radiance);
        self.share(at, &Source::Emitters(&self.emitters)) * per_area * dot(to, to) / cos
    }

    /// Share of the light samples for `at` that go to `source`.
    fn share(&self, at: &Receiver<'_>, source: &Source<'_>) -> f64 {
        let total: f64 = self.sources().map(|source| source.estimate(at)).sum();
        let share = source.estimate(at) / total;
        if share.is_finite() { share } else { 0.0 }
    }

    fn sources(&self) -> impl Iterator<Item = Source<'_>> {
        let emitters = (!self.emitters.is_empty()).then_some(Source::Emitters(&self.emitters));
        let sky = (self.sky_by == SkyBy::LightSamples).then_some(Source::Sky(self.sky));
        self.lights.iter().map(Source::Light).chain(emitters).chain(sky)
    }
}

impl Source<'_> {
    /// About what this source brings to `at` when nothing is between; 0 only where it brings nothing.
    fn estimate(&self, at: &Receiver<'_>) -> f64 {
        match self {
            Source::Light(Light::Point { position, intensity }) => {
                let to = sub(*position, at.point);
                let squared = dot(to, to);
                let cos = dot(to, at.normal) / squared.sqrt();
                if cos > 0.0 { brightness(*intensity) * cos / squared } else { 0.0 }
            }
            Source::Light(Light::Directional { direction, irradiance }) => {
                brightness(*irradiance) * (-dot(*direction, at.normal) / length(*direction)).max(0.0)
            }
            Source::Light(Light::Rect { corner, edge_u, edge_v, radiance }) => {
                let normal = cross(*edge_u, *edge_v);
                let height = |u: f64, v: f64| {
                    dot(sub(along(along(*corner, u, *edge_u), v, *edge_v), at.point), at.normal)
                };
                let below = [height(0.0, 0.0), height(1.0, 0.0), height(0.0, 1.0), height(1.0, 1.0)];
                if dot(sub(at.point, *corner), normal) <= 0.0 || below.iter().all(|&h| h <= 0.0) {
                    return 0.0;
                }
                let to = sub(along(along(*corner, 0.5, *edge_u), 0.5, *edge_v), at.point);
                let area = length(normal);
                brightness(*radiance) * area / dot(to, to).max(area)
            }
            Source::Light(Light::Sky { radiance }) | Source::Sky(radiance) => PI * brightness(*radiance),
            Source::Emitters(emitters) => {
                let to = sub(emitters.bounds().center(), at.point);
                let near = 0.5 * emitters.bounds().diagonal();
                brightness(emitters.radiance_area()) / dot(to, to).max(near * near)
            }
        }
    }

    /// A sample of this source alone.
    fn sample(&self, at: &Receiver<'_>, u: [f32; 3]) -> Option<LightSample> {
        match self {
            Source::Light(Light::Point { position, intensity }) => {
                let to = sub(*position, at.point);
                let distance = length(to);
                let weight = scale_rgb((1.0 / (distance * distance)) as f32, *intensity);
                let direction = unit(to)?;
                Some(LightSample { direction, distance, front: None, weight, density: f64::INFINITY })
            }
            Source::Light(Light::Directional { direction, irradiance }) => Some(LightSample {
                direction: unit(scale(-1.0, *direction))?,
                distance: f64::INFINITY,
                front: None,
                weight: *irradiance,
                density: f64::INFINITY,
            }),
            Source::Light(Light::Rect { corner, edge_u, edge_v, radiance }) => {
                let point = along(along(*corner, f64::from(u[1]), *edge_u), f64::from(u[2]), *edge_v);
                let normal = cross(*edge_u, *edge_v);
                surface_sample(at, point, unit(normal)?, *radiance, 1.0 / length(normal))
            }
            Source::Light(Light::Sky { radiance }) | Source::Sky(radiance) => {
                let (direction, density, _) = scatter_rough(at.material, at.normal, at.to_viewer, u)?;
                let weight = scale_rgb((1.0 / density) as f32, *radiance);
                Some(LightSample { direction, distance: f64::INFINITY, front: None, weight, density })
            }
            Source::Emitters(emitters) => {
                let on = emitters.sample(u[0], [u[1], u[2]]);
                surface_sample(at, on.point, on.normal, on.radiance, on.density)
            }
        }
    }
}

/// Light from a point on a surface that was drawn with `density` (per area).
fn surface_sample(
    at: &Receiver<'_>,
    point: [f64; 3],
    front: [f64; 3],
    radiance: [f32; 3],
    density: f64,
) -> Option<LightSample> {
    let to = sub(point, at.point);
    let distance = length(to);
    let direction = unit(to)?;
    let cos = -dot(direction, front);
    let density = distance * distance * density / cos;
    let weight = scale_rgb((1.0 / density) as f32, radiance);
    (cos > 0.0).then_some(LightSample { direction, distance, front: Some(front), weight, density })
}

/// A unit direction about `normal` with density `cos / pi`, from two numbers in [0, 1).
pub(crate) fn cosine_direction(normal: [f64; 3], u: [f32; 2]) -> [f64; 3] {
    let (a, b) = basis(normal);
    let (radius, angle) = (f64::from(u[0]).sqrt(), TAU * f64::from(u[1]));
    let height = (1.0 - f64::from(u[0])).sqrt();
    along(along(scale(height, normal), radius * angle.cos(), a), radius * angle.sin(), b)
}

/// A unit direction about `axis` with density `(n + 1) / (2 pi) cos^n`, from two numbers in [0, 1).
pub(crate) fn lobe_direction(axis: [f64; 3], ns: f32, u: [f32; 2]) -> [f64; 3] {
    let (a, b) = basis(axis);
    let height = (1.0 - f64::from(u[0])).powf(1.0 / (f64::from(ns) + 1.0));
    let (radius, angle) = ((1.0 - height * height).max(0.0).sqrt(), TAU * f64::from(u[1]));
    along(along(scale(height, axis), radius * angle.cos(), a), radius * angle.sin(), b)
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

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: Material = Material {
        name: String::new(),
        kd: [0.7; 3],
        ks: [0.0; 3],
        ns: 0.0,
        ke: [0.0; 3],
        d: 1.0,
        mirror: false,
    };
    static AT: Receiver<'_> =
        Receiver { point: [0.0; 3], normal: [0.0, 0.0, 1.0], to_viewer: [0.6, 0.0, 0.8], material: &GREY };

    /// Irradiance on [`AT`] by points of a lattice, drawn as the integrator does.
    fn irradiance(lights: &Lights) -> f64 {
        let side = 24u32;
        let number = |i: u32| (i as f32 + 0.5) / side as f32;
        let mut sum = 0.0;
        for i in 0..side.pow(4) {
            let u = [i % side, i / side % side, i / side.pow(2) % side, i / side.pow(3)].map(number);
            if let Some(sample) = lights.sample(&AT, u) {
                sum += dot(sample.direction, AT.normal) * f64::from(sample.weight[0]);
            }
        }
        sum / f64::from(side.pow(4))
    }

    fn check(lights: &[Light], emitters: &[Emitter], expected: f64) {
        let lamp = Material { ke: [2.0; 3], ..Material::default() };
        let lights = Lights::new(lights, emitters, &[lamp], [0.0, 1.0, 0.0]).unwrap();
        let found = irradiance(&lights);
        assert!((found - expected).abs() < 4e-3 * expected.max(0.05), "{found} for {expected}");
    }

    /// Form factor from a point to a parallel rectangle a x b at height 1 with a corner above the point.
    fn corner_form_factor(a: f64, b: f64) -> f64 {
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        (a / p * (b / p).atan() + b / q * (a / q).atan()) / TAU
    }

    #[test]
    fn known_irradiances() {
        let point = Light::Point { position: [3.0, 0.0, 4.0], intensity: [50.0; 3] };
        let sun = Light::Directional { direction: [0.6, 0.0, -0.8], irradiance: [3.0; 3] };
        let sky = Light::Sky { radiance: [0.5; 3] };
        check(&[point], &[], 50.0 * 0.8 / 25.0);
        check(&[sun], &[], 2.4);
        check(&[sky], &[], 0.5 * PI);
        check(&[sky, point, sun, sky], &[], 1.6 + 2.4 + PI);
    }

    #[test]
    fn rectangles_bring_their_form_factor_on_one_side() {
        let (a, b) = (0.5, 0.75);
        let corner = [0.0, 0.0, 1.0];
        let (edge_a, edge_b) = ([a, 0.0, 0.0], [0.0, b, 0.0]);
        let down = Light::Rect { corner, edge_u: edge_b, edge_v: edge_a, radiance: [2.0; 3] };
        let up = Light::Rect { corner, edge_u: edge_a, edge_v: edge_b, radiance: [2.0; 3] };
        let expected = 2.0 * PI * corner_form_factor(a, b);
        check(&[down], &[], expected);
        check(&[up], &[], 0.0);
        // The same rectangle as two triangles of the model, facing down; and facing up.
        let far = [a, b, 1.0];
        let emitter = |corners| Emitter { corners, material: 0 };
        let (p, q) = ([a, 0.0, 1.0], [0.0, b, 1.0]);
        check(&[], &[emitter([corner, q, p]), emitter([far, p, q])], expected);
        check(&[], &[emitter([corner, p, q]), emitter([far, q, p])], 0.0);
    }

    #[test]
    fn rectangles_are_seen_on_the_front() {
        let rect = Light::Rect {
            corner: [-1.0, -1.0, 5.0],
            edge_u: [0.0, 2.0, 0.0],
            edge_v: [2.0, 0.0, 0.0],
            radiance: [7.0; 3],
        };
        let lights = Lights::new(&[rect], &[], &[], [0.0, 1.0, 0.0]).unwrap();
        let ray = |origin, z| Ray { origin, direction: [0.0, 0.0, z], t_max: f64::INFINITY };
        assert_eq!(lights.seen(&ray([0.5, -0.5, 0.0], 1.0), f64::INFINITY), Some([7.0; 3]));
        assert_eq!(lights.seen(&ray([0.5, -0.5, 0.0], 1.0), 4.9), None);
        assert_eq!(lights.seen(&ray([1.5, -0.5, 0.0], 1.0), f64::INFINITY), None);
        assert_eq!(lights.seen(&ray([0.5, -0.5, 9.0], -1.0), f64::INFINITY), None);
    }

    #[test]
    fn without_lights_there_are_sun_and_sky() {
        let lights = Lights::new(&[], &[], &[], [0.0, 0.0, 1.0]).unwrap();
        assert_eq!((lights.sky(), lights.lights.len()), (DEFAULT_SKY_RADIANCE, 1));
        let found = irradiance(&lights);
        let sky = PI * f64::from(DEFAULT_SKY_RADIANCE[0]);
        let sun = f64::from(DEFAULT_SUN_IRRADIANCE[0]) * 0.5 / length(DEFAULT_SUN_TOWARDS);
        // The pick between the two is on a lattice of 24: half a step, and a little.
        assert!((found / (sky + sun) - 1.0).abs() < 0.01, "{found}");
        // A lit surface of Kd 0.7 that faces the sun is not burnt out.
        assert!(0.7 / PI * (sky + f64::from(DEFAULT_SUN_IRRADIANCE[0])) < 1.0);
        // One light of the scene, if only a black sky, and the defaults are gone.
        let dark = Lights::new(&[Light::Sky { radiance: [0.0; 3] }], &[], &[], [0.0, 0.0, 1.0]).unwrap();
        assert!(dark.sample(&AT, [0.5; 4]).is_none() && dark.sky() == [0.0; 3]);
    }

    #[test]
    fn lights_that_make_no_sense_are_named() {
        let cases = [
            Light::Point { position: [f64::NAN, 0.0, 0.0], intensity: [1.0; 3] },
            Light::Point { position: [0.0; 3], intensity: [-1.0, 0.0, 0.0] },
            Light::Directional { direction: [0.0; 3], irradiance: [1.0; 3] },
            Light::Rect { corner: [0.0; 3], edge_u: [1.0; 3], edge_v: [2.0; 3], radiance: [1.0; 3] },
            Light::Sky { radiance: [f32::INFINITY; 3] },
        ];
        for light in cases {
            let error = Lights::new(&[light], &[], &[], [0.0, 1.0, 0.0]).unwrap_err();
            assert_eq!((error.code(), error.place()), (Code::SceneFormat, "light[0]"));
        }
    }
}
