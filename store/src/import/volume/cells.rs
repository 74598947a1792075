//! The triangles of a row of cells, of the vertices on the edges about it.
//!
//! ```text
//!   rows of vertices:   x edges of the four rows of samples, z edges of two, y edges of two
//!
//!        Y1                    a row of cells lies between rows y and y + 1 of slices z and z + 1; the next row of
//!    X01----X11   z + 1        cells takes over what lies at y + 1, so that rows of samples have their place by
//!     | Z0   | Z1              whether they are even
//!    X00----X10   z
//!     y  Y0  y + 1
//! ```
//!
//! Invariants: 1. a vertex follows from the two samples of its edge and the place of the edge: whichever row or slab
//! asks for it gets the same bits, so nothing has to be welded; 2. where two samples are finite it lies where the line
//! between them crosses the value, else halfway; 3. a triangle two of whose corners are one point is left out, which
//! leaves no hole: its other two sides are one edge, there and back.

use super::layout::VolumeAxes;
use super::masks::{WORD_BITS, bits_below, next_samples};
use super::samples::Sample;
use crate::marching_cubes::{self, CellEdge, MAX_TRIANGLES};
use crate::source::TriangleBatch;

/// Rows of vertices about a row of cells.
const ROWS: usize = 8;
/// The first of those along z, and along y; those along x come first, one of each slice for each row of samples.
const Z_ROWS: usize = 4;
const Y_ROWS: usize = 6;

/// Four rows of samples about a row of cells: `[slice][row]`.
pub(super) type CellRows<'a, T> = [[&'a [T]; 2]; 2];

/// The samples about a row of cells, and which of them are inside.
pub(super) struct RowSamples<'a, T> {
    pub(super) samples: CellRows<'a, T>,
    pub(super) inside: CellRows<'a, u64>,
    /// Of the row of cells, and of its slab.
    pub(super) y: usize,
    pub(super) z: usize,
    pub(super) value: f64,
}

/// The table, the axes, and the vertices of the row at work.
pub(super) struct CellRow {
    axes: VolumeAxes,
    is_mirrored: bool,
    /// Samples of a row.
    side: usize,
    /// Places of corners in the vertices, from the cell's on: for rows at even y, and for those at odd.
    slots: [Vec<[u32; 3 * MAX_TRIANGLES]>; 2],
    counts: Vec<u8>,
    vertices: Vec<[f64; 3]>,
}

impl CellRow {
    /// For rows of `side` samples.
    pub(super) fn new(axes: VolumeAxes, side: usize) -> CellRow {
        let tables: Vec<_> = (0..256).map(marching_cubes::triangles).collect();
        let slots = [0, 1].map(|parity| {
            let slots = |triangles: &Vec<[CellEdge; 3]>| {
                let mut slots = [0; 3 * MAX_TRIANGLES];
                for (slot, edge) in slots.iter_mut().zip(triangles.as_flattened()) {
                    *slot = vertex_slot(*edge, parity, side);
                }
                slots
            };
            tables.iter().map(slots).collect()
        });
        CellRow {
            axes,
            is_mirrored: axes.handedness() < 0.0,
            side,
            slots,
            counts: tables.iter().map(|triangles| triangles.len() as u8).collect(),
            vertices: vec![[0.0; 3]; ROWS * side],
        }
    }

    /// Bytes that it takes.
    pub(super) fn bytes(side: usize) -> u64 {
        let table = 256 * (2 * size_of::<[u32; 3 * MAX_TRIANGLES]>() + 1);
        (table + ROWS * side * size_of::<[f64; 3]>()) as u64
    }

    /// Computes the vertices about a row of cells, but for those that the row before it has left.
    pub(super) fn place_vertices<T: Sample>(&mut self, row: &RowSamples<'_, T>) {
        if row.y == 0 {
            self.place_on_row(row, 0);
        }
        self.place_on_row(row, 1);
        for slice in [0, 1] {
            let [near, far] = row.inside[slice];
            let crossings = near.iter().zip(far).map(|(near, far)| near ^ far);
            let samples = row.samples[slice];
            let z = (row.z + slice) as f64;
            self.place(Y_ROWS + slice, crossings, |x| {
                let part = crossing(samples[0][x], samples[1][x], row.value);
                [x as f64, row.y as f64 + part, z]
            });
        }
    }

    /// Computes the vertices on the edges along x and z of a row of samples: the nearer or the farther one.
    fn place_on_row<T: Sample>(&mut self, row: &RowSamples<'_, T>, far: usize) {
        let y = row.y + far;
        for slice in [0, 1] {
            let (words, samples) = (row.inside[slice][far], row.samples[slice][far]);
            let cells = self.side - 1;
            let crossings = (0..words.len()).map(|at| {
                (words[at] ^ next_samples(words, at)) & bits_below(cells.saturating_sub(at * WORD_BITS))
            });
            let z = (row.z + slice) as f64;
            self.place(2 * (y & 1) + slice, crossings, |x| {
                let part = crossing(samples[x], samples[x + 1], row.value);
                [x as f64 + part, y as f64, z]
            });
        }
        let [low, high] = row.inside.map(|rows| rows[far]);
        let samples = row.samples.map(|rows| rows[far]);
        let crossings = low.iter().zip(high).map(|(low, high)| low ^ high);
        self.place(Z_ROWS + (y & 1), crossings, |x| {
            let part = crossing(samples[0][x], samples[1][x], row.value);
            [x as f64, y as f64, row.z as f64 + part]
        });
    }

    /// Sets the vertices of a row whose bits are set.
    #[inline]
    fn place(
        &mut self,
        row: usize,
        crossings: impl Iterator<Item = u64>,
        in_samples: impl Fn(usize) -> [f64; 3],
    ) {
        let vertices = &mut self.vertices[row * self.side..(row + 1) * self.side];
        for (word, mut crossing) in crossings.enumerate() {
            while crossing != 0 {
                let x = word * WORD_BITS + crossing.trailing_zeros() as usize;
                crossing &= crossing - 1;
                vertices[x] = self.axes.position(in_samples(x));
            }
        }
    }

    /// Adds the triangles of the row's cells from word `from` on, until the row ends or the batch is full. Gives the
    /// word that comes next.
    pub(super) fn march<T>(
        &self,
        row: &RowSamples<'_, T>,
        from: usize,
        material: u32,
        batch: &mut TriangleBatch,
    ) -> usize {
        let [[a, b], [c, d]] = row.inside;
        let (slots, cells) = (&self.slots[row.y & 1], self.side - 1);
        for at in from..a.len() {
            if batch.len() >= TriangleBatch::TARGET_TRIANGLES {
                return at;
            }
            let rows = [a, b, c, d].map(|row| [row[at], next_samples(row, at)]);
            let any = rows.iter().fold(0, |any, [here, next]| any | here | next);
            let all = rows.iter().fold(u64::MAX, |all, [here, next]| all & here & next);
            let mut active = any & !all & bits_below(cells.saturating_sub(at * WORD_BITS));
            while active != 0 {
                let bit = active.trailing_zeros();
                active &= active - 1;
                let pair = |[here, next]: [u64; 2]| (here >> bit & 1 | (next >> bit & 1) << 1) as usize;
                let pattern = pair(rows[0]) | pair(rows[1]) << 2 | pair(rows[2]) << 4 | pair(rows[3]) << 6;
                let cell = &self.vertices[at * WORD_BITS + bit as usize..];
                let (triangles, _) = slots[pattern].as_chunks::<3>();
                for triangle in &triangles[..usize::from(self.counts[pattern])] {
                    let [p, q, r] = triangle.map(|slot| cell[slot as usize]);
                    if p == q || q == r || r == p {
                        continue;
                    }
                    batch.push(if self.is_mirrored { [p, r, q] } else { [p, q, r] }, material);
                }
            }
        }
        a.len()
    }
}

/// Place of an edge's vertex, from its cell's on, in a row of cells at even (0) or odd (1) y.
fn vertex_slot(CellEdge { axis, corner }: CellEdge, parity: usize, side: usize) -> u32 {
    let [dx, dy, dz] = [corner & 1, corner >> 1 & 1, corner >> 2];
    let row = match axis {
        0 => 2 * (parity ^ dy) + dz,
        1 => Y_ROWS + dz,
        _ => Z_ROWS + (parity ^ dy),
    };
    (row * side + dx) as u32
}

/// How far between two samples, one of which is inside, the line between them crosses the value.
#[inline]
fn crossing<T: Sample>(a: T, b: T, value: f64) -> f64 {
    let (a, b) = (a.number(), b.number());
    let part = (value - a) / (b - a);
    // Samples may be farther apart than numbers reach, and integers of 64 bits equal once they are rounded.
    let part = if (b - a).is_finite() { part } else { (value / 2.0 - a / 2.0) / (b / 2.0 - a / 2.0) };
    if part.is_nan() || !(a.is_finite() && b.is_finite()) { 0.5 } else { part.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_crossed_where_it_takes_the_value() {
        assert_eq!([crossing(0u8, 200, 50.0), crossing(200u8, 0, 50.0)], [0.25, 0.75]);
        assert_eq!([crossing(50u8, 0, 50.0), crossing(0u8, 50, 50.0)], [0.0, 1.0]);
        // Beyond what can be subtracted, and without a line.
        assert_eq!(crossing(-1.5e308, 1.5e308, 0.75e308), 0.75);
        for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!([crossing(odd, 1.0, 0.5), crossing(1.0, odd, 0.5)], [0.5; 2]);
        }
        // Integers that f64 does not tell apart.
        assert_eq!(crossing(i64::MAX - 1, i64::MAX, 2f64.powi(63)), 0.5);
    }
}
