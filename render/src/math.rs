//! Three-vectors: f64 for geometry, f32 for light.
//!
//! Invariant: directions that leave [`unit`] and [`basis`] have length 1 to rounding.

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

/// The direction of `a`; `None` when it has none (zero, not finite, or too short to square).
pub(crate) fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let most = a.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    if !most.is_finite() || most < f64::MIN_POSITIVE || a.iter().any(|x| x.is_nan()) {
        return None;
    }
    let scaled = a.map(|x| x / most);
    Some(scale(1.0 / length(scaled), scaled))
}

/// `direction` mirrored about the plane with unit normal `normal`.
pub(crate) fn reflect(direction: [f64; 3], normal: [f64; 3]) -> [f64; 3] {
    along(direction, -2.0 * dot(direction, normal), normal)
}

/// Two unit vectors that make a right-handed frame with unit `normal` as its third.
/// T. Duff et al., "Building an orthonormal basis, revisited", JCGT 6 (2017).
pub(crate) fn basis(normal: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let [x, y, z] = normal;
    let sign = 1f64.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    ([1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y])
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

/// Right and front of a model with this unit `up`: (+x, +z) for +y up, (+x, -y) for +z up.
pub(crate) fn ground_axes(up: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let other = if up[0].abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, -1.0] };
    let front = unit(cross(other, up)).expect("not along up");
    (cross(up, front), front)
}

/// One number for how much light a colour is: the mean, so that no colour counts as dark.
pub(crate) fn brightness(rgb: [f32; 3]) -> f64 {
    rgb.iter().map(|&x| f64::from(x)).sum::<f64>() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_is_right_handed_and_orthonormal() {
        for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]] {
            let (u, v) = basis(normal);
            for (a, b, expected) in
                [(u, u, 1.0), (v, v, 1.0), (u, v, 0.0), (u, normal, 0.0), (v, normal, 0.0)]
            {
                assert!((dot(a, b) - expected).abs() < 1e-12);
            }
            assert!((dot(cross(u, v), normal) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn unit_takes_tiny_and_huge_but_not_nothing() {
        for size in [1e-300, 1.0, 1e300] {
            assert!((length(unit([size, -size, size]).unwrap()) - 1.0).abs() < 1e-12);
        }
        for none in [[0.0; 3], [f64::NAN, 1.0, 0.0], [f64::INFINITY, 0.0, 0.0]] {
            assert!(unit(none).is_none());
        }
    }
}
