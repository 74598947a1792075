//! `RenderEdit`: changes to the numbers of a picture, as scenes, flags and pages give them; `Quality`: many at once.
//!
//! Invariants: 1. names are those of scene files; 2. what an integrator has no use for is turned off when it is changed
//! to, unless it is asked for.

use super::exposure::Exposure;
use super::key::{Key, KeyValue};
use super::keys;
use super::method::{Filter, LightRig, Method, Near, Shadows, UpAxis};
use super::settings::RenderKeys;
use crate::voxel::Occluders;
use serde::Deserialize;

/// A trade of time for accuracy, by name: where each lies between others is measured (`docs/performance.md`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quality {
    /// A look in the shortest time that shows all light.
    Draft,
    /// A picture to work with: what is shown where nothing is asked for.
    #[default]
    Normal,
    /// What others are measured by: all light, unbiased, and noise alone.
    Reference,
}

impl Quality {
    /// All of them.
    pub const ALL: [Quality; 3] = [Quality::Draft, Quality::Normal, Quality::Reference];

    /// The quality that `keys` are of, if they are of one.
    pub fn of(keys: &RenderKeys) -> Option<Quality> {
        Quality::ALL.into_iter().find(|quality| quality.apply(keys) == *keys)
    }

    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Quality::Draft => "draft",
            Quality::Normal => "normal",
            Quality::Reference => "reference",
        }
    }

    /// `keys` with all that trades time for accuracy as this says. Resolution, lamps, what is up, exposure and seed
    /// stay; so does the error of the footprint rule with [`Quality::Normal`], since pictures and sessions differ in
    /// it.
    #[must_use]
    pub fn apply(self, keys: &RenderKeys) -> RenderKeys {
        let RenderKeys { light, up, resolution, lod_error, exposure, seed, .. } = *keys;
        let normal = RenderKeys {
            integrator: Method::Photon,
            light,
            up,
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

impl Key {
    /// The value in a scene that says nothing.
    pub fn default_value(&self) -> KeyValue {
        let quality = Quality::default();
        let keys = quality.apply(&RenderKeys::default());
        keys.value(self).unwrap_or(KeyValue::Choice(quality.as_str()))
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
    pub light: Option<LightRig>,
    pub up: Option<UpAxis>,
    pub resolution: Option<[u32; 2]>,
    pub spp: Option<u32>,
    pub n_shadow: Option<u32>,
    pub n_gather: Option<u32>,
    pub photons: Option<u64>,
    pub k_nearest: Option<u32>,
    pub bake: Option<bool>,
    pub caustics: Option<bool>,
    pub near: Option<Near>,
    pub shadows: Option<Shadows>,
    pub occluders: Option<Occluders>,
    pub lod_error: Option<f64>,
    pub filter: Option<Filter>,
    pub exposure: Option<Exposure>,
    pub seed: Option<u64>,
}

/// The changes that give keys these values, each in its range.
impl FromIterator<(&'static Key, KeyValue)> for RenderEdit {
    /// # Panics
    /// When a value is none of its key.
    fn from_iter<I: IntoIterator<Item = (&'static Key, KeyValue)>>(values: I) -> RenderEdit {
        let table: toml::Table =
            values.into_iter().map(|(key, value)| (key.name.to_owned(), toml_of(value))).collect();
        table.try_into().expect("values are of their keys")
    }
}

fn toml_of(value: KeyValue) -> toml::Value {
    match value {
        KeyValue::Count(count) => toml::Value::Integer(i64::try_from(count).expect("counts are in range")),
        KeyValue::Number(number) => number.into(),
        KeyValue::Pair(pair) => pair.map(toml::Value::from).to_vec().into(),
        KeyValue::Choice(name) => name.into(),
        KeyValue::Flag(flag) => flag.into(),
    }
}

impl RenderEdit {
    /// `keys` with these changes, unchecked.
    #[must_use]
    pub fn apply(&self, keys: &RenderKeys) -> RenderKeys {
        let keys = self.quality.map_or(*keys, |quality| quality.apply(keys));
        let integrator = self.integrator.unwrap_or(keys.integrator);
        let (mut bake, mut caustics, mut filter) = (keys.bake, keys.caustics, keys.filter);
        if integrator != keys.integrator {
            bake &= (keys::BAKE.is_used_by)(integrator);
            caustics &= (keys::CAUSTICS.is_used_by)(integrator);
            filter = if (keys::FILTER.is_used_by)(integrator) { filter } else { Filter::Off };
        }
        RenderKeys {
            integrator,
            light: self.light.unwrap_or(keys.light),
            up: self.up.unwrap_or(keys.up),
            resolution: self.resolution.unwrap_or(keys.resolution),
            spp: self.spp.unwrap_or(keys.spp),
            n_shadow: self.n_shadow.unwrap_or(keys.n_shadow),
            n_gather: self.n_gather.unwrap_or(keys.n_gather),
            photons: self.photons.unwrap_or(keys.photons),
            k_nearest: self.k_nearest.unwrap_or(keys.k_nearest),
            bake: self.bake.unwrap_or(bake),
            caustics: self.caustics.unwrap_or(caustics),
            near: self.near.unwrap_or(keys.near),
            shadows: self.shadows.unwrap_or(keys.shadows),
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
    use crate::scene::key::KeyKind;
    use crate::scene::keys::KEYS;
    use crate::scene::settings::RenderSettings;

    #[test]
    fn every_quality_is_a_picture() {
        let keys = RenderKeys {
            resolution: [7, 5],
            exposure: Exposure::Factor(2.0),
            seed: 9,
            ..RenderKeys::default()
        };
        for quality in [Quality::Draft, Quality::Normal, Quality::Reference] {
            let edit = RenderEdit { quality: Some(quality), ..RenderEdit::default() };
            let settings = RenderSettings::new(edit.apply(&keys)).unwrap();
            assert_eq!(
                (settings.resolution, settings.exposure, settings.seed),
                ([7, 5], Exposure::Factor(2.0), 9)
            );
            assert!(settings.integrator != Method::Direct, "{quality:?} has all light");
        }
    }

    /// Values of all kinds, as far from the defaults as they go.
    fn extremes(key: &'static Key) -> Vec<KeyValue> {
        match key.kind {
            KeyKind::Count { least, most } => vec![KeyValue::Count(least), KeyValue::Count(most)],
            KeyKind::Length { most } => [0.0, 0.1, most].map(KeyValue::Number).to_vec(),
            KeyKind::Factor => {
                let numbers = [0.1, 1e-30, 1e30].map(KeyValue::Number);
                numbers.into_iter().chain([KeyValue::Choice("auto")]).collect()
            }
            KeyKind::Pair { most } => [[1, most], [most, 1]].map(KeyValue::Pair).to_vec(),
            KeyKind::Choice(choices) => choices.iter().map(|choice| KeyValue::Choice(choice.name)).collect(),
            KeyKind::Flag => [true, false].map(KeyValue::Flag).to_vec(),
        }
    }

    /// The table, the struct of keys and the struct of edits name each key by themselves: here they agree, and what
    /// one writes the other reads.
    #[test]
    fn each_key_of_the_table_is_edited_and_comes_back() {
        let base = RenderKeys::default();
        let names = base.values().map(|(key, _)| key.name);
        assert_eq!(names[..], KEYS[1..].iter().map(|key| key.name).collect::<Vec<_>>());
        for key in KEYS {
            for value in extremes(key).into_iter().chain([key.default_value()]) {
                key.check(value).unwrap();
                let edit: RenderEdit = [(key, value)].into_iter().collect();
                let read: RenderEdit = toml::from_str(&format!("{} = {value}", key.name)).unwrap();
                assert_eq!(read, edit, "{} = {value}", key.name);
                let keys = edit.apply(&base);
                let quality = || KeyValue::Choice(Quality::of(&keys).unwrap().as_str());
                let found = keys.value(key).unwrap_or_else(quality);
                assert_eq!(found, value, "{}", key.name);
            }
        }
        let named: RenderEdit = toml::from_str("integrator = 'cpu-gi'").unwrap();
        assert_eq!(named.integrator, Some(Method::Photon));
        assert_eq!(keys::INTEGRATOR.choice("cpu-gi").unwrap().name, "photon");
    }

    #[test]
    fn defaults_are_those_of_a_scene_that_says_nothing() {
        let words =
            "normal photon scene auto 1024x1024 16 2 2 1048576 50 false false contact mesh on 0.0 on 1.0 1";
        let default = |key: &&'static Key| match key.default_value() {
            KeyValue::Pair([width, height]) => format!("{width}x{height}"),
            KeyValue::Choice(name) => name.to_owned(),
            value => value.to_string(),
        };
        assert_eq!(KEYS.iter().map(default).collect::<Vec<_>>().join(" "), words);
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
            caustics: true,
            ..RenderKeys::default()
        };
        let to = |integrator| RenderEdit { integrator: Some(integrator), ..RenderEdit::default() };
        let direct = RenderSettings::new(to(Method::Direct).apply(&keys)).unwrap();
        assert!(direct.filter == Filter::Off && !direct.bake && !direct.caustics);
        let full = RenderSettings::new(to(Method::FullGi).apply(&keys)).unwrap();
        assert!(full.filter == Filter::On && !full.bake && !full.caustics);
        let asked = RenderEdit { filter: Some(Filter::On), ..to(Method::Direct) };
        assert!(RenderSettings::new(asked.apply(&keys)).is_err());
    }
}
