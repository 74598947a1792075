//! Vectors as arrays, for the floors that do not take those of `glam` yet.

use glam::DVec3;

/// `a + s * b`.
pub(crate) fn along(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + s * b[i])
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

pub(crate) fn scale(s: f64, a: [f64; 3]) -> [f64; 3] {
    a.map(|x| s * x)
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

pub(crate) fn to_f64(a: [f32; 3]) -> [f64; 3] {
    a.map(f64::from)
}

pub(crate) fn add_rgb(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

pub(crate) fn mul_rgb(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] * b[i])
}

pub(crate) fn scale_rgb(s: f32, a: [f32; 3]) -> [f32; 3] {
    a.map(|x| s * x)
}

pub(crate) fn max_rgb(a: [f32; 3]) -> f32 {
    a[0].max(a[1]).max(a[2])
}

pub(crate) fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    super::unit(a.into()).map(|a| a.to_array())
}

pub(crate) fn reflect(direction: [f64; 3], normal: [f64; 3]) -> [f64; 3] {
    DVec3::from(direction).reflect(normal.into()).to_array()
}

pub(crate) fn basis(normal: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let (u, v) = DVec3::from(normal).any_orthonormal_pair();
    (u.to_array(), v.to_array())
}

pub(crate) fn ground_axes(up: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let (right, front) = super::ground_axes(up.into());
    (right.to_array(), front.to_array())
}

pub(crate) fn brightness(rgb: [f32; 3]) -> f64 {
    super::brightness(rgb.into())
}
