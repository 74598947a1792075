//! An 8-wide node with 16-bit child boxes, and the words that lead from a node to what is below it: in the top tree
//! they stand for good, in a frame that of a cluster changes once, when it is unpacked.
//!
//! ```text
//! plane of child i on axis a = (origin[a] + lo[a][i] * 2^exponent[a]) << node_shift     (lattice steps)
//! ```
//!
//! Why 16 bits: rays that start on a plate start in any box that is a step wider than the plate.
//!
//! Invariants: 1. a child's 16-bit box holds the child's exact box (floor, ceil in integers); 2. slots from
//! `child_count` on hold the inverted box (65,535, 0).

use crate::layout::{NODE_WIDTH, PAGE_ROOTS, PAGES};
use std::sync::atomic::{AtomicU32, Ordering};

/// Bits of a page root's slot in a [`TopRef`].
pub const ROOT_SLOT_BITS: u32 = 6;
const _: () = assert!(PAGE_ROOTS <= 1 << ROOT_SLOT_BITS && PAGES == 1 << (31 - ROOT_SLOT_BITS));

/// A box on the lattice; both corners inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatticeBox {
    /// Least corner.
    pub lo: [i64; 3],
    /// Greatest corner.
    pub hi: [i64; 3],
}

impl LatticeBox {
    /// Holds nothing; the identity of `join`.
    pub const EMPTY: LatticeBox = LatticeBox { lo: [i64::MAX; 3], hi: [i64::MIN; 3] };

    /// Grows to hold `q`.
    pub fn add(&mut self, q: [i64; 3]) {
        for axis in 0..3 {
            self.lo[axis] = self.lo[axis].min(q[axis]);
            self.hi[axis] = self.hi[axis].max(q[axis]);
        }
    }

    /// The box that holds both.
    pub fn join(&self, other: &LatticeBox) -> LatticeBox {
        LatticeBox {
            lo: std::array::from_fn(|a| self.lo[a].min(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(other.hi[a])),
        }
    }

    /// Half of the surface area, in square steps; for SAH, not exact.
    pub fn half_area(&self) -> f64 {
        let [x, y, z] = std::array::from_fn(|a| (self.hi[a] - self.lo[a]) as f64);
        x * y + y * z + z * x
    }
}

/// The boxes of a node's children. 112 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct ChildBoxes {
    /// Least corner of all children, in units of `2^node_shift` lattice steps.
    pub origin: [i32; 3],
    /// Child planes are multiples of `2^exponent` of that unit.
    pub exponent: [u8; 3],
    /// Children in use, 1 to 8.
    pub child_count: u8,
    /// Lower planes, `[axis][child]`.
    pub lo: [[u16; NODE_WIDTH]; 3],
    /// Upper planes, `[axis][child]`.
    pub hi: [[u16; NODE_WIDTH]; 3],
}

/// A node of the top tree. 144 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Node {
    /// The boxes of its children.
    pub boxes: ChildBoxes,
    /// A [`TopRef`] each.
    pub child: [u32; NODE_WIDTH],
}

/// A node in a frame, of the same 144 bytes: its words may change while it is read.
#[derive(Debug)]
#[repr(C)]
pub struct FrameNode {
    /// The boxes of its children.
    pub boxes: ChildBoxes,
    /// A [`super::FrameRef`] each.
    child: [AtomicU32; NODE_WIDTH],
}

const _: () = assert!(size_of::<FrameNode>() == Node::BYTES && align_of::<FrameNode>() == 4);

/// A node, wherever it stands.
pub trait TreeNode {
    /// The boxes of its children.
    fn boxes(&self) -> &ChildBoxes;

    /// The word that leads to child `index`, modulo the width of a node.
    fn word(&self, index: usize) -> u32;
}

impl TreeNode for Node {
    #[inline(always)]
    fn boxes(&self) -> &ChildBoxes {
        &self.boxes
    }

    #[inline(always)]
    fn word(&self, index: usize) -> u32 {
        self.child[index % NODE_WIDTH]
    }
}

impl TreeNode for FrameNode {
    #[inline(always)]
    fn boxes(&self) -> &ChildBoxes {
        &self.boxes
    }

    #[inline(always)]
    fn word(&self, index: usize) -> u32 {
        // Acquires the cluster that the word leads to.
        self.child[index % NODE_WIDTH].load(Ordering::Acquire)
    }
}

impl FrameNode {
    /// The words of the children in use.
    pub fn words(&self) -> impl Iterator<Item = u32> + '_ {
        (0..usize::from(self.boxes.child_count)).map(|i| self.word(i))
    }
}

impl Node {
    /// Bytes of a node in memory.
    pub const BYTES: usize = size_of::<Node>();

    /// A node over `children`: 1 to 8 boxes, each with the word that leads to it.
    pub fn from_children(children: &[(LatticeBox, u32)], node_shift: u32) -> Node {
        assert!((1..=NODE_WIDTH).contains(&children.len()), "{} children", children.len());
        let all = children.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let up = |q: i64| (q + (1 << node_shift) - 1) >> node_shift;
        let mut boxes = ChildBoxes {
            origin: all.lo.map(|q| i32::try_from(q >> node_shift).expect("31 bits after the shift")),
            exponent: [0; 3],
            child_count: children.len() as u8,
            lo: [[u16::MAX; NODE_WIDTH]; 3],
            hi: [[0; NODE_WIDTH]; 3],
        };
        for axis in 0..3 {
            let origin = i64::from(boxes.origin[axis]);
            let side = up(all.hi[axis]) - origin;
            let exponent =
                (0..).find(|e| side <= i64::from(u16::MAX) << e).expect("a side has at most 40 bits");
            boxes.exponent[axis] = exponent as u8;
            for (i, (b, _)) in children.iter().enumerate() {
                let (lo, hi) = ((b.lo[axis] >> node_shift) - origin, up(b.hi[axis]) - origin);
                boxes.lo[axis][i] = (lo >> exponent) as u16;
                boxes.hi[axis][i] = ((hi + (1 << exponent) - 1) >> exponent) as u16;
            }
        }
        let mut child = [0; NODE_WIDTH];
        child.iter_mut().zip(children).for_each(|(word, child)| *word = child.1);
        Node { boxes, child }
    }
}

impl ChildBoxes {
    /// The box of child `i` as traversal sees it, in lattice steps.
    pub fn child_box(&self, i: usize, node_shift: u32) -> LatticeBox {
        let plane = |axis: usize, q: u16| {
            (i64::from(self.origin[axis]) + (i64::from(q) << self.exponent[axis])) << node_shift
        };
        LatticeBox {
            lo: std::array::from_fn(|a| plane(a, self.lo[a][i])),
            hi: std::array::from_fn(|a| plane(a, self.hi[a][i])),
        }
    }
}

/// Where a child of a top-tree node leads: to another top node, or to a root of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TopRef {
    /// Index of a node of the top tree.
    Node(u32),
    /// A root within a page.
    Page {
        /// Page id.
        page: u32,
        /// Slot in the page's list of roots.
        slot: u32,
    },
}

impl TopRef {
    const PAGE_FLAG: u32 = 1 << 31;

    /// The word that stands in a node.
    pub fn to_word(self) -> u32 {
        match self {
            TopRef::Node(index) => {
                assert!(index < TopRef::PAGE_FLAG);
                index
            }
            TopRef::Page { page, slot } => {
                assert!(page < PAGES && slot < 1 << ROOT_SLOT_BITS);
                TopRef::PAGE_FLAG | slot << (31 - ROOT_SLOT_BITS) | page
            }
        }
    }

    /// Reads the word.
    pub fn from_word(word: u32) -> TopRef {
        if word & TopRef::PAGE_FLAG == 0 {
            return TopRef::Node(word);
        }
        TopRef::Page {
            page: word & (PAGES - 1),
            slot: word >> (31 - ROOT_SLOT_BITS) & ((1 << ROOT_SLOT_BITS) - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_box() -> impl Strategy<Value = LatticeBox> {
        ((0i64..1 << 40), (0i64..1 << 40), (0i64..1 << 40), 0u32..40).prop_map(|(x, y, z, size)| {
            let lo = [x, y, z];
            LatticeBox { lo, hi: lo.map(|q| (q + (q % (1 << size))).min((1 << 40) - 1)) }
        })
    }

    proptest! {
        #[test]
        fn sixteen_bit_boxes_hold_the_exact_ones(boxes in proptest::collection::vec(any_box(), 1..=8)) {
            let children: Vec<_> = boxes.iter().map(|&b| (b, 7)).collect();
            let node = Node::from_children(&children, 10);
            for (i, exact) in boxes.iter().enumerate() {
                let coarse = node.boxes.child_box(i, 10);
                prop_assert_eq!(coarse.join(exact), coarse);
            }
        }

        #[test]
        fn top_refs_survive(page in 0..PAGES, slot in 0u32..64, node in 0u32..1 << 31) {
            for r in [TopRef::Page { page, slot }, TopRef::Node(node)] {
                prop_assert_eq!(TopRef::from_word(r.to_word()), r);
            }
        }
    }
}
