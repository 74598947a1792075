//! The numbers of a picture, as pages are told them: their values, and the table of their keys.
//!
//! Invariants: 1. names are those of scene files; 2. ranges are the library's, but where a page can say less: then they
//! are narrowed here.

use serde::Serialize;
use trex_render::keys::{KEYS, LIGHT};
use trex_render::{Choice, Key, KeyKind, LightRig, Method, Quality, RenderKeys};

/// Greatest whole number that a page counts exactly: its numbers are of double precision.
const PAGE_COUNT_MAX: u64 = (1 << 53) - 1;

/// The numbers of a picture, all of them.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct SettingsText {
    #[serde(flatten)]
    keys: RenderKeys,
    /// The quality that they are of, if they are of one.
    quality: Option<Quality>,
}

impl From<&RenderKeys> for SettingsText {
    fn from(keys: &RenderKeys) -> SettingsText {
        SettingsText { keys: *keys, quality: Quality::of(keys) }
    }
}

/// A key, for the page's panels.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct KeyText {
    name: &'static str,
    title: &'static str,
    unit: &'static str,
    text: &'static str,
    /// Those that use it.
    methods: Vec<&'static str>,
    #[serde(flatten)]
    kind: KindText,
}

/// What a key holds, and its range.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum KindText {
    Count {
        min: u64,
        max: u64,
        /// A method that takes fewer, and its most.
        narrower: Option<(&'static str, u64)>,
    },
    Length {
        min: f64,
        max: f64,
    },
    Factor {
        min: f32,
        max: f32,
    },
    Pair {
        min: u32,
        max: u32,
    },
    Choice {
        choices: Vec<ChoiceText>,
    },
    Flag {},
}

/// A choice.
#[derive(Clone, Debug, Serialize)]
struct ChoiceText {
    name: &'static str,
    title: &'static str,
    text: &'static str,
}

impl KeyText {
    /// The table.
    pub(crate) fn all() -> Vec<KeyText> {
        KEYS.iter().map(|key| KeyText::new(key)).collect()
    }

    fn new(key: &'static Key) -> KeyText {
        let kind = match key.kind {
            KeyKind::Count { least, most } => KindText::Count {
                min: least,
                max: most.min(PAGE_COUNT_MAX),
                narrower: key.narrower.map(|(method, most)| (method.as_str(), most)),
            },
            KeyKind::Length { most } => KindText::Length { min: 0.0, max: most },
            KeyKind::Factor => KindText::Factor { min: f32::MIN_POSITIVE, max: f32::MAX },
            KeyKind::Pair { most } => KindText::Pair { min: 1, max: most },
            KeyKind::Choice(choices) => KindText::Choice {
                choices: choices
                    .iter()
                    .filter(|choice| !is_decided(key, choice))
                    .map(|choice| ChoiceText { name: choice.name, title: choice.title, text: choice.text })
                    .collect(),
            },
            KeyKind::Flag => KindText::Flag {},
        };
        let methods = key.methods().map(Method::as_str).collect();
        KeyText { name: key.name, title: key.title, unit: key.unit, text: key.text, methods, kind }
    }
}

/// True for a choice that a page is shown the outcome of.
fn is_decided(key: &Key, choice: &Choice) -> bool {
    key.name == LIGHT.name && choice.name == LightRig::Auto.as_str()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_render::{RenderEdit, RenderSettings};

    /// The page had a table of its own: up to 4 * 10^9 photons and 65536 samples, and its Draft was not the library's.
    #[test]
    fn a_page_may_say_both_ends_of_each_range() {
        let table = serde_json::to_value(KeyText::all()).unwrap();
        for key in table.as_array().unwrap() {
            let name = key["name"].as_str().unwrap();
            let values: Vec<serde_json::Value> = match key["kind"].as_str().unwrap() {
                "choice" => {
                    let choices = key["choices"].as_array().unwrap();
                    choices.iter().map(|choice| choice["name"].clone()).collect()
                }
                "flag" => vec![true.into(), false.into()],
                "pair" => [["min", "max"], ["max", "min"]]
                    .iter()
                    .map(|ends| ends.map(|end| key[end].clone()).to_vec().into())
                    .collect(),
                _ => vec![key["min"].clone(), key["max"].clone()],
            };
            for value in values {
                let edit: RenderEdit = serde_json::from_value(serde_json::json!({ name: value }))
                    .unwrap_or_else(|error| panic!("{error}"));
                let method = key["methods"][0].as_str().unwrap();
                let method: RenderEdit =
                    serde_json::from_value(serde_json::json!({ "integrator": method })).unwrap();
                let keys = edit.apply(&method.apply(&RenderKeys::default()));
                RenderSettings::new(keys).unwrap_or_else(|error| panic!("{name} {value}: {error}"));
                let said = serde_json::to_value(SettingsText::from(&keys)).unwrap();
                assert_eq!(said[name], value, "{name}");
            }
        }
    }

    #[test]
    fn the_quality_that_a_picture_is_of_is_said() {
        for quality in Quality::ALL {
            let keys = quality.apply(&RenderKeys { seed: 7, ..RenderKeys::default() });
            let quality_of = |keys: &RenderKeys| {
                serde_json::to_value(SettingsText::from(keys)).unwrap()["quality"].clone()
            };
            assert_eq!(quality_of(&keys), quality.as_str());
            assert!(quality_of(&RenderKeys { k_nearest: 9, ..keys }).is_null());
        }
    }
}
