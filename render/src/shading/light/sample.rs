//! Light samples: a direction in which light may come to a place, and with which density it is drawn.
//!
//! One sample picks one source, in proportion to an estimate of what it could bring (its intensity and distance,
//! shadows not asked), then a point on it. The sky is a source like the others, drawn by what the surface scatters, so
//! that scans are lit by sun and sky alike and shiny materials show no sparks.
//!
//! Invariants: 1. the estimate is positive wherever a source brings light, so the mean of the samples is right;
//! 2. a sample is drawn on the side of the surface that its normal shows.

use super::lights::{Lights, SkyBy, Source};
use crate::math::{brightness, unit};
use crate::shading::bsdf::BsdfSample;
use crate::shading::surface::ShadingPoint;
use crate::trace::Ray;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Most estimates that are kept between their sum and the pick; of more sources all are made twice.
const ESTIMATES_KEPT: usize = 16;

/// One light sample, not yet tested for shadow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightSample {
    /// Unit direction to the light; above the surface.
    pub(crate) wi: DVec3,
    /// Distance to the light, model units; infinite for sun and sky.
    pub(crate) distance: f64,
    /// Unit normal of the light's front where it is a surface.
    pub(crate) front: Option<DVec3>,
    /// Radiance over pdf: `bsdf * cos * weight` estimates the radiance returned.
    pub(crate) weight: Vec3,
    /// Density of the direction, per solid angle; infinite for points and suns.
    pub(crate) pdf: f64,
}

impl Lights {
    /// A light sample for `at` from four numbers in [0, 1), where the sky's light comes by `sky_by`; `None` when it can
    /// bring nothing (which counts as a sample of zero).
    pub(crate) fn sample(&self, at: &ShadingPoint<'_>, sky_by: SkyBy, u: [f32; 4]) -> Option<LightSample> {
        let (source, share) = self.pick(at, sky_by, u[0].into())?;
        let mut sample = source.sample(at, [u[1], u[2], u[3]])?;
        sample.weight = (1.0 / share) as f32 * sample.weight;
        sample.pdf *= share;
        (sample.wi.dot(at.bsdf.normal) > 0.0).then_some(sample)
    }

    /// The source that a number in [0, 1) picks for `at`, and its share of the estimates.
    fn pick(&self, at: &ShadingPoint<'_>, sky_by: SkyBy, number: f64) -> Option<(Source<'_>, f64)> {
        let estimates = || self.sampled_sources(sky_by).map(|source| source.estimate(at));
        let (mut total, mut count, mut kept) = (0.0, 0, [0.0; ESTIMATES_KEPT]);
        estimates().for_each(|estimate| {
            total += estimate;
            if let Some(kept) = kept.get_mut(count) {
                *kept = estimate;
            }
            count += 1;
        });
        if total <= 0.0 || !total.is_finite() {
            return None;
        }
        let (index, estimate) = match kept.get(..count) {
            Some(kept) => picked(kept.iter().copied(), number * total),
            None => picked(estimates(), number * total),
        }?;
        Some((self.sampled_sources(sky_by).nth(index)?, estimate / total))
    }

    /// Radiance of all rectangles whose front `ray` crosses before `t_max`, and the density (per solid angle) with
    /// which [`Lights::sample`] for `at` draws that way.
    pub(crate) fn crossed(
        &self,
        at: &ShadingPoint<'_>,
        ray: &Ray,
        t_max: f64,
    ) -> impl Iterator<Item = (Vec3, f64)> {
        self.rects_crossed(ray, t_max).filter_map(move |(source, t)| {
            let Source::Rect { edge_u, edge_v, radiance, .. } = source else { return None };
            let to = ray.at(t) - at.point;
            // |cross| is the area, so that the cosine and the density per area leave one factor.
            let facing = -DVec3::from(ray.direction).dot(edge_u.cross(edge_v));
            Some((radiance, self.share(at, &source) * to.length_squared() / facing))
        })
    }

    /// Density (per solid angle) with which [`Lights::sample`] for `at` draws the sky in unit `direction`.
    pub(crate) fn sky_pdf(&self, at: &ShadingPoint<'_>, direction: DVec3) -> f64 {
        self.share(at, &Source::Sky(self.sky())) * at.bsdf.pdf_rough(direction)
    }

    /// Density (per solid angle) with which [`Lights::sample`] for `at` draws the point of an emitter that `ray` meets
    /// at
    /// `t` with cosine `cos` > 0.
    pub(crate) fn emitter_pdf(&self, at: &ShadingPoint<'_>, (ray, t): (&Ray, f64), cos: f64) -> f64 {
        let to = ray.at(t) - at.point;
        let per_area = self.emitters().pdf_for(at.point, ray, t);
        self.share(at, &Source::Emitters(self.emitters())) * per_area * to.length_squared() / cos
    }

    /// Share of the light samples for `at` that go to `source`, the sky among all.
    fn share(&self, at: &ShadingPoint<'_>, source: &Source<'_>) -> f64 {
        let total: f64 = self.sources().map(|source| source.estimate(at)).sum();
        let share = source.estimate(at) / total;
        if share.is_finite() { share } else { 0.0 }
    }
}

/// Index and size of the estimate in which `left` falls when all are laid one after the other; of the last one that is
/// positive where rounding leaves it behind them.
fn picked(estimates: impl Iterator<Item = f64>, mut left: f64) -> Option<(usize, f64)> {
    let mut last = None;
    for (index, estimate) in estimates.enumerate().filter(|&(_, estimate)| estimate > 0.0) {
        last = Some((index, estimate));
        left -= estimate;
        if left < 0.0 {
            break;
        }
    }
    last
}

impl Source<'_> {
    /// About what this source brings to `at` when nothing is between; 0 only where it brings nothing.
    fn estimate(&self, at: &ShadingPoint<'_>) -> f64 {
        match self {
            Source::Point { position, intensity } => {
                let to = *position - at.point;
                let squared = to.length_squared();
                let cos = to.dot(at.bsdf.normal) / squared.sqrt();
                if cos > 0.0 { brightness(*intensity) * cos / squared } else { 0.0 }
            }
            Source::Directional { direction, irradiance } => {
                let cos = -direction.dot(at.bsdf.normal) / direction.length();
                brightness(*irradiance) * cos.max(0.0)
            }
            Source::Rect { corner, edge_u, edge_v, radiance } => {
                let normal = edge_u.cross(*edge_v);
                let to = |u: f64, v: f64| *corner + u * *edge_u + v * *edge_v - at.point;
                let height = |(u, v)| to(u, v).dot(at.bsdf.normal);
                let heights = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(height);
                if (at.point - *corner).dot(normal) <= 0.0 || heights.iter().all(|&h| h <= 0.0) {
                    return 0.0;
                }
                let area = normal.length();
                brightness(*radiance) * area / to(0.5, 0.5).length_squared().max(area)
            }
            Source::Sky(radiance) => PI * brightness(*radiance),
            Source::Emitters(emitters) => {
                let to = DVec3::from(emitters.bounds().center()) - at.point;
                let near = 0.5 * emitters.bounds().diagonal();
                brightness(emitters.radiance_area()) / to.length_squared().max(near * near)
            }
        }
    }

    /// A sample of this source alone.
    fn sample(&self, at: &ShadingPoint<'_>, u: [f32; 3]) -> Option<LightSample> {
        match self {
            Source::Point { position, intensity } => {
                let to = *position - at.point;
                let distance = to.length();
                let weight = (1.0 / (distance * distance)) as f32 * *intensity;
                let wi = unit(to)?;
                Some(LightSample { wi, distance, front: None, weight, pdf: f64::INFINITY })
            }
            Source::Directional { direction, irradiance } => Some(LightSample {
                wi: unit(-*direction)?,
                distance: f64::INFINITY,
                front: None,
                weight: *irradiance,
                pdf: f64::INFINITY,
            }),
            Source::Rect { corner, edge_u, edge_v, radiance } => {
                let point = *corner + f64::from(u[1]) * *edge_u + f64::from(u[2]) * *edge_v;
                let normal = edge_u.cross(*edge_v);
                surface_sample(at, point, unit(normal)?, *radiance, 1.0 / normal.length())
            }
            Source::Sky(radiance) => {
                let BsdfSample { wi, pdf, .. } = at.bsdf.sample_rough(u)?;
                let pdf = pdf?;
                let weight = (1.0 / pdf) as f32 * *radiance;
                Some(LightSample { wi, distance: f64::INFINITY, front: None, weight, pdf })
            }
            Source::Emitters(emitters) => {
                let on = emitters.sample_for(at.point, u[0], [u[1], u[2]])?;
                surface_sample(at, on.point, on.normal, on.radiance, on.pdf)
            }
        }
    }
}

/// Light from a point on a surface that was drawn with `pdf_area` (per area).
fn surface_sample(
    at: &ShadingPoint<'_>,
    point: DVec3,
    front: DVec3,
    radiance: Vec3,
    pdf_area: f64,
) -> Option<LightSample> {
    let to = point - at.point;
    let distance = to.length();
    let wi = unit(to)?;
    let cos = -wi.dot(front);
    let pdf = distance * distance * pdf_area / cos;
    let weight = (1.0 / pdf) as f32 * radiance;
    (cos > 0.0).then_some(LightSample { wi, distance, front: Some(front), weight, pdf })
}

#[cfg(test)]
mod tests {
    use super::super::lights::{DEFAULT_SKY_RADIANCE, DEFAULT_SUN_IRRADIANCE, DEFAULT_SUN_TOWARDS};
    use super::super::scene_light::Light;
    use super::*;
    use crate::shading::bsdf::Bsdf;
    use crate::shading::light::Emitter;
    use std::f64::consts::TAU;
    use trex_store::{Code, Material};

    const GREY: Material = Material {
        kd: [0.7; 3],
        ks: [0.0; 3],
        ns: 0.0,
        ke: [0.0; 3],
        d: 1.0,
        mirror: false,
        mean_colour: [255; 3],
    };
    static AT: ShadingPoint<'_> = ShadingPoint {
        point: DVec3::ZERO,
        bsdf: Bsdf {
            material: &GREY,
            colour: Vec3::ONE,
            normal: DVec3::Z,
            shading_normal: DVec3::Z,
            wo: DVec3::new(0.6, 0.0, 0.8),
        },
    };

    /// Irradiance on [`AT`] by points of a lattice, drawn as the integrator does.
    fn irradiance(lights: &Lights) -> f64 {
        let side = 24u32;
        let number = |i: u32| (i as f32 + 0.5) / side as f32;
        let mut sum = 0.0;
        for i in 0..side.pow(4) {
            let u = [i % side, i / side % side, i / side.pow(2) % side, i / side.pow(3)].map(number);
            if let Some(sample) = lights.sample(&AT, SkyBy::LightSamples, u) {
                sum += sample.wi.dot(AT.bsdf.normal) * f64::from(sample.weight[0]);
            }
        }
        sum / f64::from(side.pow(4))
    }

    fn check(lights: &[Light], emitters: &[Emitter], expected: f64) {
        let lamp = Material { ke: [2.0; 3], ..Material::default() };
        let lights = Lights::new(lights, emitters, &[lamp], DVec3::Y).unwrap();
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
        // More sources than estimates are kept of: as many as there are numbers to pick by, so each is picked alike.
        check(&[sun; 24], &[], 24.0 * 2.4);
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
        let lights = Lights::new(&[rect], &[], &[], DVec3::Y).unwrap();
        let ray = |origin, z| Ray { origin, direction: [0.0, 0.0, z], t_max: f64::INFINITY };
        assert_eq!(lights.seen(&ray([0.5, -0.5, 0.0], 1.0), f64::INFINITY), Some(Vec3::splat(7.0)));
        assert_eq!(lights.seen(&ray([0.5, -0.5, 0.0], 1.0), 4.9), None);
        assert_eq!(lights.seen(&ray([1.5, -0.5, 0.0], 1.0), f64::INFINITY), None);
        assert_eq!(lights.seen(&ray([0.5, -0.5, 9.0], -1.0), f64::INFINITY), None);
    }

    #[test]
    fn without_lights_there_are_sun_and_sky() {
        let lights = Lights::new(&[], &[], &[], DVec3::Z).unwrap();
        assert_eq!((lights.sky(), lights.sources().count()), (Vec3::from(DEFAULT_SKY_RADIANCE), 2));
        let found = irradiance(&lights);
        let sky = PI * f64::from(DEFAULT_SKY_RADIANCE[0]);
        let sun = f64::from(DEFAULT_SUN_IRRADIANCE[0]) * 0.5 / DEFAULT_SUN_TOWARDS.length();
        // The pick between the two is on a lattice of 24: half a step, and a little.
        assert!((found / (sky + sun) - 1.0).abs() < 0.01, "{found}");
        // A lit surface of Kd 0.7 that faces the sun is not burnt out.
        assert!(0.7 / PI * (sky + f64::from(DEFAULT_SUN_IRRADIANCE[0])) < 1.0);
        // One light of the scene, if only a black sky, and the defaults are gone.
        let dark = Lights::new(&[Light::Sky { radiance: [0.0; 3] }], &[], &[], DVec3::Z).unwrap();
        assert!(dark.sample(&AT, SkyBy::LightSamples, [0.5; 4]).is_none() && dark.sky() == Vec3::ZERO);
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
            let error = Lights::new(&[light], &[], &[], DVec3::Y).unwrap_err();
            assert_eq!((error.code(), error.place()), (Code::SceneFormat, "light[0]"));
        }
    }
}
