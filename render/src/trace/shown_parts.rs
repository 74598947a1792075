//! `ShownParts`: what a tracer keeps of the parts that it shows; `PartNeeds`: what they take of memory.

use super::caps::Caps;
use super::parts::{Parts, Section};
use glam::DVec3;
use std::sync::Arc;
use trex_store::octree::UpperOctree;

/// What is shown of a model.
pub(super) struct ShownParts {
    pub(super) parts: Arc<Parts>,
    pub(super) sections: Vec<Section>,
    pub(super) caps: Option<Caps>,
    /// The model's box, in which solids are.
    pub(super) bounds: [DVec3; 2],
}

/// Which parts of a model are left out, as memory goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PartNeeds {
    /// True when sections cut it.
    pub is_cut: bool,
    /// True when materials are hidden.
    pub hides: bool,
}

impl PartNeeds {
    /// Bytes of the caps of so many workers.
    pub(crate) fn cap_bytes(self, workers: usize) -> u64 {
        if self.is_cut { (workers * Caps::BYTES) as u64 } else { 0 }
    }

    /// What these and others take, while one takes the place of the other.
    pub fn beside(self, other: PartNeeds) -> PartNeeds {
        PartNeeds { is_cut: self.is_cut || other.is_cut, hides: self.hides || other.hides }
    }

    /// Bytes of an octree of so many leaves without what is hidden, beside the whole one.
    pub(crate) fn voxel_bytes(self, leaves: usize) -> u64 {
        if self.hides { UpperOctree::without_bytes(leaves) } else { 0 }
    }
}

impl Parts {
    /// What these parts take.
    pub fn needs(&self) -> PartNeeds {
        PartNeeds { is_cut: !self.sections().is_empty(), hides: self.hides_any() }
    }

    /// Bytes that are leased beside what [`PartNeeds::beside`] says while these parts take the place of `before`, in an
    /// octree of so many leaves: for a while there are two without what is hidden.
    pub fn exchange_bytes(&self, before: &Parts, leaves: usize) -> u64 {
        let has_both = self.hides_any() && before.hides_any() && self.hidden() != before.hidden();
        if has_both { UpperOctree::without_bytes(leaves) } else { 0 }
    }
}
