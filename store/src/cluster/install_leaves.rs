//! Leaves on their way to the frame: their corners, what the indices take, boxes.
//!
//! ```text
//! corners of strips -> Leaves -> least index and shape, a leaf -> Indices -> bytes of the frame
//! cells of vertices --------------------------------------------> Boxes   -> planes, shapes
//! ```
//!
//! Invariant: what is written is a function of corners, sizes and cells alone.

use super::cells::{self, Cell, Cells};
use super::fields::{BYTES_OF_ONE, Mover, Work};
use super::strips::Corners;
use super::{CLUSTER_HEAD_BYTES, LEAF_HEAD_BYTES, LEAF_PLANES, LeafShape};
use crate::layout::{CLUSTER_LEAVES, CLUSTER_TRIANGLES, LEAF_TRIANGLES};

/// A leaf on its way to the frame.
#[derive(Clone, Copy, Default)]
pub(super) struct InstalledLeaf {
    /// Corners of its triangles, a byte each; behind the last triangle those of the first.
    corners: [u64; 3],
    least: u8,
    pub(super) shape: LeafShape,
}

/// The leaves of the corners: what their indices take.
pub(super) struct LeafIndexer<'a> {
    pub(super) corners: &'a Corners,
    pub(super) sizes: &'a [u8; CLUSTER_LEAVES],
    pub(super) leaves: &'a mut [InstalledLeaf],
}

impl Work for LeafIndexer<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Mover>(self, _: M) {
        let mut first = 0;
        for (leaf, &size) in self.leaves.iter_mut().zip(self.sizes) {
            let (size, there) = (usize::from(size), u64::MAX >> (64 - 8 * u32::from(size)));
            for (word, corners) in leaf.corners.iter_mut().zip(self.corners) {
                let eight = &corners[first % CLUSTER_TRIANGLES..][..LEAF_TRIANGLES];
                let eight = u64::from_le_bytes(eight.try_into().expect("eight bytes"));
                *word = (eight & there) | ((eight & 0xff) * (BYTES_OF_ONE & !there));
            }
            let (least, most) = cells::range(leaf.corners);
            (leaf.least, leaf.shape) = (least, LeafShape::new(size, most - least));
            first += size;
        }
    }
}

/// Leaf boxes, from the cells, and shapes, to where they stand in the frame.
pub(super) struct Boxes<'a> {
    pub(super) leaves: &'a [InstalledLeaf],
    /// Bit t: triangle t is the first of a strip.
    pub(super) starts: u128,
    pub(super) cells: &'a Cells,
    /// The cluster's.
    pub(super) frame: &'a mut [u8],
}

impl Work for Boxes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Mover>(self, _: M) {
        let mut planes = [[0u8; CLUSTER_LEAVES]; LEAF_HEAD_BYTES];
        let mut starts = self.starts;
        for (i, leaf) in self.leaves.iter().enumerate().take(CLUSTER_LEAVES) {
            let [a, b, x] = leaf.corners.map(u64::to_le_bytes);
            let mut all = x.iter().fold(Cell::MOST, |all, &v| all.min(Cell::of(self.cells, v)));
            // The other corners of a triangle are among those of the one before it, but where a strip or leaf begins.
            let mut first = (starts as u8 & (u8::MAX >> (LEAF_TRIANGLES - leaf.shape.triangle_count()))) | 1;
            while first != 0 {
                let at = first.trailing_zeros() as usize % LEAF_TRIANGLES;
                all = all.min(Cell::of(self.cells, a[at])).min(Cell::of(self.cells, b[at]));
                first &= first - 1;
            }
            starts >>= leaf.shape.triangle_count();
            for (plane, value) in planes.iter_mut().zip(all.planes()) {
                plane[i] = value;
            }
            planes[LEAF_PLANES][i] = leaf.shape.0;
        }
        let count = self.leaves.len();
        for (there, plane) in self.frame[CLUSTER_HEAD_BYTES..].chunks_exact_mut(count).zip(&planes) {
            there.copy_from_slice(&plane[..count]);
        }
    }
}

/// The indices of all leaves. They run into what is written behind them, by less than the tail.
pub(super) struct Indices<'a> {
    pub(super) leaves: &'a [InstalledLeaf],
    pub(super) frame: &'a mut [u8],
}

impl Work for Indices<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) {
        let mut at = CLUSTER_HEAD_BYTES + LEAF_HEAD_BYTES * self.leaves.len();
        for leaf in self.leaves {
            let (least, shape) = (leaf.least, leaf.shape);
            let there = u64::MAX >> (64 - 8 * shape.triangle_count());
            self.frame[at] = least;
            at += 1;
            for &corners in &leaf.corners {
                let above = (corners - u64::from(least) * BYTES_OF_ONE) & there;
                self.frame[at..at + 8].copy_from_slice(&mover.narrow(above, shape.width()).to_le_bytes());
                at += shape.corner_bytes();
            }
        }
    }
}
