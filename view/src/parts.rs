//! What is shown of the model, as pages say it and are told it: sections as six numbers, materials by index.
//!
//! Invariants: 1. a list in a message is bounded; 2. materials are named by index, since names may be missing or
//! doubled; 3. planes are told as they were set, so that texts of the view read back as the same bits; 4. where a page
//! names no materials, those that are hidden stay hidden.

use crate::wire::{PARTS_MAX, SECTIONS_MAX};
use serde::{Deserialize, Deserializer, Serialize};
use std::sync::Arc;
use trex_render::{Parts, Section};
use trex_store::{Code, Error, Result};

/// A point on a plane, x, y, z, and its normal, which points into what is kept.
type Plane = [f64; 6];

/// What a page wants to be shown.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct PartsWish {
    #[serde(deserialize_with = "few_sections")]
    section: Vec<Plane>,
    #[serde(deserialize_with = "few_materials")]
    hide: Option<Vec<usize>>,
    #[serde(deserialize_with = "few_materials")]
    only: Option<Vec<usize>>,
}

/// What is shown. Of the hidden materials and of those that are shown the shorter list is told; neither where both are
/// longer than a message may hold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct PartsText {
    section: Vec<Plane>,
    hidden_count: usize,
    hide: Option<Vec<usize>>,
    only: Option<Vec<usize>>,
}

fn few<T, E: serde::de::Error>(list: Vec<T>, most: usize, what: &str) -> Result<Vec<T>, E> {
    match list.len() {
        count if count > most => Err(E::custom(format!("{count} {what}, at most {most} from a page"))),
        _ => Ok(list),
    }
}

fn few_sections<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Plane>, D::Error> {
    few(Vec::deserialize(deserializer)?, SECTIONS_MAX, "sections")
}

fn few_materials<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<usize>>, D::Error> {
    let list = Option::<Vec<usize>>::deserialize(deserializer)?;
    list.map(|list| few(list, PARTS_MAX, "materials")).transpose()
}

impl PartsWish {
    /// Takes the place of `waiting`, which nobody has seen to: where this names no materials, those of that count.
    pub(crate) fn replace(self, waiting: &mut PartsWish) {
        let keeps = self.hide.is_none() && self.only.is_none();
        let PartsWish { hide, only, .. } = std::mem::take(waiting);
        *waiting = if keeps { PartsWish { hide, only, ..self } } else { self };
    }

    /// Bytes that a wish holds beside itself, at most.
    pub(crate) const BYTES_MAX: usize =
        SECTIONS_MAX * size_of::<Plane>() + 2 * PARTS_MAX * size_of::<usize>();

    /// The parts that are meant, of a model of so many materials of which `before` is shown.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] for a plane without a normal, and for a material that the model has not.
    pub(crate) fn parts(&self, before: &Parts, material_count: usize) -> Result<Arc<Parts>> {
        let section = |plane: &Plane| {
            let [px, py, pz, nx, ny, nz] = *plane;
            Section::new([px, py, pz], [nx, ny, nz]).ok_or_else(|| {
                Error::new(Code::SceneFormat, "this section is no plane")
                    .at_place("a section of this page")
                    .numbers(format!("{plane:?}"))
                    .next("give a point and a normal, six finite numbers")
            })
        };
        let sections = self.section.iter().map(section).collect::<Result<Vec<_>>>()?;
        let mut named = [&self.hide, &self.only].into_iter().flatten().flatten();
        if let Some(index) = named.find(|&&index| index >= material_count) {
            return Err(Error::new(Code::SceneFormat, "the model has no such material")
                .at_place("the parts of this page")
                .numbers(format!("material {index} of {material_count}"))
                .next("choose one of the list"));
        }
        let mut hidden = self.hide.clone().unwrap_or_default();
        if let Some(only) = &self.only {
            let mut is_shown = vec![false; material_count];
            only.iter().for_each(|&index| is_shown[index] = true);
            hidden.extend((0..material_count).filter(|&index| !is_shown[index]));
        }
        if self.hide.is_none() && self.only.is_none() {
            hidden.extend((0..material_count).filter(|&index| before.hides(index)));
        }
        Ok(Arc::new(Parts::new(sections, &hidden)))
    }
}

impl PartsText {
    /// Those of a model of so many materials.
    pub(crate) fn of(parts: &Parts, material_count: usize) -> PartsText {
        let plane = |section: &Section| {
            let ([px, py, pz], [nx, ny, nz]) = (section.point, section.normal);
            [px, py, pz, nx, ny, nz]
        };
        let materials = 0..material_count;
        let hidden_count = materials.clone().filter(|&index| parts.hides(index)).count();
        let shown_count = material_count - hidden_count;
        let hides_few = hidden_count <= shown_count;
        let is_told = hidden_count.min(shown_count) <= PARTS_MAX;
        let list = |hides: bool| {
            let indices = materials.clone().filter(|&index| parts.hides(index) == hides);
            (is_told && hides_few == hides).then(|| indices.collect())
        };
        PartsText {
            section: parts.sections().iter().map(plane).collect(),
            hidden_count,
            hide: list(true),
            only: list(false),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wish(text: &str) -> Result<PartsWish, String> {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn materials_of_a_wish_that_waits_are_not_lost() {
        let mut waiting = wish(r#"{"section":[[0,0,0,0,0,1]],"hide":[2]}"#).unwrap();
        wish(r#"{"section":[]}"#).unwrap().replace(&mut waiting);
        assert_eq!(waiting, wish(r#"{"section":[],"hide":[2]}"#).unwrap());
        wish(r#"{"only":[1]}"#).unwrap().replace(&mut waiting);
        assert_eq!(waiting, wish(r#"{"only":[1]}"#).unwrap());
    }

    #[test]
    fn lists_are_bounded() {
        let plane = "[0,0,0,0,0,1]";
        assert!(wish(&format!(r#"{{"section":[{plane},{plane},{plane}]}}"#)).is_ok());
        let error = wish(&format!(r#"{{"section":[{plane},{plane},{plane},{plane}]}}"#)).unwrap_err();
        assert!(error.contains("4 sections, at most 3"), "{error}");
        for key in ["hide", "only"] {
            let list = |count: usize| format!(r#"{{"{key}":{:?}}}"#, vec![1; count]);
            assert!(wish(&list(PARTS_MAX)).is_ok());
            assert!(wish(&list(PARTS_MAX + 1)).unwrap_err().contains("materials, at most"));
        }
    }

    #[test]
    fn what_is_no_part_is_refused() {
        let refused = |text: &str| wish(text).unwrap().parts(&Parts::default(), 5).unwrap_err();
        for text in [r#"{"section":[[0,0,0,0,0,0]]}"#, r#"{"hide":[5]}"#, r#"{"only":[0,99]}"#] {
            let error = refused(text);
            assert_eq!(error.code(), Code::SceneFormat, "{text}");
            assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty(), "{text}");
        }
    }

    #[test]
    fn the_shorter_list_is_told_and_says_the_same_parts() {
        let told = |text: &str| {
            let parts = wish(text).unwrap().parts(&Parts::new(vec![], &[2]), 6).unwrap();
            let text = PartsText::of(&parts, 6);
            let again =
                PartsWish { section: text.section.clone(), hide: text.hide.clone(), only: text.only.clone() };
            assert_eq!(again.parts(&Parts::default(), 6).unwrap(), parts);
            (text.hidden_count, text.hide, text.only)
        };
        assert_eq!(told("{}"), (1, Some(vec![2]), None), "what was hidden stays");
        assert_eq!(told(r#"{"hide":[]}"#), (0, Some(vec![]), None));
        assert_eq!(told(r#"{"hide":[4,1,4]}"#), (2, Some(vec![1, 4]), None));
        assert_eq!(told(r#"{"only":[3],"hide":[1]}"#), (5, None, Some(vec![3])));
        assert_eq!(told(r#"{"only":[]}"#), (6, None, Some(vec![])));
        assert_eq!(told(r#"{"section":[[0.1,1e-9,-3,0.3,0.6,-0.7]]}"#).0, 1);
        let many = PartsText::of(&Parts::new(vec![], &(0..20_000).collect::<Vec<_>>()), 40_000);
        assert_eq!((many.hidden_count, many.hide, many.only), (20_000, None, None));
    }
}
