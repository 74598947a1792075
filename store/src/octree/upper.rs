//! `UpperOctree`: the octree that is always resident: how it lies in memory.
//!
//! ```text
//! nodes, level by level from the root: see `node`     (children of a node stand together)
//! bitmaps u64 per leaf                                (all that shadow rays read)
//! payload per leaf: normal u16 | material u8 or u16   (where there are several)
//! facets per last node                                (what light is kept by)
//! ```
//!
//! Invariants: 1. every mask has a bit set, and every bitmap, but for those of materials that are left out; 2. nodes
//! and leaves stand in key order, so that neighbours are near; 3. counts agree with masks, materials are below the
//! count of materials.

use super::node::{OctreeNode, Tree};
use super::payload::{LeafNormal, Materials};
use super::{Facets, VoxelGrid};
use std::sync::Arc;

/// Normal, flatness and material of the surface in a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeafVoxel {
    /// Mean unit normal, weighted by area; zero where none is known.
    pub normal: [f32; 3],
    /// Length of the mean before it was made unit: 1 = flat, 0 = all directions.
    pub flatness: f32,
    /// The material with the most area.
    pub material: u16,
}

/// Sizes of a resident octree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpperSize {
    /// Leaves along an axis of the cube.
    pub resolution: u32,
    /// Lattice steps along a leaf.
    pub leaf_steps: i64,
    /// Count of leaves.
    pub leaf_count: u32,
    /// Count of facets.
    pub facet_count: u32,
    /// Bytes in the file.
    pub stored_bytes: u64,
    /// Bytes of memory, without light.
    pub resident_bytes: u64,
    /// Bytes of memory beside these while it is read.
    pub reading_bytes: u64,
}

impl UpperSize {
    /// Bytes of memory for so many nodes, leaves and facets, at most: of the last nodes it is known only that they have
    /// leaves.
    pub(super) fn resident_bytes(nodes: u64, leaves: u64, facets: u64, material_count: usize) -> u64 {
        nodes * size_of::<OctreeNode>() as u64
            + leaves * (LEAF_BYTES + Materials::bytes(material_count))
            + Facets::bytes(nodes.min(leaves), facets)
    }
}

/// Bytes of a leaf: bitmap, normal.
const LEAF_BYTES: u64 = 8 + 2;

/// The resident octree. See the module's picture.
#[derive(Clone, Debug, PartialEq)]
pub struct UpperOctree {
    grid: VoxelGrid,
    bitmaps: Vec<u64>,
    shared: Arc<SharedOctree>,
}

/// What an octree shares with one that leaves materials out of it.
#[derive(Debug, PartialEq)]
struct SharedOctree {
    tree: Tree,
    normals: Vec<LeafNormal>,
    materials: Materials,
    facets: Facets,
}

/// What is known of each leaf, in key order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Leaves {
    pub(super) bitmaps: Vec<u64>,
    pub(super) normals: Vec<LeafNormal>,
    pub(super) materials: Materials,
}

impl UpperOctree {
    /// An octree of checked parts.
    pub(super) fn new(grid: VoxelGrid, tree: Tree, leaves: Leaves, facets: Facets) -> UpperOctree {
        let Leaves { bitmaps, normals, materials } = leaves;
        UpperOctree { grid, bitmaps, shared: Arc::new(SharedOctree { tree, normals, materials, facets }) }
    }

    /// This octree without the leaves of some materials: their bitmaps are empty, so that rays pass through them. All
    /// else is shared with this one.
    pub fn without(&self, is_left_out: impl Fn(u16) -> bool) -> UpperOctree {
        let bitmap =
            |(leaf, &bitmap): (usize, &u64)| if is_left_out(self.material(leaf)) { 0 } else { bitmap };
        let bitmaps = self.bitmaps.iter().enumerate().map(bitmap).collect();
        UpperOctree { bitmaps, shared: self.shared.clone(), ..*self }
    }

    /// Bytes of an octree without some materials, of so many leaves, beside the one that has them.
    pub fn without_bytes(leaves: usize) -> u64 {
        leaves as u64 * size_of::<u64>() as u64
    }

    /// The cube.
    pub fn grid(&self) -> &VoxelGrid {
        &self.grid
    }

    /// Nodes, level by level; the root is the first.
    pub fn nodes(&self) -> &[OctreeNode] {
        &self.shared.tree.nodes
    }

    /// Nodes whose children are leaves, in order.
    pub fn last_nodes(&self) -> &[OctreeNode] {
        self.shared.tree.last_nodes()
    }

    /// Occluder bitmaps, one per leaf.
    pub fn bitmaps(&self) -> &[u64] {
        &self.bitmaps
    }

    /// Count of leaves.
    pub fn leaf_count(&self) -> usize {
        self.bitmaps.len()
    }

    /// Normal, flatness and material of the surface in `leaf`.
    pub fn leaf(&self, leaf: usize) -> LeafVoxel {
        let (normal, flatness) = self.shared.normals[leaf].unpack();
        LeafVoxel { normal, flatness, material: self.shared.materials.get(leaf) }
    }

    /// Material of `leaf`.
    pub fn material(&self, leaf: usize) -> u16 {
        self.shared.materials.get(leaf)
    }

    /// What [`UpperOctree::leaf`] says as a device takes it: the packed normal in the lower half of the word, the
    /// material in the upper one.
    #[inline]
    pub fn leaf_word(&self, leaf: usize) -> u32 {
        u32::from(self.shared.normals[leaf].0) | u32::from(self.material(leaf)) << 16
    }

    /// The facets.
    pub fn facets(&self) -> &Facets {
        &self.shared.facets
    }

    /// Index of the facet to which `leaf` under `node` belongs.
    ///
    /// # Panics
    /// When `node` is none of the last level.
    #[inline]
    pub fn facet(&self, node: u32, leaf: u32) -> u32 {
        let number = node as usize - self.shared.tree.first_last();
        self.shared.facets.index(number, self.shared.normals[leaf as usize])
    }
}

/// Bytes in memory of a leaf and its share of nodes and facets, as a rule: a byte of material; twelve leaves a node,
/// and a facet for six of them (16 and 8 on the iso-surface).
pub(crate) fn leaf_bytes() -> u64 {
    LEAF_BYTES + 1 + (size_of::<OctreeNode>() as u64 + Facets::bytes(1, 2)).div_ceil(12)
}
