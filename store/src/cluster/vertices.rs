//! Vertices of a cluster on disk: the difference from a parallelogram, in one of three widths, or plain.
//!
//! ```text
//! vertices = tag 2 bits each | values, one after the other
//! tag 0..2 : per axis min(class width, axis width) bits: what is to be added to the prediction, less half of the range
//! tag 3    : per axis the axis' width: the vertex above the base, as in the frame
//! ```
//!
//! Differences are those of packed vertices, see `packing.rs`, and told by their digits; so no value leads out of the
//! axis widths, whatever the file says. Tags stand apart so that a value with the widest axes still fits one 57-bit
//! load. Bits a vertex, `gen:isosurface:20M` / `gen:scan:20M` / the Stanford dragon / `gen:pipes:20M` / a circuit
//! board, of 31.6 / 27.7 / 36.4 / 29.9 / 30.4 plain, in the order of version 2:
//!
//! | three classes, one width each (this) | 26.0 | 9.6 | 30.9 | 15.4 | 22.3 |
//! | one class | 27.4 | 11.7 | 31.9 | 18.7 | 24.2 |
//! | seven classes | 26.5 | 10.0 | 31.6 | 16.0 | 22.8 |
//! | three classes, a width per axis | 25.9 | 9.0 | 31.5 | 14.9 | 21.4 |
//! | Rice, a parameter per axis: three dependent bit scans a vertex | 25.1 | 9.8 | 29.9 | 17.4 | 24.2 |
//!
//! Wide clusters store each axis above the base, plain.
//!
//! Invariants: 1. a vertex decodes to the integers that were encoded; 2. any bits at all decode to vertices within
//! the axis widths.

use super::bits::{BYTES_OF_ONE, BitReader, BitWriter};
use super::fields::Mover;
use super::finish::{Guides, PLAIN, VertexWords};
use super::packing::VertexPacking;
use super::{ClusterMesh, Widths};
use crate::layout::{AXIS_BITS, CLUSTER_VERTICES};

/// Classes of differences.
pub(super) const CLASSES: usize = 3;
/// Bits of a class's width in the head of a cluster.
pub(super) const CLASS_WIDTH_BITS: u32 = 5;
/// Bits of a tag.
pub(super) const TAG_BITS: u32 = 2;
const _: () = assert!(PLAIN as usize == CLASSES && CLASSES < 1 << TAG_BITS);

/// The widths of a cluster's classes, ascending.
pub(super) type ClassWidths = [u32; CLASSES];

/// How the value behind each tag is read, and what is done with it. Arrays by tag, so that each is an operand of the
/// instruction that takes it.
struct TagTable<M: Mover> {
    /// Bits of the whole value.
    bits: [usize; CLASSES + 1],
    /// Where its axes go.
    fields: [M::Fields; CLASSES + 1],
    /// Half of the range of each axis, to be taken away in the end.
    halves: [u64; CLASSES + 1],
}

impl<M: Mover> TagTable<M> {
    /// Classes of one width for all axes, and plain ones, which have no prediction and no halves.
    #[inline(always)]
    fn new(mover: M, packing: &VertexPacking, classes: ClassWidths) -> TagTable<M> {
        let [a, b, c] = classes.map(|width| packing.bits.map(|bits| bits.min(width)));
        let all = [a, b, c, packing.bits];
        let mut halves = all.map(|bits| packing.halves(bits));
        halves[CLASSES] = 0;
        TagTable {
            bits: all.map(|bits| bits.iter().sum::<u32>() as usize),
            fields: all.map(|bits| mover.fields(bits, packing.shift)),
            halves,
        }
    }
}

/// A compact cluster to be written, and what its vertices are predicted from.
pub(super) struct VertexEncoder<'a> {
    pub(super) cluster: &'a ClusterMesh,
    pub(super) widths: &'a Widths,
    pub(super) guides: &'a Guides,
}

impl VertexEncoder<'_> {
    /// Chooses the class widths: all that fewer than three classes could do is tried, too.
    pub(super) fn class_widths(&self) -> ClassWidths {
        let packing = VertexPacking::new(self.widths);
        // How many differences need at most so many bits.
        let mut fitting = [0u32; AXIS_BITS as usize + 1];
        self.differences(|_, _, needs| fitting[needs as usize] += 1);
        for width in 1..fitting.len() {
            fitting[width] += fitting[width - 1];
        }
        let bits = |width: usize| packing.bits.iter().map(|&b| b.min(width as u32)).sum::<u32>();
        let costs: [u32; AXIS_BITS as usize + 1] = std::array::from_fn(bits);
        let plain: u32 = packing.bits.iter().sum();
        let mut best = (u32::MAX, [0; CLASSES]);
        // No class needs to be wider than the widest axis.
        let widest = packing.bits.iter().fold(0, |all, &b| all.max(b as usize));
        for c in 0..=widest {
            let above = (fitting[widest] - fitting[c]) * plain;
            for b in 0..=c {
                let third = above + (fitting[c] - fitting[b]) * costs[c];
                for a in 0..=b {
                    let all = third + (fitting[b] - fitting[a]) * costs[b] + fitting[a] * costs[a];
                    if all < best.0 {
                        best = (all, [a as u32, b as u32, c as u32]);
                    }
                }
            }
        }
        best.1
    }

    /// Writes the vertices.
    pub(super) fn encode(&self, classes: ClassWidths, out: &mut BitWriter) {
        let packing = VertexPacking::new(self.widths);
        let mut values = Vec::with_capacity(self.cluster.vertices.len());
        self.differences(|vertex, digits, needs| {
            let fits = classes.iter().position(|&width| needs <= width);
            let value = match fits {
                Some(tag) => {
                    let bits = packing.bits.map(|b| b.min(classes[tag]));
                    (bits, std::array::from_fn(|a| (digits[a] + (1 << bits[a]) / 2) as u64))
                }
                None => (packing.bits, packing.get(vertex)),
            };
            out.put(fits.unwrap_or(CLASSES) as u64, TAG_BITS);
            values.push(value);
        });
        for (bits, value) in values {
            (0..3).for_each(|axis| out.put(value[axis], bits[axis]));
        }
    }

    /// Calls `visit` with each vertex, packed, the digits of its difference from the prediction, and the width that
    /// these need.
    fn differences(&self, mut visit: impl FnMut(u64, [i64; 3], u32)) {
        let packing = VertexPacking::new(self.widths);
        let mut placed = [0u64; CLUSTER_VERTICES];
        for (i, vertex) in self.cluster.vertices.iter().enumerate() {
            placed[i] = packing.put(std::array::from_fn(|a| (vertex[a] - self.widths.base[a]) as u64));
            let [a, b, c] = [0, 1, 2].map(|corner| placed[usize::from(self.guides[corner][i])]);
            // Of the first one, zero: its guide names itself.
            let prediction = if i == 0 { 0 } else { VertexPacking::predict(a, b, c) };
            let digits = packing.digits(placed[i].wrapping_sub(prediction) & packing.mask);
            visit(placed[i], digits, digits.map(signed_bits).into_iter().max().expect("three axes"));
        }
    }
}

/// Bits of a number in two's complement: 0 for 0.
fn signed_bits(value: i64) -> u32 {
    if value == 0 { 0 } else { 65 - (value ^ (value >> 63)).leading_zeros() }
}

/// Writes the vertices of a wide cluster.
pub(super) fn encode_wide(cluster: &ClusterMesh, widths: &Widths, out: &mut BitWriter) {
    for vertex in &cluster.vertices {
        for axis in 0..3 {
            out.put((vertex[axis] - widths.base[axis]) as u64, u32::from(widths.bits[axis]));
        }
    }
}

/// A compact cluster to be read: what its head says of its vertices, and what they are predicted from.
pub(super) struct VertexDecoder<'a> {
    pub(super) packing: VertexPacking,
    pub(super) classes: ClassWidths,
    pub(super) count: usize,
    /// Parted from the vertex before when they are used.
    pub(super) guides: &'a mut Guides,
}

impl VertexDecoder<'_> {
    /// Reads the vertices, packed, to the front of `placed`; bits above the packing's mask mean nothing. Behind them
    /// stand zeros.
    #[inline(always)]
    pub(super) fn decode<M: Mover>(self, mover: M, input: &mut BitReader<'_>, placed: &mut VertexWords) {
        let VertexDecoder { packing, classes, count, guides } = self;
        let reading = TagTable::new(mover, &packing, classes);
        // In registers, since nothing else knows it.
        let (mut tags_input, mut reader) = (*input, *input);
        reader.skip(TAG_BITS as usize * count);
        let mut tags = [0; CLUSTER_VERTICES];
        for eight in tags.as_chunks_mut().0.iter_mut().take(count.div_ceil(8)) {
            *eight = mover.deposit(tags_input.peek(), BYTES_OF_ONE, TAG_BITS).to_le_bytes();
            tags_input.skip(TAG_BITS as usize * eight.len());
        }
        let signs = mover.part_guides(guides, &tags, count);
        // The first one's guide names itself, and those of garbage name anyone.
        placed[..CLUSTER_VERTICES].fill(0);
        let mut before = 0u64;
        for i in 0..count.min(CLUSTER_VERTICES) {
            let tag = usize::from(tags[i]) % (CLASSES + 1);
            let value = mover.spread(reader.peek(), &reading.fields[tag]).wrapping_sub(reading.halves[tag]);
            reader.skip(reading.bits[tag]);
            let [a, b, c] = [0, 1, 2].map(|corner| placed[usize::from(guides[corner][i])]);
            let others = VertexPacking::predict(a, b, c).wrapping_add(value);
            before = others.wrapping_add(before.wrapping_mul(signs[i] as u64));
            placed[i] = before;
        }
        *input = reader;
    }
}

/// Reads the next vertex of a wide cluster, above its base.
pub(super) fn decode_wide(input: &mut BitReader<'_>, widths: &Widths) -> [u64; 3] {
    widths.bits.map(|bits| input.take(u32::from(bits)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signed_bits_are_those_of_twos_complement() {
        for (value, needs) in [(0, 0), (-1, 1), (1, 2), (-2, 2), (127, 8), (-128, 8), (128, 9)] {
            assert_eq!(signed_bits(value), needs, "{value}");
        }
    }
}
