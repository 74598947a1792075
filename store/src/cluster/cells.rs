//! Boxes of vertices in 256ths of their cluster's: what leaf boxes are made of, 24 corners a leaf.
//!
//! ```text
//! byte   0 1 2     3 4 5                    6 to 15
//!        x y z     255 - x, 255 - y, 255 - z    0
//! ```
//!
//! So the box of two is the least of both, byte by byte: one instruction on a register of SSE2, which every x86-64
//! has. (In loops of bytes the compiler turns rows into columns and takes seventeen.)
//!
//! Why unsafe: that instruction as an intrinsic, which asks for nothing but SSE2.
//!
//! Invariant: `lo <= hi` on each axis, but for [`Cell::MOST`], which holds nothing.

#![allow(unsafe_code)]

/// A box in 256ths.
#[derive(Clone, Copy, Default)]
pub(super) struct Cell(u128);

impl Cell {
    /// Nothing; the identity of `min`.
    pub(super) const MOST: Cell = Cell(u128::MAX);

    /// The cell of a point: x in the lowest byte, y, z.
    #[inline(always)]
    pub(super) fn new(places: u64) -> Cell {
        Cell(u128::from(places | (places ^ 0xff_ffff) << 24))
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

    /// Where it begins.
    pub(super) fn lo(self, axis: usize) -> u8 {
        self.0.to_le_bytes()[axis]
    }

    /// The last 256th in it.
    pub(super) fn hi(self, axis: usize) -> u8 {
        !self.0.to_le_bytes()[3 + axis]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_least_of_two_cells_is_the_box_of_both(a in 0u64..1 << 24, b in 0u64..1 << 24) {
            let (one, two) = (Cell::new(a), Cell::new(b));
            let both = Cell::MOST.min(one).min(two);
            prop_assert_eq!(both.0, one.min_in_bytes(two).0);
            for axis in 0..3 {
                let [a, b] = [a, b].map(|places| (places >> (8 * axis)) as u8);
                prop_assert_eq!((both.lo(axis), both.hi(axis)), (a.min(b), a.max(b)));
            }
        }
    }
}
