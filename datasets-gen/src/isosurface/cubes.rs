//! Marching cubes over one block of samples, by row masks.
//!
//! Which triangles a pattern of signs makes, and why there are no holes, stands in [`trex_store::marching_cubes`].
//!
//! Invariants: 1. inside is what is below zero; 2. a vertex depends on the two samples of its edge and on their global
//! place only, so blocks share it to the bit.

use super::field::{Block, CELLS, SIDE, STRIDE};
use trex_store::TriangleBatch;
use trex_store::marching_cubes::{self, CellEdge, MAX_TRIANGLES};

/// Samples per axis that the cells of a block touch.
const SAMPLES: usize = CELLS + 1;
/// Row length of the vertex array: a power of two, so that places are shifts.
const ROW: usize = 16;
/// Vertices per axis: one slot for each sample's edge.
const PLANE: usize = SAMPLES * SAMPLES * ROW;
/// Vertices stay this far (in edges) from the samples: no degenerate triangles, and none that the store's
/// lattice, far finer than a cell, could collapse.
const EDGE_MARGIN: f32 = 0.05;

/// Which triangles each of the 256 sign patterns of a cell makes.
pub(super) struct Table {
    /// Places in the vertex array, relative to the cell's.
    corners: [[u16; 3 * MAX_TRIANGLES]; 256],
    count: [u8; 256],
}

/// Where a block's cells stand and which of them belong to the domain.
pub(super) struct Place {
    /// Global index of the block's first sample.
    pub(super) first: [i64; 3],
    /// Index of the sample at the origin of model space.
    pub(super) center: [i64; 3],
    /// Cells of this block that lie inside of the domain, per axis.
    pub(super) inside: [usize; 3],
    /// Length of a cell.
    pub(super) step: f32,
}

/// Vertices of the block at work.
pub(super) struct Cubes {
    vertices: Box<[[f32; 3]; 3 * PLANE]>,
}

type Masks = [[u16; SAMPLES]; SAMPLES];

impl Default for Cubes {
    fn default() -> Cubes {
        Cubes { vertices: Box::new([[0.0; 3]; 3 * PLANE]) }
    }
}

impl Cubes {
    /// Appends the triangles of the zero level in `block`.
    pub(super) fn extract(&mut self, table: &Table, block: &Block, place: &Place, out: &mut TriangleBatch) {
        let masks = sign_masks(block);
        self.place_vertices(block, &masks, place);
        for_each_cell(&masks, place, |case, x, y, z| {
            let base = (z * SAMPLES + y) * ROW + x;
            let count = usize::from(table.count[case]);
            for corner in table.corners[case].chunks_exact(3).take(count) {
                let vertex = |slot: usize| self.vertices[base + usize::from(corner[slot])].map(f64::from);
                out.corners.push([vertex(0), vertex(1), vertex(2)]);
            }
        });
        out.material.resize(out.corners.len(), 0);
    }

    /// Computes the vertex of every edge that crosses zero.
    fn place_vertices(&mut self, block: &Block, masks: &Masks, place: &Place) {
        // Sample coordinates are small integers, exact in f32.
        let sample: [[f32; SAMPLES]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|i| (place.first[axis] - place.center[axis] + i as i64) as f32)
        });
        let within = (1u16 << SAMPLES) - 1;
        for z in 0..SAMPLES {
            for y in 0..SAMPLES {
                let row = masks[z][y];
                let next_y = if y < CELLS { masks[z][y + 1] } else { row };
                let next_z = if z < CELLS { masks[z + 1][y] } else { row };
                let crossing = [(row ^ row >> 1) & (within >> 1), row ^ next_y, row ^ next_z];
                let from = ((z + 1) * SIDE + y + 1) * STRIDE + 1;
                let place_row = (z * SAMPLES + y) * ROW;
                for (axis, stride) in [(0, 1), (1, STRIDE), (2, SIDE * STRIDE)] {
                    let mut left = crossing[axis];
                    while left != 0 {
                        let x = left.trailing_zeros() as usize;
                        left &= left - 1;
                        let (low, high) = (block.values[from + x], block.values[from + x + stride]);
                        let t = (low / (low - high)).clamp(EDGE_MARGIN, 1.0 - EDGE_MARGIN);
                        let mut at = [sample[0][x], sample[1][y], sample[2][z]];
                        at[axis] += t;
                        self.vertices[axis * PLANE + place_row + x] = at.map(|value| value * place.step);
                    }
                }
            }
        }
    }
}

/// Count of the triangles that [`Cubes::extract`] would append.
pub(super) fn count(table: &Table, block: &Block, place: &Place) -> u64 {
    let mut sum = 0;
    for_each_cell(&sign_masks(block), place, |case, _, _, _| sum += u64::from(table.count[case]));
    sum
}

/// Bit x of `[z][y]`: the sample is inside (negative).
fn sign_masks(block: &Block) -> Masks {
    std::array::from_fn(|z| {
        std::array::from_fn(|y| {
            let from = ((z + 1) * SIDE + y + 1) * STRIDE + 1;
            let row: &[f32] = &block.values[from..from + SAMPLES];
            row.iter().enumerate().fold(0, |mask, (x, value)| mask | u16::from(*value < 0.0) << x)
        })
    })
}

/// Calls `visit(case, x, y, z)` for each cell of the domain that the surface crosses.
fn for_each_cell(masks: &Masks, place: &Place, mut visit: impl FnMut(usize, usize, usize, usize)) {
    let domain = (1u16 << place.inside[0]) - 1;
    for z in 0..place.inside[2] {
        for y in 0..place.inside[1] {
            let rows = [masks[z][y], masks[z][y + 1], masks[z + 1][y], masks[z + 1][y + 1]];
            let any = rows[0] | rows[1] | rows[2] | rows[3];
            let all = rows[0] & rows[1] & rows[2] & rows[3];
            let mut active = (any | any >> 1) & !(all & all >> 1) & domain;
            while active != 0 {
                let x = active.trailing_zeros() as usize;
                active &= active - 1;
                let pair = |row: usize| usize::from(rows[row] >> x & 3);
                visit(pair(0) | pair(1) << 2 | pair(2) << 4 | pair(3) << 6, x, y, z);
            }
        }
    }
}

impl Table {
    /// Makes the table.
    pub(super) fn new() -> Table {
        let mut table = Table { corners: [[0; 3 * MAX_TRIANGLES]; 256], count: [0; 256] };
        for case in 0..256 {
            let triangles = marching_cubes::triangles(case);
            table.count[case] = triangles.len() as u8;
            for (slot, &edge) in table.corners[case].iter_mut().zip(triangles.as_flattened()) {
                *slot = vertex_slot(edge);
            }
        }
        table
    }
}

/// Place of the edge's vertex in the vertex array, relative to the cell's.
fn vertex_slot(CellEdge { axis, corner }: CellEdge) -> u16 {
    let [dx, dy, dz] = [corner & 1, corner >> 1 & 1, corner >> 2];
    (axis * PLANE + (dz * SAMPLES + dy) * ROW + dx) as u16
}
