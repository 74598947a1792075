//! `RowLayout`: rows of numbers, each of one size, at a stride from each other.

use crate::import::scalar::Scalar;

/// How the rows of an accessor lie in their view, and what is in them.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowLayout {
    /// Of the first row, in its place.
    pub(super) offset: u64,
    /// Bytes from a row to the next.
    pub(super) stride: u64,
    /// Rows.
    pub(super) count: u64,
    /// Type of a number.
    pub(super) scalar: Scalar,
    /// Numbers of a row, four at most.
    pub(super) components: usize,
    /// Integers stand for shares of their greatest value.
    pub(super) is_normalized: bool,
}

impl RowLayout {
    /// Bytes of a row.
    pub(super) fn row_bytes(&self) -> usize {
        self.components * self.scalar.size()
    }

    /// Rows one after the other, of this content.
    pub(super) fn packed(&self) -> RowLayout {
        RowLayout { offset: 0, stride: self.row_bytes() as u64, ..*self }
    }
}
