//! `RenderSettings`: the numbers of a picture, in one place from the scene file or the flags to the integrator.
//!
//! Invariant: a [`RenderSettings`] has every key in its range, and no key beside an integrator that has no use for it.

use super::exposure::{AUTO, Exposure};
use super::key::{Key, KeyValue};
use super::keys;
use super::method::{Filter, LightRig, Method, Near, Shadows, UpAxis};
use crate::voxel::Occluders;
use std::ops::Deref;
use trex_store::Result;

/// The numbers of a picture as a scene file or flags give them, by the names of the scene's keys; unchecked. Ranges,
/// units and who uses what: [`keys`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[expect(missing_docs, reason = "each is the key of that name of `keys`")]
pub struct RenderKeys {
    pub integrator: Method,
    pub light: LightRig,
    pub up: UpAxis,
    pub resolution: [u32; 2],
    pub spp: u32,
    pub n_shadow: u32,
    pub n_gather: u32,
    pub photons: u64,
    pub k_nearest: u32,
    pub bake: bool,
    pub caustics: bool,
    pub near: Near,
    pub shadows: Shadows,
    pub occluders: Occluders,
    pub lod_error: f64,
    pub filter: Filter,
    pub exposure: Exposure,
    pub seed: u64,
}

impl Default for RenderKeys {
    fn default() -> RenderKeys {
        RenderKeys {
            integrator: Method::Direct,
            light: LightRig::Scene,
            up: UpAxis::Auto,
            resolution: [1024, 1024],
            spp: 16,
            n_shadow: 2,
            n_gather: 2,
            photons: 1 << 21,
            // H. W. Jensen's own number for pictures with final gathering.
            k_nearest: 50,
            bake: false,
            caustics: false,
            near: Near::Contact,
            shadows: Shadows::Mesh,
            occluders: Occluders::On,
            lod_error: 0.0,
            filter: Filter::Off,
            exposure: Exposure::Factor(1.0),
            seed: 1,
        }
    }
}

impl RenderKeys {
    /// Each key with its value, in the order of the table.
    pub fn values(&self) -> [(&'static Key, KeyValue); 18] {
        [
            (&keys::INTEGRATOR, KeyValue::Choice(self.integrator.as_str())),
            (&keys::LIGHT, KeyValue::Choice(self.light.as_str())),
            (&keys::UP, KeyValue::Choice(self.up.as_str())),
            (&keys::RESOLUTION, KeyValue::Pair(self.resolution)),
            (&keys::SPP, KeyValue::Count(self.spp.into())),
            (&keys::N_SHADOW, KeyValue::Count(self.n_shadow.into())),
            (&keys::N_GATHER, KeyValue::Count(self.n_gather.into())),
            (&keys::PHOTONS, KeyValue::Count(self.photons)),
            (&keys::K_NEAREST, KeyValue::Count(self.k_nearest.into())),
            (&keys::BAKE, KeyValue::Flag(self.bake)),
            (&keys::CAUSTICS, KeyValue::Flag(self.caustics)),
            (&keys::NEAR, KeyValue::Choice(self.near.as_str())),
            (&keys::SHADOWS, KeyValue::Choice(self.shadows.as_str())),
            (&keys::OCCLUDERS, KeyValue::Choice(self.occluders.as_str())),
            (&keys::LOD_ERROR, KeyValue::Number(self.lod_error)),
            (&keys::FILTER, KeyValue::Choice(self.filter.as_str())),
            (&keys::EXPOSURE, value_of(self.exposure)),
            (&keys::SEED, KeyValue::Count(self.seed)),
        ]
    }

    /// The value of `key`; `None` for the quality, which stands for many.
    pub fn value(&self, key: &Key) -> Option<KeyValue> {
        self.values().into_iter().find(|(found, _)| found.name == key.name).map(|(_, value)| value)
    }

    /// Checks that each key is in its range.
    ///
    /// # Errors
    /// Those of [`Key::check`].
    pub fn check_ranges(&self) -> Result<()> {
        self.values().into_iter().try_for_each(|(key, value)| key.check(value))
    }
}

/// An exposure as the value of its key.
fn value_of(exposure: Exposure) -> KeyValue {
    match exposure {
        Exposure::Auto => KeyValue::Choice(AUTO),
        Exposure::Factor(factor) => KeyValue::Number(shortest(factor)),
    }
}

/// The number of double precision that is written as `number` is: 0.1, not 0.10000000149011612.
fn shortest(number: f32) -> f64 {
    number.to_string().parse().expect("numbers are read as they are written")
}

/// The numbers of a picture, checked: each in its range, and all of them together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings(RenderKeys);

impl RenderSettings {
    /// Checked settings.
    ///
    /// # Errors
    /// Those of [`Key::check`] and [`Key::check_beside`].
    pub fn new(keys: RenderKeys) -> Result<RenderSettings> {
        keys.check_ranges()?;
        keys.values().into_iter().try_for_each(|(key, value)| key.check_beside(keys.integrator, value))?;
        Ok(RenderSettings(keys))
    }
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings::new(RenderKeys::default()).expect("the defaults go together")
    }
}

impl Deref for RenderSettings {
    type Target = RenderKeys;

    fn deref(&self) -> &RenderKeys {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::Code;

    #[track_caller]
    fn check(keys: RenderKeys, place: &str) {
        let error = RenderSettings::new(keys).unwrap_err();
        assert_eq!((error.code(), error.place()), (Code::SceneFormat, place), "{error}");
        assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty());
    }

    #[test]
    fn keys_that_do_not_go_together_are_refused() {
        let keys = RenderKeys::default();
        check(RenderKeys { filter: Filter::On, integrator: Method::Path, ..keys }, "render.filter");
        check(RenderKeys { bake: true, integrator: Method::FullGi, ..keys }, "render.bake");
        let photons = (1 << 30) + 1;
        check(RenderKeys { photons, integrator: Method::FullGi, ..keys }, "render.photons");
        assert!(RenderSettings::new(RenderKeys { photons, integrator: Method::Photon, ..keys }).is_ok());
    }

    /// A seed that a scene file cannot say passed the gate: the page could not save the view.
    #[test]
    fn both_ends_of_each_range_are_in_it() {
        type Give = fn(u64, RenderKeys) -> RenderKeys;
        let ranges: [(&str, Give, u64, u64); 7] = [
            ("spp", |n, keys| RenderKeys { spp: n as u32, ..keys }, 1, 1_000_000_000),
            ("n_shadow", |n, keys| RenderKeys { n_shadow: n as u32, ..keys }, 0, 4096),
            ("n_gather", |n, keys| RenderKeys { n_gather: n as u32, ..keys }, 0, 4096),
            ("photons", |n, keys| RenderKeys { photons: n, ..keys }, 1, 1 << 40),
            ("k_nearest", |n, keys| RenderKeys { k_nearest: n as u32, ..keys }, 2, 1024),
            ("resolution", |n, keys| RenderKeys { resolution: [n as u32, 9], ..keys }, 1, 65_536),
            ("seed", |n, keys| RenderKeys { seed: n, ..keys }, 0, (1 << 63) - 1),
        ];
        let keys = RenderKeys::default();
        for (name, give, least, most) in ranges {
            let place = format!("render.{name}");
            for inside in [least, most] {
                assert!(RenderSettings::new(give(inside, keys)).is_ok(), "{place} {inside}");
            }
            for outside in least.checked_sub(1).into_iter().chain([most + 1]) {
                check(give(outside, keys), &place);
            }
        }
        for lod_error in [-1.0, f64::NAN, 1024.5] {
            check(RenderKeys { lod_error, ..keys }, "render.lod_error");
        }
        for exposure in [0.0, f32::NAN, f32::INFINITY] {
            let exposure = Exposure::Factor(exposure);
            check(RenderKeys { exposure, ..keys }, "render.exposure");
        }
        check(RenderKeys { resolution: [5, 65_537], ..keys }, "render.resolution");
    }
}
