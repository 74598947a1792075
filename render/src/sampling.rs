//! Directions drawn from numbers in [0, 1): by the cosine, by a lobe, over the sphere.
//!
//! Invariant: a direction has length 1 to rounding, and the density that its function states.

use glam::DVec3;
use std::f64::consts::TAU;

/// A unit direction about unit `normal` with density `cos / pi`, from two numbers in [0, 1).
pub(crate) fn cosine_direction(normal: DVec3, u: [f32; 2]) -> DVec3 {
    let (a, b) = normal.any_orthonormal_pair();
    let (radius, angle) = (f64::from(u[0]).sqrt(), TAU * f64::from(u[1]));
    let height = (1.0 - f64::from(u[0])).sqrt();
    height * normal + radius * angle.cos() * a + radius * angle.sin() * b
}

/// A unit direction about unit `axis` with density `(ns + 1) / (2 pi) cos^ns`, from two numbers in [0, 1).
pub(crate) fn lobe_direction(axis: DVec3, ns: f32, u: [f32; 2]) -> DVec3 {
    let (a, b) = axis.any_orthonormal_pair();
    let height = (1.0 - f64::from(u[0])).powf(1.0 / (f64::from(ns) + 1.0));
    let (radius, angle) = ((1.0 - height * height).max(0.0).sqrt(), TAU * f64::from(u[1]));
    height * axis + radius * angle.cos() * a + radius * angle.sin() * b
}

/// A unit direction, each as likely as any other (density `1 / (4 pi)`), from two numbers in [0, 1).
pub(crate) fn sphere_direction([u, v]: [f32; 2]) -> DVec3 {
    let height = 1.0 - 2.0 * f64::from(u);
    let (radius, angle) = ((1.0 - height * height).max(0.0).sqrt(), TAU * f64::from(v));
    DVec3::new(radius * angle.cos(), radius * angle.sin(), height)
}
