//! Leaves: how many triangles each has, on disk, and how the indices of one lie in a frame.
//!
//! Invariant: sizes that are read are 1 to 8, and all together the triangles of their cluster.

use super::ClusterMesh;
use super::bits::{BitReader, BitWriter};
use crate::layout::{CLUSTER_LEAVES, LEAF_TRIANGLES};

/// Bits of a count of leaves, and of a count of triangles of one, less one.
pub(super) const LEAF_COUNT_BITS: u32 = 4;
pub(super) const LEAF_SIZE_BITS: u32 = 3;

/// The sizes of the leaves, where they are not the plain ones.
pub(super) fn encode_sizes(cluster: &ClusterMesh, out: &mut BitWriter) {
    let sizes = &cluster.leaf_sizes;
    let total: usize = sizes.iter().map(|&size| usize::from(size)).sum();
    assert!(sizes.len() <= CLUSTER_LEAVES && total == cluster.triangles.len(), "{sizes:?}");
    let differ = sizes[..sizes.len() - 1].iter().any(|&size| usize::from(size) < LEAF_TRIANGLES);
    out.put(u64::from(differ), 1);
    if differ {
        out.put(sizes.len() as u64 - 1, LEAF_COUNT_BITS);
        sizes.iter().for_each(|&size| out.put(u64::from(size) - 1, LEAF_SIZE_BITS));
    }
}

/// Count and sizes of leaves, which are all of the triangles.
pub(super) fn decode_sizes(
    input: &mut BitReader<'_>,
    triangle_count: usize,
) -> Result<(usize, [u8; CLUSTER_LEAVES]), &'static str> {
    let mut sizes = [LEAF_TRIANGLES as u8; CLUSTER_LEAVES];
    let (differ, plain) = (input.take(1) == 1, triangle_count.div_ceil(LEAF_TRIANGLES));
    if !differ {
        let last = plain.clamp(1, CLUSTER_LEAVES) - 1;
        sizes[last] = triangle_count.saturating_sub(last * LEAF_TRIANGLES) as u8;
        return Ok((last + 1, sizes));
    }
    let count = input.take(LEAF_COUNT_BITS) as usize + 1;
    let word = input.take(count as u32 * LEAF_SIZE_BITS);
    let mut total = 0;
    for (leaf, size) in sizes[..count].iter_mut().enumerate() {
        *size = (word >> (leaf as u32 * LEAF_SIZE_BITS) & ((1 << LEAF_SIZE_BITS) - 1)) as u8 + 1;
        total += usize::from(*size);
    }
    if total != triangle_count {
        return Err("the leaves of a cluster are not what its counts say");
    }
    Ok((count, sizes))
}

/// How the indices of a leaf lie in a frame: count of its triangles, less one, and bytes of each of its three corners'
/// indices above the least, times 8.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct LeafShape(pub u8);

impl LeafShape {
    /// The least shape of `count` triangles whose greatest index is `span` above the least.
    #[inline(always)]
    pub(super) fn new(count: usize, span: u8) -> LeafShape {
        let width = (u32::BITS - (u32::from(span) | 1).leading_zeros()) as usize;
        LeafShape(((count - 1) | ((count * width).div_ceil(8) << 3)) as u8)
    }

    /// Count of triangles, 1 to 8.
    #[inline(always)]
    pub fn triangle_count(self) -> usize {
        usize::from(self.0 % 8) + 1
    }

    /// Bytes of one corner's indices, 1 to 7.
    #[inline(always)]
    pub fn corner_bytes(self) -> usize {
        usize::from(self.0 >> 3)
    }

    /// Bits of an index above the least: as many as there is room for, 7 at most.
    #[inline(always)]
    pub fn width(self) -> u32 {
        const WIDTHS: [u8; 64] = {
            let mut widths = [0; 64];
            let mut shape = 0;
            while shape < 64 {
                let fits = 8 * (shape >> 3) / (shape % 8 + 1);
                widths[shape] = if fits < 7 { fits as u8 } else { 7 };
                shape += 1;
            }
            widths
        };
        u32::from(WIDTHS[usize::from(self.0) % 64])
    }

    /// Bytes of a leaf's indices: the least, then those of three corners above it.
    pub(super) fn bytes(self) -> usize {
        1 + 3 * self.corner_bytes()
    }
}
