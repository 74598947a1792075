//! `Mirrors`: a gather ray behind the mirrors that it has followed, through voxels and the mesh alike.
//!
//! ```text
//! no mirror yet    lamps are left out: the shadow rays of the surface that gathers bring their light
//! after a mirror   lamps count: no shadow ray looks for them there
//! ```
//!
//! Points and suns are met by no ray, so what they bring over a mirror to the surface that gathers is left out.
//!
//! Invariants: 1. the ray goes on by roulette, and over `BOUNCES_MAX` mirrors at most; 2. its roulette depends on
//! the ray alone, so that it ends alike whether it is asked alone or among many.

use super::roulette::{BOUNCES_MAX, MIRROR_CHANCE, survives};
use crate::shading::light::Lights;
use crate::trace::Ray;
use glam::Vec3;
use trex_film::mix;
use trex_store::Material;

/// Mirrors that a ray follows which is asked again from its beginning: what lies behind more of them is dark.
const WAITING_MAX: u32 = 8;

/// The mirrors behind a gather ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mirrors {
    count: u32,
    /// Most that are followed.
    most: u32,
    /// Share of the radiance at the ray's end that arrives where it began.
    pub(super) throughput: Vec3,
}

impl Mirrors {
    /// None yet, of a ray that a retry asks mirror by mirror, or that waits for nothing.
    pub(super) const NONE: Mirrors = Mirrors { count: 0, most: BOUNCES_MAX, throughput: Vec3::ONE };
    /// None yet, of a ray that may wait for pages and is asked again from its beginning: it follows few, so that their
    /// pages find room together.
    pub(super) const NONE_WAITING: Mirrors = Mirrors { most: WAITING_MAX, ..Mirrors::NONE };

    /// True when the ray comes straight from its end: lamps are left out.
    pub(super) fn is_none(&self) -> bool {
        self.count == 0
    }

    /// Radiance of the rectangle that `ray` ends at, if one is met before `t_max`.
    pub(super) fn lamp(&self, lights: &Lights, ray: &Ray, t_max: f64) -> Option<Vec3> {
        if self.is_none() { None } else { lights.seen(ray, t_max) }
    }

    /// Radiance that a surface itself gives to the ray, which has met its front or its back.
    pub(super) fn emitted(&self, material: &Material, is_front: bool) -> Vec3 {
        if !self.is_none() && is_front { Vec3::from(material.ke) } else { Vec3::ZERO }
    }

    /// True when the ray goes on from a surface of `material`, which `ray` has met: off a mirror, while anything is
    /// left of it.
    pub(super) fn follow(&mut self, ray: &Ray, material: &Material) -> bool {
        self.throughput *= Vec3::from(material.ks);
        if !material.mirror || self.throughput.max_element() == 0.0 || self.count == self.most {
            return false;
        }
        let goes_on = survives(&mut self.throughput, self.count, MIRROR_CHANCE, || number(ray, self.count));
        self.count += 1;
        goes_on
    }
}

/// A number in [0, 1) of a ray that has followed so many mirrors.
fn number(ray: &Ray, mirrors: u32) -> f32 {
    let places = ray.origin.iter().chain(&ray.direction);
    let key = places.fold(u64::from(mirrors), |key, place| mix(key ^ place.to_bits()));
    (key >> 40) as f32 / (1u64 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// A hall of two mirrors that keep r, at whose n-th mirror a lamp of 1 is met: r^n, by roulette on average.
    #[test]
    fn roulette_keeps_the_mean() {
        let mirror = Material { kd: [0.0; 3], ks: [0.9; 3], mirror: true, ..Material::default() };
        for mirrors in [1, 4, 12, 20] {
            let rays = 200_000;
            let mut sum = 0.0;
            for i in 0..rays {
                let mut way = Mirrors::NONE;
                let ray = Ray::new(DVec3::splat(f64::from(i)), DVec3::X, f64::INFINITY);
                if (0..mirrors).all(|_| way.follow(&ray, &mirror)) {
                    sum += f64::from(way.throughput.x);
                }
            }
            let (found, expected) = (sum / f64::from(rays), 0.9f64.powi(mirrors));
            assert!((found / expected - 1.0).abs() < 0.02, "{mirrors} mirrors: {found} for {expected}");
        }
    }

    #[test]
    fn even_mirrors_that_keep_all_end_a_ray() {
        let mirror = Material { kd: [0.0; 3], ks: [1.0; 3], mirror: true, ..Material::default() };
        let mut longest = 0;
        for i in 0..10_000 {
            let mut way = Mirrors::NONE;
            let ray = Ray::new(DVec3::splat(f64::from(i)), DVec3::X, f64::INFINITY);
            while way.follow(&ray, &mirror) {}
            longest = longest.max(way.count);
        }
        assert!((50..BOUNCES_MAX).contains(&longest), "{longest} mirrors");
    }
}
