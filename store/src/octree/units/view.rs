//! `UnitsView`: units read where they lie in a frame; the picture of it is in `units.rs`.
//!
//! Invariant: what `install_units` has passed is read without asking again.

use super::super::LeafVoxel;
use super::super::links::UnitRef;
use super::super::payload::LeafNormal;
use super::{BITMAP_BYTES, FRAME_HEAD_BYTES, INDEX_BYTES, LINK_BYTES, NORMAL_BYTES};

/// A node of a unit: one leaf of the octree above it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnitNode {
    /// Index within the page of its first leaf.
    first: u32,
    /// Its leaves.
    count: u32,
    /// Where the unit is that hangs here, when units nest.
    pub link: Option<UnitRef>,
}

impl UnitNode {
    /// Index within the page of the leaf in `place`, which is set in `mask`, the bitmap of the leaf that this node is;
    /// `None` when that cannot be its mask.
    #[inline]
    pub fn leaf(&self, mask: u64, place: u32) -> Option<u32> {
        let rank = (mask & ((1 << place) - 1)).count_ones();
        (mask.count_ones() == self.count).then_some(self.first + rank)
    }

    /// Index within the page of its first leaf; the others follow.
    pub fn first_leaf(&self) -> u32 {
        self.first
    }

    /// Count of its leaves, 1 to 64.
    pub fn leaf_count(&self) -> u32 {
        self.count
    }
}

/// A page of units in its frame.
#[derive(Clone, Copy, Debug)]
pub struct UnitsView<'a> {
    frame: &'a [u8],
    units: u16,
    nodes: u16,
    leaves: u16,
    material_bytes: u8,
    is_linked: bool,
}

impl<'a> UnitsView<'a> {
    /// The view of a frame that `install` has filled with a page of units.
    #[inline]
    pub fn new(frame: &'a [u8]) -> UnitsView<'a> {
        let count = |i: usize| u16::from_le_bytes([frame[2 * i], frame[2 * i + 1]]);
        UnitsView {
            frame,
            units: count(0),
            nodes: count(1),
            leaves: count(2),
            material_bytes: frame[6],
            is_linked: frame[7] != 0,
        }
    }

    /// Nodes of a unit, 1 to 64; 0 where there is no such unit.
    pub fn node_count(&self, unit: u32) -> u32 {
        if unit >= u32::from(self.units) { 0 } else { self.index(unit + 1) - self.index(unit) }
    }

    /// Node `rank` of a unit: of the leaves above it the one with so many before it. `None` where there is none.
    #[inline(always)]
    pub fn node(&self, unit: u32, rank: u32) -> Option<UnitNode> {
        if unit >= u32::from(self.units) || rank >= self.index(unit + 1) - self.index(unit) {
            return None;
        }
        let node = self.index(unit) + rank;
        // First leaves stand behind the first nodes and their end.
        let at = u32::from(self.units) + 1 + node;
        let first = self.index(at);
        let link = self.is_linked.then(|| {
            let link_at = self.links_at() + LINK_BYTES * node as usize;
            UnitRef::from_word(u32::from_le_bytes(self.bytes(link_at)))
        });
        Some(UnitNode { first, count: self.index(at + 1) - first, link })
    }

    /// Occluder bitmap of a leaf, by its index within the page.
    #[inline]
    pub fn bitmap(&self, leaf: u32) -> u64 {
        u64::from_le_bytes(self.bytes(self.bitmaps_at() + BITMAP_BYTES * leaf as usize))
    }

    /// The occluder bitmaps of all leaves, where they lie: words of 8 bytes, the least first.
    #[inline]
    pub fn bitmaps(&self) -> &'a [u8] {
        &self.frame[self.bitmaps_at()..]
    }

    /// Normal, flatness and material of the surface in a leaf.
    pub fn leaf(&self, leaf: u32) -> LeafVoxel {
        let link_count = if self.is_linked { usize::from(self.nodes) } else { 0 };
        let normals_at = self.links_at() + LINK_BYTES * link_count;
        let word = self.bytes(normals_at + NORMAL_BYTES * leaf as usize);
        let (normal, flatness) = LeafNormal(u16::from_le_bytes(word)).unpack();
        let material_at = normals_at
            + NORMAL_BYTES * usize::from(self.leaves)
            + usize::from(self.material_bytes) * leaf as usize;
        let material = match self.material_bytes {
            1 => u16::from(self.frame[material_at]),
            _ => u16::from_le_bytes(self.bytes(material_at)),
        };
        LeafVoxel { normal, flatness, material }
    }

    fn links_at(&self) -> usize {
        FRAME_HEAD_BYTES + INDEX_BYTES * (usize::from(self.units) + usize::from(self.nodes) + 2)
    }

    fn bitmaps_at(&self) -> usize {
        self.frame.len() - BITMAP_BYTES * usize::from(self.leaves)
    }

    /// Of the first nodes and first leaves.
    #[inline]
    fn index(&self, at: u32) -> u32 {
        u32::from(u16::from_le_bytes(self.bytes(FRAME_HEAD_BYTES + INDEX_BYTES * at as usize)))
    }

    #[inline]
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        *self.frame[at..].first_chunk().expect("inside of the frame")
    }
}
