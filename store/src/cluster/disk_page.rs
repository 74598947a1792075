//! `DiskPage`: the disk form of a page, taken apart as far as its clusters.
//!
//! Invariant: no byte is believed; counts and widths are compared with their bounds before anything is read by them.

use super::bits;
use super::encode::{DISK_HEADER_BYTES, Head};
use super::entry::{ClusterEntry, EntryWidths};
use crate::layout::PAGE_ROOTS;

const ENDS_EARLY: &str = "a page ends early";

/// The parts of a page on disk.
pub(super) struct DiskPage<'a> {
    pub(super) cluster_count: usize,
    /// Bit i: root i is a node.
    pub(super) root_kinds: &'a [u8],
    pub(super) root_count: usize,
    /// Per node: count of children, which of them are nodes.
    pub(super) node_kinds: &'a [[u8; 2]],
    pub(super) head: Head,
    /// All of its bytes.
    pub(super) bytes: &'a [u8],
    /// Where the clusters begin in these.
    pub(super) clusters_at: usize,
    widths: EntryWidths,
    entries: &'a [u8],
}

impl<'a> DiskPage<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<DiskPage<'a>, &'static str> {
        let (fixed, rest) = bytes.split_at_checked(DISK_HEADER_BYTES).ok_or(ENDS_EARLY)?;
        let number = |at: usize, bits: u32| bits::get(fixed, 8 * at, bits);
        let [cluster_count, node_count, root_count] =
            [number(0, 16), number(2, 16), number(4, 8)].map(|count| count as usize);
        let head = Head {
            anchor: std::array::from_fn(|a| number(9 + 5 * a, 40) as i64),
            offset_bits: [fixed[5], fixed[6], fixed[7]],
            material_bits: fixed[8],
        };
        if root_count == 0 || root_count > PAGE_ROOTS || cluster_count == 0 {
            return Err("the counts of a page are out of range");
        }
        let widths = EntryWidths { offset: head.offset_bits, size: fixed[24] };
        if !widths.are_sound() || head.material_bits > 16 {
            return Err("a width of a page is out of range");
        }
        let (root_kinds, rest) = rest.split_at_checked(root_count.div_ceil(8)).ok_or(ENDS_EARLY)?;
        let (node_kinds, rest) = rest.split_at_checked(2 * node_count).ok_or(ENDS_EARLY)?;
        let (entries, rest) = rest.split_at_checked(widths.table_bytes(cluster_count)).ok_or(ENDS_EARLY)?;
        Ok(DiskPage {
            cluster_count,
            root_kinds,
            root_count,
            node_kinds: node_kinds.as_chunks().0,
            head,
            bytes,
            clusters_at: bytes.len() - rest.len(),
            widths,
            entries,
        })
    }

    /// True when all bits are zero behind the kinds of roots, and behind the entries.
    pub(super) fn is_padded_with_zeros(&self) -> bool {
        let is_zero =
            |bytes: &[u8], bits: usize| bits.is_multiple_of(8) || bytes[bits / 8] >> (bits % 8) == 0;
        is_zero(self.root_kinds, self.root_count)
            && is_zero(self.entries, self.cluster_count * self.widths.entry_bits())
    }

    /// What is told of a cluster, on a lattice of so many bits.
    pub(super) fn entry(&self, index: usize, lattice_bits: u32) -> Result<ClusterEntry, &'static str> {
        ClusterEntry::read(self.entries, index, &self.widths, self.head.anchor, lattice_bits)
            .ok_or("a cluster is out of range")
    }
}
