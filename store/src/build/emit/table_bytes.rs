//! Bytes of memory that the tables of a file take while they are made, and while they are read back.
//!
//! Invariant: they follow from the counts of the input, so that they are known before anything is built.

use crate::build::clusters::clusterer::BinaryNode;
use crate::build::clusters::pages::WideRef;
use crate::build::clusters::sah::Prim;
use crate::build::input_sizes::InputSizes;
use crate::cluster::{LatticeBox, Node, TopRef};
use crate::file::Emitter;
use crate::layout::EMITTER_BYTES;

/// Bytes of a root of a page while it waits for the top tree, in a vector that grows by doubling.
const ROOT_BYTES: usize = 2 * size_of::<(LatticeBox, TopRef)>();
/// Bytes that the top tree takes while it is made, a root of a page: two binary nodes; and primitive and rank, or, once
/// these are gone, its place in a wide node and in the node that is written. A node with fewer than eight children has
/// none but roots below it, so there are at most 4/7 as many nodes.
pub(crate) const TOP_BYTES: usize = 2 * size_of::<(LatticeBox, BinaryNode)>()
    + 2 * size_of::<(LatticeBox, WideRef)>()
    + (4 * Node::BYTES).div_ceil(7);
const _: () = assert!(size_of::<Prim>() + size_of::<u64>() <= 2 * size_of::<(LatticeBox, WideRef)>());
/// Bytes of the tables of a small model.
pub(crate) const TABLES_LEAST: u64 = 1 << 18;
/// Triangles a root of a page, for the plan: 530 to 735 in files of 1M to 100M triangles, rounded down.
const TRIANGLES_PER_ROOT: u64 = 512;

/// Bytes that the tables of such an input take while chunks are built: a list that grows is there twice.
pub(crate) fn tables_bytes(sizes: &InputSizes) -> u64 {
    let roots = sizes.triangle_count.div_ceil(TRIANGLES_PER_ROOT) * (ROOT_BYTES + ROOT_BYTES / 2) as u64;
    TABLES_LEAST + roots + 3 * sizes.emissive_count * EMITTER_BYTES as u64
}

/// Bytes that the tables and the top tree of such an input take while it is made.
pub(crate) fn top_tree_bytes(sizes: &InputSizes) -> u64 {
    let roots = sizes.triangle_count.div_ceil(TRIANGLES_PER_ROOT) * (ROOT_BYTES + TOP_BYTES) as u64;
    TABLES_LEAST + roots + 2 * sizes.emissive_count * EMITTER_BYTES as u64
}

/// Bytes of memory while the tables of the file of such an input are read, materials apart.
pub(crate) fn file_bytes(sizes: &InputSizes) -> u64 {
    let roots = sizes.triangle_count.div_ceil(TRIANGLES_PER_ROOT) * TOP_BYTES as u64;
    TABLES_LEAST + roots + sizes.emissive_count * (size_of::<Emitter>() + EMITTER_BYTES) as u64
}
