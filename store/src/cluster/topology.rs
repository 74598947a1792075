//! Topology of a cluster, triangle by triangle: each hangs on an edge of an earlier one where it can.
//!
//! ```text
//!        x            A triangle (a, b, x) crosses the gate a -> b, whose earlier triangle has its third corner at
//!      /   \          `opposite`. It pushes two gates: x -> b, then a -> x. A free triangle (a, b, c) pushes four, as
//! --- a --> b ---     gates come in pairs: b -> a twice, a -> c, c -> b. The rim is what lies open: `behind` a vertex
//!      \   /          and `before` it. A new vertex is inserted between a and b; where x lies behind b or before a
//!     opposite        already, the triangle fills the notch. Where surfaces are no manifolds the rim is a guess, and
//!                     the corner is named.
//! ```
//!
//! Bits a triangle, `gen:isosurface:20M` / the Stanford dragon / `gen:pipes:20M` (entropies where not ours):
//!
//! | this | 5.3 | 5.1 | 4.5 |
//! | no rim: corners that are known by their rank of last use; 16 gates | 6.6 | 6.5 | 5.4 |
//! | no rim, leaves in their order | 6.7 | 6.6 | 5.7 |
//! | rim, 8 gates / 32 gates that a symbol tells | 5.5 / 5.0 | 5.3 / 4.9 | 4.4 / 4.1 |
//! | 7-bit corners | 21 | 21 | 21 |
//!
//! After Touma and Gotsman, "Triangle mesh compression", 1998, and the edge queue of meshoptimizer's index codec;
//! the order of triangles is ours to choose within leaves only (see `order.rs`), so the gate is named each time.
//!
//! Invariants: 1. encoder and decoder make the same `Walk`; 2. vertices are numbered in the order of first use;
//! 3. what `decode` accepts holds corners below the count of vertices, and a guide for each of them; those that no
//! encoder wrote may guide to a vertex behind their own.

use super::bits::{BitReader, BitWriter};
use super::code::{Entry, FREE, LENGTHS, NAME_BITS, NAME_MASK, WORDS, apex, gate_class};
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES, LEAF_TRIANGLES};

/// Room for gates: four a triangle, and a power of two so that a masked index needs no check.
const GATES_MOST: usize = 512;
const _: () = assert!(4 * CLUSTER_TRIANGLES <= GATES_MOST && GATES_MOST.is_power_of_two());

/// A directed edge that the next triangle may cross, and the corner on its other side: from, to, opposite, one byte
/// each from the lowest on. One word, since the decoder moves it whole.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Gate(u32);

impl Gate {
    fn new(from: u8, to: u8, opposite: u8) -> Gate {
        Gate(u32::from(from) | u32::from(to) << 8 | u32::from(opposite) << 16)
    }

    pub(super) fn from(self) -> u8 {
        self.0 as u8
    }

    pub(super) fn to(self) -> u8 {
        (self.0 >> 8) as u8
    }

    pub(super) fn opposite(self) -> u8 {
        (self.0 >> 16) as u8
    }
}

/// How many gates and vertices there are so far. Apart from the tables, so that the decoder keeps it in registers.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    pub(super) gates: usize,
    pub(super) vertices: usize,
}

impl Counts {
    /// Behind a free triangle of which bit `c` says that corner `c` was known.
    fn with_free(self, known: u64) -> Counts {
        Counts { gates: self.gates + 4, vertices: self.vertices + 3 - known.count_ones() as usize }
    }
}

/// What both sides know after each triangle.
pub(super) struct Walk {
    pub(super) counts: Counts,
    tables: Tables,
}

struct Tables {
    gates: [[Gate; 2]; GATES_MOST / 2],
    /// Neighbours on the rim, by vertex. 256 of each, so that a byte needs no check.
    behind: [u8; 256],
    before: [u8; 256],
    /// By vertex: the gate across which it was met, from which it is predicted. All three vertices are the same
    /// where there was no gate.
    guides: [Gate; 256],
    corners: Corners,
}

/// Corners of a cluster's triangles, `[corner][triangle]`; eight from any of them on can be read.
pub(super) type Corners = [[u8; CLUSTER_TRIANGLES + LEAF_TRIANGLES]; 3];

/// How a triangle is told: across a gate, or on its own.
#[derive(Clone, Copy)]
pub(super) enum Step {
    Across { ago: usize, apex: u8 },
    Free,
}

impl Tables {
    const EMPTY: Tables = Tables {
        gates: [[Gate(0); 2]; GATES_MOST / 2],
        behind: [0; 256],
        before: [0; 256],
        guides: [Gate(0); 256],
        corners: [[0; CLUSTER_TRIANGLES + LEAF_TRIANGLES]; 3],
    };

    /// The gate pushed `ago` pushes ago.
    #[inline(always)]
    fn gate(&self, counts: Counts, ago: usize) -> Gate {
        self.gates.as_flattened()[(counts.gates.wrapping_sub(1 + ago)) % GATES_MOST]
    }

    #[inline(always)]
    fn push(&mut self, counts: &mut Counts, pair: [Gate; 2]) {
        self.gates[counts.gates / 2 % (GATES_MOST / 2)] = pair;
        counts.gates += 2;
    }

    /// The triangle (from, to, `x`) across a gate. No branches: which apex comes cannot be predicted.
    #[inline(always)]
    fn attach(&mut self, mut counts: Counts, gate: Gate, x: u8, told: &Entry) -> Counts {
        let (a, b) = (gate.from(), gate.to());
        self.guides[counts.vertices % 256] = gate;
        counts.vertices += usize::from(told.shift == 8 * apex::NEW);
        self.behind[usize::from(x | told.behind)] = b;
        self.before[usize::from(x | told.before)] = a;
        self.behind[usize::from(a)] = x;
        self.before[usize::from(b)] = x;
        self.push(&mut counts, [Gate::new(x, b, a), Gate::new(a, x, b)]);
        counts
    }

    /// A triangle on its own; bit `c` of `known` = corner `c` is there already.
    fn found(&mut self, mut counts: Counts, [a, b, c]: [u8; 3], known: u64) {
        let mut near = counts.vertices.saturating_sub(1) as u8;
        for (corner, v) in [a, b, c].into_iter().enumerate() {
            if known >> corner & 1 == 0 {
                self.guides[counts.vertices % 256] = Gate::new(near, near, near);
                counts.vertices += 1;
            }
            near = v;
        }
        for (from, to) in [(b, a), (a, c), (c, b)] {
            self.behind[usize::from(from)] = to;
            self.before[usize::from(to)] = from;
        }
        let [first, second, third] = [Gate::new(b, a, c), Gate::new(a, c, b), Gate::new(c, b, a)];
        self.push(&mut counts, [first, first]);
        self.push(&mut counts, [second, third]);
    }
}

impl Walk {
    pub(super) fn new() -> Walk {
        Walk { counts: Counts::default(), tables: Tables::EMPTY }
    }

    /// Forgets the last cluster. A vertex that garbage names before it is met may be asked for its neighbours; of
    /// gates and guides nothing is read that was not written.
    pub(super) fn restart(&mut self) {
        self.counts = Counts::default();
        self.tables.behind[..CLUSTER_VERTICES].fill(0);
        self.tables.before[..CLUSTER_VERTICES].fill(0);
    }

    /// Corners, as decoded.
    pub(super) fn corners_mut(&mut self) -> &mut Corners {
        &mut self.tables.corners
    }

    /// By vertex: what it is predicted from.
    pub(super) fn guides(&self) -> &[Gate; 256] {
        &self.tables.guides
    }

    /// How the third corner `x` of a triangle across `gate` is told.
    pub(super) fn apex(&self, gate: (u8, u8), x: u8) -> u8 {
        if usize::from(x) == self.counts.vertices {
            apex::NEW
        } else if self.tables.behind[usize::from(gate.1)] == x {
            apex::BEHIND
        } else if self.tables.before[usize::from(gate.0)] == x {
            apex::BEFORE
        } else {
            apex::NAMED
        }
    }

    /// Bit `c`: corner `c` is known. New ones must be next in number.
    pub(super) fn known(&self, triangle: [u8; 3]) -> u64 {
        let mut next = self.counts.vertices;
        let mut known = 0;
        for (corner, &v) in triangle.iter().enumerate() {
            assert!(usize::from(v) <= next, "vertices do not stand in the order of first use");
            known |= u64::from(usize::from(v) < next) << corner;
            next += usize::from(usize::from(v) == next);
        }
        known
    }

    /// Records a triangle that was told as `step`.
    pub(super) fn step(&mut self, triangle: [u8; 3], step: Step) {
        self.counts = match step {
            Step::Across { ago, apex } => {
                let gate = self.tables.gate(self.counts, ago);
                self.tables.attach(self.counts, gate, triangle[2], Entry::of_apex(apex))
            }
            Step::Free => {
                let known = self.known(triangle);
                self.tables.found(self.counts, triangle, known);
                self.counts.with_free(known)
            }
        };
    }

    /// The cheapest way to tell a triangle as it stands.
    fn cheapest(&self, triangle: [u8; 3]) -> Step {
        let gate = (triangle[0], triangle[1]);
        let mut newest = self.tables.gates.as_flattened()[..self.counts.gates].iter().rev();
        let Some(ago) = newest.position(|g| (g.from(), g.to()) == gate) else { return Step::Free };
        let across = Step::Across { ago, apex: self.apex(gate, triangle[2]) };
        if bit_count(across, 0) <= bit_count(Step::Free, self.known(triangle)) { across } else { Step::Free }
    }
}

/// Bits that a step takes; `known` is for free ones.
pub(super) fn bit_count(step: Step, known: u64) -> u32 {
    match step {
        Step::Across { ago, apex } => {
            let (class, more) = gate_class(ago);
            let name = if apex == apex::NAMED { NAME_BITS } else { 0 };
            u32::from(LENGTHS[4 * class + usize::from(apex)]) + more.length + name
        }
        Step::Free => free_bit_count(known),
    }
}

fn free_bit_count(known: u64) -> u32 {
    u32::from(LENGTHS[FREE]) + 3 + NAME_BITS * known.count_ones()
}

/// Writes the triangles; `walk` has been restarted and holds the guides afterwards.
pub(super) fn encode(triangles: &[[u8; 3]], walk: &mut Walk, out: &mut BitWriter) {
    for &triangle in triangles {
        let step = walk.cheapest(triangle);
        match step {
            Step::Across { ago, apex } => {
                let (class, more) = gate_class(ago);
                let word = WORDS[4 * class + usize::from(apex)];
                out.put(word.bits, word.length);
                out.put(more.bits, more.length);
                if apex == apex::NAMED {
                    out.put(u64::from(triangle[2]), NAME_BITS);
                }
            }
            Step::Free => {
                let known = walk.known(triangle);
                out.put(WORDS[FREE].bits, WORDS[FREE].length);
                out.put(known, 3);
                for (_, &v) in triangle.iter().enumerate().filter(|(corner, _)| known >> corner & 1 == 1) {
                    out.put(u64::from(v), NAME_BITS);
                }
            }
        }
        walk.step(triangle, step);
    }
}

/// Reads `triangle_count` triangles over `vertex_count` vertices; `walk` has been restarted and holds the guides
/// afterwards.
#[inline(always)]
pub(super) fn decode(
    input: &mut BitReader<'_>,
    (triangle_count, vertex_count): (usize, usize),
    walk: &mut Walk,
) -> Result<(), &'static str> {
    let tables = &mut walk.tables;
    // In registers, since nothing else knows them.
    let (mut counts, mut reader) = (walk.counts, *input);
    // Its sign is set by an `ago` that leads behind the first gate.
    let mut unsound = 0i64;
    let mut word = 0;
    for t in 0..triangle_count.min(CLUSTER_TRIANGLES) {
        // One load for two triangles: less than its 57 bits, where none is free.
        if t % 2 == 0 {
            word = reader.peek();
        }
        let entry = Entry::at(word);
        let triangle = if entry.shift == Entry::FREE {
            let (triangle, known) = free(reader.peek() >> LENGTHS[FREE], tables, counts);
            counts = counts.with_free(known);
            reader.skip(free_bit_count(known) as usize);
            word = reader.peek();
            triangle
        } else {
            let gate_word = (word >> entry.length) as usize;
            let ago = usize::from(entry.gate) + (gate_word & usize::from(entry.gate_mask));
            unsound |= counts.gates.wrapping_sub(1 + ago) as i64;
            let gate = tables.gate(counts, ago);
            let name = word >> (u32::from(entry.bits).wrapping_sub(NAME_BITS) % 64);
            let known_or_new = (counts.vertices as u32 | (name as u32) << 24) >> entry.shift;
            // All four at once, the rim last: from gate to rim to the next gate is the longest wait in here. Lost: the
            // two newest gates in registers (3 to 10 % slower: it is the instructions that count), and two clusters
            // side by side (a tenth of this loop, for which pages would have to tell where clusters begin).
            let x = known_or_new as u8 & NAME_MASK
                | tables.behind[usize::from(gate.to())] & entry.behind
                | tables.before[usize::from(gate.from())] & entry.before;
            reader.skip(usize::from(entry.bits));
            word >>= entry.bits;
            counts = tables.attach(counts, gate, x, entry);
            [gate.from(), gate.to(), x]
        };
        for corner in 0..3 {
            tables.corners[corner][t] = triangle[corner];
        }
    }
    (walk.counts, *input) = (counts, reader);
    let greatest = |corner: &[u8]| corner[..triangle_count].iter().fold(0, |all: u8, &v| all.max(v));
    let inside = walk.tables.corners.iter().all(|corner| usize::from(greatest(corner)) < vertex_count);
    if unsound < 0 || counts.vertices != vertex_count || !inside {
        return Err("the triangles of a cluster are not what its counts say");
    }
    Ok(())
}

/// Reads a free triangle behind its code word; the second number says which corners were known.
#[cold]
fn free(mut word: u64, tables: &mut Tables, counts: Counts) -> ([u8; 3], u64) {
    let known = word & 7;
    word >>= 3;
    let mut next = counts.vertices;
    let triangle = std::array::from_fn(|corner| {
        if known >> corner & 1 == 1 {
            let v = word as u8 & NAME_MASK;
            word >>= NAME_BITS;
            return v;
        }
        next += 1;
        (next - 1) as u8
    });
    tables.found(counts, triangle, known);
    (triangle, known)
}
