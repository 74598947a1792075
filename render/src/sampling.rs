//! Directions drawn from numbers in [0, 1): by the cosine, by a lobe, over the sphere.
//!
//! Invariant: a direction has length 1 to rounding, and the density that its function states.

use crate::math::arrays::{along, basis, scale};
use std::f64::consts::TAU;

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

/// A unit direction of a sphere, with density `1 / (4 pi)`, from two numbers in [0, 1).
pub(crate) fn sphere_direction([u, v]: [f32; 2]) -> [f64; 3] {
    let height = 1.0 - 2.0 * f64::from(u);
    let (radius, angle) = ((1.0 - height * height).max(0.0).sqrt(), TAU * f64::from(v));
    let across = scale(radius, [angle.cos(), angle.sin(), 0.0]);
    [across[0], across[1], height]
}
