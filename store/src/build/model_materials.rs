//! `ModelMaterials`: the materials that a build writes, and the forms in which it needs them: what emits, what is
//! hashed, what stands in the file and in the journal.
//!
//! Invariants: 1. their memory is leased; names are those of the source, which leases them, where there is one and they
//! all differ; 2. the section is made in pieces; 3. of two materials of one name the later one has a number behind.

use crate::budget::{Budget, Lease};
use crate::cluster::Colour;
use crate::error::Result;
use crate::layout::{MATERIAL_NAME_BYTES, MATERIALS};
use crate::material::Material;
use crate::material_json;
use crate::material_list::MaterialList;
use crate::material_names::MaterialNames;
use xxhash_rust::xxh3::Xxh3;

/// What they are called in messages.
const LEASED: &str = "the materials of the model";

/// All materials of a model that was read.
pub(super) struct ModelMaterials {
    list: MaterialList,
    _lease: Lease,
}

impl ModelMaterials {
    /// Those of a source whose stream has ended, with the mean colours of the first of them.
    pub(super) fn of(
        list: &MaterialList,
        mean_colours: &[Colour],
        budget: &Budget,
    ) -> Result<ModelMaterials> {
        let copies = size_of_val::<[Material]>(list) as u64;
        let mut lease = budget.lease(LEASED, copies + size_of::<u32>() as u64 * list.len() as u64)?;
        let mut list = list.clone();
        if list.names().all_differ() {
            lease.shrink_to(copies);
        } else {
            lease.grow(LEASED, list.names().bytes_to_tell_apart())?;
            let names = list.names().told_apart();
            lease.shrink_to(copies + MaterialNames::bytes(names.len() as u64, names.text_bytes() as u64));
            list.rename(names);
        }
        let coloured = mean_colours.iter().enumerate().take(list.len());
        for (index, &mean_colour) in coloured {
            list.replace(index, Material { mean_colour, ..list[index] });
        }
        Ok(ModelMaterials { list, _lease: lease })
    }

    /// Those of the journal; `None` where it holds anything else.
    pub(super) fn parse(section: &[u8], budget: &Budget) -> Result<Option<ModelMaterials>> {
        let text_bytes = section.len().min(MATERIALS * MATERIAL_NAME_BYTES);
        let lease = budget.lease(LEASED, MaterialList::bytes(MATERIALS as u64, text_bytes as u64))?;
        let list = material_json::read(section, 1..=MATERIALS, text_bytes);
        Ok(list.map(|list| {
            let mut lease = lease;
            lease.shrink_to(MaterialList::bytes(list.len() as u64, list.names().text_bytes() as u64));
            ModelMaterials { list, _lease: lease }
        }))
    }

    /// The same once more.
    pub(super) fn copy(&self, budget: &Budget) -> Result<ModelMaterials> {
        ModelMaterials::of(&self.list, &[], budget)
    }

    /// Count of materials.
    pub(super) fn count(&self) -> usize {
        self.list.len()
    }

    /// Whether each emits.
    pub(super) fn emissive(&self) -> Vec<bool> {
        self.list.iter().map(Material::emits).collect()
    }

    /// Adds the section to a hash.
    pub(super) fn hash(&self, hasher: &mut Xxh3) {
        self.write(|piece| {
            hasher.update(piece);
            Ok(())
        })
        .expect("a hash takes all bytes");
    }

    /// Hands the section to `put`, in pieces.
    pub(super) fn write(&self, put: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        material_json::write(&self.list, put)
    }

    /// The section as bytes, with their lease.
    pub(super) fn to_bytes(&self, budget: &Budget) -> Result<(Vec<u8>, Lease)> {
        let mut length = 0;
        self.write(|piece| {
            length += piece.len();
            Ok(())
        })
        .expect("a length takes all bytes");
        let lease = budget.lease("the section of materials", length as u64)?;
        let mut bytes = Vec::with_capacity(length);
        self.write(|piece| {
            bytes.extend_from_slice(piece);
            Ok(())
        })
        .expect("a vector takes all bytes");
        Ok((bytes, lease))
    }
}
