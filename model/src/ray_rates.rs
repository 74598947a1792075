//! `RayRates`: rays per second, by kind.

use serde::Serialize;
use trex_render::RayCounts;

/// Rays per second, by kind.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RayRates {
    /// Rays per second from the camera.
    pub primary: f64,
    /// Rays per second off perfect mirrors.
    pub mirror: f64,
    /// Rays per second towards lights.
    pub shadow: f64,
    /// Rays per second that gather light.
    pub gather: f64,
    /// Rays per second of photons.
    pub photon: f64,
}

impl RayRates {
    /// Rates of `rays` over `seconds`; those of photons over a time of their own.
    pub fn new(rays: &RayCounts, seconds: f64, photons_s: f64) -> RayRates {
        let rate = |count: u64| count as f64 / seconds.max(1e-9);
        RayRates {
            primary: rate(rays.primary),
            mirror: rate(rays.mirror),
            shadow: rate(rays.shadow),
            gather: rate(rays.gather),
            photon: rays.photon as f64 / photons_s.max(1e-9),
        }
    }
}
