//! The numbers of a picture, as they are told.
//!
//! Invariant: names are those of scene files.

use serde::Serialize;
use trex_render::{Filter, Near, Occluders, RenderKeys};

/// The numbers of a picture, all of them.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct SettingsText {
    integrator: &'static str,
    resolution: [u32; 2],
    spp: u32,
    n_shadow: u32,
    n_gather: u32,
    photons: u64,
    k_nearest: u32,
    bake: bool,
    near: Near,
    occluders: Occluders,
    lod_error: f64,
    filter: Filter,
    exposure: f32,
    seed: u64,
}

impl From<&RenderKeys> for SettingsText {
    fn from(keys: &RenderKeys) -> SettingsText {
        SettingsText {
            integrator: keys.integrator.as_str(),
            resolution: keys.resolution,
            spp: keys.spp,
            n_shadow: keys.n_shadow,
            n_gather: keys.n_gather,
            photons: keys.photons,
            k_nearest: keys.k_nearest,
            bake: keys.bake,
            near: keys.near,
            occluders: keys.occluders,
            lod_error: keys.lod_error,
            filter: keys.filter,
            exposure: keys.exposure,
            seed: keys.seed,
        }
    }
}
