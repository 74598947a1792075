//! `AttributeColumns`: what corners have beside their places: colours, normals. A stream without any takes no memory
//! for them.
//!
//! Invariant: a column has a row for each triangle, or none where no corner has such a value.

use crate::cluster::{Colour, CornerValue, Normal, WHITE};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Which attributes the corners of a model have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttributeSet {
    /// Whether a corner has another colour than white.
    pub colours: bool,
    /// Whether a corner has a normal.
    pub normals: bool,
}

impl AttributeSet {
    /// Everything.
    pub const ALL: AttributeSet = AttributeSet { colours: true, normals: true };

    /// What either has.
    #[must_use]
    pub fn union(self, other: AttributeSet) -> AttributeSet {
        AttributeSet { colours: self.colours || other.colours, normals: self.normals || other.normals }
    }

    /// Whether it has all that `other` has.
    pub fn holds(self, other: AttributeSet) -> bool {
        self.union(other) == self
    }

    /// Bytes of the rows of a triangle.
    pub const fn row_bytes(self) -> u64 {
        let colours = if self.colours { size_of::<[Colour; 3]>() } else { 0 };
        let normals = if self.normals { size_of::<[Normal; 3]>() } else { 0 };
        (colours + normals) as u64
    }
}

/// The attributes of the corners of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CornerAttributes {
    /// sRGB.
    pub colours: [Colour; 3],
    /// Normals.
    pub normals: [Normal; 3],
}

impl CornerAttributes {
    /// Of corners without any.
    pub const NONE: CornerAttributes = CornerAttributes { colours: [WHITE; 3], normals: [Normal::NONE; 3] };
}

impl From<[Colour; 3]> for CornerAttributes {
    fn from(colours: [Colour; 3]) -> CornerAttributes {
        CornerAttributes { colours, ..CornerAttributes::NONE }
    }
}

/// The attributes of triangles, in columns. See the module's invariant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AttributeColumns {
    pub(crate) colours: Vec<[Colour; 3]>,
    pub(crate) normals: Vec<[Normal; 3]>,
}

impl AttributeColumns {
    /// Which columns have rows.
    pub(crate) fn set(&self) -> AttributeSet {
        AttributeSet { colours: !self.colours.is_empty(), normals: !self.normals.is_empty() }
    }

    /// The attributes of a triangle.
    pub fn of(&self, triangle: usize) -> CornerAttributes {
        CornerAttributes {
            colours: self.colours.get(triangle).copied().unwrap_or([WHITE; 3]),
            normals: self.normals.get(triangle).copied().unwrap_or([Normal::NONE; 3]),
        }
    }

    /// Adds those of the next triangle, behind `count`; a column that begins gets room for `capacity`.
    pub(crate) fn push(&mut self, attributes: &CornerAttributes, (count, capacity): (usize, usize)) {
        push(&mut self.colours, attributes.colours, (count, capacity));
        push(&mut self.normals, attributes.normals, (count, capacity));
    }

    /// Appends a stretch of other columns, behind `count`; a column that begins gets room for `capacity`.
    pub(crate) fn extend(
        &mut self,
        other: &AttributeColumns,
        stretch: Range<usize>,
        (count, capacity): (usize, usize),
    ) {
        extend(&mut self.colours, &other.colours, stretch.clone(), (count, capacity));
        extend(&mut self.normals, &other.normals, stretch, (count, capacity));
    }

    /// Removes the rows of some columns.
    pub(crate) fn drop_columns(&mut self, dropped: AttributeSet) {
        if dropped.colours {
            self.colours.clear();
        }
        if dropped.normals {
            self.normals.clear();
        }
    }

    /// Removes all rows, keeps the memory.
    pub(crate) fn clear(&mut self) {
        self.colours.clear();
        self.normals.clear();
    }
}

fn push<V: CornerValue>(column: &mut Vec<[V; 3]>, row: [V; 3], (count, capacity): (usize, usize)) {
    if column.is_empty() {
        if row == [V::NONE; 3] {
            return;
        }
        begin(column, (count, capacity));
    }
    column.push(row);
}

fn extend<V: CornerValue>(
    column: &mut Vec<[V; 3]>,
    other: &[[V; 3]],
    stretch: Range<usize>,
    (count, capacity): (usize, usize),
) {
    if column.is_empty() {
        if other.is_empty() {
            return;
        }
        begin(column, (count, capacity));
    }
    match other.is_empty() {
        true => column.resize(count + stretch.len(), [V::NONE; 3]),
        false => column.extend_from_slice(&other[stretch]),
    }
}

/// Gives the triangles so far a row each.
fn begin<V: CornerValue>(column: &mut Vec<[V; 3]>, (count, capacity): (usize, usize)) {
    column.reserve_exact(capacity);
    column.resize(count, [V::NONE; 3]);
}
