//! `PartKeys`: what a scene says of the parts that are shown: sections, and materials by name.
//!
//! Invariant: what is out of range is refused with its key; names are looked up when there is a model.

use super::world::Model;
use crate::trace::{PartNeeds, Parts, SECTIONS_MAX, Section};
use serde::Deserialize;
use trex_store::{Code, Error, Result};

/// What is to be given for a section.
pub(super) const SECTION_STEP: &str =
    "give a point and a normal, six finite numbers, for each of at most three planes";

/// What is shown of a model; all of it where nothing is said.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PartKeys {
    /// Planes that cut away what lies behind them: a point and a normal each, x, y, z, model units. At most
    /// [`SECTIONS_MAX`].
    pub section: Vec<[f64; 6]>,
    /// Names of materials that are hidden.
    pub hide: Vec<String>,
    /// Names of materials beside which all are hidden; all are shown where this is empty.
    pub only: Vec<String>,
}

/// The section through a point with a normal, as six numbers; `None` where there is none.
fn section([px, py, pz, nx, ny, nz]: [f64; 6]) -> Option<Section> {
    Section::new([px, py, pz], [nx, ny, nz])
}

impl PartKeys {
    /// Whether the sections are some, and not too many.
    ///
    /// # Errors
    /// The numbers that are wrong.
    pub(super) fn check(&self) -> Result<(), String> {
        if self.section.len() > SECTIONS_MAX {
            return Err(format!("{} sections, at most {SECTIONS_MAX}", self.section.len()));
        }
        let wrong = self.section.iter().find(|numbers| section(**numbers).is_none());
        wrong.map_or(Ok(()), |numbers| Err(format!("{numbers:?}")))
    }

    /// What these parts take of memory.
    pub fn needs(&self) -> PartNeeds {
        let hides = !self.hide.is_empty() || !self.only.is_empty();
        PartNeeds { is_cut: !self.section.is_empty(), hides }
    }

    /// The parts of `model` that these keys name.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] for a name that the model has not, and for sections that are none or too many.
    pub fn parts(&self, model: &Model) -> Result<Parts> {
        self.check().map_err(|numbers| {
            Error::new(Code::SceneFormat, "the sections are not planes, or too many")
                .at_place("parts.section")
                .numbers(numbers)
                .next(SECTION_STEP)
        })?;
        let indices = |names: &[String]| -> Result<Vec<usize>> {
            names.iter().map(|name| model.material_index(name)).collect()
        };
        let mut hidden = indices(&self.hide)?;
        let only = indices(&self.only)?;
        if !only.is_empty() {
            let mut is_shown = vec![false; model.materials.len()];
            only.into_iter().for_each(|material| is_shown[material] = true);
            hidden.extend((0..is_shown.len()).filter(|&material| !is_shown[material]));
        }
        let sections = self.section.iter().filter_map(|numbers| section(*numbers));
        Ok(Parts::new(sections.collect(), &hidden))
    }
}
