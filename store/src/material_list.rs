//! `MaterialList`: the materials of a model, each with its name.
//!
//! Invariants: 1. there are as many names as materials; 2. every material is checked; 3. a clone shares the names.

use crate::material::Material;
use crate::material_names::MaterialNames;
use std::ops::Deref;
use std::sync::Arc;

/// The name of the material of what has none.
pub(crate) const DEFAULT_NAME: &str = "default";

/// Materials and their names, by index. Reads as a slice of materials.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialList {
    entries: Vec<Material>,
    names: Arc<MaterialNames>,
}

impl MaterialList {
    /// An empty list with room for `count` materials, whose names have so many bytes together.
    pub(crate) fn with_capacity(count: usize, text_bytes: usize) -> MaterialList {
        let names = Arc::new(MaterialNames::with_capacity(count, text_bytes));
        MaterialList { entries: Vec::with_capacity(count), names }
    }

    /// Most bytes of memory of a list whose names have so many bytes together.
    pub(crate) fn bytes(count: u64, text_bytes: u64) -> u64 {
        count * size_of::<Material>() as u64 + MaterialNames::bytes(count, text_bytes)
    }

    /// Appends a material, which is checked.
    ///
    /// # Panics
    /// Where [`MaterialNames::push`] does.
    pub fn push(&mut self, name: &str, material: Material) {
        Arc::make_mut(&mut self.names).push(name);
        self.entries.push(material.checked());
    }

    /// Replaces a material, which keeps its name.
    ///
    /// # Panics
    /// When there is none with this index.
    pub(crate) fn replace(&mut self, index: usize, material: Material) {
        self.entries[index] = material.checked();
    }

    /// Gives the materials other names, one for each.
    ///
    /// # Panics
    /// When their counts differ.
    pub(crate) fn rename(&mut self, names: MaterialNames) {
        assert_eq!(names.len(), self.len(), "a name for each material");
        self.names = Arc::new(names);
    }

    /// Appends all of `other`.
    pub(crate) fn extend(&mut self, other: &MaterialList) {
        other.named().for_each(|(name, material)| self.push(name, *material));
    }

    /// The names.
    pub fn names(&self) -> &Arc<MaterialNames> {
        &self.names
    }

    /// The name of the material with this index.
    ///
    /// # Panics
    /// When there is none.
    pub fn name(&self, index: usize) -> &str {
        self.names.get(index).expect("every material has a name")
    }

    /// Materials with their names, in order.
    pub fn named(&self) -> impl ExactSizeIterator<Item = (&str, &Material)> {
        self.names.iter().zip(&self.entries)
    }

    /// Gives back the memory beyond what the list takes.
    pub(crate) fn shrink(&mut self) {
        Arc::make_mut(&mut self.names).shrink();
        self.entries.shrink_to_fit();
    }
}

impl Deref for MaterialList {
    type Target = [Material];

    fn deref(&self) -> &[Material] {
        &self.entries
    }
}

impl<N: AsRef<str>> FromIterator<(N, Material)> for MaterialList {
    fn from_iter<I: IntoIterator<Item = (N, Material)>>(materials: I) -> MaterialList {
        let mut list = MaterialList::default();
        materials.into_iter().for_each(|(name, material)| list.push(name.as_ref(), material));
        list
    }
}

impl From<Material> for MaterialList {
    /// A list of one material, called `default`, as of inputs without names.
    fn from(material: Material) -> MaterialList {
        MaterialList::from_iter([(DEFAULT_NAME, material)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_names_until_one_of_them_grows() {
        let mut list = MaterialList::from(Material::default());
        let before = list.clone();
        assert!(Arc::ptr_eq(list.names(), before.names()));
        list.push("lamp", Material { ke: [f32::NAN, 2.0, -1.0], ..Material::default() });
        assert_eq!((before.len(), before.names().len()), (1, 1));
        assert_eq!((list.name(0), list.name(1), list[1].ke), ("default", "lamp", [0.0, 2.0, 0.0]));
        assert_eq!(list.named().map(|(name, _)| name).collect::<Vec<_>>(), ["default", "lamp"]);
    }
}
