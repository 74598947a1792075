//! Units of the lower octrees: 16^3 leaves each, those in 4x4x4 leaves above them. A page of them, on disk and in a
//! frame.
//!
//! ```text
//! upper octree     linking node --mask--> leaf --bitmap--> subvoxel
//! unit                                    node ----------> leaf --bitmap--> subvoxel
//! ```
//!
//! The children of a linking node are the nodes of its unit, and their bitmaps are the nodes' masks: so a unit stores
//! neither. A node is the index of its first leaf; the leaf in place `i` of a mask `m` is `first + popcount(m & (2^i
//! - 1))`, as everywhere in the octree. Where units nest, each node of the outer unit is a linking node and holds a
//!   word that leads on.
//!
//! ```text
//! disk   units u32 | nodes u32 | leaves u32 | linked u32 | nodes of each unit u8 | leaves of each node u8
//!        | words of nodes u32, when linked | bitmaps u64 | normals u16 | materials u8 or u16
//!        (words of more than a byte in planes, see `stored`)
//! frame  units u16 | nodes u16 | leaves u16 | material bytes u8 | linked u8
//!        | first node of each unit u16, and the end | first leaf of each node u16, and the end
//!        | words of nodes u32 | normals u16 | materials | .. | bitmaps u64
//! ```
//!
//! What leads from a unit to a bitmap stands near the frame's head, few cache lines for all units. Bitmaps end where
//! the frame ends, so that they are aligned as it is, whatever stands before: rays read them as words.
//!
//! Areas are not stored: light is kept by the facets of the upper leaves.
//!
//! Invariants: 1. a page leads nowhere but by its words, so it can lie in any frame; 2. the largest unit fits a
//! frame; 3. what `install_units` has passed, [`UnitsView`] reads without asking again.

use super::NODE_SIDE;
use super::links::UnitRef;
use super::payload::LeafNormal;
use crate::layout::FRAME_BYTES;

#[cfg(test)]
mod tests;
mod view;

pub use view::{UnitNode, UnitsView};

/// Children of a node, in all.
const NODE_CHILDREN: usize = (NODE_SIDE * NODE_SIDE * NODE_SIDE) as usize;
/// Bytes before the arrays of the stored form, and of the frame's.
const STORED_HEAD_BYTES: usize = 16;
const FRAME_HEAD_BYTES: usize = 8;
/// Bytes of a leaf's words: bitmap, normal.
const BITMAP_BYTES: usize = 8;
const NORMAL_BYTES: usize = 2;
const LINK_BYTES: usize = 4;
const INDEX_BYTES: usize = 2;

/// Counts of what is in a page.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnitCounts {
    pub(super) units: usize,
    pub(super) nodes: usize,
    pub(super) leaves: usize,
    /// Words of nodes: one each, or none.
    pub(super) links: usize,
}

impl UnitCounts {
    /// Bytes of the frame's form.
    pub(super) const fn frame_bytes(&self, material_bytes: usize) -> usize {
        FRAME_HEAD_BYTES
            + self.leaves * (BITMAP_BYTES + NORMAL_BYTES + material_bytes)
            + self.links * LINK_BYTES
            + (self.units + self.nodes + 2) * INDEX_BYTES
    }

    /// Bytes of the stored form before packing.
    fn stored_bytes(&self, material_bytes: usize) -> usize {
        STORED_HEAD_BYTES
            + self.units
            + self.nodes
            + self.links * LINK_BYTES
            + self.leaves * (BITMAP_BYTES + NORMAL_BYTES + material_bytes)
    }
}

/// The largest unit.
const LARGEST: UnitCounts = UnitCounts {
    units: 1,
    nodes: NODE_CHILDREN,
    leaves: NODE_CHILDREN * NODE_CHILDREN,
    links: NODE_CHILDREN,
};
const _: () = assert!(LARGEST.frame_bytes(2) <= FRAME_BYTES);

/// Bytes of a material's index in a model of so many.
pub(super) fn material_bytes(material_count: usize) -> usize {
    if material_count <= 256 { 1 } else { 2 }
}

/// Units on their way to a page.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Units {
    /// Nodes of each unit.
    pub(super) units: Vec<u8>,
    /// Leaves of each node.
    pub(super) nodes: Vec<u8>,
    /// Words of nodes: one each, or none.
    pub(super) links: Vec<u32>,
    pub(super) bitmaps: Vec<u64>,
    pub(super) normals: Vec<u16>,
    pub(super) materials: Vec<u16>,
}

impl Units {
    pub(super) fn counts(&self) -> UnitCounts {
        let (units, nodes) = (self.units.len(), self.nodes.len());
        UnitCounts { units, nodes, leaves: self.bitmaps.len(), links: self.links.len() }
    }

    /// Forgets all, keeps the memory.
    pub(super) fn clear(&mut self) {
        self.units.clear();
        self.nodes.clear();
        self.links.clear();
        self.bitmaps.clear();
        self.normals.clear();
        self.materials.clear();
    }

    /// The stored form before packing.
    pub(super) fn encode(&self, material_bytes: usize) -> Vec<u8> {
        let UnitCounts { units, nodes, leaves, links } = self.counts();
        let mut out = Vec::with_capacity(self.counts().stored_bytes(material_bytes));
        for count in [units, nodes, leaves, usize::from(links > 0)] {
            out.extend((count as u32).to_le_bytes());
        }
        out.extend(&self.units);
        out.extend(&self.nodes);
        for plane in 0..LINK_BYTES {
            out.extend(self.links.iter().map(|word| word.to_le_bytes()[plane]));
        }
        for plane in 0..BITMAP_BYTES {
            out.extend(self.bitmaps.iter().map(|word| word.to_le_bytes()[plane]));
        }
        for (words, bytes) in [(&self.normals, NORMAL_BYTES), (&self.materials, material_bytes)] {
            for plane in 0..bytes {
                out.extend(words.iter().map(|word| word.to_le_bytes()[plane]));
            }
        }
        out
    }
}

/// The stored form, its arrays found but not looked into.
#[derive(Clone, Copy)]
pub(super) struct StoredUnits<'a> {
    counts: UnitCounts,
    pub(super) units: &'a [u8],
    pub(super) nodes: &'a [u8],
    links: &'a [u8],
    bitmaps: &'a [u8],
    normals: &'a [u8],
    materials: &'a [u8],
}

impl<'a> StoredUnits<'a> {
    /// `None` for another length than the counts say.
    pub(super) fn read(raw: &'a [u8], material_bytes: usize) -> Option<StoredUnits<'a>> {
        let (head, arrays) = raw.split_first_chunk::<STORED_HEAD_BYTES>()?;
        let word = |i: usize| u32::from_le_bytes(head[4 * i..4 * i + 4].try_into().expect("four")) as usize;
        let linked = word(3);
        let counts =
            UnitCounts { units: word(0), nodes: word(1), leaves: word(2), links: word(1) * linked.min(1) };
        if linked > 1 || counts.stored_bytes(material_bytes) != raw.len() {
            return None;
        }
        let mut rest = arrays;
        let mut take = |bytes: usize| {
            let (array, tail) = rest.split_at(bytes);
            rest = tail;
            array
        };
        Some(StoredUnits {
            counts,
            units: take(counts.units),
            nodes: take(counts.nodes),
            links: take(LINK_BYTES * counts.links),
            bitmaps: take(BITMAP_BYTES * counts.leaves),
            normals: take(NORMAL_BYTES * counts.leaves),
            materials: take(material_bytes * counts.leaves),
        })
    }

    fn link(&self, node: usize) -> u32 {
        word_of(self.links, self.counts.links, node) as u32
    }

    pub(super) fn bitmap(&self, leaf: usize) -> u64 {
        word_of(self.bitmaps, self.counts.leaves, leaf)
    }

    pub(super) fn normal(&self, leaf: usize) -> u16 {
        word_of(self.normals, self.counts.leaves, leaf) as u16
    }

    pub(super) fn material(&self, leaf: usize) -> u16 {
        word_of(self.materials, self.counts.leaves, leaf) as u16
    }

    /// Whether units part the nodes, and nodes the leaves, each with 1 to 64 of them.
    fn is_parted(&self) -> bool {
        let parts = |sizes: &[u8], sum: usize| {
            sizes.iter().all(|&size| (1..=NODE_CHILDREN).contains(&usize::from(size)))
                && sizes.iter().map(|&size| usize::from(size)).sum::<usize>() == sum
        };
        self.counts.units > 0 && parts(self.units, self.counts.nodes) && parts(self.nodes, self.counts.leaves)
    }
}

/// Word `index` of `count`, whose bytes stand in planes.
fn word_of(planes: &[u8], count: usize, index: usize) -> u64 {
    planes
        .iter()
        .skip(index)
        .step_by(count)
        .enumerate()
        .map(|(plane, &byte)| u64::from(byte) << (8 * plane))
        .sum()
}

/// What a page's words and materials must agree with.
pub(crate) struct UnitsContext<'a> {
    /// Materials of the model.
    pub(crate) material_count: usize,
    /// Whether a page has units.
    pub(crate) is_units: &'a dyn Fn(u32) -> bool,
}

/// The gate for foreign bytes: from the stored form to a frame. What is wrong, in words.
pub(crate) fn install_units(
    raw: &[u8],
    context: &UnitsContext<'_>,
    frame: &mut [u8],
) -> Result<(), &'static str> {
    let material_bytes = material_bytes(context.material_count);
    let stored = StoredUnits::read(raw, material_bytes)
        .ok_or("a page of units has another length than its head says")?;
    let counts = stored.counts;
    if counts.frame_bytes(material_bytes) > frame.len() {
        return Err("a page of units holds more than a frame can");
    }
    if !stored.is_parted() {
        return Err("units of a page do not part its leaves");
    }
    let mut out = FrameWriter { frame, at: 0 };
    [counts.units, counts.nodes, counts.leaves]
        .iter()
        .for_each(|&count| out.put(&(count as u16).to_le_bytes()));
    out.put(&[material_bytes as u8, u8::from(counts.links > 0)]);
    for sizes in [stored.units, stored.nodes] {
        let mut sum = 0u16;
        out.put(&sum.to_le_bytes());
        for &size in sizes {
            sum += u16::from(size);
            out.put(&sum.to_le_bytes());
        }
    }
    for node in 0..counts.links {
        let word = stored.link(node);
        if !(context.is_units)(UnitRef::from_word(word).page()) {
            return Err("a unit leads to a page that has none");
        }
        out.put(&word.to_le_bytes());
    }
    for leaf in 0..counts.leaves {
        let normal = stored.normal(leaf);
        if !LeafNormal(normal).is_sound() {
            return Err("a normal of a unit is out of its range");
        }
        out.put(&normal.to_le_bytes());
    }
    for leaf in 0..counts.leaves {
        let material = stored.material(leaf);
        if usize::from(material) >= context.material_count {
            return Err("a unit names a material that is not there");
        }
        out.put(&material.to_le_bytes()[..material_bytes]);
    }
    out.at = out.frame.len() - BITMAP_BYTES * counts.leaves;
    for leaf in 0..counts.leaves {
        let bitmap = stored.bitmap(leaf);
        if bitmap == 0 {
            return Err("a leaf of a unit is empty");
        }
        out.put(&bitmap.to_le_bytes());
    }
    Ok(())
}

/// Fills a frame.
struct FrameWriter<'a> {
    frame: &'a mut [u8],
    at: usize,
}

impl FrameWriter<'_> {
    fn put(&mut self, bytes: &[u8]) {
        self.frame[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }
}
