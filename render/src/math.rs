//! What the renderer's vectors need beyond `glam`: `DVec3` (f64) for geometry, `Vec3` (f32) for light in linear RGB.
//!
//! The bytes of pictures rest on `glam` without its feature `fast-math`: componentwise products, sums from x to z,
//! nothing fused. Hence no `mul_add`, and no `Vec3A`, which computes as the machine's SIMD does.
//!
//! Invariant: directions that leave [`unit`] have length 1 to rounding.

use glam::{DVec3, Vec3};

/// The direction of `a`; `None` when it has none (zero, not finite, or too short to divide by).
///
/// Not `DVec3::try_normalize`: squares of components below 1e-154 or above 1e154 leave the range of f64.
pub(crate) fn unit(a: DVec3) -> Option<DVec3> {
    let most = a.abs().max_element();
    if !a.is_finite() || most < f64::MIN_POSITIVE {
        return None;
    }
    let scaled = a / most;
    Some(scaled.length_recip() * scaled)
}

/// Right and front of a model with this unit `up`: (+x, +z) for +y up, (+x, -y) for +z up.
pub(crate) fn ground_axes(up: DVec3) -> (DVec3, DVec3) {
    let other = if up.x.abs() < 0.9 { DVec3::X } else { DVec3::NEG_Z };
    let front = unit(other.cross(up)).expect("not along up");
    (up.cross(front), front)
}

/// One number for how much light a colour is: the mean, so that no colour counts as dark.
pub(crate) fn brightness(rgb: Vec3) -> f64 {
    rgb.as_dvec3().element_sum() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_takes_tiny_and_huge_but_not_nothing() {
        for size in [1e-300, 1.0, 1e300] {
            let direction = unit(DVec3::new(size, -size, size)).unwrap();
            assert!((direction.length() - 1.0).abs() < 1e-12);
        }
        for none in [DVec3::ZERO, DVec3::new(f64::NAN, 1.0, 0.0), DVec3::X * f64::INFINITY] {
            assert!(unit(none).is_none());
        }
    }
}
