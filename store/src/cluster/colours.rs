//! Colours of the triangles of mesh pages: pages of their own kind, which shading reads and rays do not.
//!
//! ```text
//! disk    = clusters u16 | cluster ... | zeros to the next byte
//! cluster = bits of: triangles - 1, 7 | kind, 2 | vertices - 1, 7, exceptions, 8 (by vertex) | Rice parameters 3 x 3
//!         | value ... | corner, 9, and colour, 24, of each exception
//! value   = green, red - green, blue - green: each less that of the value before, modulo 256, small ones of either
//!           sign first, Rice coded
//! frame   = clusters u32 | cluster: first triangle u16, kind u8, exceptions u8, offset u32 ...
//!         | of each: exceptions, 5 bytes each, and values, 3 bytes each
//! ```
//!
//! A colour is three bytes, sRGB. It belongs to a vertex of a cluster, where all corners at that vertex have it but for
//! some exceptions, to a face, or to a corner, whichever takes the fewest bits. Clusters all of whose colours are white
//! hold none, and a mesh page without any other has no page of colours.
//!
//! Vertices and triangles stand in the order of strips, so the value before is that of a neighbour.
//!
//! Invariants: 1. colours come back to the bit; 2. both forms fit a frame; 3. what [`install_colours`] accepts, a
//! [`ColourView`] reads without leaving the frame, whatever is asked of it.

use super::ClusterMesh;
use super::bits::{BitStream, BitWriter};
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES};

/// Red, green, blue.
pub type Colour = [u8; 3];
/// The colour of what has none: a material's colour times white is the material's.
pub const WHITE: Colour = [255; 3];

/// Bytes of the disk form before its clusters.
pub(super) const DISK_HEAD_BYTES: usize = 2;
/// Bytes of a frame before its clusters, and of the head of each.
pub(super) const FRAME_HEAD_BYTES: usize = 4;
const CLUSTER_HEAD_BYTES: usize = 8;
/// Bytes of a colour, and of an exception, in a frame.
const COLOUR_BYTES: usize = 3;
const EXCEPTION_BYTES: usize = 5;
/// Bits of a count of triangles or vertices, less one; of a kind; of a Rice parameter; of a count of exceptions; of the
/// corner of one, and of its colour.
const COUNT_BITS: u32 = 7;
const KIND_BITS: u32 = 2;
const PARAMETER_BITS: u32 = 3;
const EXCEPTION_COUNT_BITS: u32 = 8;
const CORNER_BITS: u32 = 9;
const COLOUR_BITS: u32 = 24;
/// Exceptions of a cluster, at most.
const EXCEPTIONS: usize = (1 << EXCEPTION_COUNT_BITS) - 1;
/// The longest run of ones: behind it a number stands in eight bits.
const ONES_MOST: u32 = 16;
/// Bits of a number, at most, under the best parameter: under the greatest one, a one, a zero and seven bits.
const NUMBER_BITS_MOST: usize = 9;

const _: () = assert!(CLUSTER_TRIANGLES <= 1 << COUNT_BITS && CLUSTER_VERTICES <= 1 << COUNT_BITS);
const _: () = assert!(3 * CLUSTER_TRIANGLES <= 1 << CORNER_BITS);
const _: () = assert!(ONES_MOST + 8 < 57);

/// What the colours of a cluster belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum ColourKind {
    None = 0,
    Vertex = 1,
    Face = 2,
    Corner = 3,
}

impl ColourKind {
    fn from_bits(bits: u64) -> ColourKind {
        [ColourKind::None, ColourKind::Vertex, ColourKind::Face, ColourKind::Corner][bits as usize & 3]
    }
}

/// The colours of a cluster as they are stored.
pub(super) struct ClusterColours {
    kind: ColourKind,
    pub(super) triangle_count: usize,
    values: Vec<Colour>,
    /// By corner, three to a triangle, ascending.
    exceptions: Vec<(u16, Colour)>,
}

impl ClusterColours {
    /// The cheapest form of a cluster's colours.
    pub(super) fn of(cluster: &ClusterMesh) -> ClusterColours {
        let (triangle_count, none) = (cluster.triangles.len(), ColourKind::None);
        let corners = cluster.colours.as_flattened();
        if corners.iter().all(|&colour| colour == WHITE) {
            return ClusterColours { kind: none, triangle_count, values: Vec::new(), exceptions: Vec::new() };
        }
        let with = |kind, values, exceptions| ClusterColours { kind, triangle_count, values, exceptions };
        let mut forms = vec![with(ColourKind::Corner, corners.to_vec(), Vec::new())];
        if cluster.colours.iter().all(|[a, b, c]| a == b && b == c) {
            let faces = cluster.colours.iter().map(|corners| corners[0]).collect();
            forms.push(with(ColourKind::Face, faces, Vec::new()));
        }
        let mut of_vertex = vec![None; cluster.vertices.len()];
        let mut exceptions = Vec::new();
        for (corner, (&vertex, &colour)) in cluster.triangles.as_flattened().iter().zip(corners).enumerate() {
            if *of_vertex[usize::from(vertex)].get_or_insert(colour) != colour {
                exceptions.push((corner as u16, colour));
            }
        }
        if exceptions.len() <= EXCEPTIONS {
            let values = of_vertex.into_iter().map(|colour| colour.unwrap_or(WHITE)).collect();
            forms.push(with(ColourKind::Vertex, values, exceptions));
        }
        forms.into_iter().min_by_key(ClusterColours::bit_count).expect("by corner at least")
    }

    fn bit_count(&self) -> usize {
        let numbers = numbers(&self.values);
        let coded: usize = numbers.iter().map(|channel| best_parameter(channel).1).sum();
        coded + self.exceptions.len() * (CORNER_BITS + COLOUR_BITS) as usize
    }

    /// Whether all of them are white.
    pub(super) fn is_white(&self) -> bool {
        self.kind == ColourKind::None
    }

    /// Bytes in a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        CLUSTER_HEAD_BYTES + COLOUR_BYTES * self.values.len() + EXCEPTION_BYTES * self.exceptions.len()
    }

    /// Bytes on disk, at most.
    pub(super) fn disk_bytes_most(&self) -> usize {
        let head = 2 * COUNT_BITS + KIND_BITS + 3 * PARAMETER_BITS + EXCEPTION_COUNT_BITS;
        let exceptions = self.exceptions.len() * (CORNER_BITS + COLOUR_BITS) as usize;
        (head as usize + 3 * NUMBER_BITS_MOST * self.values.len() + exceptions).div_ceil(8)
    }

    pub(super) fn write(&self, out: &mut BitWriter) {
        out.put(self.triangle_count as u64 - 1, COUNT_BITS);
        out.put(self.kind as u64, KIND_BITS);
        if self.kind == ColourKind::None {
            return;
        }
        if self.kind == ColourKind::Vertex {
            out.put(self.values.len() as u64 - 1, COUNT_BITS);
            out.put(self.exceptions.len() as u64, EXCEPTION_COUNT_BITS);
        }
        let numbers = numbers(&self.values);
        let parameters = [0, 1, 2].map(|channel| best_parameter(&numbers[channel]).0);
        parameters.iter().for_each(|&parameter| out.put(u64::from(parameter), PARAMETER_BITS));
        for value in 0..self.values.len() {
            (0..3).for_each(|channel| put_number(numbers[channel][value], parameters[channel], out));
        }
        for &(corner, [r, g, b]) in &self.exceptions {
            out.put(u64::from(corner), CORNER_BITS);
            out.put(u64::from(u32::from_le_bytes([r, g, b, 0])), COLOUR_BITS);
        }
    }
}

/// What is coded of colours, by channel.
fn numbers(values: &[Colour]) -> [Vec<u8>; 3] {
    let mut before = [0; 3];
    let mut numbers = [0, 1, 2].map(|_| Vec::with_capacity(values.len()));
    for &[r, g, b] in values {
        let now = [g, r.wrapping_sub(g), b.wrapping_sub(g)];
        for channel in 0..3 {
            numbers[channel].push(zigzag(now[channel].wrapping_sub(before[channel])));
        }
        before = now;
    }
    numbers
}

fn zigzag(difference: u8) -> u8 {
    (difference << 1) ^ ((difference as i8) >> 7) as u8
}

fn unzigzag(number: u8) -> u8 {
    (number >> 1) ^ (number & 1).wrapping_neg()
}

/// Bits of a number under a parameter.
fn number_bits(number: u8, parameter: u32) -> usize {
    match u32::from(number) >> parameter {
        ones if ones < ONES_MOST => (ones + 1 + parameter) as usize,
        _ => ONES_MOST as usize + 8,
    }
}

/// The parameter under which numbers take the fewest bits, and how many.
fn best_parameter(numbers: &[u8]) -> (u32, usize) {
    let all = |parameter| numbers.iter().map(|&number| number_bits(number, parameter)).sum();
    (0..1 << PARAMETER_BITS).map(|p| (p, all(p))).min_by_key(|&(_, bits)| bits).expect("eight parameters")
}

fn put_number(number: u8, parameter: u32, out: &mut BitWriter) {
    let ones = u32::from(number) >> parameter;
    if ones >= ONES_MOST {
        out.put((1 << ONES_MOST) - 1, ONES_MOST);
        return out.put(u64::from(number), 8);
    }
    out.put((1 << ones) - 1, ones + 1);
    out.put(u64::from(number) & ((1 << parameter) - 1), parameter);
}

/// A number; one that no encoder wrote may come out modulo 256.
fn take_number(input: &mut BitStream<'_>, parameter: u32) -> u8 {
    let ones = (!input.peek()).trailing_zeros().min(ONES_MOST);
    if ones == ONES_MOST {
        input.skip(ONES_MOST);
        return input.take(8) as u8;
    }
    input.skip(ones + 1);
    ((ones << parameter) as u64 | input.take(parameter)) as u8
}

const UNSOUND: &str = "a page of colours is not what its counts say";

/// Decodes the disk form of a page of colours into `frame`.
///
/// # Errors
/// What is wrong, in words; the frame's content is then not specified.
pub(crate) fn install_colours(bytes: &[u8], frame: &mut [u8]) -> Result<(), &'static str> {
    let mut input = BitStream::new(bytes);
    let (mut triangle, cluster_count) = (0, input.take(16) as usize);
    let mut at = FRAME_HEAD_BYTES + CLUSTER_HEAD_BYTES * cluster_count;
    if cluster_count == 0 || at > frame.len() {
        return Err(UNSOUND);
    }
    frame[..FRAME_HEAD_BYTES].copy_from_slice(&(cluster_count as u32).to_le_bytes());
    for cluster in 0..cluster_count {
        let triangle_count = input.take(COUNT_BITS) as usize + 1;
        let kind = ColourKind::from_bits(input.take(KIND_BITS));
        let count = match kind {
            ColourKind::None => 0,
            ColourKind::Vertex => input.take(COUNT_BITS) as usize + 1,
            ColourKind::Face => triangle_count,
            ColourKind::Corner => 3 * triangle_count,
        };
        let exception_count = match kind {
            ColourKind::Vertex => input.take(EXCEPTION_COUNT_BITS) as usize,
            _ => 0,
        };
        let offset = at;
        at += EXCEPTION_BYTES * exception_count + COLOUR_BYTES * count;
        let room = frame.get_mut(offset..at).ok_or(UNSOUND)?;
        let (exceptions, values) = room.split_at_mut(EXCEPTION_BYTES * exception_count);
        if kind != ColourKind::None {
            take_values(&mut input, values.as_chunks_mut().0);
        }
        for exception in exceptions.as_chunks_mut::<EXCEPTION_BYTES>().0 {
            let corner = (input.take(CORNER_BITS) as u16).to_le_bytes();
            let [r, g, b, _] = (input.take(COLOUR_BITS) as u32).to_le_bytes();
            *exception = [corner[0], corner[1], r, g, b];
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
    if input.is_whole() { Ok(()) } else { Err(UNSOUND) }
}

fn take_values(input: &mut BitStream<'_>, values: &mut [Colour]) {
    let parameters = [0, 1, 2].map(|_| input.take(PARAMETER_BITS) as u32);
    let mut now = [0u8; 3];
    for value in values {
        for channel in 0..3 {
            now[channel] = now[channel].wrapping_add(unzigzag(take_number(input, parameters[channel])));
        }
        let [g, r, b] = now;
        *value = [r.wrapping_add(g), g, b.wrapping_add(g)];
    }
}

/// A frame that a page of colours was decoded into.
#[derive(Clone, Copy)]
pub struct ColourView<'a> {
    bytes: &'a [u8],
}

impl<'a> ColourView<'a> {
    /// A view of such a frame.
    pub fn new(bytes: &'a [u8]) -> ColourView<'a> {
        ColourView { bytes }
    }

    /// The colours of the corners of a triangle, given by its index from the first that the page is of on, and the
    /// indices of its vertices within its cluster. What the page does not have is white.
    pub fn colours(&self, triangle: usize, vertices: [usize; 3]) -> [Colour; 3] {
        let count = u32::from_le_bytes(self.bytes[..4].try_into().expect("four bytes")) as usize;
        let heads = &self.bytes[FRAME_HEAD_BYTES..][..CLUSTER_HEAD_BYTES * count];
        let heads = heads.as_chunks::<CLUSTER_HEAD_BYTES>().0;
        let first = |head: &[u8; CLUSTER_HEAD_BYTES]| usize::from(u16::from_le_bytes([head[0], head[1]]));
        let Some(at) = heads.partition_point(|head| first(head) <= triangle).checked_sub(1) else {
            return [WHITE; 3];
        };
        let head = &heads[at];
        let offset = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let (exceptions, values) = self.bytes[offset..].split_at(EXCEPTION_BYTES * usize::from(head[3]));
        let value = |index: usize| {
            let value = values.get(COLOUR_BYTES * index..COLOUR_BYTES * (index + 1));
            value.map_or(WHITE, |value| [value[0], value[1], value[2]])
        };
        let local = triangle - first(head);
        match ColourKind::from_bits(u64::from(head[2])) {
            ColourKind::None => [WHITE; 3],
            ColourKind::Face => [value(local); 3],
            ColourKind::Corner => [0, 1, 2].map(|corner| value(3 * local + corner)),
            ColourKind::Vertex => {
                let mut colours = vertices.map(value);
                for &[lo, hi, r, g, b] in exceptions.as_chunks::<EXCEPTION_BYTES>().0 {
                    let corner = usize::from(u16::from_le_bytes([lo, hi])).wrapping_sub(3 * local);
                    if let Some(colour) = colours.get_mut(corner) {
                        *colour = [r, g, b];
                    }
                }
                colours
            }
        }
    }
}
