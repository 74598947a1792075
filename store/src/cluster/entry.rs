//! `ClusterEntry`: what the head of a page says of a cluster, so that rays can pass it by before it is unpacked.
//!
//! ```text
//! entry  = triangles - 1, 7 | base - anchor | axis widths 3 x 6 | extents 3 x 6 | bytes on disk
//! extent = of an axis of w bits, which has its highest bit set: the next six, or all w - 1 where there are no more
//! ```
//!
//! Invariants: 1. all entries of a page have the same number of bits; 2. the box of an entry holds all vertices of its
//! cluster: `lo` is their least corner, `hi` at most a 64th of the extent above their greatest.

use super::bits::{self, BitWriter};
use super::{ClusterMesh, LatticeBox};
use crate::geom::Lattice;
use crate::layout::CLUSTER_TRIANGLES;

/// Bits of a count of triangles, vertices or materials of a cluster, less one.
pub(super) const COUNT_BITS: u32 = 7;
/// Bits of an axis width.
const AXIS_WIDTH_BITS: u32 = 6;
/// Bits of an extent behind its highest.
const EXTENT_BITS: u32 = 6;
/// Most bits of a cluster's bytes on disk.
const SIZE_BITS_MOST: u32 = 16;
/// Most bits of an entry.
pub(super) const ENTRY_BITS_MOST: u32 =
    COUNT_BITS + 3 * (Lattice::MAX_BITS + AXIS_WIDTH_BITS + EXTENT_BITS) + SIZE_BITS_MOST;

/// Bits of the fields that differ from page to page.
#[derive(Clone, Copy, Debug)]
pub(super) struct EntryWidths {
    /// Of a base above the anchor, per axis.
    pub(super) offset: [u8; 3],
    /// Of a cluster's bytes on disk.
    pub(super) size: u8,
}

impl EntryWidths {
    /// Whether a page can have them.
    pub(super) fn are_sound(&self) -> bool {
        self.offset.iter().all(|&bits| u32::from(bits) <= Lattice::MAX_BITS)
            && u32::from(self.size) <= SIZE_BITS_MOST
    }

    /// Bits of an entry.
    pub(super) fn entry_bits(&self) -> usize {
        let offsets: usize = self.offset.iter().map(|&bits| usize::from(bits)).sum();
        (COUNT_BITS + 3 * (AXIS_WIDTH_BITS + EXTENT_BITS)) as usize + offsets + usize::from(self.size)
    }

    /// Bytes of so many entries.
    pub(super) fn table_bytes(&self, count: usize) -> usize {
        (count * self.entry_bits()).div_ceil(8)
    }
}

/// A cluster as the head of its page tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ClusterEntry {
    /// Triangles, 1 to 128.
    pub(super) triangle_count: usize,
    /// Least corner of the vertices.
    pub(super) base: [i64; 3],
    /// Bits per axis above the base.
    pub(super) bits: [u8; 3],
    /// Bytes on disk.
    pub(super) size: usize,
    extents: [u8; 3],
}

impl ClusterEntry {
    /// What is told of `cluster`, which takes `size` bytes on disk.
    pub(super) fn new(cluster: &ClusterMesh, size: usize) -> ClusterEntry {
        let (bounds, widths) = (cluster.bounds(), cluster.widths());
        let extents = std::array::from_fn(|axis| {
            let (extent, width) = ((bounds.hi[axis] - bounds.lo[axis]) as u64, u32::from(widths.bits[axis]));
            let below = width.saturating_sub(1);
            ((extent & !(1 << below)) >> below.saturating_sub(EXTENT_BITS)) as u8
        });
        ClusterEntry {
            triangle_count: cluster.triangles.len(),
            base: widths.base,
            bits: widths.bits,
            size,
            extents,
        }
    }

    pub(super) fn write(&self, widths: &EntryWidths, anchor: [i64; 3], out: &mut BitWriter) {
        out.put(self.triangle_count as u64 - 1, COUNT_BITS);
        for axis in 0..3 {
            out.put((self.base[axis] - anchor[axis]) as u64, u32::from(widths.offset[axis]));
        }
        self.bits.iter().for_each(|&bits| out.put(u64::from(bits), AXIS_WIDTH_BITS));
        self.extents.iter().for_each(|&extent| out.put(u64::from(extent), EXTENT_BITS));
        out.put(self.size as u64, u32::from(widths.size));
    }

    /// Entry `index` of a table of a page on a lattice of so many bits; `None` where no page can have it.
    pub(super) fn read(
        table: &[u8],
        index: usize,
        widths: &EntryWidths,
        anchor: [i64; 3],
        lattice_bits: u32,
    ) -> Option<ClusterEntry> {
        let mut at = index * widths.entry_bits();
        let mut take = |bits: u32| {
            let value = bits::get(table, at, bits);
            at += bits as usize;
            value
        };
        let entry = ClusterEntry {
            triangle_count: take(COUNT_BITS) as usize + 1,
            base: std::array::from_fn(|axis| anchor[axis] + take(u32::from(widths.offset[axis])) as i64),
            bits: std::array::from_fn(|_| take(AXIS_WIDTH_BITS) as u8),
            extents: std::array::from_fn(|_| take(EXTENT_BITS) as u8),
            size: take(u32::from(widths.size)) as usize,
        };
        let is_extent = |(&extent, &bits): (&u8, &u8)| u32::from(extent) >> (bits.clamp(1, 7) - 1) == 0;
        let is_sound = entry.triangle_count <= CLUSTER_TRIANGLES
            && entry.bits.iter().all(|&bits| u32::from(bits) <= lattice_bits)
            && entry.base.iter().all(|&q| q >> lattice_bits == 0)
            && entry.extents.iter().zip(&entry.bits).all(is_extent);
        is_sound.then_some(entry)
    }

    /// The box that holds its vertices, on a lattice of so many bits.
    pub(super) fn bounds(&self, lattice_bits: u32) -> LatticeBox {
        let end = (1i64 << lattice_bits) - 1;
        let hi = std::array::from_fn(|axis| {
            let below = u32::from(self.bits[axis]).saturating_sub(1);
            let lost = below.saturating_sub(EXTENT_BITS);
            let kept = i64::from(self.extents[axis]) | i64::from(self.bits[axis] > 0) << (below - lost);
            (self.base[axis] + (((kept + 1) << lost) - 1)).min(end)
        });
        LatticeBox { lo: self.base, hi }
    }
}
