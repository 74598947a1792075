//! The voxel octree (ASVO): the second, decoupled form of the model, which answers G-rays. Paper, section 4.
//!
//! ```text
//! triangles --voxelize--> records (leaf, material, bitmap, area, sums of normals) --sort, merge--> leaves in key order
//!
//! leaves --> octree; where there are finer ones:
//! finest leaves --sum by 64--> coarser leaves --sum by 64--> upper leaves --> upper octree
//!       '-------------------------'--> units of 16^3 leaves --> pages
//! ```
//!
//! A node divides its cube by 4 along each axis: two octree levels at once, so that 64 children fit a word. Leaves are
//! nodes of the same kind: their 64 children are the *occluder bitmap*, the subvoxels that the surface touches. So a
//! leaf's bitmap is also the mask of the finer leaves in it: what lies below the upper leaves, the *lower octrees*,
//! needs no masks.
//!
//! Invariants: 1. a subvoxel is set when and only when a triangle overlaps it, exactly (integers); 2. no vertex lies
//! on a boundary, since boundaries stand half a lattice step off: a wall on a grid plane marks one layer, not two; 3.
//! leaves and sums do not depend on threads: records are made and merged in the order of chunks.

mod coarsen;
mod divisor;
mod emit;
mod exposed;
mod facets;
mod families;
mod links;
mod merge;
mod node;
mod overlap;
mod payload;
mod record;
mod stored;
mod units;
mod upper;
mod voxelize;

pub(crate) use emit::{STREAM_BYTES, UpperBuilder};
pub use facets::Facets;
pub(crate) use families::{FamilyOutcome, FirstPage, LowerBuilder, family_bytes};
pub use links::{LowerLinks, LowerSize, UnitRef};
pub(crate) use merge::{RUN_BYTES, RecordBounds, RunsSize, VoxelRunTable, VoxelRuns, merge};
pub use node::OctreeNode;
pub(crate) use payload::LeafNormal;
pub use payload::OCTAHEDRAL_BITS;
pub use units::{UnitNode, UnitsView};
pub(crate) use units::{UnitsContext, install_units};
pub(crate) use upper::leaf_bytes;
pub use upper::{LeafVoxel, UpperOctree, UpperSize};
pub(crate) use voxelize::{RUN_RECORDS, Voxelizer};

/// Children of a node along an axis.
pub const NODE_SIDE: u32 = 4;
/// Subvoxels of a leaf along an axis.
pub const LEAF_SIDE: u32 = 4;
/// Most levels of nodes above the leaves of the upper octree: 4^5 = 1024 leaves along an axis.
pub const MAX_DEPTH: usize = 5;
/// Most levels of leaves below these.
pub const MAX_FINER: usize = 2;

/// How many of the finest leaves make an upper one, along an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Refinement {
    /// The upper leaves are the finest.
    #[default]
    None = 1,
    /// One level of leaves below them.
    By4 = 4,
    /// Two.
    By16 = 16,
}

impl Refinement {
    /// All of them, the coarsest first.
    pub const ALL: [Refinement; 3] = [Refinement::None, Refinement::By4, Refinement::By16];

    /// By its number; `None` for one that is not offered.
    pub fn from_factor(factor: u32) -> Option<Refinement> {
        Refinement::ALL.into_iter().find(|known| known.factor() == factor)
    }

    /// Finest leaves along an upper one.
    pub fn factor(self) -> u32 {
        self as u32
    }

    /// Levels of leaves below the upper ones.
    pub fn levels(self) -> usize {
        self.factor().ilog2() as usize / 2
    }
}

/// The cube of leaves over a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct VoxelGrid {
    /// Leaves along an axis of the cube: 64, 256, 512 or 1024 of the upper octree; times 4 or 16 of finer ones.
    pub resolution: u32,
    /// Lattice point in the middle of the first subvoxel's least corner; boundaries stand half a step before it.
    pub lo: [i64; 3],
    /// Lattice steps along a subvoxel.
    pub subvoxel_steps: i64,
}

impl VoxelGrid {
    /// Over lattice points `lo` to `hi`, with `resolution` leaves along the longest side, which can be divided by
    /// `refinement`: boundaries of finer leaves are on the lattice, too.
    pub fn from_bounds(lo: [i64; 3], hi: [i64; 3], resolution: u32, refinement: Refinement) -> VoxelGrid {
        assert!(is_upper(resolution), "{resolution} leaves along an axis");
        let points = (0..3).map(|a| hi[a] - lo[a] + 1).max().expect("three axes").max(1) as u64;
        let steps = points.div_ceil(u64::from(resolution * LEAF_SIDE));
        let subvoxel_steps = steps.next_multiple_of(u64::from(refinement.factor())) as i64;
        VoxelGrid { resolution, lo, subvoxel_steps }
    }

    /// The finest leaves of a grid that was made for `refinement`.
    pub fn refined(&self, refinement: Refinement) -> VoxelGrid {
        let factor = refinement.factor();
        let subvoxel_steps = self.subvoxel_steps / i64::from(factor);
        VoxelGrid { resolution: self.resolution * factor, lo: self.lo, subvoxel_steps }
    }

    /// Levels of nodes above the leaves.
    pub fn depth(&self) -> usize {
        self.resolution.ilog2().div_ceil(2) as usize
    }

    /// Lattice steps along a leaf.
    pub fn leaf_steps(&self) -> i64 {
        self.subvoxel_steps * i64::from(LEAF_SIDE)
    }
}

/// Whether an upper octree can have so many leaves along an axis.
pub(crate) fn is_upper(resolution: u32) -> bool {
    [64, 256, 512, 1024].contains(&resolution)
}

/// Bits of a key per level of the octree.
pub(crate) const KEY_BITS: u32 = 6;

/// Place of a leaf in the octree: six bits per level, the root's first; in each `x + 4 y + 16 z`.
pub(crate) fn leaf_key(at: [u32; 3], depth: usize) -> u64 {
    (0..depth).rev().fold(0, |key, level| {
        let part = |axis: usize| at[axis] >> (2 * level) & 3;
        key << KEY_BITS | u64::from(part(0) | part(1) << 2 | part(2) << 4)
    })
}

/// The inverse of [`leaf_key`].
pub(crate) fn place_of(key: u64, depth: usize) -> [u32; 3] {
    let digit = |level: usize| (key >> (KEY_BITS as usize * level)) as u32 & 63;
    std::array::from_fn(|axis| (0..depth).rev().fold(0, |at, level| at << 2 | digit(level) >> (2 * axis) & 3))
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
        for at in [[0, 0, 0], [5, 2, 3], [16_383, 1, 9_999]] {
            assert_eq!(place_of(leaf_key(at, 7), 7), at);
        }
    }

    #[test]
    fn the_cube_holds_the_model() {
        for (lo, hi) in
            [([0; 3], [0; 3]), ([5, 0, 7], [5, 1, 7]), ([0; 3], [100_000, 3, 99_999]), ([1; 3], [4096; 3])]
        {
            for resolution in [64, 256, 512, 1024] {
                for refinement in Refinement::ALL {
                    let upper = VoxelGrid::from_bounds(lo, hi, resolution, refinement);
                    let grid = upper.refined(refinement);
                    assert_eq!(grid.depth(), upper.depth() + refinement.levels());
                    for grid in [upper, grid] {
                        let side = grid.leaf_steps() * i64::from(grid.resolution);
                        assert!((0..3).all(|a| hi[a] - lo[a] < side), "{grid:?}");
                        assert!(4usize.pow(grid.depth() as u32) >= grid.resolution as usize);
                    }
                }
            }
        }
    }
}
