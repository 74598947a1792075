//! Runs: snapped triangles of one cell as bytes, packed column by column.
//!
//! ```text
//! run     = seal (`crate::scratch`), least corner 3 x 8 bytes, 16 widths, LZ4(columns)
//! columns = corner 0 minus the least corner; corners 1 and 2 minus corner 0 (zigzag); material;
//!           what the colours of the corners lack of white; their normals, as far from none
//! column  = as many byte planes as its width says: what its greatest value takes
//! ```
//!
//! Invariant: a run comes back as it was, or not at all.

use crate::attributes::{AttributeColumns, AttributeSet, CornerAttributes};
use crate::cluster::CornerValue;
use crate::scratch::SEAL_BYTES;
use lz4_flex::block::get_maximum_output_size;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Triangles of a full run.
pub(crate) const RUN_TRIANGLES: usize = 4096;
/// Bits of a lattice coordinate.
const COORDINATE_MASK: i64 = (1 << crate::geom::Lattice::MAX_BITS) - 1;
/// Columns of a run: nine coordinates, the material, three colours, three normals.
const COLUMNS: usize = 16;
/// The column of the material, and the first ones of the colours and of the normals.
const MATERIAL_COLUMN: usize = 9;
const COLOUR_COLUMN: usize = MATERIAL_COLUMN + 1;
const NORMAL_COLUMN: usize = COLOUR_COLUMN + 3;
/// Most bytes of a value.
const WIDTH_MOST: usize = 5;
/// Bytes between the seal and the columns.
const HEAD_BYTES: usize = 3 * 8 + COLUMNS;

/// A triangle on the lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LatticeTriangle {
    pub(crate) q: [[i64; 3]; 3],
    pub(crate) material: u16,
}

/// Triangles, and the attributes of their corners.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TriangleList {
    pub(crate) triangles: Vec<LatticeTriangle>,
    attributes: AttributeColumns,
}

impl TriangleList {
    /// Bytes of a triangle without attributes.
    pub(crate) const TRIANGLE_BYTES: u64 = size_of::<LatticeTriangle>() as u64;

    pub(crate) fn len(&self) -> usize {
        self.triangles.len()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Triangles that there is memory for.
    pub(crate) fn room(&self) -> u64 {
        self.triangles.capacity() as u64
    }

    /// What a corner may have beside its place.
    pub(crate) fn attributes(&self) -> AttributeSet {
        self.attributes.set()
    }

    /// The attributes of the corners of a triangle.
    pub(crate) fn attributes_of(&self, triangle: usize) -> CornerAttributes {
        self.attributes.of(triangle)
    }

    pub(crate) fn push(&mut self, triangle: LatticeTriangle, attributes: &CornerAttributes) {
        self.attributes.push(attributes, (self.triangles.len(), self.triangles.capacity()));
        self.triangles.push(triangle);
    }

    /// Appends a stretch of another list.
    pub(crate) fn extend(&mut self, other: &TriangleList, stretch: Range<usize>) {
        let room = (self.triangles.len(), self.triangles.capacity());
        self.attributes.extend(&other.attributes, stretch.clone(), room);
        self.triangles.extend_from_slice(&other.triangles[stretch]);
    }

    /// Makes room for so many triangles in all.
    pub(crate) fn reserve_exact(&mut self, triangle_count: usize) {
        self.triangles.reserve_exact(triangle_count);
    }

    pub(crate) fn clear(&mut self) {
        self.triangles.clear();
        self.attributes.clear();
    }
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
    pub(crate) fn encode(&mut self, list: &TriangleList) -> Vec<u8> {
        let triangles = &list.triangles;
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
                _ if column < NORMAL_COLUMN => {
                    let corner = column - COLOUR_COLUMN;
                    self.values.extend(list.attributes.colours.iter().map(|row| from_none(row[corner])));
                }
                _ => {
                    let corner = column - NORMAL_COLUMN;
                    self.values.extend(list.attributes.normals.iter().map(|row| from_none(row[corner])));
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
pub(super) fn decode(bytes: &[u8], n: usize, out: &mut TriangleList) -> Option<()> {
    let (head, packed) = bytes.split_at_checked(HEAD_BYTES)?;
    let (base, widths) = head.split_at(24);
    let base: [i64; 3] =
        std::array::from_fn(|a| i64::from_le_bytes(base[8 * a..8 * a + 8].try_into().expect("8")));
    let is_sound = base.iter().all(|place| (0..=COORDINATE_MASK).contains(place))
        && widths.iter().all(|&width| usize::from(width) <= WIDTH_MOST);
    if !is_sound {
        return None;
    }
    let bytes = n * widths.iter().map(|&width| usize::from(width)).sum::<usize>();
    let planes = lz4_flex::block::decompress(packed, bytes).ok().filter(|planes| planes.len() == bytes)?;
    let from = out.len();
    out.triangles.resize(from + n, LatticeTriangle::default());
    make_rows(&mut out.attributes.colours, &widths[COLOUR_COLUMN..NORMAL_COLUMN], from + n);
    make_rows(&mut out.attributes.normals, &widths[NORMAL_COLUMN..], from + n);
    let (triangles, mut planes) = (&mut out.triangles[from..], planes.as_slice());
    for (column, &width) in widths.iter().enumerate() {
        let (these, rest) = planes.split_at(n * usize::from(width));
        planes = rest;
        let AttributeColumns { colours, normals } = &mut out.attributes;
        if let Some(corner) = column.checked_sub(NORMAL_COLUMN) {
            set_values(these, corner, normals.get_mut(from..).unwrap_or_default());
            continue;
        }
        if let Some(corner) = column.checked_sub(COLOUR_COLUMN) {
            set_values(these, corner, colours.get_mut(from..).unwrap_or_default());
            continue;
        }
        match width {
            0 => set_column::<0>(these, column, base, triangles),
            1 => set_column::<1>(these, column, base, triangles),
            2 => set_column::<2>(these, column, base, triangles),
            3 => set_column::<3>(these, column, base, triangles),
            4 => set_column::<4>(these, column, base, triangles),
            _ => set_column::<WIDTH_MOST>(these, column, base, triangles),
        }
    }
    Some(())
}

/// Makes rows for so many triangles, where there are some already, or columns of such widths say more than none.
fn make_rows<V: CornerValue>(rows: &mut Vec<[V; 3]>, widths: &[u8], triangle_count: usize) {
    if !rows.is_empty() || widths.iter().any(|&width| width > 0) {
        rows.resize(triangle_count, [V::NONE; 3]);
    }
}

/// Sets the value of a corner of triangles, of byte planes; without rows there are no planes.
fn set_values<V: CornerValue>(planes: &[u8], corner: usize, rows: &mut [[V; 3]]) {
    let n = rows.len().max(1);
    for (i, row) in rows.iter_mut().enumerate() {
        let value = planes.iter().skip(i).step_by(n).enumerate();
        let value = value.fold(0, |all, (plane, &byte)| all | u64::from(byte) << (8 * plane));
        row[corner] = of_from_none(value);
    }
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
            _ => t.material = value(i) as u16,
        }
    }
}

/// Differences of 40-bit coordinates, modulo 2^40, small ones of either sign first: 40 bits hold them all.
fn zigzag(difference: i64) -> u64 {
    let value = difference << 24 >> 24;
    ((value << 1) ^ (value >> 63)) as u64
}

/// The bits in which a value differs from none, as a number.
fn from_none<V: CornerValue>(value: V) -> u64 {
    let [a, b, c] = value.to_bytes();
    let [x, y, z] = V::NONE.to_bytes();
    u64::from(u32::from_le_bytes([a ^ x, b ^ y, c ^ z, 0]))
}

fn of_from_none<V: CornerValue>(value: u64) -> V {
    let ([a, b, c, ..], [x, y, z]) = (value.to_le_bytes(), V::NONE.to_bytes());
    V::from_bytes([a ^ x, b ^ y, c ^ z])
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::{Colour, Normal, WHITE};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_survive(
            corners in proptest::collection::vec(
                (any::<[[u32; 3]; 3]>(), any::<u16>(), any::<[Colour; 3]>(), any::<[u32; 3]>()), 1..300
            ),
            cut in 0u32..32,
            shift in 0u32..8,
            is_white: bool,
            is_flat: bool,
        ) {
            let mut list = TriangleList::default();
            for (q, material, colours, normals) in &corners {
                let q = q.map(|c| c.map(|v| i64::from(v >> cut) << shift));
                let attributes = CornerAttributes {
                    colours: if is_white { [WHITE; 3] } else { *colours },
                    normals: if is_flat { [Normal::NONE; 3] } else { normals.map(Normal::from_code) },
                };
                list.push(LatticeTriangle { q, material: *material }, &attributes);
            }
            let has = AttributeSet {
                colours: !is_white && corners.iter().any(|of| of.2 != [WHITE; 3]),
                normals: !is_flat && corners.iter().any(|of| of.3.map(Normal::from_code) != [Normal::NONE; 3]),
            };
            prop_assert_eq!(list.attributes(), has);
            let mut back = TriangleList::default();
            let run = Encoder::default().encode(&list);
            decode(&run[SEAL_BYTES..], list.len(), &mut back).unwrap();
            prop_assert_eq!(&back, &list);
            // Behind one without attributes, which has none then.
            let mut both = TriangleList::default();
            both.push(list.triangles[0], &CornerAttributes::NONE);
            decode(&run[SEAL_BYTES..], list.len(), &mut both).unwrap();
            prop_assert_eq!((both.len(), both.attributes_of(0)), (list.len() + 1, CornerAttributes::NONE));
            prop_assert_eq!(both.attributes_of(list.len()), list.attributes_of(list.len() - 1));
        }
    }
}
