//! Topology of a cluster: strips of one to eight triangles, decoded a strip at a time.
//!
//! ```text
//!        x            A triangle (a, b, x) hangs on the edge a -> b and opens two: x -> b, then a -> x. Each triangle
//!      /   \          of a strip hangs on one that the triangle before it opened: its *turn* is 0 or 1. The first
//! --- a --> b ---     hangs on the strip's *gate*, an edge that any earlier triangle opened; or the strip is *free*
//!      \   /          and names its first edge. A corner x is new, the next number, or known and named.
//!     opposite
//!
//! strip = triangles - 1, 3 | turns, 1 each but the first | new, 1 each | gate | a, b of a free one | names of known x
//! gate  = 2 * triangles between + turn, in as many bits as the count t of triangles before needs; 2 t: free
//! ```
//!
//! Why strips: eight corners x come from two words without a loop (`pdep` puts names in their bytes, a product counts
//! new ones), and all a and b are these same bytes, in an order that the turns choose from a table of 128. A code that
//! tells each triangle by itself, on any gate and beside a rim that it keeps, took 0.6 to 1.2 bits less (files of the
//! iso-surface 4 %, the plant 6 %, the scan 8 %, a circuit board 3 % smaller), and all of install half as long again:
//! what a triangle is waited for the one before it. Strips have 5.1, 5.2, 6.0 and 5.4 triangles there.
//!
//! Invariants: 1. encoder and decoder know the same corners and guides; 2. vertices are numbered in the order of
//! first use; 3. what `decode` accepts holds corners below the count of vertices, and a guide for each of them; those
//! that no encoder wrote may guide to a vertex behind their own.

use super::bits::{BYTES_OF_ONE, BitReader, BitWriter, bits_of};
use super::fields::Mover;
use super::finish::Guides;
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES, LEAF_TRIANGLES};

// One more than the last vertex, and two of a free strip, are bytes.
const _: () = assert!(CLUSTER_VERTICES + 2 <= u8::MAX as usize);

/// Triangles of a strip, at most: the bytes of a word.
pub(super) const STRIP_TRIANGLES: usize = 8;
const STRIP_LENGTH_BITS: u32 = 3;
const _: () = assert!(STRIP_TRIANGLES == 1 << STRIP_LENGTH_BITS && STRIP_TRIANGLES == LEAF_TRIANGLES);

/// Corners of a cluster's triangles, `[corner][triangle]`; eight from any of them on can be read.
pub(super) type Corners = [[u8; CLUSTER_TRIANGLES + STRIP_TRIANGLES]; 3];

/// What is known of a cluster behind its topology.
pub(super) struct Topology {
    pub(super) corners: Corners,
    pub(super) guides: Guides,
    /// 1 for each triangle that is the first of a strip, 0 for others. Behind the last it means nothing.
    pub(super) starts: [u8; CLUSTER_TRIANGLES + STRIP_TRIANGLES],
}

impl Topology {
    pub(super) const EMPTY: Topology = Topology {
        corners: [[0; CLUSTER_TRIANGLES + STRIP_TRIANGLES]; 3],
        guides: [[0; 256 + STRIP_TRIANGLES]; 3],
        starts: [0; CLUSTER_TRIANGLES + STRIP_TRIANGLES],
    };
}

/// Guides of the first two corners of a free strip behind `vertex_count` vertices; gives how many there are then.
fn guide_free(guides: &mut Guides, mut vertex_count: usize, ab: [u8; 2]) -> usize {
    let mut near = vertex_count.saturating_sub(1) as u8;
    for v in ab {
        if usize::from(v) == vertex_count {
            guides.iter_mut().for_each(|guide| guide[vertex_count] = near);
            vertex_count += 1;
        }
        near = v;
    }
    vertex_count
}

/// Bits of a gate behind `triangle_count` triangles: 0 to twice as many.
#[inline(always)]
fn gate_bits(triangle_count: usize) -> u32 {
    u32::from(bits_of(2 * triangle_count as u64))
}

/// Bits of a corner of a free strip's first edge: known, or the next one.
fn edge_bits(vertex_count: usize) -> u32 {
    u32::from(bits_of(vertex_count as u64))
}

/// Bits of a name, behind whose strip there are so many vertices.
#[inline(always)]
fn name_bits(vertex_count: usize) -> u32 {
    u32::from(bits_of(vertex_count as u64 - 1))
}

/// The turn by which triangle `next` hangs on the one before it.
pub(super) fn turn([a, b, x]: [u8; 3], next: [u8; 3]) -> Option<u8> {
    match (next[0], next[1]) {
        edge if edge == (x, b) => Some(0),
        edge if edge == (a, x) => Some(1),
        _ => None,
    }
}

/// A strip to be written.
struct Strip {
    first: usize,
    count: usize,
    turns: u64,
    /// Its number; none: free.
    gate: Option<usize>,
    /// Vertices before it.
    before: usize,
    /// Bit i: the third corner of its triangle i is new.
    new: u64,
}

impl Strip {
    /// The longest strip from `first` on, which is not behind the last triangle, on the gate with the least number.
    fn longest(triangles: &[[u8; 3]], first: usize, before: usize) -> Strip {
        let rest = &triangles[first..];
        let pairs = rest.windows(2).take(STRIP_TRIANGLES - 1);
        let turns: Vec<u8> = pairs.map_while(|pair| turn(pair[0], pair[1])).collect();
        let count = 1 + turns.len();
        let opened = |ago: usize| {
            let [a, b, x] = triangles[first - 1 - ago / 2];
            if ago.is_multiple_of(2) { (x, b) } else { (a, x) }
        };
        let gate = (0..2 * first).find(|&ago| opened(ago) == (rest[0][0], rest[0][1]));
        let turns = turns.iter().enumerate().map(|(i, &turn)| u64::from(turn) << i).sum();
        let mut strip = Strip { first, count, turns, gate, before, new: 0 };
        let mut next = before;
        if gate.is_none() {
            rest[0][..2].iter().for_each(|&v| next += usize::from(usize::from(v) == next));
        }
        for (i, &[a, b, x]) in rest[..count].iter().enumerate() {
            let is_new = usize::from(x) == next;
            strip.new |= u64::from(is_new) << i;
            next += usize::from(is_new);
            let in_order = [a, b, x].iter().all(|&v| usize::from(v) < next);
            assert!(in_order, "vertices do not stand in the order of first use");
        }
        strip
    }

    /// Writes the strip and its guides; gives how many vertices there are behind it.
    fn write(&self, triangles: &[[u8; 3]], out: &mut BitWriter, guides: &mut Guides) -> usize {
        let strip = &triangles[self.first..self.first + self.count];
        let count = self.count as u32;
        out.put(u64::from(count) - 1, STRIP_LENGTH_BITS);
        out.put(self.turns, count - 1);
        out.put(self.new, count);
        out.put(self.gate.unwrap_or(2 * self.first) as u64, gate_bits(self.first));
        let mut next = self.before;
        if self.gate.is_none() {
            let ab = [strip[0][0], strip[0][1]];
            for v in ab {
                out.put(u64::from(v), edge_bits(next));
                next += usize::from(usize::from(v) == next);
            }
            guide_free(guides, self.before, ab);
        }
        let after = next + self.new.count_ones() as usize;
        let mut opposite = match self.gate {
            Some(ago) => triangles[self.first - 1 - ago / 2][ago % 2],
            None => strip[0][0],
        };
        for (i, &[a, b, x]) in strip.iter().enumerate() {
            if i > 0 {
                opposite = strip[i - 1][(self.turns >> (i - 1) & 1) as usize];
            }
            if self.new >> i & 1 == 1 {
                for (guide, v) in guides.iter_mut().zip([a, b, opposite]) {
                    guide[next] = v;
                }
                next += 1;
            } else {
                out.put(u64::from(x), name_bits(after));
            }
        }
        after
    }
}

/// Writes the triangles; gives what vertices are predicted from, and their count.
pub(super) fn encode(triangles: &[[u8; 3]], out: &mut BitWriter) -> (Guides, usize) {
    let mut guides = Topology::EMPTY.guides;
    let (mut first, mut vertex_count) = (0, 0);
    while first < triangles.len() {
        let strip = Strip::longest(triangles, first, vertex_count);
        vertex_count = strip.write(triangles, out, &mut guides);
        first += strip.count;
    }
    (guides, vertex_count)
}

/// Bits that the triangles take.
pub(super) fn bit_count(triangles: &[[u8; 3]]) -> u32 {
    let mut out = BitWriter::default();
    encode(triangles, &mut out);
    out.bit_count() as u32
}

const UNSOUND: &str = "the triangles of a cluster are not what its counts say";

/// Reads `triangle_count` triangles over `vertex_count` vertices, neither more than a cluster has.
#[inline(always)]
pub(super) fn decode<M: Mover>(
    mover: M,
    input: &mut BitReader<'_>,
    (triangle_count, vertex_count): (usize, usize),
    topology: &mut Topology,
) -> Result<(), &'static str> {
    // In registers, since nothing else knows it.
    let mut reader = *input;
    let (mut first, mut next) = (0, 0);
    while first < triangle_count {
        let word = reader.peek();
        let count = word as usize % STRIP_TRIANGLES + 1;
        let turns = (word >> STRIP_LENGTH_BITS) as usize % (1 << (STRIP_TRIANGLES - 1));
        let new =
            (word >> (STRIP_LENGTH_BITS as usize + count - 1)) as u8 & (u8::MAX >> (STRIP_TRIANGLES - count));
        let (head_bits, gate_bits) = (STRIP_LENGTH_BITS as usize + 2 * count - 1, gate_bits(first));
        let ago = (word >> head_bits) as usize & !(usize::MAX << gate_bits);
        reader.skip(head_bits + gate_bits as usize);
        let gate = if ago < 2 * first {
            let [a, b, x] = [0, 1, 2].map(|c| topology.corners[c][(first - 1 - ago / 2) % CLUSTER_TRIANGLES]);
            let [from, to, opposite] = if ago.is_multiple_of(2) { [x, b, a] } else { [a, x, b] };
            u32::from(from) | u32::from(to) << 8 | u32::from(opposite) << 16
        } else {
            let (gate, behind) = free(&mut reader, topology, next, ago == 2 * first)?;
            next = behind;
            gate
        };
        let after = next + new.count_ones() as usize;
        if after > vertex_count {
            return Err(UNSOUND);
        }
        let (is_new, is_known) = (mover.ones(new), mover.ones(!new & (u8::MAX >> (STRIP_TRIANGLES - count))));
        // Byte i of the product: the new ones up to i. Where one is new it is at least 1, so that no byte borrows.
        let numbers = is_new.wrapping_mul(BYTES_OF_ONE) + next as u64 * BYTES_OF_ONE;
        let numbers = (numbers & (is_new * 0xff)) - is_new;
        let name_bits = name_bits(after);
        let x = numbers | mover.deposit(reader.peek(), is_known, name_bits);
        reader.skip(name_bits as usize * (count - new.count_ones() as usize));
        let [a, b, opposite] = mover.follow(x, gate, turns);
        for (corner, eight) in topology.corners.iter_mut().zip([a, b, x]) {
            corner[first % CLUSTER_TRIANGLES..][..8].copy_from_slice(&eight.to_le_bytes());
        }
        for (guide, eight) in topology.guides.iter_mut().zip([a, b, opposite]) {
            guide[next % 256..][..8].copy_from_slice(&mover.extract(eight, is_new).to_le_bytes());
        }
        // One, and zeros, of which the next strip takes what is its own.
        topology.starts[first % CLUSTER_TRIANGLES..][..8].copy_from_slice(&1u64.to_le_bytes());
        first += count;
        next = after;
    }
    *input = reader;
    let greatest =
        topology.corners[2][..triangle_count.min(CLUSTER_TRIANGLES)].iter().fold(0, |all: u8, &x| all.max(x));
    if first != triangle_count || next != vertex_count || usize::from(greatest) >= vertex_count {
        return Err(UNSOUND);
    }
    Ok(())
}

/// The gate of a free strip, and how many vertices there are behind its first edge.
#[cold]
fn free(
    reader: &mut BitReader<'_>,
    topology: &mut Topology,
    before: usize,
    is_free: bool,
) -> Result<(u32, usize), &'static str> {
    let a = reader.take(edge_bits(before)) as usize;
    let between = before + usize::from(a == before);
    let b = reader.take(edge_bits(between)) as usize;
    if !is_free || a > before || b > between {
        return Err(UNSOUND);
    }
    let (a, b) = (a as u8, b as u8);
    let after = guide_free(&mut topology.guides, before, [a, b]);
    // A new third corner is predicted as its neighbour b: a + b - a.
    Ok((u32::from(a) | u32::from(b) << 8 | u32::from(a) << 16, after))
}
