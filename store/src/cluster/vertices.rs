//! Vertices of a cluster on disk: the difference from a parallelogram, in one of three widths, or plain.
//!
//! ```text
//! vertices = tag 2 bits each | values, one after the other
//! tag 0..2 : per axis min(class width, axis width) bits: what is to be added to the prediction, less half of the range
//! tag 3    : per axis the axis' width: the vertex above the base, as in the frame
//! ```
//!
//! All of it modulo 2^(axis width), so no value leads out of the cluster's box, whatever the file says. Tags stand
//! apart so that a value with the widest axes still fits one 57-bit load. Bits a vertex, `gen:isosurface:20M` /
//! `gen:scan:20M` / the Stanford dragon / `gen:pipes:20M` / a circuit board, of 31.6 / 27.7 / 36.4 / 29.9 / 30.4 plain:
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

use super::bits::{BitReader, BitWriter};
use super::fields::{Fields, Mover};
use super::lanes::Lanes;
use super::topology::Gate;
use super::{ClusterMesh, Widths};
use crate::layout::{AXIS_BITS, CLUSTER_VERTICES};

/// Classes of differences.
pub(super) const CLASSES: usize = 3;
/// Bits of a class's width in the head of a cluster.
pub(super) const CLASS_WIDTH_BITS: u32 = 5;
/// Bits of a tag.
pub(super) const TAG_BITS: u32 = 2;
/// Tags of one 57-bit load.
const TAGS_A_LOAD: usize = 28;
const _: () = assert!(TAGS_A_LOAD * TAG_BITS as usize <= 57);

/// The widths of a cluster's classes, ascending.
pub(super) type ClassWidths = [u32; CLASSES];

/// How the value behind a tag is read, and what is done with it.
#[derive(Clone, Copy, Default)]
struct Class {
    /// Bits of the whole value.
    bits: u32,
    /// Where its axes go.
    fields: Fields,
    /// What is kept of the prediction: all values, or nothing.
    keep: u64,
    /// Added in the end: minus half of the range, in each lane.
    bias: u64,
}

impl Class {
    /// The class of one width for all axes.
    fn difference(width: u32, lanes: &Lanes) -> Class {
        let bits = lanes.bits.map(|b| b.min(width));
        let half = bits.map(|b| if b == 0 { 0 } else { 1u64 << (b - 1) });
        Class { keep: lanes.mask(), bias: lanes.sub(0, lanes.put(half)), ..Class::new(bits, lanes) }
    }

    /// No prediction, no bias.
    fn plain(lanes: &Lanes) -> Class {
        Class::new(lanes.bits, lanes)
    }

    fn new(bits: [u32; 3], lanes: &Lanes) -> Class {
        let fields = Fields::new(bits, [0, 1, 2].map(|axis| lanes.shift(axis)));
        Class { bits: bits.iter().sum(), fields, keep: 0, bias: 0 }
    }
}

/// A compact cluster to be written, and what its vertices are predicted from.
pub(super) struct Guided<'a> {
    pub(super) cluster: &'a ClusterMesh,
    pub(super) widths: &'a Widths,
    pub(super) guides: &'a [Gate; 256],
}

impl Guided<'_> {
    /// Chooses the class widths: all that fewer than three classes could do is tried, too.
    pub(super) fn class_widths(&self) -> ClassWidths {
        let lanes = Lanes::new(self.widths);
        // How many differences need at most so many bits.
        let mut fitting = [0u32; AXIS_BITS as usize + 1];
        self.differences(|_, _, needs| fitting[needs as usize] += 1);
        for width in 1..fitting.len() {
            fitting[width] += fitting[width - 1];
        }
        let bits = |width: usize| lanes.bits.iter().map(|&b| b.min(width as u32)).sum::<u32>();
        let costs: [u32; AXIS_BITS as usize + 1] = std::array::from_fn(bits);
        let plain: u32 = lanes.bits.iter().sum();
        let mut best = (u32::MAX, [0; CLASSES]);
        // No class needs to be wider than the widest axis.
        let widest = lanes.bits.iter().fold(0, |all, &b| all.max(b as usize));
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
        let lanes = Lanes::new(self.widths);
        let biases = classes.map(|width| Class::difference(width, &lanes).bias);
        let mut values = Vec::with_capacity(self.cluster.vertices.len());
        self.differences(|vertex, difference, needs| {
            let fits = classes.iter().position(|&width| needs <= width);
            let value = match fits {
                Some(tag) => {
                    let bits = lanes.bits.map(|b| b.min(classes[tag]));
                    (bits, lanes.get(lanes.sub(difference, biases[tag])))
                }
                None => (lanes.bits, lanes.get(vertex)),
            };
            out.put(fits.unwrap_or(CLASSES) as u64, TAG_BITS);
            values.push(value);
        });
        for (bits, value) in values {
            (0..3).for_each(|axis| out.put(value[axis], bits[axis]));
        }
    }

    /// Calls `visit` with each vertex in lanes, its difference from the prediction, and the width that this needs.
    fn differences(&self, mut visit: impl FnMut(u64, u64, u32)) {
        let lanes = Lanes::new(self.widths);
        let mut placed = [0u64; CLUSTER_VERTICES];
        for (i, vertex) in self.cluster.vertices.iter().enumerate() {
            placed[i] = lanes.put(std::array::from_fn(|a| (vertex[a] - self.widths.base[a]) as u64));
            let prediction = predict(&lanes, &placed, self.guides[i], i);
            let difference = lanes.sub(placed[i], prediction);
            let needs =
                lanes.get(difference).into_iter().zip(lanes.bits).map(|(d, bits)| signed_bits(d, bits));
            visit(placed[i], difference, needs.max().expect("three axes"));
        }
    }
}

/// The prediction of vertex `i`: of the first one, zero.
fn predict(lanes: &Lanes, placed: &[u64], guide: Gate, i: usize) -> u64 {
    let [a, b, c] = [guide.from(), guide.to(), guide.opposite()].map(usize::from);
    if i == 0 { 0 } else { lanes.predict(placed[a], placed[b], placed[c]) }
}

/// Bits of a two's complement number of at most `bits` bits.
fn signed_bits(value: u64, bits: u32) -> u32 {
    let away = if bits > 0 && value >> (bits - 1) == 1 { ((1 << bits) - 1) ^ value } else { value };
    if value == 0 { 0 } else { 65 - away.leading_zeros() }.min(bits)
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
pub(super) struct Coded<'a> {
    pub(super) lanes: Lanes,
    pub(super) classes: ClassWidths,
    pub(super) count: usize,
    pub(super) guides: &'a [Gate; 256],
}

impl Coded<'_> {
    /// Reads the vertices and hands each, in lanes, to `take`. `placed` is work memory.
    #[inline(always)]
    pub(super) fn decode<M: Mover>(
        &self,
        mover: M,
        input: &mut BitReader<'_>,
        placed: &mut [u64; 256],
        mut take: impl FnMut(usize, u64),
    ) {
        let (lanes, count) = (&self.lanes, self.count);
        let mut classes = [Class::plain(lanes); CLASSES + 1];
        for (class, width) in classes.iter_mut().zip(self.classes) {
            *class = Class::difference(width, lanes);
        }
        let mut tags_input = *input;
        input.skip(TAG_BITS as usize * count);
        // The first one's guide names itself, and those of garbage name anyone.
        placed[..CLUSTER_VERTICES].fill(0);
        for first in (0..count).step_by(TAGS_A_LOAD) {
            let mut tags = tags_input.peek();
            tags_input.skip(TAG_BITS as usize * TAGS_A_LOAD);
            for i in first..count.min(first + TAGS_A_LOAD) {
                let class = &classes[tags as usize % (CLASSES + 1)];
                tags >>= TAG_BITS;
                let value = lanes.add(mover.spread(input.peek(), &class.fields), class.bias);
                input.skip(class.bits as usize);
                let guide = self.guides[i % 256];
                let [a, b, c] = [guide.from(), guide.to(), guide.opposite()].map(usize::from);
                let prediction = lanes.predict_within(class.keep, placed[a], placed[b], placed[c]);
                let vertex = lanes.add(value, prediction);
                placed[i % 256] = vertex;
                take(i, vertex);
            }
        }
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
        for (value, bits, needs) in
            [(0, 0, 0), (0, 8, 0), (1, 8, 2), (255, 8, 1), (254, 8, 2), (127, 8, 8), (128, 8, 8), (1, 1, 1)]
        {
            assert_eq!(signed_bits(value, bits), needs, "{value} in {bits}");
        }
    }
}
