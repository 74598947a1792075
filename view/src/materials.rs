//! Materials as pages see them: a part of the list at a time, searched here; after an edit the one that has changed.
//!
//! ```text
//! page: find "bolt" from the 48th on -> the names of all are looked at -> how many match, and 24 of them
//! page: edit of number 7             -> every page: number 7
//! ```
//!
//! Invariants: 1. a part of the list is bounded, in materials and in the bytes of each: it fits beside what else may
//! wait for a page; 2. names are looked up in [`name_of`] alone; no table has longer ones than [`NAME_BYTES_MAX`].

use crate::wire::LIST_MAX;
use serde::Serialize;
use std::hash::{DefaultHasher, Hash, Hasher};
use trex_render::Model;
use trex_store::Material;
use trex_store::layout::MATERIAL_NAME_BYTES;

/// Most bytes of what is searched for, as of a name; the rest of a longer text is cut off.
pub(crate) const NAME_BYTES_MAX: usize = MATERIAL_NAME_BYTES;

/// A material.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct MaterialText {
    index: usize,
    name: String,
    kd: [f32; 3],
    ks: [f32; 3],
    ns: f32,
    ke: [f32; 3],
    mirror: bool,
    emits: bool,
}

/// The part of the list that a page asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ListWish {
    /// Comes back with the answer.
    pub(crate) id: u32,
    /// Part of a name, upper and lower case alike; empty for all materials.
    pub(crate) find: String,
    /// Matches to leave out before the first.
    pub(crate) from: usize,
    /// In place of both: the part in which this material is.
    pub(crate) index: Option<usize>,
}

/// A part of the list.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename = "materials")]
pub(crate) struct ListText {
    id: u32,
    /// Matches before the first of these.
    from: usize,
    /// All matches.
    found: usize,
    items: Vec<MaterialText>,
}

/// The name of a material; empty where there is no such material.
pub(crate) fn name_of(model: &Model, index: usize) -> &str {
    model.names.get(index).unwrap_or_default()
}

/// The beginning of a text, of at most [`NAME_BYTES_MAX`] bytes.
pub(crate) fn cut(text: &str) -> &str {
    let most = text.len().min(NAME_BYTES_MAX);
    let end = (0..=most).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
    &text[..end]
}

/// The material with this index, if there is one.
pub(crate) fn material_text(model: &Model, index: usize) -> Option<MaterialText> {
    let material = model.materials.get(index)?;
    let Material { kd, ks, ns, ke, mirror, .. } = *material;
    let name = name_of(model, index).to_owned();
    Some(MaterialText { index, name, kd, ks, ns, ke, mirror, emits: material.emits() })
}

/// The part of the list that is asked for.
pub(crate) fn list(model: &Model, wish: &ListWish) -> ListText {
    let (find, from) = match wish.index {
        Some(index) => (String::new(), index - index % LIST_MAX),
        None => (wish.find.to_lowercase(), wish.from),
    };
    let mut list = ListText { id: wish.id, from, found: 0, items: vec![] };
    for index in 0..model.materials.len() {
        if find.is_empty() || name_of(model, index).to_lowercase().contains(&find) {
            if list.found >= from && list.items.len() < LIST_MAX {
                list.items.extend(material_text(model, index));
            }
            list.found += 1;
        }
    }
    list
}

/// A number that is another one when a material is edited, but for a chance of 2^-64.
pub(crate) fn fingerprint(materials: &[Material]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for Material { kd, ks, ns, ke, mirror, .. } in materials {
        (kd.map(f32::to_bits), ks.map(f32::to_bits), ns.to_bits()).hash(&mut hasher);
        (ke.map(f32::to_bits), mirror).hash(&mut hasher);
    }
    hasher.finish()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::message::text_of;
    use std::sync::Arc;
    use trex_store::Aabb;

    /// A model without triangles.
    pub(crate) fn model(materials: Vec<Material>, names: &[&str]) -> Model {
        let names = Arc::new(names.iter().copied().collect());
        Model {
            bounds: Aabb::EMPTY,
            outline: Default::default(),
            materials,
            names,
            emitters: vec![],
            voxels: None,
        }
    }

    fn numbered(count: usize) -> Model {
        let name =
            |index: usize| format!("{} {index}", if index.is_multiple_of(3) { "Schraube" } else { "ÖSE" });
        let names: Vec<String> = (0..count).map(name).collect();
        model(vec![Material::default(); count], &names.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn listed(model: &Model, find: &str, from: usize, index: Option<usize>) -> (usize, usize, Vec<usize>) {
        let list = list(model, &ListWish { id: 1, find: find.into(), from, index });
        (list.from, list.found, list.items.iter().map(|item| item.index).collect())
    }

    #[test]
    fn the_list_goes_in_parts_that_together_are_all_of_it() {
        let model = numbered(100);
        let mut seen = vec![];
        while seen.len() < 100 {
            let (from, found, part) = listed(&model, "", seen.len(), None);
            assert_eq!((from, found), (seen.len(), 100));
            assert!((1..=LIST_MAX).contains(&part.len()));
            seen.extend(part);
        }
        assert_eq!(seen, (0..100).collect::<Vec<_>>());
        assert_eq!(listed(&model, "", 100, None), (100, 100, vec![]));
        assert_eq!(listed(&model, "", usize::MAX, None).2, [0; 0]);
        // The part around what was picked, whatever is searched for.
        let (from, _, part) = listed(&model, "x", 0, Some(77));
        assert!(from <= 77 && part.contains(&77) && part[0] == from);
    }

    #[test]
    fn names_are_found_by_a_part_in_any_case() {
        let model = numbered(100);
        assert_eq!(listed(&model, "schrAUBE 9", 0, None).2, [9, 90, 93, 96, 99]);
        assert_eq!(listed(&model, "öse 1", 2, None), (2, 8, vec![11, 13, 14, 16, 17, 19]));
        assert_eq!(listed(&model, "none", 0, None), (0, 0, vec![]));
    }

    /// Control characters take six bytes each in JSON; names of files had no bound.
    #[test]
    fn a_part_of_the_list_is_bounded_whatever_names_say() {
        let name = "\u{1}".repeat(5000);
        let numbers = [f32::MIN_POSITIVE; 3];
        let material =
            Material { kd: numbers, ks: numbers, ns: numbers[0], ke: numbers, ..Material::default() };
        let model = model(vec![material; 1000], &[name.as_str(); 1000]);
        let text =
            text_of(&list(&model, &ListWish { id: u32::MAX, find: String::new(), from: 0, index: None }));
        assert!(text.len() < 48 << 10, "{} bytes", text.len());
        // No character is cut in two.
        assert_eq!(cut(&"ö".repeat(200)), "ö".repeat(127));
    }

    #[test]
    fn an_edit_has_another_fingerprint() {
        let mut materials = numbered(100).materials;
        let before = fingerprint(&materials);
        materials[70].mirror = true;
        assert_ne!(fingerprint(&materials), before);
        materials[70].mirror = false;
        assert_eq!(fingerprint(&materials), before);
    }
}
