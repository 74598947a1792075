//! Vectors of three numbers, and cameras that turn.

use trex_render::Camera;

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

pub(super) fn unit(v: [f64; 3]) -> [f64; 3] {
    v.map(|x| x / length(v))
}

pub(super) fn along(origin: [f64; 3], t: f64, direction: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|a| origin[a] + t * direction[a])
}

/// The camera after `turns` about the axis `up` through `center`.
pub(super) fn turned_about(center: [f64; 3], up: [f64; 3], camera: &Camera, turns: f64) -> Camera {
    let (sin, cos) = (turns * std::f64::consts::TAU).sin_cos();
    // Rodrigues.
    let turn = |point: [f64; 3]| {
        let v: [f64; 3] = std::array::from_fn(|a| point[a] - center[a]);
        let lift: f64 = (0..3).map(|a| v[a] * up[a]).sum();
        let across = cross(up, v);
        std::array::from_fn(|a| center[a] + cos * v[a] + sin * across[a] + (1.0 - cos) * lift * up[a])
    };
    Camera { position: turn(camera.position), target: turn(camera.target), ..*camera }
}
