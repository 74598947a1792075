//! How a surface scatters: modified Phong, `Kd/pi + Ks (n+2)/(2 pi) cos^n`, on both sides alike.
//! E. Lafortune and Y. Willems, "Using the modified Phong reflectance model for physically based rendering" (1994).
//!
//! Invariants: 1. the BSDF is symmetric in its two directions; 2. it reflects at most `kd + ks` <= 1 of what comes
//! from any direction; 3. the Ks of a mirror is its bounce, never a lobe.

use crate::math::{dot, reflect};
use std::f32::consts::{FRAC_1_PI, TAU};
use trex_store::Material;

/// The BSDF (1/sr, linear RGB) for unit directions away from the surface, both on the side of unit `normal`.
pub fn bsdf(material: &Material, normal: [f64; 3], to_viewer: [f64; 3], to_light: [f64; 3]) -> [f32; 3] {
    let glossy = if material.mirror { 0.0 } else { lobe(material.ns, normal, to_viewer, to_light) };
    std::array::from_fn(|c| material.kd[c] * FRAC_1_PI + material.ks[c] * glossy)
}

/// `(n + 2) / (2 pi) cos^n` of the angle between `to_light` and the mirror image of `to_viewer`.
fn lobe(ns: f32, normal: [f64; 3], to_viewer: [f64; 3], to_light: [f64; 3]) -> f32 {
    let cos = -dot(reflect(to_viewer, normal), to_light);
    if cos <= 0.0 { 0.0 } else { (ns + 2.0) / TAU * cos.min(1.0).powf(f64::from(ns)) as f32 }
}

/// True when the surface returns light that a shadow ray can bring: a pure mirror does not.
pub fn takes_shadow_rays(material: &Material) -> bool {
    let lobe = !material.mirror && material.ks.iter().any(|&k| k > 0.0);
    lobe || material.kd.iter().any(|&k| k > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::cosine_direction;

    const NORMAL: [f64; 3] = [0.0, 0.0, 1.0];

    /// Share of the light from `to_viewer` that is reflected, by cosine-weighted points: mean of `pi * bsdf`.
    fn albedo(material: &Material, to_viewer: [f64; 3]) -> f64 {
        let side = 512;
        let mut sum = 0.0;
        for i in 0..side * side {
            let u = [(i % side) as f32 + 0.5, (i / side) as f32 + 0.5].map(|x| x / side as f32);
            sum += f64::from(bsdf(material, NORMAL, to_viewer, cosine_direction(NORMAL, u))[0]);
        }
        std::f64::consts::PI * sum / f64::from(side * side)
    }

    #[test]
    fn never_more_light_leaves_than_came() {
        for ns in [0.0, 1.0, 10.0, 100.0] {
            let material = Material { kd: [0.8; 3], ks: [0.9; 3], ns, ..Material::default() }.checked();
            assert!((material.kd[0] + material.ks[0] - 1.0).abs() < 1e-6);
            for angle in [0.0f64, 0.7, 1.3, 1.55] {
                let share = albedo(&material, [angle.sin(), 0.0, angle.cos()]);
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
        let (a, b) = ([0.6, 0.0, 0.8], [0.0, -0.28, 0.96]);
        let (there, back) = (bsdf(&material, NORMAL, a, b), bsdf(&material, NORMAL, b, a));
        assert!((there[0] - back[0]).abs() < 1e-6);
    }
}
