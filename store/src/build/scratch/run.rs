//! Runs: snapped triangles of one cell as bytes, packed column by column.
//!
//! ```text
//! run     = seal (`crate::scratch`), least corner 3 x 8 bytes, 13 widths, LZ4(columns)
//! columns = corner 0 minus the least corner; corners 1 and 2 minus corner 0 (zigzag); material;
//!           what the colours of the corners lack of white
//! column  = as many byte planes as its width says: what its greatest value takes
//! ```
//!
//! Invariant: a run comes back as it was, or not at all.

use crate::cluster::Colour;
use crate::scratch::SEAL_BYTES;
use lz4_flex::block::get_maximum_output_size;
use serde::{Deserialize, Serialize};

/// Triangles of a full run.
pub(crate) const RUN_TRIANGLES: usize = 4096;
/// Bits of a lattice coordinate.
const COORDINATE_MASK: i64 = (1 << crate::geom::Lattice::MAX_BITS) - 1;
/// Columns of a run: nine coordinates, the material, three colours.
const COLUMNS: usize = 13;
/// The column of the material; those of the colours follow.
const MATERIAL_COLUMN: usize = 9;
/// Most bytes of a value.
const WIDTH_MOST: usize = 5;
/// Bytes between the seal and the columns.
const HEAD_BYTES: usize = 3 * 8 + COLUMNS;

/// A triangle on the lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LatticeTriangle {
    pub(crate) q: [[i64; 3]; 3],
    pub(crate) material: u16,
    pub(crate) colours: [Colour; 3],
}

/// Where a run lies.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Run {
    pub(crate) offset: u64,
    pub(crate) bytes: u32,
    pub(crate) triangle_count: u32,
}

impl Run {
    /// Whether it can lie in a scratch file of so many bytes, for what a record says.
    pub(crate) fn is_sound(&self, scratch_bytes: u64) -> bool {
        let head = SEAL_BYTES + HEAD_BYTES;
        let most = head + get_maximum_output_size(RUN_TRIANGLES * COLUMNS * WIDTH_MOST);
        (1..=RUN_TRIANGLES).contains(&(self.triangle_count as usize))
            && (head..=most).contains(&(self.bytes as usize))
            && self.offset.checked_add(u64::from(self.bytes)).is_some_and(|end| end <= scratch_bytes)
    }
}

/// Makes runs, in memory that is used again.
#[derive(Default)]
pub(crate) struct Encoder {
    values: Vec<u64>,
    planes: Vec<u8>,
}

impl Encoder {
    /// The bytes of a run, with room for its seal.
    pub(crate) fn encode(&mut self, triangles: &[LatticeTriangle]) -> Vec<u8> {
        let least = |axis: usize| triangles.iter().map(|t| t.q[0][axis]).min().unwrap_or(0);
        let base = [0, 1, 2].map(least);
        self.planes.clear();
        let widths: [u8; COLUMNS] = std::array::from_fn(|column| {
            let (corner, axis) = (column / 3, column % 3);
            self.values.clear();
            match corner {
                0 => self.values.extend(triangles.iter().map(|t| (t.q[0][axis] - base[axis]) as u64)),
                1 | 2 => {
                    self.values.extend(triangles.iter().map(|t| zigzag(t.q[corner][axis] - t.q[0][axis])));
                }
                _ if column == MATERIAL_COLUMN => {
                    self.values.extend(triangles.iter().map(|t| u64::from(t.material)));
                }
                _ => {
                    let corner = column - MATERIAL_COLUMN - 1;
                    self.values.extend(triangles.iter().map(|t| below_white(t.colours[corner])));
                }
            }
            let all = self.values.iter().fold(0, |all, value| all | value);
            let width = (u64::BITS - all.leading_zeros()).div_ceil(8);
            for plane in 0..width {
                self.planes.extend(self.values.iter().map(|value| (value >> (8 * plane)) as u8));
            }
            width as u8
        });
        let room = get_maximum_output_size(self.planes.len());
        let mut out = Vec::with_capacity(SEAL_BYTES + HEAD_BYTES + room);
        out.resize(SEAL_BYTES, 0);
        out.extend(base.iter().flat_map(|b| b.to_le_bytes()));
        out.extend(widths);
        let head = out.len();
        out.resize(head + room, 0);
        let packed = lz4_flex::block::compress_into(&self.planes, &mut out[head..]);
        out.truncate(head + packed.expect("there is room for what cannot be compressed"));
        out
    }
}

/// Appends the triangles of a run, of which `bytes` are what follows the seal; `None` when that is no run of so many.
pub(super) fn decode(bytes: &[u8], n: usize, out: &mut Vec<LatticeTriangle>) -> Option<()> {
    let (head, packed) = bytes.split_at_checked(HEAD_BYTES)?;
    let (base, widths) = head.split_at(24);
    let base: [i64; 3] =
        std::array::from_fn(|a| i64::from_le_bytes(base[8 * a..8 * a + 8].try_into().expect("8")));
    if widths.iter().any(|&width| usize::from(width) > WIDTH_MOST) {
        return None;
    }
    let bytes = n * widths.iter().map(|&width| usize::from(width)).sum::<usize>();
    let planes = lz4_flex::block::decompress(packed, bytes).ok().filter(|planes| planes.len() == bytes)?;
    let from = out.len();
    out.resize(from + n, LatticeTriangle::default());
    let (out, mut planes) = (&mut out[from..], planes.as_slice());
    for (column, &width) in widths.iter().enumerate() {
        let (these, rest) = planes.split_at(n * usize::from(width));
        planes = rest;
        match width {
            0 => set_column::<0>(these, column, base, out),
            1 => set_column::<1>(these, column, base, out),
            2 => set_column::<2>(these, column, base, out),
            3 => set_column::<3>(these, column, base, out),
            4 => set_column::<4>(these, column, base, out),
            _ => set_column::<WIDTH_MOST>(these, column, base, out),
        }
    }
    Some(())
}

/// Sets a column of triangles, whose corner 0 is set before the others.
fn set_column<const WIDTH: usize>(
    planes: &[u8],
    column: usize,
    base: [i64; 3],
    triangles: &mut [LatticeTriangle],
) {
    let n = triangles.len();
    let planes: [&[u8]; WIDTH] = std::array::from_fn(|plane| &planes[plane * n..][..n]);
    let value =
        |i: usize| (0..WIDTH).fold(0u64, |all, plane| all | u64::from(planes[plane][i]) << (8 * plane));
    let (corner, axis) = (column / 3, column % 3);
    for (i, t) in triangles.iter_mut().enumerate() {
        match corner {
            0 => t.q[0][axis] = base[axis] + value(i) as i64,
            1 | 2 => t.q[corner][axis] = (t.q[0][axis] + unzigzag(value(i))) & COORDINATE_MASK,
            _ if column == MATERIAL_COLUMN => t.material = value(i) as u16,
            _ => t.colours[column - MATERIAL_COLUMN - 1] = of_below_white(value(i)),
        }
    }
}

/// Differences of 40-bit coordinates, modulo 2^40, small ones of either sign first: 40 bits hold them all.
fn zigzag(difference: i64) -> u64 {
    let value = difference << 24 >> 24;
    ((value << 1) ^ (value >> 63)) as u64
}

/// What a colour lacks of white, as a number.
fn below_white([r, g, b]: Colour) -> u64 {
    u64::from(u32::from_le_bytes([!r, !g, !b, 0]))
}

fn of_below_white(value: u64) -> Colour {
    let [r, g, b, ..] = value.to_le_bytes();
    [!r, !g, !b]
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_survive(
            corners in proptest::collection::vec((any::<[[u32; 3]; 3]>(), any::<u16>(), any::<[Colour; 3]>()), 1..300),
            cut in 0u32..32,
            shift in 0u32..8,
        ) {
            let triangles: Vec<_> = corners
                .iter()
                .map(|(q, material, colours)| LatticeTriangle {
                    q: q.map(|c| c.map(|v| i64::from(v >> cut) << shift)),
                    material: *material,
                    colours: *colours,
                })
                .collect();
            let mut back = Vec::new();
            let run = Encoder::default().encode(&triangles);
            decode(&run[SEAL_BYTES..], triangles.len(), &mut back).unwrap();
            prop_assert_eq!(back, triangles);
        }
    }
}
