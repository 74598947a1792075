//! Photons at their start: which light, where on it, whither, and with how much flux.
//!
//! ```text
//! point       all directions alike                        4 pi I
//! directional a rectangle before the model's box          E * area of the rectangle
//! rectangle   a point by area, a direction by the cosine  pi L A
//! emitters    a triangle by power, then the same          pi sum(L A)
//! sky         all directions, then as directional         4 pi L * area of the rectangle
//! ```
//!
//! The rectangle is the shadow of the model's box on a plane across the direction: smaller than the disc of the
//! bounding sphere, so that fewer photons miss a flat model.
//!
//! Invariants: 1. flux over chance is what the light sends into the model's box, so the mean over photons is right;
//! 2. a source that gives light has a chance.

use super::lights::{Lights, Source};
use crate::math::{brightness, unit};
use crate::sampler::{Decision, Sampler};
use crate::sampling::{cosine_direction, sphere_direction};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use trex_store::Aabb;

/// A photon as it leaves its light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Emission {
    /// Place, model units.
    pub(crate) origin: DVec3,
    /// Unit normal of the light's front where it is a surface.
    pub(crate) front: Option<DVec3>,
    /// Longest edge of that surface, model units; 0 where the light is none.
    pub(crate) size: f64,
    /// Unit direction of flight.
    pub(crate) direction: DVec3,
    /// True for a point or a sun, which no ray meets by chance.
    pub(crate) is_delta: bool,
    /// Flux over the photon's chance, W in linear RGB; the mean over photons is the flux of all lights.
    pub(crate) flux: Vec3,
}

/// The sources of photons: all that gives light.
#[derive(Clone, Debug)]
pub(crate) struct PhotonSources<'a> {
    bounds: Aabb,
    sources: Vec<Source<'a>>,
    /// Share of the photons up to and with this source.
    cumulated: Vec<f64>,
    flux: Vec3,
}

impl<'a> PhotonSources<'a> {
    /// The sources of `lights` around a model with box `bounds`; `None` when nothing gives light.
    pub(crate) fn new(lights: &'a Lights, bounds: &Aabb) -> Option<PhotonSources<'a>> {
        let mut made =
            PhotonSources { bounds: *bounds, sources: vec![], cumulated: vec![], flux: Vec3::ZERO };
        let mut total = 0.0;
        for source in lights.sources() {
            let flux = made.flux_of(&source);
            let power = brightness(flux);
            if power > 0.0 && power.is_finite() {
                total += power;
                made.sources.push(source);
                made.cumulated.push(total);
                made.flux += flux;
            }
        }
        made.cumulated.iter_mut().for_each(|sum| *sum /= total);
        (total > 0.0 && total.is_finite()).then_some(made)
    }

    /// About the flux of all sources together, W in linear RGB.
    pub(crate) fn flux(&self) -> Vec3 {
        self.flux
    }

    /// A photon, by the numbers of `sampler`.
    pub(crate) fn emit(&self, sampler: &Sampler) -> Option<Emission> {
        let [pick, a, b, _] = sampler.draw(Decision::PhotonStart);
        let [u, v, ..] = sampler.draw(Decision::PhotonDirection);
        let pick = f64::from(pick);
        let index = self.cumulated.partition_point(|&sum| sum <= pick).min(self.sources.len() - 1);
        let before = if index == 0 { 0.0 } else { self.cumulated[index - 1] };
        let chance = self.cumulated[index] - before;
        // What is left of the number that picked the source picks the triangle.
        let left = (((pick - before) / chance) as f32).clamp(0.0, 1.0 - f32::EPSILON);
        let emission = match &self.sources[index] {
            Source::Point { position, intensity } => Emission {
                origin: *position,
                front: None,
                size: 0.0,
                direction: sphere_direction([u, v]),
                is_delta: true,
                flux: 4.0 * PI as f32 * *intensity,
            },
            Source::Directional { direction, irradiance } => {
                let sent = self.parallel(unit(*direction)?, *irradiance, [a, b]);
                Emission { is_delta: true, ..sent }
            }
            Source::Rect { corner, edge_u, edge_v, radiance } => {
                let area = edge_u.cross(*edge_v).length();
                let normal = unit(edge_u.cross(*edge_v))?;
                Emission {
                    origin: *corner + f64::from(a) * *edge_u + f64::from(b) * *edge_v,
                    // It may hang in the plane of a ceiling.
                    front: Some(normal),
                    size: edge_u.length().max(edge_v.length()),
                    direction: cosine_direction(normal, [u, v]),
                    is_delta: false,
                    flux: (PI * area) as f32 * *radiance,
                }
            }
            Source::Emitters(emitters) => {
                let on = emitters.sample(left, [a, b]);
                Emission {
                    origin: on.point,
                    front: Some(on.normal),
                    size: on.size(),
                    direction: cosine_direction(on.normal, [u, v]),
                    is_delta: false,
                    flux: (PI / on.pdf) as f32 * on.radiance,
                }
            }
            Source::Sky(radiance) => {
                self.parallel(sphere_direction([u, v]), 4.0 * PI as f32 * *radiance, [a, b])
            }
        };
        Some(Emission { flux: (1.0 / chance) as f32 * emission.flux, ..emission })
    }

    /// Parallel light through the model's box.
    fn parallel(&self, direction: DVec3, irradiance: Vec3, [a, b]: [f32; 2]) -> Emission {
        let ([e, f], [reach_e, reach_f]) = self.across(direction);
        let back = DVec3::from(self.bounds.center()) - self.bounds.diagonal() * direction;
        let on = |number: f32, reach: f64| (2.0 * f64::from(number) - 1.0) * reach;
        Emission {
            origin: back + on(a, reach_e) * e + on(b, reach_f) * f,
            front: None,
            size: 0.0,
            direction,
            is_delta: false,
            flux: (4.0 * reach_e * reach_f) as f32 * irradiance,
        }
    }

    /// Two directions across `direction`, and half of the box's shadow along each.
    fn across(&self, direction: DVec3) -> ([DVec3; 2], [f64; 2]) {
        let (e, f) = direction.any_orthonormal_pair();
        let half = 0.5 * (DVec3::from(self.bounds.hi) - DVec3::from(self.bounds.lo));
        ([e, f], [e, f].map(|axis| half.dot(axis.abs())))
    }

    /// Flux of a source, W in linear RGB; of the sky about that.
    fn flux_of(&self, source: &Source<'_>) -> Vec3 {
        let (factor, light) = match source {
            Source::Point { intensity, .. } => (4.0 * PI, *intensity),
            Source::Directional { direction, irradiance } => {
                let [e, f] = unit(*direction).map_or([0.0; 2], |direction| self.across(direction).1);
                (4.0 * e * f, *irradiance)
            }
            Source::Rect { edge_u, edge_v, radiance, .. } => (PI * edge_u.cross(*edge_v).length(), *radiance),
            Source::Emitters(emitters) => (PI, emitters.radiance_area()),
            Source::Sky(radiance) => {
                let radius = 0.5 * self.bounds.diagonal();
                (4.0 * PI * PI * radius * radius, *radiance)
            }
        };
        factor as f32 * light
    }
}

#[cfg(test)]
mod tests {
    use super::super::scene_light::Light;
    use super::*;
    use crate::shading::light::Emitter;
    use std::f64::consts::TAU;
    use trex_store::Material;

    const BOUNDS: Aabb = Aabb { lo: [-1.0; 3], hi: [1.0, 1.0, -0.5] };

    /// Flux of photons whose straight way crosses the square of half side `half` at height -1 about the origin.
    fn caught(lights: &[Light], emitters: &[Emitter], half: f64) -> f64 {
        let lamp = Material { ke: [2.0; 3], ..Material::default() };
        let lights = Lights::new(lights, emitters, &[lamp], DVec3::Z).unwrap();
        let sources = PhotonSources::new(&lights, &BOUNDS).unwrap();
        let count = 1 << 16;
        let mut sum = 0.0;
        for index in 0..count {
            let start = sources.emit(&Sampler::new(5, [0, 0], index)).unwrap();
            let t = (-1.0 - start.origin[2]) / start.direction[2];
            let at = start.origin + t * start.direction;
            assert!((start.direction.length_squared() - 1.0).abs() < 1e-9);
            if t > 0.0 && at[0].abs() <= half && at[1].abs() <= half {
                sum += f64::from(start.flux[1]);
            }
        }
        sum / f64::from(count)
    }

    /// The share of a cosine emitter's light that a coaxial parallel square takes, per area of a tiny emitter.
    fn form_factor(half: f64, height: f64) -> f64 {
        let x = half / height;
        let root = (1.0 + x * x).sqrt();
        4.0 * 2.0 * (x / root * (x / root).atan()) / TAU
    }

    #[test]
    fn each_light_sends_its_flux() {
        let near = |found: f64, expected: f64| {
            assert!((found / expected - 1.0).abs() < 0.015, "{found} for {expected}");
        };
        let point = Light::Point { position: [0.0; 3], intensity: [3.0; 3] };
        // A cube's face is a sixth of all directions.
        near(caught(&[point], &[], 1.0), 4.0 * PI * 3.0 / 6.0);
        let sun = Light::Directional { direction: [0.3, -0.2, -0.7], irradiance: [5.0; 3] };
        let cos = 0.7 / DVec3::new(0.3, -0.2, -0.7).length();
        near(caught(&[sun], &[], 0.6), 5.0 * cos * 1.44);
        let sky = Light::Sky { radiance: [0.5; 3] };
        // From both sides.
        near(caught(&[sky], &[], 0.7), 2.0 * PI * 0.5 * 1.96);
        near(
            caught(&[sky, sun, point], &[], 0.7),
            (2.0 * PI * 0.5 + 5.0 * cos) * 1.96 + {
                let solid = 4.0 * (0.49 / (1.49f64 * 1.49).sqrt()).asin();
                3.0 * solid
            },
        );
        let (edge_u, edge_v) = ([0.0, 0.1, 0.0], [0.1, 0.0, 0.0]);
        let rect = Light::Rect { corner: [-0.05, -0.05, 0.0], edge_u, edge_v, radiance: [7.0; 3] };
        near(caught(&[rect], &[], 0.5), PI * 0.01 * 7.0 * form_factor(0.5, 1.0));
        let corners = [[-0.05, -0.05, 0.0], [0.0, 0.05, 0.0], [0.05, -0.05, 0.0]];
        near(caught(&[], &[Emitter { corners, material: 0 }], 0.5), PI * 0.005 * 2.0 * form_factor(0.5, 1.0));
    }

    #[test]
    fn darkness_has_no_photons() {
        let lights = Lights::new(&[Light::Sky { radiance: [0.0; 3] }], &[], &[], DVec3::Z).unwrap();
        assert!(PhotonSources::new(&lights, &BOUNDS).is_none());
    }
}
