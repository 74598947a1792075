//! Rows: the elements of an accessor, of one size, at a stride from each other.
//!
//! ```text
//! ElementRows   what the file says: in a view, compressed or not, with replaced rows or without
//! PlainRows     where the rows lie for reading, all of them
//! RowWindow     reads PlainRows by index, a window at a time
//! ```
//!
//! Invariants: 1. `offset + (count - 1) * stride + row bytes` lies in the place, checked by who makes the rows; 2. a
//! window takes [`WINDOW_BYTES`] at most, leased; 3. rows that fit the window are read once.

use super::bytes::{BufferPlace, ByteSource, Spool};
use super::draco::DracoStream;
use super::packed::PackedView;
use super::row_layout::RowLayout;
use crate::budget::{Budget, Lease};
use crate::error::Result;
use crate::import::scalar::{ByteOrder, Scalar};
use std::sync::Arc;

/// Most bytes of a window.
const WINDOW_BYTES: u64 = 64 << 10;

/// Where the bytes of a view lie.
#[derive(Clone, Debug)]
pub(super) enum ViewPlace {
    /// As they are.
    Plain(BufferPlace),
    /// Compressed: decoded when they are first read.
    Packed(Arc<PackedView>),
    /// Those of an accessor in a stream of Draco, decoded with all others of it.
    Draco(Arc<DracoStream>, u32),
}

/// Rows of an accessor as the file says.
#[derive(Clone, Debug)]
pub(super) struct ElementRows {
    /// The accessor.
    pub(super) accessor: u32,
    /// `None`: all numbers are zero, but for the replaced ones.
    pub(super) view: Option<ViewPlace>,
    pub(super) layout: RowLayout,
    /// Rows that are replaced.
    pub(super) sparse: Option<Arc<SparseRows>>,
}

/// What tells rows from others: an accessor, and the view of the stream where Draco has compressed them, since two
/// streams may have one accessor.
pub(super) type RowsId = (u32, Option<u32>);

impl ElementRows {
    /// Rows of one identity are the same.
    pub(super) fn identity(&self) -> RowsId {
        let stream = match &self.view {
            Some(ViewPlace::Draco(stream, _)) => Some(stream.view),
            _ => None,
        };
        (self.accessor, stream)
    }
}

/// Rows that stand in the place of others.
#[derive(Clone, Debug)]
pub(super) struct SparseRows {
    /// Which ones, in rising order.
    pub(super) indices: (ViewPlace, RowLayout),
    pub(super) values: (ViewPlace, RowLayout),
}

/// Rows that can be read as they are.
#[derive(Clone, Debug)]
pub(super) struct PlainRows {
    pub(super) place: BufferPlace,
    pub(super) layout: RowLayout,
}

/// Reads rows by index.
pub(super) struct RowWindow {
    source: ByteSource,
    layout: RowLayout,
    window: Vec<u8>,
    /// The rows that the window holds.
    first: u64,
    held_count: u64,
    most_count: u64,
    _lease: Lease,
}

impl RowWindow {
    /// Opens rows.
    pub(super) fn open(rows: &PlainRows, spool: &Spool, budget: &Budget) -> Result<RowWindow> {
        let layout = rows.layout;
        let most_count = (WINDOW_BYTES / layout.stride).clamp(1, layout.count.max(1));
        let bytes = (most_count - 1) * layout.stride + layout.row_bytes() as u64;
        let lease = budget.lease("a window of an accessor", bytes)?;
        let source = ByteSource::open(&rows.place, spool)?;
        Ok(RowWindow {
            source,
            layout,
            window: Vec::new(),
            first: 0,
            held_count: 0,
            most_count,
            _lease: lease,
        })
    }

    /// Rows in all.
    pub(super) fn count(&self) -> u64 {
        self.layout.count
    }

    /// The bytes of a row.
    #[inline]
    pub(super) fn row(&mut self, index: u64) -> Result<&[u8]> {
        debug_assert!(index < self.layout.count);
        if index.wrapping_sub(self.first) >= self.held_count {
            self.fill(index)?;
        }
        let at = (index - self.first) as usize * self.layout.stride as usize;
        Ok(&self.window[at..at + self.layout.row_bytes()])
    }

    /// A row of one integer.
    #[inline]
    pub(super) fn integer(&mut self, index: u64) -> Result<u64> {
        let scalar = self.layout.scalar;
        Ok(scalar.integer(self.row(index)?, ByteOrder::Little) as u64)
    }

    /// A row of numbers, as they are meant.
    pub(super) fn numbers<const N: usize>(&mut self, index: u64) -> Result<[f64; N]> {
        let RowLayout { scalar, is_normalized, .. } = self.layout;
        let row = self.row(index)?;
        Ok(std::array::from_fn(|part| {
            let number = scalar.number(&row[part * scalar.size()..], ByteOrder::Little);
            if is_normalized { number_of_share(scalar, number) } else { number }
        }))
    }

    #[cold]
    fn fill(&mut self, index: u64) -> Result<()> {
        let count = self.most_count.min(self.layout.count - index);
        let bytes = (count - 1) * self.layout.stride + self.layout.row_bytes() as u64;
        self.held_count = 0;
        self.window.reserve_exact((bytes as usize).saturating_sub(self.window.len()));
        self.window.resize(bytes as usize, 0);
        self.source.read(self.layout.offset + index * self.layout.stride, &mut self.window)?;
        (self.first, self.held_count) = (index, count);
        Ok(())
    }
}

/// What a normalized integer stands for: -1 to 1, or 0 to 1.
#[inline]
pub(super) fn number_of_share(scalar: Scalar, number: f64) -> f64 {
    match scalar {
        Scalar::I8 => (number / 127.0).max(-1.0),
        Scalar::U8 => number / 255.0,
        Scalar::I16 => (number / 32_767.0).max(-1.0),
        Scalar::U16 => number / 65_535.0,
        Scalar::I32 | Scalar::U32 | Scalar::F32 | Scalar::F64 => number,
    }
}
