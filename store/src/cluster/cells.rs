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
//! Why unsafe: that instruction, and a few for the range, as intrinsics, which ask for nothing but SSE2.
//!
//! Invariant: `lo <= hi` on each axis, but for [`Cell::MOST`], which holds nothing.

#![allow(unsafe_code)]

use super::packing::VertexPacking;

/// A cell by vertex, a word each, and one word more: a register is read from any of them on.
pub(super) type Cells = [u64; 257];

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

    /// Where it begins on each axis, and its last 256ths.
    #[inline(always)]
    pub(super) fn planes(self) -> [u8; 6] {
        let bytes = (self.0 as u64 ^ 0xffff_ff00_0000).to_le_bytes();
        std::array::from_fn(|plane| bytes[plane])
    }
}

/// The least and the greatest of 24 bytes.
#[inline(always)]
pub(super) fn range([a, b, c]: [u64; 3]) -> (u8, u8) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;
        // SAFETY: SSE2 is a part of x86-64.
        unsafe {
            let (two, one) = (_mm_set_epi64x(b as i64, a as i64), _mm_set1_epi64x(c as i64));
            let (least, most) = (_mm_min_epu8(two, one), _mm_max_epu8(two, one));
            // The greatest are the least of what is left to 255. Eight of each stand side by side, then four, two, one.
            let most = _mm_xor_si128(most, _mm_set1_epi8(-1));
            let both = _mm_min_epu8(_mm_unpacklo_epi64(least, most), _mm_unpackhi_epi64(least, most));
            let both = _mm_min_epu8(both, _mm_srli_epi64::<32>(both));
            let both = _mm_min_epu8(both, _mm_srli_epi64::<16>(both));
            let both = _mm_min_epu8(both, _mm_srli_epi64::<8>(both));
            (_mm_cvtsi128_si32(both) as u8, !_mm_extract_epi16::<4>(both) as u8)
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    range_in_bytes([a, b, c])
}

#[cfg(any(test, not(target_arch = "x86_64")))]
fn range_in_bytes(words: [u64; 3]) -> (u8, u8) {
    let bytes = words.map(u64::to_le_bytes);
    let bytes = bytes.as_flattened();
    (bytes.iter().fold(u8::MAX, |all, &v| all.min(v)), bytes.iter().fold(0, |all, &v| all.max(v)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_range_holds_all_bytes_and_ends_at_two(words in prop::array::uniform3(any::<u64>())) {
            prop_assert_eq!(range(words), range_in_bytes(words));
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
                prop_assert_eq!((both.planes()[axis], both.planes()[3 + axis]), (a.min(b), a.max(b)));
            }
        }
    }
}
