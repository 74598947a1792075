//! Boxes of vertices in 256ths of their cluster's: what leaf boxes are made of; and the range of a leaf's indices.
//!
//! ```text
//! byte   0 1 2     3 4 5                    6, 7
//!        x y z     255 - x, 255 - y, 255 - z    mean nothing
//! ```
//!
//! So the box of two is the least of both, byte by byte: one instruction on a register of SSE2, which every x86-64
//! has. (In loops of bytes the compiler turns rows into columns and takes seventeen.)
//!
//! Why unsafe: that instruction and those of [`rows`], as intrinsics which ask for nothing but SSE2, and those of
//! [`range_in_lanes`], whose caller has a proof of AVX2.
//!
//! Invariant: `lo <= hi` on each axis, but for [`Cell::MOST`], which holds nothing.

#![allow(unsafe_code)]

use super::bits::BYTES_OF_ONE;
use super::packing::VertexPacking;
use crate::layout::CLUSTER_LEAVES;

/// A cell by vertex, a word each, and one word more: a register is read from any of them on. The last ones, of no
/// vertex, are [`Cell::MOST`].
pub(super) type Cells = [u64; 257];
/// No cells yet.
pub(super) const NO_CELLS: Cells = [u64::MAX; 257];

/// The word of a cell: x in the lowest byte of `places`, y, z.
#[inline(always)]
pub(super) fn word(places: u64) -> u64 {
    places | (places ^ 0xff_ffff) << 24
}

/// The cells of packed vertices: the upper eight bits of each axis, or what there is; `shift` leads to them.
#[inline(always)]
pub(super) fn fill(packing: &VertexPacking, shift: [u8; 3], vertices: &[u64], cells: &mut Cells) {
    let at: [u32; 3] = std::array::from_fn(|a| packing.shift[a] + u32::from(shift[a]));
    let masks = packing.bits.map(|bits| (1u64 << bits.min(8)) - 1);
    for (cell, v) in cells.iter_mut().zip(vertices) {
        *cell = word((v >> at[0] & masks[0]) | (v >> at[1] & masks[1]) << 8 | (v >> at[2] & masks[2]) << 16);
    }
}

/// A box in 256ths.
#[derive(Clone, Copy)]
pub(super) struct Cell(u128);

impl Cell {
    /// Nothing; the identity of `min`.
    pub(super) const MOST: Cell = Cell(u128::MAX);

    /// That of a vertex.
    #[inline(always)]
    pub(super) fn of(cells: &Cells, vertex: u8) -> Cell {
        let both: [u64; 2] =
            cells[usize::from(vertex)..usize::from(vertex) + 2].try_into().expect("two words");
        Cell(bytemuck::cast(both))
    }

    /// The box of both.
    #[inline(always)]
    pub(super) fn min(self, other: Cell) -> Cell {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::_mm_min_epu8;
            // SAFETY: SSE2 is a part of x86-64.
            Cell(bytemuck::cast(unsafe { _mm_min_epu8(bytemuck::cast(self.0), bytemuck::cast(other.0)) }))
        }
        #[cfg(not(target_arch = "x86_64"))]
        self.min_in_bytes(other)
    }

    #[cfg(any(test, not(target_arch = "x86_64")))]
    fn min_in_bytes(self, other: Cell) -> Cell {
        let (a, b) = (self.0.to_le_bytes(), other.0.to_le_bytes());
        Cell(u128::from_le_bytes(std::array::from_fn(|i| a[i].min(b[i]))))
    }

    /// Where it begins on each axis, and its last 256ths, a byte each from the lowest on, and `seventh`.
    #[inline(always)]
    pub(super) fn planes(self, seventh: u8) -> u64 {
        (self.0 as u64 ^ 0xffff_ff00_0000) & 0xffff_ffff_ffff | u64::from(seventh) << 48
    }
}

/// The indices of a leaf's corners, a byte each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LeafRange {
    /// The least.
    pub(super) least: u8,
    /// How far the greatest is above it.
    pub(super) span: u8,
    /// Each above the least; zero where there is none.
    pub(super) above: [u64; 3],
}

/// The range of the bytes of `corners` that are 0xff in `there`, of which there is one at least.
#[inline(always)]
pub(super) fn range_in_bytes(corners: [u64; 3], there: u64) -> LeafRange {
    let bytes = |words: [u64; 3]| words.map(u64::to_le_bytes);
    let least =
        bytes(corners.map(|word| word | !there)).as_flattened().iter().fold(u8::MAX, |all, &v| all.min(v));
    let most = bytes(corners.map(|word| word & there)).as_flattened().iter().fold(0, |all, &v| all.max(v));
    let above = corners.map(|word| (word & there) - ((u64::from(least) * BYTES_OF_ONE) & there));
    LeafRange { least, span: most - least, above }
}

/// As [`range_in_bytes`].
///
/// # Safety
/// AVX2 is there.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) unsafe fn range_in_lanes([a, b, c]: [u64; 3], there: u64) -> LeafRange {
    use std::arch::x86_64::*;
    // SAFETY: by the contract.
    unsafe {
        let all = _mm_set1_epi8(-1);
        let there = _mm_set1_epi64x(there as i64);
        let (ab, c) = (_mm_set_epi64x(b as i64, a as i64), _mm_set1_epi64x(c as i64));
        let (ab, c) = (_mm_and_si128(ab, there), _mm_and_si128(c, there));
        let absent = _mm_xor_si128(there, all);
        let least = _mm_min_epu8(_mm_or_si128(ab, absent), _mm_or_si128(c, absent));
        // The greatest is the least of what is left to 255.
        let rest = _mm_xor_si128(_mm_max_epu8(ab, c), all);
        // Of two bytes one, above it zeros; of eight such the instruction finds the least.
        let of_two = |v| _mm_minpos_epu16(_mm_min_epu8(v, _mm_srli_epi16::<8>(v)));
        let (least, rest) = (of_two(least), of_two(rest));
        let low = _mm_and_si128(_mm_broadcastb_epi8(least), there);
        let (ab, c) = (_mm_sub_epi8(ab, low), _mm_sub_epi8(c, low));
        let least = _mm_cvtsi128_si32(least) as u8;
        LeafRange {
            least,
            span: !(_mm_cvtsi128_si32(rest) as u8) - least,
            above: [_mm_cvtsi128_si64(ab), _mm_extract_epi64::<1>(ab), _mm_cvtsi128_si64(c)]
                .map(|word| word as u64),
        }
    }
}

/// Eight bytes of each leaf to a row for each byte, a leaf beside the other.
#[inline(always)]
pub(super) fn rows(leaves: &[u64; CLUSTER_LEAVES]) -> [[u8; CLUSTER_LEAVES]; 8] {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;
        let mut all: [__m128i; 8] = bytemuck::cast(*leaves);
        // A byte's place is leaf * 8 + row. Each step puts the highest bit of the place behind the lowest, as a card
        // shuffle does; four make it row * 16 + leaf.
        for _ in 0..4 {
            // SAFETY: SSE2 is a part of x86-64.
            all = std::array::from_fn(|i| unsafe {
                match i % 2 {
                    0 => _mm_unpacklo_epi8(all[i / 2], all[i / 2 + 4]),
                    _ => _mm_unpackhi_epi8(all[i / 2], all[i / 2 + 4]),
                }
            });
        }
        bytemuck::cast(all)
    }
    #[cfg(not(target_arch = "x86_64"))]
    rows_in_bytes(leaves)
}

#[cfg(any(test, not(target_arch = "x86_64")))]
fn rows_in_bytes(leaves: &[u64; CLUSTER_LEAVES]) -> [[u8; CLUSTER_LEAVES]; 8] {
    std::array::from_fn(|row| std::array::from_fn(|leaf| leaves[leaf].to_le_bytes()[row]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// With words of few and of many values; the machine's best is compared in `fields`.
        #[test]
        fn the_range_holds_all_bytes_and_ends_at_two(
            words in prop::array::uniform3(any::<u64>()),
            and in any::<u64>(),
            size in 1u32..=8,
        ) {
            let there = u64::MAX >> (64 - 8 * size);
            let words = words.map(|word| word & and);
            let LeafRange { least, span, above } = range_in_bytes(words, there);
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()[..size as usize].to_vec()).collect();
            prop_assert_eq!(Some(least), bytes.iter().min().copied());
            prop_assert_eq!(Some(least + span), bytes.iter().max().copied());
            let back = above.iter().flat_map(|word| word.to_le_bytes()[..size as usize].to_vec());
            prop_assert!(back.map(|byte| byte + least).eq(bytes));
            prop_assert!(above.iter().all(|word| word & !there == 0));
        }

        #[test]
        fn rows_are_columns(leaves in prop::array::uniform16(any::<u64>())) {
            prop_assert_eq!(rows(&leaves), rows_in_bytes(&leaves));
        }

        #[test]
        fn the_least_of_two_cells_is_the_box_of_both(a in 0u64..1 << 24, b in 0u64..1 << 24) {
            let mut cells = [0; 257];
            (cells[7], cells[255]) = (word(a), word(b));
            let (one, two) = (Cell::of(&cells, 7), Cell::of(&cells, 255));
            let both = Cell::MOST.min(one).min(two);
            prop_assert_eq!(both.0 as u64, one.min_in_bytes(two).0 as u64);
            for axis in 0..3 {
                let [a, b] = [a, b].map(|places| (places >> (8 * axis)) as u8);
                let planes = both.planes(9).to_le_bytes();
                prop_assert_eq!((planes[axis], planes[3 + axis], planes[6]), (a.min(b), a.max(b), 9));
            }
        }
    }
}
