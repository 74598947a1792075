//! Boxes of vertices in 256ths of their cluster's: what leaf boxes are made of, 24 corners a leaf.
//!
//! ```text
//! byte   0 1 2     3 4 5                    6 to 15
//!        x y z     255 - x, 255 - y, 255 - z    0
//! ```
//!
//! So the box of two is the least of both, byte by byte.
//!
//! Invariant: `lo <= hi` on each axis, but for [`Cell::MOST`], which holds nothing.

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
                        for axis in 0..3 {
                let [a, b] = [a, b].map(|places| (places >> (8 * axis)) as u8);
                prop_assert_eq!((both.lo(axis), both.hi(axis)), (a.min(b), a.max(b)));
            }
        }
    }
}
