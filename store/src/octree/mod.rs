//! The voxel octree (ASVO): the second, decoupled form of the model, which answers G-rays. Paper, section 4.
//!
//! ```text
//! triangles --voxelize--> records (leaf, material, bitmap, area, normal) --sort, merge--> leaves in key order --> octree
//! ```
//!
//! A node divides its cube by 4 along each axis: two octree levels at once, so that 64 children fit a word. Leaves are
//! nodes of the same kind: their 64 children are the *occluder bitmap*, the subvoxels that the surface touches.
//!
//! Invariants: 1. a subvoxel is set when and only when a triangle overlaps it, exactly (integers); 2. no vertex lies on a
//! boundary, since boundaries stand half a lattice step off: a wall on a grid plane marks one layer, not two; 3. leaves
//! and sums do not depend on threads: records are made and merged in the order of chunks.

mod emit;
mod facets;
mod merge;
mod overlap;
mod payload;
mod stored;
mod upper;
mod voxelize;

pub(crate) use emit::{STREAM_BYTES, UpperBuilder};
pub use facets::Facets;
pub(crate) use merge::{RUN_BYTES, VoxelRuns, merge};
pub(crate) use payload::LeafNormal;
pub(crate) use upper::leaf_bytes;
pub use upper::{LeafVoxel, OctreeNode, UpperOctree, UpperSize};
pub(crate) use voxelize::Voxelizer;

/// Children of a node along an axis.
pub const NODE_SIDE: u32 = 4;
/// Subvoxels of a leaf along an axis.
pub const LEAF_SIDE: u32 = 4;
/// Most levels of nodes above the leaves: 4^5 = 1024 leaves along an axis.
pub const MAX_DEPTH: usize = 5;

/// The cube of leaves over a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct VoxelGrid {
    /// Leaves along an axis of the cube: 64, 256, 512 or 1024.
    pub resolution: u32,
    /// Lattice point in the middle of the first subvoxel's least corner; boundaries stand half a step before it.
    pub lo: [i64; 3],
    /// Lattice steps along a subvoxel.
    pub subvoxel_steps: i64,
}

impl VoxelGrid {
    /// Over lattice points `lo` to `hi`, with `resolution` leaves along the longest side.
    pub fn over(lo: [i64; 3], hi: [i64; 3], resolution: u32) -> VoxelGrid {
        assert!(depth_of(resolution).is_some(), "{resolution} leaves along an axis");
        let points = (0..3).map(|a| hi[a] - lo[a] + 1).max().expect("three axes").max(1) as u64;
        let subvoxel_steps = points.div_ceil(u64::from(resolution * LEAF_SIDE)) as i64;
        VoxelGrid { resolution, lo, subvoxel_steps }
    }

    /// Levels of nodes above the leaves.
    pub fn depth(&self) -> usize {
        depth_of(self.resolution).expect("checked by the constructor and the parser")
    }

    /// Lattice steps along a leaf.
    pub fn leaf_steps(&self) -> i64 {
        self.subvoxel_steps * i64::from(LEAF_SIDE)
    }
}

/// Levels for so many leaves along an axis; `None` for a resolution that is not offered.
pub(crate) fn depth_of(resolution: u32) -> Option<usize> {
    match resolution {
        64 => Some(3),
        256 => Some(4),
        512 | 1024 => Some(5),
        _ => None,
    }
}

/// Place of a leaf in the octree: six bits per level, the root's first; in each `x + 4 y + 16 z`.
pub(crate) fn leaf_key(at: [u32; 3], depth: usize) -> u32 {
    (0..depth).rev().fold(0, |key, level| {
        let part = |axis: usize| at[axis] >> (2 * level) & 3;
        key << 6 | part(0) | part(1) << 2 | part(2) << 4
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_order_leaves_by_node() {
        assert_eq!(leaf_key([0, 0, 0], 4), 0);
        assert_eq!(leaf_key([3, 0, 0], 4), 3);
        assert_eq!(leaf_key([4, 0, 0], 4), 1 << 6);
        assert_eq!(leaf_key([5, 2, 3], 4), 1 << 6 | (1 + 8 + 48));
        assert_eq!(leaf_key([255, 255, 255], 4), (1 << 24) - 1);
    }

    #[test]
    fn the_cube_holds_the_model() {
        for (lo, hi) in
            [([0; 3], [0; 3]), ([5, 0, 7], [5, 1, 7]), ([0; 3], [100_000, 3, 99_999]), ([1; 3], [4096; 3])]
        {
            for resolution in [64, 256, 512, 1024] {
                let grid = VoxelGrid::over(lo, hi, resolution);
                let side = grid.leaf_steps() * i64::from(resolution);
                assert!((0..3).all(|a| hi[a] - lo[a] < side), "{grid:?}");
            }
        }
    }
}
