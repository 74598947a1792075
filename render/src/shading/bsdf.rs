//! `Bsdf`: how a surface scatters: modified Phong, `Kd/pi + Ks (n+2)/(2 pi) cos^n`, on both sides alike.
//! E. Lafortune and Y. Willems, "Using the modified Phong reflectance model for physically based rendering" (1994).
//!
//! Where the mesh has normals of its own, the surface is shaded as if it were the smooth one that these are of: with
//! the cosine to the shading normal, and lobe and mirror around it. [`Bsdf::eval`] stays what callers multiply by the
//! cosine to the *plane* of the triangle, which alone says what is above the surface, and whose shadow it casts on
//! itself. From there the smooth surface goes dark before the light is in its plane, at a step, unless both cosines
//! agree: so it is damped by the smooth shadow term of M. Chiang, Y. K. Li and B. Burley, "Taming the Shadow
//! Terminator" (2019),
//!
//! ```text
//! G = min(1, 2 cos_plane / (cos_shading * cos_between))    factor = -G^3 + G^2 + G
//! ```
//!
//! which is 1 but near the plane's own horizon, and falls to 0 with the plane's cosine, so that a shadow ray that
//! starts on the plane finds no edge of the mesh in light. The 2 is not in the paper: without it each triangle that
//! faces the light less than the smooth surface there is darker than its neighbours, and edges are seen all over. On a
//! sphere of 320 triangles it halves the error against a true one, .0125 of full light without it, .0060 with it, .0047
//! undamped, which has the steps; planes have .0354. It needs nothing but the two normals: to move
//! the starts of shadow rays to the smooth surface would need that surface, and rays that start off the mesh leak.
//!
//! Invariants: 1. without shading normals the BSDF is symmetric in its two directions; 2. it reflects at most `kd + ks`
//! <= 1 of what comes from any direction; 3. the Ks of a mirror is its bounce, never a lobe; 4. [`Bsdf::pdf`] is the
//! density of what [`Bsdf::sample`] draws.

use crate::math::unit;
use crate::sampling::{cosine_direction, lobe_direction};
use glam::{DVec3, Vec3};
use std::f32::consts::{FRAC_1_PI, TAU};
use trex_store::Material;

/// The smooth surface is damped where the plane has less than one in so many parts of the light that its slope
/// explains.
const DAMPED_BELOW: f64 = 2.0;
/// Least cosine between the plane's normal and what a shading normal mirrors.
const MIRRORED_COS_LEAST: f64 = 0.01;

/// A material at a place, seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bsdf<'a> {
    pub(crate) material: &'a Material,
    /// What its `kd` is multiplied by, linear: at most 1, so that the surface reflects no more than its material.
    pub(crate) colour: Vec3,
    /// Unit normal of the plane, on the side that is looked at.
    pub(crate) normal: DVec3,
    /// Unit normal that shades, less than a right angle from it.
    pub(crate) shading_normal: DVec3,
    /// Unit direction to where the surface is looked at from, on the side of the normal.
    pub(crate) wo: DVec3,
}

/// A direction that light is looked for in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BsdfSample {
    /// Unit; on the side of the normal.
    pub(crate) wi: DVec3,
    /// `bsdf * cos / pdf`; of a mirror: what it reflects over the chance of choosing it.
    pub(crate) weight: Vec3,
    /// Density per solid angle; `None` for a mirror's one direction.
    pub(crate) pdf: Option<f64>,
}

impl Bsdf<'_> {
    /// The BSDF (1/sr, linear RGB) for light from unit `wi`, on the side of the normal: what the cosine to the plane is
    /// multiplied by.
    pub(crate) fn eval(&self, wi: DVec3) -> Vec3 {
        self.eval_with_lobe(wi, self.lobe(wi))
    }

    /// The cosine that shades over that to the plane, for a direction above the plane: 1 without a shading normal.
    fn bend(&self, wi: DVec3) -> f64 {
        if self.shading_normal == self.normal {
            return 1.0;
        }
        let (shading, plane) = (self.shading_normal.dot(wi), self.normal.dot(wi));
        if shading <= 0.0 || plane <= 0.0 {
            return 0.0;
        }
        let g = DAMPED_BELOW * plane / (shading * self.shading_normal.dot(self.normal));
        let damped = if g < 1.0 { g * (1.0 + g - g * g) } else { 1.0 };
        damped * shading / plane
    }

    fn kd(&self) -> Vec3 {
        self.colour * Vec3::from(self.material.kd)
    }

    fn eval_with_lobe(&self, wi: DVec3, lobe: f32) -> Vec3 {
        let smooth = self.kd() * FRAC_1_PI + Vec3::from(self.material.ks) * lobe;
        self.bend(wi) as f32 * smooth
    }

    /// The direction that a mirror would show.
    fn mirrored(&self) -> DVec3 {
        mirrored(self.wo, self.normal, self.shading_normal)
    }

    /// `(n + 2) / (2 pi) cos^n` of the angle between `wi` and the mirror image of `wo`; 0 where there is no lobe.
    fn lobe(&self, wi: DVec3) -> f32 {
        if !has_lobe(self.material) {
            return 0.0;
        }
        let cos = self.mirrored().dot(wi);
        if cos <= 0.0 {
            0.0
        } else {
            (self.material.ns + 2.0) / TAU * cos.min(1.0).powf(f64::from(self.material.ns)) as f32
        }
    }

    /// Draws a direction by what the surface scatters, from numbers in [0, 1); `None` when it goes nowhere (which
    /// counts as black).
    pub(crate) fn sample(&self, [pick, u, v, _]: [f32; 4]) -> Option<BsdfSample> {
        let diffuse = self.diffuse_chance()?;
        let mirrored = self.mirrored();
        if f64::from(pick) >= diffuse && self.material.mirror {
            let weight = (1.0 / (1.0 - diffuse)) as f32 * Vec3::from(self.material.ks);
            return Some(BsdfSample { wi: mirrored, weight, pdf: None });
        }
        let wi = if f64::from(pick) < diffuse {
            cosine_direction(self.shading_normal, [u, v])
        } else {
            lobe_direction(mirrored, self.material.ns, [u, v])
        };
        let cos = wi.dot(self.normal);
        let lobe = self.lobe(wi);
        let pdf = self.pdf_with_lobe(diffuse, wi.dot(self.shading_normal), lobe);
        let weight = (cos / pdf) as f32 * self.eval_with_lobe(wi, lobe);
        (cos > 0.0 && pdf > 0.0).then_some(BsdfSample { wi, weight, pdf: Some(pdf) })
    }

    /// Draws a direction for light from everywhere, as [`Bsdf::sample`] but never the mirror's one direction. Drawing
    /// the sky by this and not by the cosine keeps shiny materials free of sparks. Its `pdf` is always there.
    pub(crate) fn sample_rough(&self, [pick, u, v]: [f32; 3]) -> Option<BsdfSample> {
        let rough = self.rough_chance()?;
        let drawn = self.sample([pick * rough as f32, u, v, 0.0])?;
        let pdf = Some(drawn.pdf? / rough);
        Some(BsdfSample { wi: drawn.wi, weight: rough as f32 * drawn.weight, pdf })
    }

    /// Density (per solid angle) with which [`Bsdf::sample`] draws unit `wi`, mirrors left out.
    pub(crate) fn pdf(&self, wi: DVec3) -> f64 {
        let Some(diffuse) = self.diffuse_chance() else { return 0.0 };
        self.pdf_with_lobe(diffuse, self.shading_normal.dot(wi), self.lobe(wi))
    }

    /// Density (per solid angle) with which [`Bsdf::sample_rough`] draws unit `wi`.
    pub(crate) fn pdf_rough(&self, wi: DVec3) -> f64 {
        self.rough_chance().map_or(0.0, |rough| self.pdf(wi) / rough)
    }

    /// The density where the chance to scatter by the cosine, that cosine and the lobe are known.
    fn pdf_with_lobe(&self, diffuse: f64, cos: f64, lobe: f32) -> f64 {
        let cosine = diffuse * cos.max(0.0) * std::f64::consts::FRAC_1_PI;
        // The lobe's own factor is n + 2, that of its density n + 1.
        let ns = f64::from(self.material.ns);
        cosine + (1.0 - diffuse) * (f64::from(lobe) * (ns + 1.0) / (ns + 2.0))
    }

    /// Chance that [`Bsdf::sample`] does not choose the mirror's direction; `None` for what scatters nothing but that.
    fn rough_chance(&self) -> Option<f64> {
        let diffuse = self.diffuse_chance()?;
        let rough = if self.material.mirror { diffuse } else { 1.0 };
        (rough > 0.0).then_some(rough)
    }

    /// Chance to scatter by the cosine; `None` for black.
    fn diffuse_chance(&self) -> Option<f64> {
        let [kd, ks] = [self.kd(), self.material.ks.into()].map(|rgb| f64::from(Vec3::max_element(rgb)));
        (kd + ks > 0.0).then(|| kd / (kd + ks))
    }
}

/// The direction in which a surface mirrors unit `wo`, by its shading normal, but above its plane.
pub(crate) fn mirrored(wo: DVec3, normal: DVec3, shading_normal: DVec3) -> DVec3 {
    let mirrored = (-wo).reflect(shading_normal);
    if shading_normal == normal {
        return mirrored;
    }
    lifted(mirrored, normal, (0.9 * wo.dot(normal)).min(MIRRORED_COS_LEAST))
}

/// Unit `direction`, brought so near to unit `normal` that the cosine between them is about `least`, where it is less.
pub(crate) fn lifted(direction: DVec3, normal: DVec3, least: f64) -> DVec3 {
    let cos = direction.dot(normal);
    if cos >= least {
        return direction;
    }
    unit(direction + (least - cos) * normal).unwrap_or(normal)
}

/// The BSDF of a diffuse surface that reflects as much as `material` does on average over all directions: what a place
/// looks like to a ray that asks only for its irradiance.
pub(crate) fn diffuse_equivalent(material: &Material, colour: Vec3) -> Vec3 {
    let glossy = if material.mirror { 0.0 } else { hemispherical_albedo(material.ns) };
    (colour * Vec3::from(material.kd) + glossy * Vec3::from(material.ks)) * FRAC_1_PI
}

/// Share of light from everywhere that a lobe of Ks = 1 reflects: at grazing angles half of it points into the
/// surface. From 5/6 for n = 0 to 2/3 for a sharp one; fitted to the integral, to 5e-4.
fn hemispherical_albedo(ns: f32) -> f32 {
    2.0 / 3.0 + 1.0 / (6.0 + ns * (7.4 + 0.75 * ns))
}

fn has_lobe(material: &Material) -> bool {
    !material.mirror && material.ks.iter().any(|&k| k > 0.0)
}

/// True when the surface returns light that a shadow ray can bring: a pure mirror does not.
pub(crate) fn takes_shadow_rays(material: &Material) -> bool {
    has_lobe(material) || material.kd.iter().any(|&k| k > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integral over all pairs of directions, by the middles of equal shares of cosine-weighted directions.
    #[test]
    fn on_average_a_lobe_reflects_its_albedo() {
        const SHARES: usize = 128;
        let direction = |i: usize, j: usize| {
            let [u, v] = [i, j].map(|x| (x as f64 + 0.5) / SHARES as f64);
            let (sin, phi) = (u.sqrt(), v * std::f64::consts::TAU);
            DVec3::new(sin * phi.cos(), sin * phi.sin(), (1.0 - u).sqrt())
        };
        for ns in [0.0, 0.5, 1.0, 3.0, 10.0, 40.0] {
            let material = Material { kd: [0.0; 3], ks: [1.0; 3], ns, ..Material::default() };
            let mut sum = 0.0;
            for from in (0..SHARES).map(|i| direction(i, 0)) {
                for to in (0..SHARES * SHARES).map(|i| direction(i / SHARES, i % SHARES)) {
                    sum += f64::from(
                        Bsdf {
                            material: &material,
                            colour: Vec3::ONE,
                            normal: NORMAL,
                            shading_normal: NORMAL,
                            wo: from,
                        }
                        .eval(to)[0],
                    );
                }
            }
            let mean = sum / (SHARES * SHARES * SHARES) as f64;
            let (integral, fit) = (mean as f32, diffuse_equivalent(&material, Vec3::ONE)[0]);
            assert!(
                (integral / fit - 1.0).abs() < 5e-3,
                "n {ns}: {integral} by integration, {fit} by the fit"
            );
        }
    }

    const NORMAL: DVec3 = DVec3::Z;

    fn at(material: &Material, wo: DVec3) -> Bsdf<'_> {
        Bsdf { material, colour: Vec3::ONE, normal: NORMAL, shading_normal: NORMAL, wo }
    }

    /// Share of the light from `wo` that is reflected, by cosine-weighted points: mean of `pi * bsdf`.
    fn albedo(material: &Material, wo: DVec3) -> f64 {
        let side = 512;
        let mut sum = 0.0;
        for i in 0..side * side {
            let u = [(i % side) as f32 + 0.5, (i / side) as f32 + 0.5].map(|x| x / side as f32);
            sum += f64::from(at(material, wo).eval(cosine_direction(NORMAL, u))[0]);
        }
        std::f64::consts::PI * sum / f64::from(side * side)
    }

    #[test]
    fn never_more_light_leaves_than_came() {
        for ns in [0.0, 1.0, 10.0, 100.0] {
            let material = Material { kd: [0.8; 3], ks: [0.9; 3], ns, ..Material::default() }.checked();
            assert!((material.kd[0] + material.ks[0] - 1.0).abs() < 1e-6);
            for angle in [0.0f64, 0.7, 1.3, 1.55] {
                let share = albedo(&material, DVec3::new(angle.sin(), 0.0, angle.cos()));
                assert!(share < 1.003, "ns {ns}, angle {angle}: {share}");
            }
        }
    }

    #[test]
    fn straight_on_a_glossy_surface_returns_all_of_ks() {
        let material = Material { kd: [0.0; 3], ks: [0.5; 3], ns: 20.0, ..Material::default() }.checked();
        // (n + 2) / (2 pi) * integral of cos^n cos = 1: what the factor is for.
        let share = albedo(&material, NORMAL);
        assert!((share - 0.5).abs() < 1e-3, "{share}");
    }

    #[test]
    fn viewer_and_light_may_change_places() {
        let material = Material { ks: [0.2; 3], ns: 7.0, ..Material::default() }.checked();
        let (a, b) = (DVec3::new(0.6, 0.0, 0.8), DVec3::new(0.0, -0.28, 0.96));
        let (there, back) = (at(&material, a).eval(b), at(&material, b).eval(a));
        assert!((there[0] - back[0]).abs() < 1e-6);
    }

    /// Seen along the shading normal, which leans to x by 0.3 rad: as `at` elsewhere.
    fn leaning(material: &Material) -> Bsdf<'_> {
        let shading_normal = DVec3::new(0.3f64.sin(), 0.0, 0.3f64.cos());
        Bsdf { material, colour: Vec3::ONE, normal: NORMAL, shading_normal, wo: shading_normal }
    }

    /// All around the horizon of the plane light goes out without a step, whichever way the shading normal leans; it is
    /// never more than that of the smooth surface, and the same where the plane is well lit.
    #[test]
    fn the_terminator_has_no_step() {
        let material = Material { kd: [1.0; 3], ks: [0.0; 3], ..Material::default() };
        let bsdf = leaning(&material);
        let light = |around: f64, up: f64| {
            let wi = DVec3::new(around.cos() * up.cos(), around.sin() * up.cos(), up.sin());
            let returned = f64::from(bsdf.eval(wi)[0]) * std::f64::consts::PI * wi.z;
            (returned, bsdf.shading_normal.dot(wi).max(0.0))
        };
        for around in (0..64).map(|i| f64::from(i) * std::f64::consts::TAU / 64.0) {
            let mut before = 0.0;
            for step in 1..=1570 {
                let up = f64::from(step) * 1e-3;
                let (returned, smooth) = light(around, up);
                assert!(returned <= smooth + 1e-6, "{around} {up}: {returned} of {smooth}");
                assert!((returned - before).abs() < 5e-3, "{around} {up}: {before} to {returned}");
                let is_well_lit = up.sin() > smooth * 0.5;
                assert!(!is_well_lit || returned > smooth - 1e-6, "{around} {up}: {returned} of {smooth}");
                before = returned;
            }
            assert_eq!(bsdf.eval(DVec3::new(around.cos(), around.sin(), -0.1)), Vec3::ZERO);
        }
    }

    /// What is drawn under a shading normal is above the plane, weighs what is returned over its density, and is no
    /// more light than came; mirrors show what is above the plane.
    #[test]
    fn shading_normals_return_no_more_than_came() {
        let glossy = Material { kd: [0.4; 3], ks: [0.6; 3], ns: 12.0, ..Material::default() }.checked();
        for lean in [0.1f64, 0.7, 1.4] {
            for angle in [-1.5f64, -0.8, 0.0, 0.8, 1.5] {
                let shading_normal = DVec3::new(lean.sin(), 0.0, lean.cos());
                let wo = DVec3::new(angle.sin(), 0.0, angle.cos());
                let bsdf = Bsdf { shading_normal, wo, ..leaning(&glossy) };
                let (side, mut sum) = (40, 0.0);
                for i in 0..side * side * side {
                    let number = |i: i32| (i as f32 + 0.5) / side as f32;
                    let u = [number(i % side), number(i / side % side), number(i / side / side), 0.0];
                    let Some(drawn) = bsdf.sample(u) else { continue };
                    let returned = f64::from(bsdf.eval(drawn.wi)[0]) * drawn.wi.z / bsdf.pdf(drawn.wi);
                    assert!(drawn.wi.z > 0.0 && (returned - f64::from(drawn.weight[0])).abs() < 1e-4);
                    sum += returned / f64::from(side).powi(3);
                }
                assert!(sum < 1.003, "lean {lean}, from {angle}: {sum}");
                assert!(bsdf.mirrored().dot(NORMAL) > 0.0);
            }
        }
    }

    #[test]
    fn what_is_drawn_has_the_density_that_is_told() {
        let glossy = Material { kd: [0.3; 3], ks: [0.5; 3], ns: 12.0, ..Material::default() }.checked();
        let wo = DVec3::new(0.6, 0.0, 0.8);
        // The mean weight is the albedo, the mean of 1 / density the solid angle of the hemisphere.
        let (side, mut weight, mut solid_angle) = (48, 0.0, 0.0);
        for i in 0..side * side * side {
            let number = |i: i32| (i as f32 + 0.5) / side as f32;
            let u = [number(i % side), number(i / side % side), number(i / side / side), 0.0];
            if let Some(drawn) = at(&glossy, wo).sample(u) {
                weight += f64::from(drawn.weight[0]) / f64::from(side).powi(3);
                solid_angle += 1.0 / drawn.pdf.unwrap() / f64::from(side).powi(3);
            }
        }
        let expected = albedo(&glossy, wo);
        assert!((weight / expected - 1.0).abs() < 5e-3, "{weight} for {expected}");
        assert!((solid_angle / std::f64::consts::TAU - 1.0).abs() < 5e-2, "{solid_angle}");
    }
}
