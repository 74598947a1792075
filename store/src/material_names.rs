//! `MaterialNames`: the names of a model's materials, by index: one text, and where each name ends in it.
//!
//! Copies of materials hold no names: a table is made once, by an importer or by an opened file, and shared from then
//! on.
//!
//! Invariants: 1. no name is longer than [`MATERIAL_NAME_BYTES`]; 2. a name that was longer ends in the hash of all of
//! it, so that different names stay different; 3. a table that is shared does not change.

use crate::layout::{MATERIAL_NAME_BYTES, MATERIALS};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes behind a name that was cut: a tilde, and sixteen hexadecimal digits.
const CUT_BYTES: usize = 17;

/// Most bytes of a number behind a name: a point and up to six digits, or what a name that was cut ends in.
const NUMBER_BYTES: usize = CUT_BYTES;
/// Most bytes for each name of the tables that tell names apart: three entries of 24 bytes, in tables that are half
/// empty at least, and an end.
const APART_BYTES: u64 = 160;

const _: () = assert!(CUT_BYTES < MATERIAL_NAME_BYTES);
const _: () = assert!(MATERIALS * MATERIAL_NAME_BYTES <= u32::MAX as usize);

/// Names by index. See the module's invariants.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MaterialNames {
    text: String,
    ends: Vec<u32>,
}

impl MaterialNames {
    /// Room for `count` names, which have so many bytes together.
    pub(crate) fn with_capacity(count: usize, text_bytes: usize) -> MaterialNames {
        MaterialNames { text: String::with_capacity(text_bytes), ends: Vec::with_capacity(count) }
    }

    /// Most bytes of memory of `count` names that have so many bytes together.
    pub(crate) fn bytes(count: u64, text_bytes: u64) -> u64 {
        text_bytes + count * size_of::<u32>() as u64
    }

    /// True when no name stands twice; takes four bytes a name for as long as it looks.
    pub(crate) fn all_differ(&self) -> bool {
        let name = |&index: &u32| self.get(index as usize);
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.sort_unstable_by_key(name);
        order.windows(2).all(|pair| name(&pair[0]) != name(&pair[1]))
    }

    /// Most bytes of memory that [`MaterialNames::told_apart`] takes, its answer included.
    pub(crate) fn bytes_to_tell_apart(&self) -> u64 {
        // Names with numbers behind stand in the answer and in a table.
        let text = (self.text.len() + self.len() * NUMBER_BYTES) as u64;
        2 * text + self.len() as u64 * APART_BYTES
    }

    /// These names, each once: one that stood before gets a number behind, from 2 on, as `steel.2`.
    pub(crate) fn told_apart(&self) -> MaterialNames {
        let given: HashSet<&str> = self.iter().collect();
        let mut table = MaterialNames::with_capacity(self.len(), self.text.len() + self.len() * NUMBER_BYTES);
        let (mut counts, mut made) = (HashMap::new(), HashSet::new());
        for name in self.iter() {
            let count = counts.entry(name).or_insert(0_u32);
            *count += 1;
            if *count == 1 {
                table.push(name);
                continue;
            }
            let numbered = loop {
                let numbered = stored_name(&format!("{name}.{count}")).into_owned();
                if !given.contains(numbered.as_str()) && !made.contains(&numbered) {
                    break numbered;
                }
                *count += 1;
            };
            table.push(&numbered);
            made.insert(numbered);
        }
        table.shrink();
        table
    }

    /// Appends a name, cut as [`stored_name`] does.
    ///
    /// # Panics
    /// When there are [`MATERIALS`] already.
    pub fn push(&mut self, name: &str) {
        assert!(self.ends.len() < MATERIALS, "more names than materials");
        self.text.push_str(&stored_name(name));
        self.ends.push(self.text.len() as u32);
    }

    /// The name with this index, if there is one.
    pub fn get(&self, index: usize) -> Option<&str> {
        let end = *self.ends.get(index)? as usize;
        let begin = index.checked_sub(1).map_or(0, |before| self.ends[before] as usize);
        Some(&self.text[begin..end])
    }

    /// The first index of this name, which may be one that was cut.
    pub fn index_of(&self, name: &str) -> Option<usize> {
        let name = stored_name(name);
        self.iter().position(|other| other == name)
    }

    /// All names, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &str> {
        (0..self.ends.len()).map(|index| self.get(index).expect("an index below the count"))
    }

    /// Count of names.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// True when there is no name.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Bytes of all names together.
    pub fn text_bytes(&self) -> usize {
        self.text.len()
    }

    /// Gives back the memory beyond what the names take.
    pub(crate) fn shrink(&mut self) {
        self.text.shrink_to_fit();
        self.ends.shrink_to_fit();
    }
}

impl<'a> FromIterator<&'a str> for MaterialNames {
    fn from_iter<I: IntoIterator<Item = &'a str>>(names: I) -> MaterialNames {
        let mut table = MaterialNames::default();
        names.into_iter().for_each(|name| table.push(name));
        table
    }
}

/// The name as a file holds it: one of more than [`MATERIAL_NAME_BYTES`] is cut between two characters, and gets the
/// hash of all of it behind.
pub fn stored_name(name: &str) -> Cow<'_, str> {
    if name.len() <= MATERIAL_NAME_BYTES {
        return Cow::Borrowed(name);
    }
    let mut borders = (0..=MATERIAL_NAME_BYTES - CUT_BYTES).rev();
    let kept = borders.find(|&at| name.is_char_boundary(at)).unwrap_or(0);
    Cow::Owned(format!("{}~{:016x}", &name[..kept], xxh3_64(name.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_are_found_by_index_and_by_name() {
        let names: MaterialNames = ["default", "", "lamp", "default", "\u{20ac}"].into_iter().collect();
        assert_eq!(names.iter().collect::<Vec<_>>(), ["default", "", "lamp", "default", "\u{20ac}"]);
        assert_eq!((names.get(2), names.get(1), names.get(5)), (Some("lamp"), Some(""), None));
        assert_eq!((names.index_of("default"), names.index_of("\u{20ac}")), (Some(0), Some(4)));
        assert_eq!((names.index_of("lam"), names.index_of("")), (None, Some(1)));
        assert_eq!(MaterialNames::default().index_of(""), None);
    }

    /// Names of a megabyte were kept whole, in every copy of a material.
    #[test]
    fn long_names_are_cut_between_characters_and_stay_different() {
        assert_eq!(stored_name(&"n".repeat(255)), "n".repeat(255));
        for character in ["n", "\u{e4}", "\u{20ac}", "\u{1f600}"] {
            let long = character.repeat(1000);
            let [one, other] = ["a", "b"].map(|end| stored_name(&format!("{long}{end}")).into_owned());
            assert!(one != other && one.len() <= MATERIAL_NAME_BYTES, "{one}");
            assert!(one.len() > MATERIAL_NAME_BYTES - 4 && long.starts_with(one.split('~').next().unwrap()));
            assert_eq!(stored_name(&one), one, "a name that was cut is not cut again");
        }
    }

    #[test]
    fn names_that_stand_twice_get_numbers() {
        let apart = |names: &[&str]| {
            let names: MaterialNames = names.iter().copied().collect();
            names.told_apart().iter().map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(apart(&["steel", "glass"]), ["steel", "glass"]);
        let told = apart(&["steel", "glass", "steel", "", "steel", ""]);
        assert_eq!(told, ["steel", "glass", "steel.2", "", "steel.3", ".2"]);
        // A number that is somebody's name is passed over, also where it comes later.
        assert_eq!(apart(&["a", "a", "a.2", "a", "a.2"]), ["a", "a.3", "a.2", "a.4", "a.2.2"]);
        let long = "n".repeat(MATERIAL_NAME_BYTES);
        let told = apart(&[&long, &long, &long]);
        assert!(told[0] == long && told[1] != told[2]);
        assert!(told.iter().all(|name| name.len() <= MATERIAL_NAME_BYTES));
    }

    proptest! {
        /// Beside pairs that were compared one by one.
        #[test]
        fn names_told_apart_all_differ(names in proptest::collection::vec("[ab.2]{0,3}", 0..40)) {
            let names: MaterialNames = names.iter().map(String::as_str).collect();
            let told = names.told_apart();
            prop_assert_eq!(told.len(), names.len());
            prop_assert!(told.all_differ());
            prop_assert_eq!(names.all_differ(), told == names);
            for (at, name) in told.iter().enumerate() {
                prop_assert!(told.iter().skip(at + 1).all(|other| other != name));
                let is_first = names.iter().take(at).all(|before| before != names.get(at).unwrap());
                prop_assert!(!is_first || name == names.get(at).unwrap(), "the first of a name keeps it");
                prop_assert!(name.starts_with(names.get(at).unwrap()));
            }
        }

        #[test]
        fn any_names_come_back(names in proptest::collection::vec(".{0,300}", 0..20)) {
            let table: MaterialNames = names.iter().map(String::as_str).collect();
            prop_assert_eq!(table.len(), names.len());
            for (index, name) in names.iter().enumerate() {
                let there = table.get(index).unwrap();
                prop_assert!(there.len() <= 255 && (name.len() > 255 || there == name));
                let first = table.index_of(name).unwrap();
                prop_assert!(first <= index && names[first] == *name);
            }
        }
    }
}
