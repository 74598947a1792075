//! Values of the corners of mesh pages: pages of their own kind, which shading reads and rays do not. Colours have
//! theirs, and normals theirs.
//!
//! ```text
//! disk    = clusters u16 | cluster ... | zeros to the next byte
//! cluster = bits of: triangles - 1, 7 | kind, 2 | vertices - 1, 7, exceptions, 8 (by vertex) | rule of guesses, 3
//!         | Rice parameters, 3 each
//!         | value ... | corner, 9, and value of each exception
//! value   = its channels: each less what it is guessed to be, modulo its bits, small ones of either sign first,
//!           Rice coded
//! frame   = clusters u16 | triangles u16 | cluster: first triangle u16, kind u8, exceptions u8, offset u32 ...
//!         | of each: exceptions, 5 bytes each, and values, 3 bytes each
//! ```
//!
//! A value belongs to a vertex of a cluster, where all corners at that vertex have it but for some exceptions, to a
//! face, or to a corner, whichever takes the fewest bits. Clusters whose corners have no value hold none, and a mesh
//! page without any other has no page of them.
//!
//! Vertices and triangles stand in the order of strips, so values before are those of neighbours (`value_guess`). A
//! guess by the triangles about a vertex, which other codecs make, would be nearer; but then a page could not be read
//! without its mesh, whose clusters are unpacked one by one.
//!
//! Invariants: 1. values come back to the bit; 2. both forms fit a frame; 3. what [`install_values`] accepts, a
//! [`ValueView`] reads without leaving the frame, whatever is asked of it.

use super::bits::{BitStream, BitWriter};
use super::corner_value::CornerValue;
use super::value_guess::{GuessRule, RULE_BITS, ValueGuess, signed, spare_bits};
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES};
use std::marker::PhantomData;

/// Bytes of the disk form before its clusters.
pub(super) const DISK_HEAD_BYTES: usize = 2;
/// Bytes of a frame before its clusters, and of the head of each.
pub(super) const FRAME_HEAD_BYTES: usize = 4;
const CLUSTER_HEAD_BYTES: usize = 8;
/// Bytes of a value, and of an exception, in a frame.
const VALUE_BYTES: usize = 3;
const EXCEPTION_BYTES: usize = 5;
/// Bits of a count of triangles or vertices, less one; of a kind; of a Rice parameter; of a count of exceptions; of the
/// corner of one.
const COUNT_BITS: u32 = 7;
const KIND_BITS: u32 = 2;
const PARAMETER_BITS: u32 = 3;
const EXCEPTION_COUNT_BITS: u32 = 8;
const CORNER_BITS: u32 = 9;
/// Exceptions of a cluster, at most.
const EXCEPTIONS: usize = (1 << EXCEPTION_COUNT_BITS) - 1;
/// The longest run of ones: behind it a number stands in all of its bits.
const ONES_MOST: u32 = 16;
/// The greatest Rice parameter.
const PARAMETER_MOST: u32 = (1 << PARAMETER_BITS) - 1;

const _: () = assert!(CLUSTER_TRIANGLES <= 1 << COUNT_BITS && CLUSTER_VERTICES <= 1 << COUNT_BITS);
const _: () = assert!(3 * CLUSTER_TRIANGLES <= 1 << CORNER_BITS);
const _: () = assert!(ONES_MOST + 16 < 57);

/// What the values of a cluster belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum ValueKind {
    None = 0,
    Vertex = 1,
    Face = 2,
    Corner = 3,
}

impl ValueKind {
    fn from_bits(bits: u64) -> ValueKind {
        [ValueKind::None, ValueKind::Vertex, ValueKind::Face, ValueKind::Corner][bits as usize & 3]
    }
}

/// The values of a cluster as they are stored.
pub(super) struct ClusterValues<V> {
    kind: ValueKind,
    pub(super) triangle_count: usize,
    rule: GuessRule,
    values: Vec<V>,
    /// By corner, three to a triangle, ascending.
    exceptions: Vec<(u16, V)>,
}

impl<V: CornerValue> ClusterValues<V> {
    /// Bits of a value among exceptions.
    const EXCEPTION_BITS: u32 = V::CHANNELS as u32 * V::CHANNEL_BITS;
    /// Bits of a number, at most, under the best parameter: under the greatest one, ones, a zero and its bits.
    const NUMBER_BITS_MOST: usize = ((1 << (V::CHANNEL_BITS - PARAMETER_MOST)) + PARAMETER_MOST) as usize;

    /// The cheapest form of a cluster's values: corners as indices of its vertices, and as many values, or none where
    /// no corner has one.
    pub(super) fn of(
        triangles: &[[u8; 3]],
        vertex_count: usize,
        corner_values: &[[V; 3]],
    ) -> ClusterValues<V> {
        let triangle_count = triangles.len();
        let corners = corner_values.as_flattened();
        let rule = GuessRule::from_bits(0);
        let with =
            |kind, values, exceptions| ClusterValues { kind, triangle_count, rule, values, exceptions };
        if corners.iter().all(|&value| value == V::NONE) {
            return with(ValueKind::None, Vec::new(), Vec::new());
        }
        let mut forms = Vec::with_capacity(3);
        if corner_values.iter().all(|[a, b, c]| a == b && b == c) {
            let faces = corner_values.iter().map(|corners| corners[0]).collect();
            forms.push(with(ValueKind::Face, faces, Vec::new()));
        }
        let mut of_vertex = vec![None; vertex_count];
        let mut exceptions = Vec::new();
        for (corner, (&vertex, &value)) in triangles.as_flattened().iter().zip(corners).enumerate() {
            if *of_vertex[usize::from(vertex)].get_or_insert(value) != value {
                exceptions.push((corner as u16, value));
            }
        }
        // Where vertices say all, corners say it again.
        if !exceptions.is_empty() {
            forms.push(with(ValueKind::Corner, corners.to_vec(), Vec::new()));
        }
        if exceptions.len() <= EXCEPTIONS {
            let values = of_vertex.into_iter().map(|value| value.unwrap_or(V::NONE)).collect();
            forms.push(with(ValueKind::Vertex, values, exceptions));
        }
        let form =
            forms.into_iter().min_by_key(ClusterValues::bit_count).expect("by vertex or corner at least");
        let rule = GuessRule::all::<V>().min_by_key(|&rule| form.coded_bits(rule)).expect("four rules");
        ClusterValues { rule, ..form }
    }

    fn bit_count(&self) -> usize {
        let exceptions = self.exceptions.len() * (CORNER_BITS + Self::EXCEPTION_BITS) as usize;
        self.coded_bits(self.rule) + exceptions
    }

    /// Bits of the values under a rule, as good as behind their own first.
    fn coded_bits(&self, rule: GuessRule) -> usize {
        let numbers = numbers((&self.values, self.values[0]), rule);
        numbers[..V::CHANNELS].iter().map(|channel| best_parameter::<V>(channel).1).sum()
    }

    /// Whether no corner has one.
    pub(super) fn is_none(&self) -> bool {
        self.kind == ValueKind::None
    }

    /// Bytes in a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        CLUSTER_HEAD_BYTES + VALUE_BYTES * self.values.len() + EXCEPTION_BYTES * self.exceptions.len()
    }

    /// Bytes on disk, at most.
    pub(super) fn disk_bytes_most(&self) -> usize {
        let head = 2 * COUNT_BITS + KIND_BITS + EXCEPTION_COUNT_BITS + RULE_BITS + 3 * PARAMETER_BITS;
        let exceptions = self.exceptions.len() * (CORNER_BITS + Self::EXCEPTION_BITS) as usize;
        (head as usize + V::CHANNELS * Self::NUMBER_BITS_MOST * self.values.len() + exceptions).div_ceil(8)
    }

    /// Writes it behind a cluster whose last value is `last`, which becomes its own.
    pub(super) fn write(&self, last: &mut V, out: &mut BitWriter) {
        out.put(self.triangle_count as u64 - 1, COUNT_BITS);
        out.put(self.kind as u64, KIND_BITS);
        if self.kind == ValueKind::None {
            return;
        }
        if self.kind == ValueKind::Vertex {
            out.put(self.values.len() as u64 - 1, COUNT_BITS);
            out.put(self.exceptions.len() as u64, EXCEPTION_COUNT_BITS);
        }
        out.put(self.rule.bits(), RULE_BITS);
        let numbers = numbers((&self.values, *last), self.rule);
        *last = *self.values.last().expect("a value at least");
        let parameters = [0, 1, 2].map(|channel| best_parameter::<V>(&numbers[channel]).0);
        parameters[..V::CHANNELS].iter().for_each(|&p| out.put(u64::from(p), PARAMETER_BITS));
        for value in 0..self.values.len() {
            (0..V::CHANNELS)
                .for_each(|channel| put_number::<V>(numbers[channel][value], parameters[channel], out));
        }
        for &(corner, value) in &self.exceptions {
            let [a, b, c] = value.to_bytes();
            out.put(u64::from(corner), CORNER_BITS);
            out.put(u64::from(u32::from_le_bytes([a, b, c, 0])), Self::EXCEPTION_BITS);
        }
    }
}

/// What is coded of values behind another, by channel.
fn numbers<V: CornerValue>((values, last): (&[V], V), rule: GuessRule) -> [Vec<u16>; 3] {
    let mut numbers =
        [0, 1, 2].map(|channel| Vec::with_capacity(if channel < V::CHANNELS { values.len() } else { 0 }));
    let mut guess = ValueGuess::new(rule, last);
    for value in values {
        let now = value.channels(rule.split());
        for channel in 0..V::CHANNELS {
            numbers[channel].push(zigzag::<V>(now[channel].wrapping_sub(guess.channel::<V>(channel))));
        }
        guess.learn(now);
    }
    numbers
}

fn zigzag<V: CornerValue>(difference: u16) -> u16 {
    let signed = signed::<V>(difference);
    ((signed << 1) ^ (signed >> 15)) as u16 & (u16::MAX >> spare_bits::<V>())
}

fn unzigzag(number: u16) -> u16 {
    (number >> 1) ^ (number & 1).wrapping_neg()
}

/// Bits of a number under a parameter.
fn number_bits<V: CornerValue>(number: u16, parameter: u32) -> usize {
    match u32::from(number) >> parameter {
        ones if ones < ONES_MOST => (ones + 1 + parameter) as usize,
        _ => (ONES_MOST + V::CHANNEL_BITS) as usize,
    }
}

/// The parameter under which numbers take the fewest bits, and how many.
fn best_parameter<V: CornerValue>(numbers: &[u16]) -> (u32, usize) {
    let all = |parameter| numbers.iter().map(|&number| number_bits::<V>(number, parameter)).sum();
    (0..=PARAMETER_MOST).map(|p| (p, all(p))).min_by_key(|&(_, bits)| bits).expect("eight parameters")
}

fn put_number<V: CornerValue>(number: u16, parameter: u32, out: &mut BitWriter) {
    let ones = u32::from(number) >> parameter;
    if ones >= ONES_MOST {
        out.put((1 << ONES_MOST) - 1, ONES_MOST);
        return out.put(u64::from(number), V::CHANNEL_BITS);
    }
    out.put((1 << ones) - 1, ones + 1);
    out.put(u64::from(number) & ((1 << parameter) - 1), parameter);
}

/// A number; one that no encoder wrote may come out modulo the bits of its channel.
fn take_number<V: CornerValue>(input: &mut BitStream<'_>, parameter: u32) -> u16 {
    let ones = (!input.peek()).trailing_zeros().min(ONES_MOST);
    if ones == ONES_MOST {
        input.skip(ONES_MOST);
        return input.take(V::CHANNEL_BITS) as u16;
    }
    input.skip(ones + 1);
    ((ones << parameter) as u64 | input.take(parameter)) as u16 & (u16::MAX >> spare_bits::<V>())
}

const UNSOUND: &str = "a page of colours or normals is not what its counts say";

/// Decodes the disk form of a page of values into `frame`. Gives how many bytes it takes there.
///
/// # Errors
/// What is wrong, in words; the frame's content is then not specified.
pub(crate) fn install_values<V: CornerValue>(bytes: &[u8], frame: &mut [u8]) -> Result<usize, &'static str> {
    let mut input = BitStream::new(bytes);
    let (mut triangle, cluster_count, mut last) = (0, input.take(16) as usize, V::NONE);
    let mut at = FRAME_HEAD_BYTES + CLUSTER_HEAD_BYTES * cluster_count;
    if cluster_count == 0 || at > frame.len() {
        return Err(UNSOUND);
    }
    for cluster in 0..cluster_count {
        let triangle_count = input.take(COUNT_BITS) as usize + 1;
        let kind = ValueKind::from_bits(input.take(KIND_BITS));
        let count = match kind {
            ValueKind::None => 0,
            ValueKind::Vertex => input.take(COUNT_BITS) as usize + 1,
            ValueKind::Face => triangle_count,
            ValueKind::Corner => 3 * triangle_count,
        };
        let exception_count = match kind {
            ValueKind::Vertex => input.take(EXCEPTION_COUNT_BITS) as usize,
            _ => 0,
        };
        let offset = at;
        at += EXCEPTION_BYTES * exception_count + VALUE_BYTES * count;
        let room = frame.get_mut(offset..at).ok_or(UNSOUND)?;
        let (exceptions, values) = room.split_at_mut(EXCEPTION_BYTES * exception_count);
        if kind != ValueKind::None {
            last = take_values(&mut input, last, values.as_chunks_mut().0);
        }
        for exception in exceptions.as_chunks_mut::<EXCEPTION_BYTES>().0 {
            let corner = (input.take(CORNER_BITS) as u16).to_le_bytes();
            let [a, b, c, _] = (input.take(ClusterValues::<V>::EXCEPTION_BITS) as u32).to_le_bytes();
            *exception = [corner[0], corner[1], a, b, c];
        }
        if !input.is_sound() || triangle > usize::from(u16::MAX) {
            return Err(UNSOUND);
        }
        let head = &mut frame[FRAME_HEAD_BYTES + CLUSTER_HEAD_BYTES * cluster..][..CLUSTER_HEAD_BYTES];
        head[..2].copy_from_slice(&(triangle as u16).to_le_bytes());
        (head[2], head[3]) = (kind as u8, exception_count as u8);
        head[4..].copy_from_slice(&(offset as u32).to_le_bytes());
        triangle += triangle_count;
    }
    let triangle_count = triangle.min(usize::from(u16::MAX)) as u16;
    frame[..2].copy_from_slice(&(cluster_count as u16).to_le_bytes());
    frame[2..FRAME_HEAD_BYTES].copy_from_slice(&triangle_count.to_le_bytes());
    if input.is_whole() { Ok(at) } else { Err(UNSOUND) }
}

/// Values of a cluster behind another whose last value is `last`. Gives their own last.
fn take_values<V: CornerValue>(
    input: &mut BitStream<'_>,
    mut last: V,
    values: &mut [[u8; VALUE_BYTES]],
) -> V {
    let rule = GuessRule::from_bits(input.take(RULE_BITS));
    let parameters: [u32; 3] = std::array::from_fn(|channel| match channel < V::CHANNELS {
        true => input.take(PARAMETER_BITS) as u32,
        false => 0,
    });
    let mut guess = ValueGuess::new(rule, last);
    for value in values {
        let mut now = [0; 3];
        for channel in 0..V::CHANNELS {
            let number = unzigzag(take_number::<V>(input, parameters[channel]));
            now[channel] = guess.channel::<V>(channel).wrapping_add(number);
        }
        guess.learn(now);
        last = V::from_channels(now, rule.split());
        *value = last.to_bytes();
    }
    last
}

/// A frame that a page of values was decoded into.
#[derive(Clone, Copy)]
pub struct ValueView<'a, V> {
    bytes: &'a [u8],
    value: PhantomData<V>,
}

impl<'a, V: CornerValue> ValueView<'a, V> {
    /// A view of such a frame.
    pub fn new(bytes: &'a [u8]) -> ValueView<'a, V> {
        ValueView { bytes, value: PhantomData }
    }

    /// The values of the corners of a triangle, given by its index from the first that the page is of on, and the
    /// indices of its vertices within its cluster. What the page does not have is none.
    pub fn values(&self, triangle: usize, vertices: [usize; 3]) -> [V; 3] {
        let [count, triangle_count] =
            [0, 2].map(|at| usize::from(u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]])));
        let heads = &self.bytes[FRAME_HEAD_BYTES..][..CLUSTER_HEAD_BYTES * count];
        let heads = heads.as_chunks::<CLUSTER_HEAD_BYTES>().0;
        let first = |head: &[u8; CLUSTER_HEAD_BYTES]| usize::from(u16::from_le_bytes([head[0], head[1]]));
        // Clusters have about as many triangles each; the first begins at 0.
        let mut at = (triangle * count / triangle_count).min(count - 1);
        while first(&heads[at]) > triangle {
            at -= 1;
        }
        while at + 1 < count && first(&heads[at + 1]) <= triangle {
            at += 1;
        }
        let head = &heads[at];
        let offset = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let (exceptions, values) = self.bytes[offset..].split_at(EXCEPTION_BYTES * usize::from(head[3]));
        let value = |index: usize| {
            let value = values.get(VALUE_BYTES * index..VALUE_BYTES * (index + 1));
            value.map_or(V::NONE, |value| V::from_bytes([value[0], value[1], value[2]]))
        };
        let local = triangle - first(head);
        match ValueKind::from_bits(u64::from(head[2])) {
            ValueKind::None => [V::NONE; 3],
            ValueKind::Face => [value(local); 3],
            ValueKind::Corner => [0, 1, 2].map(|corner| value(3 * local + corner)),
            ValueKind::Vertex => {
                let mut of_corners = vertices.map(value);
                for &[lo, hi, a, b, c] in exceptions.as_chunks::<EXCEPTION_BYTES>().0 {
                    let corner = usize::from(u16::from_le_bytes([lo, hi])).wrapping_sub(3 * local);
                    if let Some(of_corner) = of_corners.get_mut(corner) {
                        *of_corner = V::from_bytes([a, b, c]);
                    }
                }
                of_corners
            }
        }
    }
}
