//! Blocks of 16x16 pixels: which of them a client has not seen yet.
//!
//! ```text
//! picture of 40 x 20 pixels      columns 3, rows 2
//! +--+--+-+
//! |0 |1 |2|                      a block at the right or lower edge is cut by it
//! +--+--+-+
//! |3 |4 |5|
//! +--+--+-+
//! ```
//!
//! Invariant: marks know the blocks of one layout, and no others.

use crate::wire::BLOCK_SIDE;

/// Most blocks of a picture: their count has 16 bits.
pub(crate) const BLOCKS_MAX: u32 = (1 << 16) - 1;

/// The blocks of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
}

/// A set of blocks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Marks {
    bits: Vec<u64>,
}

impl Layout {
    /// The blocks of every `scale`-th pixel of a picture of `full` pixels.
    pub(crate) fn new(full: [u32; 2], scale: u32) -> Layout {
        Layout { size: full.map(|side| side.div_ceil(scale)) }
    }

    /// Blocks in a row.
    pub(crate) fn columns(&self) -> u32 {
        self.size[0].div_ceil(BLOCK_SIDE)
    }

    /// Blocks in all.
    pub(crate) fn count(&self) -> u32 {
        self.columns() * self.size[1].div_ceil(BLOCK_SIDE)
    }

    /// The block of pixel (x, y).
    pub(crate) fn block_of(&self, [x, y]: [u32; 2]) -> u32 {
        y / BLOCK_SIDE * self.columns() + x / BLOCK_SIDE
    }

    /// The first pixel of a block, and its width and height.
    pub(crate) fn rect(&self, block: u32) -> ([u32; 2], [u32; 2]) {
        let first = [block % self.columns() * BLOCK_SIDE, block / self.columns() * BLOCK_SIDE];
        (first, [0, 1].map(|axis| BLOCK_SIDE.min(self.size[axis] - first[axis])))
    }
}

impl Marks {
    /// No block of `layout`.
    pub(crate) fn none(layout: Layout) -> Marks {
        Marks { bits: vec![0; layout.count().div_ceil(64) as usize] }
    }

    /// Every block of `layout`.
    pub(crate) fn all(layout: Layout) -> Marks {
        let mut marks = Marks::none(layout);
        marks.bits.fill(!0);
        let past = layout.count() % 64;
        if past > 0
            && let Some(last) = marks.bits.last_mut()
        {
            *last = (1 << past) - 1;
        }
        marks
    }

    /// Marks a block.
    pub(crate) fn set(&mut self, block: u32) {
        self.bits[block as usize / 64] |= 1 << (block % 64);
    }

    /// Marks the blocks of `other`, of the same layout.
    pub(crate) fn add(&mut self, other: &Marks) {
        assert_eq!(self.bits.len(), other.bits.len(), "marks of two layouts");
        self.bits.iter_mut().zip(&other.bits).for_each(|(ours, other)| *ours |= other);
    }

    /// Marks blocks that were taken.
    pub(crate) fn put_back(&mut self, blocks: &[u16]) {
        blocks.iter().for_each(|&block| self.set(block.into()));
    }

    /// True when no block is marked.
    pub(crate) fn is_empty(&self) -> bool {
        self.bits.iter().all(|&bits| bits == 0)
    }

    /// Takes up to `most` marked blocks, in rows, away into `taken`.
    pub(crate) fn take(&mut self, most: usize, taken: &mut Vec<u16>) {
        for (word, bits) in self.bits.iter_mut().enumerate() {
            while *bits != 0 && taken.len() < most {
                taken.push((word as u32 * 64 + bits.trailing_zeros()) as u16);
                *bits &= *bits - 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_the_picture_once() {
        for size in [[40, 20], [16, 16], [1, 1], [1280, 720], [17, 64]] {
            let layout = Layout::new(size, 1);
            let mut area = 0;
            for block in 0..layout.count() {
                let (first, [width, height]) = layout.rect(block);
                area += width * height;
                assert_eq!(layout.block_of(first), block);
                assert_eq!(layout.block_of([first[0] + width - 1, first[1] + height - 1]), block);
            }
            assert_eq!(area, size[0] * size[1]);
        }
        assert_eq!(Layout::new([1281, 720], 4).size, [321, 180]);
    }

    #[test]
    fn marks_are_taken_in_rows_and_once() {
        let layout = Layout::new([16 * 10, 16 * 13], 1);
        let mut marks = Marks::all(layout);
        let mut taken = vec![];
        marks.take(100, &mut taken);
        assert_eq!(taken, (0..100).collect::<Vec<u16>>());
        taken.clear();
        marks.take(usize::MAX, &mut taken);
        assert_eq!(taken, (100..130).collect::<Vec<u16>>());
        assert!(marks.is_empty());
        marks.set(129);
        let mut other = Marks::none(layout);
        other.set(3);
        marks.add(&other);
        taken.clear();
        marks.take(9, &mut taken);
        assert_eq!(taken, [3, 129]);
    }
}
