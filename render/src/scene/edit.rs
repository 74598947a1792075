//! `RenderEdit`: changes to the numbers of a picture, as scenes, flags and pages give them; `Quality`: many at once.
//!
//! Invariants: 1. names are those of scene files; 2. what an integrator has no use for is turned off when it is changed
//! to, unless it is asked for.

use super::settings::{Filter, Method, Near, RenderKeys};
use crate::voxel::Occluders;
use serde::Deserialize;

/// A trade of time for accuracy, by name: where each lies between others is measured (`docs/performance.md`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A look in the shortest time that shows all light.
    Draft,
    /// A picture to work with: what is shown where nothing is asked for.
    Normal,
    /// What others are measured by: all light, unbiased, and noise alone.
    Reference,
}

impl Quality {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Quality::Draft => "draft",
            Quality::Normal => "normal",
            Quality::Reference => "reference",
        }
    }

    /// `keys` with all that trades time for accuracy as this says. Resolution, exposure and seed stay; so does the
    /// error of the footprint rule with [`Quality::Normal`], since pictures and sessions differ in it.
    #[must_use]
    pub fn apply(self, keys: &RenderKeys) -> RenderKeys {
        let RenderKeys { resolution, lod_error, exposure, seed, .. } = *keys;
        let normal = RenderKeys {
            integrator: Method::Photon,
            resolution,
            lod_error,
            exposure,
            seed,
            photons: 1 << 20,
            filter: Filter::On,
            ..RenderKeys::default()
        };
        match self {
            Quality::Draft => RenderKeys {
                spp: 4,
                n_shadow: 1,
                n_gather: 1,
                photons: 1 << 18,
                lod_error: lod_error.max(1.0),
                ..normal
            },
            Quality::Normal => normal,
            Quality::Reference => RenderKeys {
                integrator: Method::Path,
                spp: 256,
                lod_error: 0.0,
                filter: Filter::Off,
                ..normal
            },
        }
    }
}

/// Changes to the numbers of a picture; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[expect(missing_docs, reason = "each is the key of that name of RenderKeys")]
pub struct RenderEdit {
    /// Many at once; the others go before it.
    pub quality: Option<Quality>,
    pub integrator: Option<Method>,
    pub resolution: Option<[u32; 2]>,
    pub spp: Option<u32>,
    pub n_shadow: Option<u32>,
    pub n_gather: Option<u32>,
    pub photons: Option<u64>,
    pub k_nearest: Option<u32>,
    pub bake: Option<bool>,
    pub near: Option<Near>,
    pub occluders: Option<Occluders>,
    pub lod_error: Option<f64>,
    pub filter: Option<Filter>,
    pub exposure: Option<f32>,
    pub seed: Option<u64>,
}

impl RenderEdit {
    /// `keys` with these changes, unchecked.
    #[must_use]
    pub fn apply(&self, keys: &RenderKeys) -> RenderKeys {
        let keys = self.quality.map_or(*keys, |quality| quality.apply(keys));
        let integrator = self.integrator.unwrap_or(keys.integrator);
        let (mut bake, mut filter) = (keys.bake, keys.filter);
        if integrator != keys.integrator {
            bake &= integrator == Method::Photon;
            filter = if integrator.gathers() { filter } else { Filter::Off };
        }
        RenderKeys {
            integrator,
            resolution: self.resolution.unwrap_or(keys.resolution),
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
        }
    }

    /// True when the way in which light is computed is asked for.
    pub fn says_integrator(&self) -> bool {
        self.integrator.is_some() || self.quality.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::settings::RenderSettings;

    #[test]
    fn every_quality_is_a_picture() {
        let keys = RenderKeys { resolution: [7, 5], exposure: 2.0, seed: 9, ..RenderKeys::default() };
        for quality in [Quality::Draft, Quality::Normal, Quality::Reference] {
            let edit = RenderEdit { quality: Some(quality), ..RenderEdit::default() };
            let settings = RenderSettings::new(edit.apply(&keys)).unwrap();
            assert_eq!((settings.resolution, settings.exposure, settings.seed), ([7, 5], 2.0, 9));
            assert!(settings.integrator != Method::Direct, "{quality:?} has all light");
        }
    }

    #[test]
    fn what_is_said_goes_before_a_quality() {
        let said = RenderEdit { quality: Some(Quality::Draft), spp: Some(77), ..RenderEdit::default() };
        let keys = RenderKeys { spp: 5, n_gather: 9, ..RenderKeys::default() };
        assert_eq!((said.apply(&keys).spp, said.apply(&keys).n_gather), (77, 1));
    }

    #[test]
    fn an_integrator_takes_what_it_has_no_use_for_off() {
        let keys = RenderKeys {
            integrator: Method::Photon,
            filter: Filter::On,
            bake: true,
            ..RenderKeys::default()
        };
        let to = |integrator| RenderEdit { integrator: Some(integrator), ..RenderEdit::default() };
        let direct = RenderSettings::new(to(Method::Direct).apply(&keys)).unwrap();
        assert!(direct.filter == Filter::Off && !direct.bake);
        let full = RenderSettings::new(to(Method::FullGi).apply(&keys)).unwrap();
        assert!(full.filter == Filter::On && !full.bake);
        let asked = RenderEdit { filter: Some(Filter::On), ..to(Method::Direct) };
        assert!(RenderSettings::new(asked.apply(&keys)).is_err());
    }
}
