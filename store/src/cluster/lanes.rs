//! Three numbers of up to 24 bits in one word, and arithmetic on all three at once.
//!
//! ```text
//! lanes = | 0 | z, w_z bits | 0 | y, w_y bits | 0 | x, w_x bits |     a zero guard bit above each, 60 bits at most
//! frame =         | z, w_z bits | y, w_y bits | x, w_x bits |         as a frame holds a vertex
//! ```
//!
//! Sums are modulo 2^w in each lane: a carry ends in the guard bit and is masked off.
//!
//! Invariant: guard bits are zero between operations.

use super::Widths;
use super::fields::Fields;

/// The layout of a cluster's lanes.
#[derive(Clone, Copy)]
pub(super) struct Lanes {
    /// Bits per axis.
    pub(super) bits: [u32; 3],
    /// Where each lane begins.
    shift: [u32; 3],
    /// All bits of values.
    mask: u64,
    /// All guard bits: one more than the greatest value in each lane.
    guards: u64,
}

impl Lanes {
    /// Lanes for a compact cluster.
    pub(super) fn new(widths: &Widths) -> Lanes {
        let bits = widths.bits.map(u32::from);
        let shift = [0, bits[0] + 1, bits[0] + bits[1] + 2];
        let mask = (0..3).map(|a| ((1 << bits[a]) - 1) << shift[a]).sum();
        let guards = (0..3).map(|a| 1 << (shift[a] + bits[a])).sum();
        Lanes { bits, shift, mask, guards }
    }

    /// Three numbers, each below 2^bits.
    pub(super) fn put(&self, values: [u64; 3]) -> u64 {
        values[0] | values[1] << self.shift[1] | values[2] << self.shift[2]
    }

    /// The three numbers.
    pub(super) fn get(&self, lanes: u64) -> [u64; 3] {
        std::array::from_fn(|a| (lanes & self.mask) >> self.shift[a] & ((1 << self.bits[a]) - 1))
    }

    /// Lane-wise sum.
    #[inline(always)]
    pub(super) fn add(&self, a: u64, b: u64) -> u64 {
        (a + b) & self.mask
    }

    /// Lane-wise difference.
    #[inline(always)]
    pub(super) fn sub(&self, a: u64, b: u64) -> u64 {
        (a + (self.guards - b)) & self.mask
    }

    /// The corner of the parallelogram over the edge from `a` to `b` that lies opposite of `c`.
    #[inline(always)]
    pub(super) fn predict(&self, a: u64, b: u64, c: u64) -> u64 {
        self.predict_within(self.mask, a, b, c)
    }

    /// The same, of which only the bits of `keep` are kept.
    #[inline(always)]
    pub(super) fn predict_within(&self, keep: u64, a: u64, b: u64, c: u64) -> u64 {
        (self.add(a, b) + (self.guards - c)) & keep
    }

    /// The greatest number of each lane.
    #[inline(always)]
    pub(super) fn greatest(&self, all: &[u64]) -> [u32; 3] {
        std::array::from_fn(|a| {
            let (shift, mask) = (self.shift[a], !(u32::MAX << self.bits[a]));
            all.iter().fold(0, |most, lanes| most.max((lanes >> shift) as u32 & mask))
        })
    }

    /// All bits of values.
    pub(super) fn mask(&self) -> u64 {
        self.mask
    }

    /// The values in their lanes: packed as a frame holds them.
    pub(super) fn fields(&self) -> Fields {
        Fields::new(self.bits, self.shift)
    }

    /// Where lane `axis` begins.
    pub(super) fn shift(&self, axis: usize) -> u32 {
        self.shift[axis]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::fields::{Mover, Portable};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lanes_are_three_numbers_modulo_their_widths(
            bits in prop::array::uniform3(0u8..=24).prop_filter("57 in all", |b| b.iter().sum::<u8>() <= 57),
            values in prop::array::uniform3(prop::array::uniform3(any::<u64>())),
        ) {
            let lanes = Lanes::new(&Widths { base: [0; 3], bits, wide: false });
            let modulo = |v: [u64; 3]| -> [u64; 3] { std::array::from_fn(|a| v[a] & ((1 << bits[a]) - 1)) };
            let [a, b, c] = values.map(modulo);
            let [x, y, z] = [a, b, c].map(|v| lanes.put(v));
            prop_assert_eq!(lanes.get(x), a);
            let expected = modulo(std::array::from_fn(|i| a[i] + b[i] + (1 << 40) - c[i]));
            prop_assert_eq!(lanes.get(lanes.predict(x, y, z)), expected);
            let frame = a[0] | a[1] << bits[0] | a[2] << (bits[0] + bits[1]);
            prop_assert_eq!(Portable.gather(x, &lanes.fields()), frame);
        }
    }
}
