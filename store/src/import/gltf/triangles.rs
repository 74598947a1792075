//! `TriangleCorners`: the vertices of a primitive's triangles, by the triangle's number.
//!
//! ```text
//! triangles   3t       3t + 1           3t + 2
//! strip       t        t + 1 + t % 2    t + 2 - t % 2       every second one turns the other way
//! fan         t + 1    t + 2            0
//! ```

use super::primitives::PrimitiveShape;
use super::rows::RowWindow;
use crate::error::Result;

/// Corners by triangle.
pub(super) struct TriangleCorners {
    topology: PrimitiveShape,
    /// `None`: the corners are the vertices as they stand.
    indices: Option<RowWindow>,
    /// The first corner of a fan, which is in no window for long.
    first: Option<u64>,
}

impl TriangleCorners {
    /// Of a primitive with these indices.
    pub(super) fn new(topology: PrimitiveShape, indices: Option<RowWindow>) -> TriangleCorners {
        TriangleCorners { topology, indices, first: None }
    }

    /// The vertices of a triangle. They may not be there.
    #[inline]
    pub(super) fn of(&mut self, triangle: u64) -> Result<[u64; 3]> {
        let t = triangle;
        match self.topology {
            PrimitiveShape::Triangles => self.vertices([3 * t, 3 * t + 1, 3 * t + 2]),
            PrimitiveShape::Strip => self.vertices([t, t + 1 + t % 2, t + 2 - t % 2]),
            PrimitiveShape::Fan => {
                let first = match self.first {
                    Some(first) => first,
                    None => self.vertex(0)?,
                };
                self.first = Some(first);
                Ok([self.vertex(t + 1)?, self.vertex(t + 2)?, first])
            }
        }
    }

    #[inline]
    fn vertices(&mut self, corners: [u64; 3]) -> Result<[u64; 3]> {
        let [a, b, c] = corners;
        Ok([self.vertex(a)?, self.vertex(b)?, self.vertex(c)?])
    }

    #[inline]
    fn vertex(&mut self, corner: u64) -> Result<u64> {
        match &mut self.indices {
            Some(rows) => rows.integer(corner),
            None => Ok(corner),
        }
    }
}
