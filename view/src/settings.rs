//! The numbers of a picture, as pages change them and as they are told.
//!
//! Invariant: names are those of scene files.

use serde::{Deserialize, Serialize};
use trex_render::{Filter, Method, Near, Occluders, RenderKeys, RenderSettings};
use trex_store::Result;

/// Changes to the numbers of a picture; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct SettingsEdit {
    integrator: Option<Method>,
    spp: Option<u32>,
    n_shadow: Option<u32>,
    n_gather: Option<u32>,
    photons: Option<u64>,
    k_nearest: Option<u32>,
    bake: Option<bool>,
    near: Option<Near>,
    occluders: Option<Occluders>,
    lod_error: Option<f64>,
    filter: Option<Filter>,
    exposure: Option<f32>,
    seed: Option<u64>,
}

impl SettingsEdit {
    /// `keys` with these changes. What an integrator has no use for is turned off when it is changed to.
    ///
    /// # Errors
    /// Those of [`RenderSettings::new`].
    pub(crate) fn settings(&self, keys: &RenderKeys) -> Result<RenderSettings> {
        let integrator = self.integrator.unwrap_or(keys.integrator);
        let (mut bake, mut filter) = (keys.bake, keys.filter);
        if integrator != keys.integrator {
            bake &= integrator == Method::Photon;
            filter = if integrator.gathers() { filter } else { Filter::Off };
        }
        RenderSettings::new(RenderKeys {
            integrator,
            resolution: keys.resolution,
            spp: self.spp.unwrap_or(keys.spp),
            n_shadow: self.n_shadow.unwrap_or(keys.n_shadow),
            n_gather: self.n_gather.unwrap_or(keys.n_gather),
            photons: self.photons.unwrap_or(keys.photons),
            k_nearest: self.k_nearest.unwrap_or(keys.k_nearest),
            bake: self.bake.unwrap_or(bake),
            near: self.near.unwrap_or(keys.near),
            occluders: self.occluders.unwrap_or(keys.occluders),
            lod_error: self.lod_error.unwrap_or(keys.lod_error),
            filter: self.filter.unwrap_or(filter),
            exposure: self.exposure.unwrap_or(keys.exposure),
            seed: self.seed.unwrap_or(keys.seed),
        })
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_integrator_takes_what_it_has_no_use_for_off() {
        let keys = RenderKeys {
            integrator: Method::Photon,
            filter: Filter::On,
            bake: true,
            ..RenderKeys::default()
        };
        let edit = SettingsEdit { integrator: Some(Method::Direct), ..SettingsEdit::default() };
        let settings = edit.settings(&keys).unwrap();
        assert_eq!((settings.filter, settings.bake), (Filter::Off, false));
        let edit = SettingsEdit { filter: Some(Filter::On), ..edit };
        assert_eq!(edit.settings(&keys).unwrap_err().place(), "render.filter");
    }
}
