//! LeafWriter of a cluster, to the frame: boxes, shapes and indices.
//!
//! ```text
//! corners of strips -> least index, those above it, shape -> bytes of the frame, a leaf behind the other
//! cells of vertices -> box, beside the shape: eight bytes -> rows of planes and shapes
//! ```
//!
//! Rows and indices are written in registers, and run into what stands behind them: that is written later.
//!
//! Invariant: what is written is a function of corners, sizes and cells alone.

use super::cells::{self, Cell, Cells};
use super::fields::{Mover, Work};
use super::strips::{STRIP_TRIANGLES, Topology};
use super::{CLUSTER_HEAD_BYTES, LEAF_HEAD_BYTES, LeafShape};
use crate::layout::{CLUSTER_LEAVES, CLUSTER_TRIANGLES, LEAF_TRIANGLES};

/// Bytes that a cluster is written to: what it takes in the frame, at most, and what is written behind it on the way.
pub(super) const ROOM_BYTES: usize = 4096;
pub(super) type Room = [u8; ROOM_BYTES];

/// LeafWriter to be written. Gives where they end, bytes from the cluster's start.
pub(super) struct LeafWriter<'a> {
    pub(super) topology: &'a Topology,
    pub(super) sizes: &'a [u8],
    pub(super) cells: &'a Cells,
    pub(super) room: &'a mut Room,
}

/// A power of two behind which no leaf ends: as a mask it takes the place of a check.
const LEAVES_END: usize = 1024;
const _: () =
    assert!(CLUSTER_HEAD_BYTES + CLUSTER_LEAVES * (LEAF_HEAD_BYTES + 1 + 3 * LEAF_TRIANGLES) < LEAVES_END);

impl Work for LeafWriter<'_> {
    type Output = usize;

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) -> usize {
        let LeafWriter { topology, sizes, cells, room } = self;
        let mut boxes = [0; CLUSTER_LEAVES];
        let indices = CLUSTER_HEAD_BYTES + LEAF_HEAD_BYTES * sizes.len();
        let (mut first, mut at) = (0, indices);
        for (leaf, &size) in boxes.iter_mut().zip(sizes) {
            let there = u64::MAX >> (u64::BITS - 8 * u32::from(size));
            let corners = [0, 1, 2].map(|c| eight(&topology.corners[c], first));
            let range = mover.range(corners, there);
            let shape = LeafShape::new(usize::from(size), range.span);
            room[at % LEAVES_END] = range.least;
            at += 1;
            for above in range.above {
                let narrow = mover.narrow(above, shape.width());
                room[at % LEAVES_END..][..8].copy_from_slice(&narrow.to_le_bytes());
                at += shape.corner_bytes();
            }
            *leaf = bounds(cells, corners, there, eight(&topology.starts, first)).planes(shape.0);
            first += usize::from(size);
        }
        // The last row runs into the indices.
        let kept: [u8; CLUSTER_LEAVES] = room[indices..][..CLUSTER_LEAVES].try_into().expect("as many");
        let mut row_at = CLUSTER_HEAD_BYTES;
        for row in cells::rows(&boxes).iter().take(LEAF_HEAD_BYTES) {
            room[row_at..][..CLUSTER_LEAVES].copy_from_slice(row);
            row_at += sizes.len();
        }
        room[indices..][..CLUSTER_LEAVES].copy_from_slice(&kept);
        at
    }
}

/// Eight bytes from triangle `first` on.
#[inline(always)]
fn eight(all: &[u8; CLUSTER_TRIANGLES + STRIP_TRIANGLES], first: usize) -> u64 {
    let eight = all[first % CLUSTER_TRIANGLES..][..LEAF_TRIANGLES].try_into();
    u64::from_le_bytes(eight.expect("eight bytes"))
}

/// The box of a leaf whose triangles are 0xff in `there`; those that are 1 in `starts` are the first of a strip.
#[inline(always)]
fn bounds(cells: &Cells, [a, b, x]: [u64; 3], there: u64, starts: u64) -> Cell {
    // Where there is no triangle it is a cell that is none.
    let xs = (x | !there).to_le_bytes();
    let mut all = xs.iter().fold(Cell::MOST, |all, &v| all.min(Cell::of(cells, v)));
    // The other corners of a triangle are among those of the one before it, but where a strip or leaf begins. Most
    // leaves have one or two such places, and these cost no branch.
    let mut begins = starts & there & !0xff;
    for first in [0, begins.trailing_zeros() % u64::BITS] {
        all = all.min(Cell::of(cells, (a >> first) as u8)).min(Cell::of(cells, (b >> first) as u8));
    }
    begins &= begins.wrapping_sub(1);
    while begins != 0 {
        let first = begins.trailing_zeros();
        all = all.min(Cell::of(cells, (a >> first) as u8)).min(Cell::of(cells, (b >> first) as u8));
        begins &= begins - 1;
    }
    all
}
