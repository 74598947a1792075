//! `OctreeNode`: a node of the upper octree, and how nodes are linked.
//!
//! ```text
//! mask u64 | first child u32
//! ```
//!
//! The child in place `i` of a node with mask `m` is `first + popcount(m & (2^i - 1))`: a node of the next level, or
//! at the last level a leaf.

/// A node of the octree. 12 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct OctreeNode {
    /// Children that are there: bit `x + 4 y + 16 z`, least word first.
    pub mask: [u32; 2],
    /// Index of the first child.
    pub first: u32,
}

impl OctreeNode {
    /// The mask as one word.
    pub fn bits(&self) -> u64 {
        u64::from(self.mask[0]) | u64::from(self.mask[1]) << 32
    }

    /// Index of the child in `place`, if it is there.
    #[inline]
    pub fn child(&self, place: u32) -> Option<u32> {
        let bits = self.bits();
        (bits >> place & 1 == 1).then(|| self.first + (bits & ((1 << place) - 1)).count_ones())
    }
}

/// Nodes, level by level, linked.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tree {
    /// Where each level begins in `nodes`, the root's first.
    pub(super) levels: Vec<usize>,
    pub(super) nodes: Vec<OctreeNode>,
}

impl Tree {
    /// Index of the first node whose children are leaves.
    pub(super) fn first_last(&self) -> usize {
        *self.levels.last().expect("an octree has a root")
    }

    /// Nodes whose children are leaves, in order.
    pub(super) fn last_nodes(&self) -> &[OctreeNode] {
        &self.nodes[self.first_last()..]
    }
}

/// Nodes from masks in level order; `None` when the levels do not come out at `leaf_count`.
pub(super) fn link(masks: &[u64], depth: usize, leaf_count: usize) -> Option<Tree> {
    let mut nodes = Vec::with_capacity(masks.len());
    let (mut levels, mut begin, mut count) = (Vec::with_capacity(depth), 0usize, 1usize);
    for level in 0..depth {
        levels.push(begin);
        let end = begin.checked_add(count)?;
        let is_last = level + 1 == depth;
        let mut first = if is_last { 0 } else { end };
        for &mask in masks.get(begin..end)? {
            nodes.push(OctreeNode {
                mask: [mask as u32, (mask >> 32) as u32],
                first: u32::try_from(first).ok()?,
            });
            first += mask.count_ones() as usize;
        }
        count = if is_last { first } else { first - end };
        begin = end;
    }
    (begin == masks.len() && count == leaf_count).then_some(Tree { levels, nodes })
}
