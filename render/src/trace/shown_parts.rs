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
}
