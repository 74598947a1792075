//! Boxes around all triangles of a file, closer than the one around all of them: what a camera frames.
//!
//! Invariant: they are of the file alone, and at most [`BOXES_MAX`].

use std::sync::Arc;
use trex_store::cluster::{LatticeBox, TopRef};
use trex_store::layout::NODE_WIDTH;
use trex_store::{Aabb, PageFile};

/// Most boxes: some twenty across a surface that is seen from its side.
const BOXES_MAX: usize = 512;

/// The boxes of the top tree's upper part: the largest are divided first.
pub(crate) fn outline(file: &PageFile) -> Arc<[Aabb]> {
    let block = file.superblock();
    let children = |index: u32| {
        let node = &file.top()[index as usize];
        (0..usize::from(node.boxes.child_count))
            .map(move |i| (node.boxes.child_box(i, block.node_shift), node.child[i]))
    };
    let TopRef::Node(root) = TopRef::from_word(block.root) else { return Arc::default() };
    let mut boxes: Vec<(LatticeBox, u32)> = children(root).collect();
    while boxes.len() + NODE_WIDTH <= BOXES_MAX {
        let divisible = |(_, (_, word)): &(usize, &(LatticeBox, u32))| {
            matches!(TopRef::from_word(*word), TopRef::Node(_))
        };
        let by_size = |a: &(usize, &(LatticeBox, u32)), b: &(usize, &(LatticeBox, u32))| {
            a.1.0.half_area().total_cmp(&b.1.0.half_area())
        };
        let Some((at, _)) = boxes.iter().enumerate().filter(divisible).max_by(by_size) else { break };
        let (_, word) = boxes.swap_remove(at);
        if let TopRef::Node(index) = TopRef::from_word(word) {
            boxes.extend(children(index));
        }
    }
    // Planes of nodes are rounded outward: no box is larger than the model.
    let within = |of: &LatticeBox| {
        let [lo, hi] = [of.lo, of.hi].map(|corner| block.lattice.position(corner));
        let inside = |at: [f64; 3]| {
            std::array::from_fn(|axis| at[axis].clamp(block.bounds.lo[axis], block.bounds.hi[axis]))
        };
        Aabb { lo: inside(lo), hi: inside(hi) }
    };
    boxes.iter().map(|(of, _)| within(of)).collect()
}
