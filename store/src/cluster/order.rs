//! The order in which a cluster is told: triangles within their leaf, leaves, rotations and vertex numbers are free,
//! so they are chosen for few and long strips.
//!
//! ```text
//! while leaves are left: the leaf with the cheapest first triangle
//!     while it has triangles: of all paths over edges that its triangles share, and that begin on an edge which a told
//!     triangle opened, the one whose start and what it leaves, each part by itself, are the cheapest
//! vertices are numbered as they are met
//! ```
//!
//! Any path over shared edges is a strip. Lost: the cheapest triangle, one by one (files of the iso-surface, the plant,
//! the scan and a circuit board 1.6, 3.4, 2.4 and 4.2 % longer, `trex build --no-asvo`).
//!
//! Invariants: 1. each leaf keeps its triangles; 2. orientation is kept; 3. the result depends on the cluster alone.

use super::edges::Edges;
use super::strips::{self, turn};
use super::{ClusterMesh, encode};
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES, LEAF_TRIANGLES};

/// What a start of a strip takes, bits, about: a gate.
const START_BITS: u32 = 10;
/// What a new vertex that no gate predicts costs more, bits: about an edge length an axis.
const LOST_PREDICTION_BITS: u32 = 5;
/// Triangles that the search for a path may visit.
const VISITS_MOST: u32 = 200;
/// No number yet; no way across an edge.
const NONE: u8 = u8::MAX;
/// Ways to tell the triangles of a leaf: from one edge on each. Way `3 t + e` has corner `e` of triangle `t` first.
const WAYS: usize = 3 * LEAF_TRIANGLES;

/// Memory to choose orders with, reused from cluster to cluster.
pub(crate) struct Orderer {
    edges: Edges,
    leaves: Vec<OrderedLeaf>,
    /// By triangle of the old cluster: its leaf.
    leaf_of: [u8; CLUSTER_TRIANGLES],
    /// New number by old one.
    number: [u8; CLUSTER_VERTICES],
    /// Ways of the old cluster that begin on an edge which the last triangle opened.
    turns: Vec<usize>,
    /// Triangles of the strip under way.
    run: usize,
}

/// A cluster in coding order.
pub(crate) struct ClusterOrder {
    pub(crate) mesh: ClusterMesh,
    /// Bits of its topology on disk.
    topology_bits: u32,
}

impl ClusterOrder {
    /// Of a mesh that was decoded, and so is in coding order; `None` where no encoder can have written it: its vertices
    /// do not stand in the order of first use, or one has none.
    pub(crate) fn decoded(mesh: ClusterMesh) -> Option<ClusterOrder> {
        let mut next = 0;
        for &corner in mesh.triangles.as_flattened() {
            if usize::from(corner) > next {
                return None;
            }
            next += usize::from(usize::from(corner) == next);
        }
        let topology_bits = (next == mesh.vertices.len()).then(|| strips::bit_count(&mesh.triangles))?;
        Some(ClusterOrder { mesh, topology_bits })
    }

    /// Bytes that a page sets aside for it: what it takes in a frame, or on disk where that is more (many triangles
    /// over few vertices that share no edges).
    pub(crate) fn page_bytes(&self) -> usize {
        let in_frame = self.mesh.frame_bytes() + encode::CLUSTER_ASIDE_BYTES;
        in_frame.max(encode::disk_bytes_most(&self.mesh, self.topology_bits))
    }
}

/// A leaf on its way.
struct OrderedLeaf {
    /// Its first triangle in the old cluster, and how many it has.
    first: usize,
    count: usize,
    /// Way by way: the two that a strip may go on with; [`NONE`] where no triangle of the leaf is across.
    next: [[u8; 2]; WAYS],
    /// By triangle: those that share an edge with it.
    near: [u8; LEAF_TRIANGLES],
    /// Bit i: triangle i is not told yet.
    left: u8,
    /// Ways that begin on an edge which a told triangle opened.
    gates: u32,
}

impl OrderedLeaf {
    fn new(old: &ClusterMesh, edges: &Edges, first: usize, count: usize) -> OrderedLeaf {
        let mut across = [NONE; WAYS];
        for way in 0..3 * count {
            // Where several share an edge, each goes with the first that is free.
            let before = 3 * first..3 * (first + way / 3);
            let [a, b, _] = turned(old, 3 * first + way);
            let free = |other: &usize| before.contains(other) && across[other - 3 * first] == NONE;
            if let Some(other) = edges.ways(b, a).filter(free).min() {
                let other = other - 3 * first;
                (across[way], across[other]) = (other as u8, way as u8);
            }
        }
        let edge = |way: usize, turn: usize| across[way - way % 3 + (way + turn) % 3];
        let mut near = [0; LEAF_TRIANGLES];
        for (way, &other) in across.iter().enumerate().filter(|&(_, &other)| other != NONE) {
            near[way / 3] |= 1 << (other / 3);
        }
        let next = std::array::from_fn(|way| [edge(way, 1), edge(way, 2)]);
        OrderedLeaf { first, count, next, near, left: u8::MAX >> (LEAF_TRIANGLES - count), gates: 0 }
    }

    /// All ways to tell a triangle that is not told yet.
    fn ways(&self) -> u32 {
        (0..self.count).filter(|t| self.left >> t & 1 == 1).fold(0, |ways, t| ways | 0b111 << (3 * t))
    }

    /// In how many parts these triangles fall, where edges hold them together.
    fn part_count(&self, mut triangles: u8) -> u32 {
        let mut count = 0;
        while triangles != 0 {
            let mut front = triangles & triangles.wrapping_neg();
            triangles &= !front;
            while front != 0 {
                let near = self.near[front.trailing_zeros() as usize] & triangles;
                front = front & (front - 1) | near;
                triangles &= !near;
            }
            count += 1;
        }
        count
    }
}

/// The corners of a triangle of `old`, by a way of the cluster: from the edge on that it begins with.
fn turned(old: &ClusterMesh, way: usize) -> [u8; 3] {
    let [a, b, c] = old.triangles[way / 3];
    [[a, b, c], [b, c, a], [c, a, b]][way % 3]
}

/// How the next strip, or the one under way, gets to a triangle, the cheapest way first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Start {
    /// It goes on.
    Turn,
    /// On an edge that any told triangle opened.
    Gate,
    /// By naming an edge.
    Free,
}

/// A path through a leaf.
#[derive(Clone, Copy)]
struct Path {
    ways: [u8; LEAF_TRIANGLES],
    count: usize,
}

/// The search for the cheapest path.
struct Search<'a> {
    leaf: &'a OrderedLeaf,
    best: Option<(u32, Path)>,
    /// Triangles that the search may still visit.
    visits_left: u32,
}

impl Search<'_> {
    /// Extends `path`, of which the start takes `bits`; `left` are the triangles that it leaves.
    fn extend(&mut self, bits: u32, path: &mut Path, left: u8) {
        let mut is_end = true;
        for next in self.leaf.next[usize::from(path.ways[path.count - 1])] {
            if next == NONE || left >> (next / 3) & 1 == 0 {
                continue;
            }
            is_end = false;
            if self.visits_left == 0 {
                break;
            }
            self.visits_left -= 1;
            path.ways[path.count] = next;
            path.count += 1;
            self.extend(bits, path, left & !(1 << (next / 3)));
            path.count -= 1;
        }
        if is_end || self.visits_left == 0 {
            let all = bits + self.leaf.part_count(left) * START_BITS;
            if self.best.is_none_or(|(least, best)| (all, best.count) < (least, path.count)) {
                self.best = Some((all, *path));
            }
        }
    }
}

impl Default for Orderer {
    fn default() -> Orderer {
        Orderer {
            edges: Edges::default(),
            leaves: Vec::new(),
            leaf_of: [0; CLUSTER_TRIANGLES],
            number: [NONE; CLUSTER_VERTICES],
            turns: Vec::new(),
            run: 0,
        }
    }
}

impl Orderer {
    /// The same cluster in coding order.
    pub(crate) fn ordered(&mut self, old: &ClusterMesh) -> ClusterOrder {
        self.begin(old);
        let mut new = ClusterMesh {
            vertices: Vec::with_capacity(old.vertices.len()),
            triangles: Vec::with_capacity(old.triangles.len()),
            leaf_sizes: Vec::with_capacity(old.leaf_sizes.len()),
            materials: Vec::with_capacity(old.materials.len()),
            colours: Vec::with_capacity(old.colours.len()),
            normals: Vec::with_capacity(old.normals.len()),
        };
        while let Some(leaf) = self.next_leaf() {
            new.leaf_sizes.push(self.leaves[leaf].count as u8);
            while self.leaves[leaf].left != 0 {
                let path = self.cheapest_path(old, leaf);
                for &way in &path.ways[..path.count] {
                    self.append(old, leaf, usize::from(way), &mut new);
                }
            }
        }
        let topology_bits = strips::bit_count(&new.triangles);
        ClusterOrder { mesh: new, topology_bits }
    }

    /// Nothing is told yet.
    fn begin(&mut self, old: &ClusterMesh) {
        self.number.fill(NONE);
        self.turns.clear();
        self.run = 0;
        self.edges.fill(&old.triangles);
        self.leaves.clear();
        let mut first = 0;
        for &size in &old.leaf_sizes {
            let count = usize::from(size);
            self.leaf_of[first..first + count].fill(self.leaves.len() as u8);
            self.leaves.push(OrderedLeaf::new(old, &self.edges, first, count));
            first += count;
        }
    }

    /// The leaf to go on with. Where all are full but one, that one comes last: the plain sizes.
    fn next_leaf(&self) -> Option<usize> {
        let is_full = |leaf: &OrderedLeaf| leaf.count == LEAF_TRIANGLES;
        let left = || self.leaves.iter().enumerate().filter(|(_, leaf)| leaf.left != 0);
        let is_plain = left().filter(|(_, leaf)| !is_full(leaf)).count() == 1;
        let best = |at: usize, leaf: &OrderedLeaf| match leaf.gates {
            0 => Start::Free,
            _ if self.can_turn() && self.turns.iter().any(|way| usize::from(self.leaf_of[way / 3]) == at) => {
                Start::Turn
            }
            _ => Start::Gate,
        };
        let candidates = left().filter(|(_, leaf)| !is_plain || is_full(leaf));
        let first = candidates.min_by_key(|&(at, leaf)| (best(at, leaf), at));
        first.or_else(|| left().next()).map(|(at, _)| at)
    }

    /// Whether the strip under way may go on.
    fn can_turn(&self) -> bool {
        self.run < strips::STRIP_TRIANGLES
    }

    /// The path through a leaf to tell next.
    fn cheapest_path(&self, old: &ClusterMesh, leaf: usize) -> Path {
        let leaf = &self.leaves[leaf];
        let gates = leaf.gates & leaf.ways();
        let mut starts = if gates != 0 { gates } else { leaf.ways() };
        let mut search = Search { leaf, best: None, visits_left: VISITS_MOST };
        while starts != 0 {
            let way = starts.trailing_zeros() as usize;
            starts &= starts - 1;
            let bits = if gates == 0 {
                let [a, b, _] = turned(old, 3 * leaf.first + way);
                let new = [a, b].iter().filter(|&&v| self.number[usize::from(v)] == NONE).count();
                START_BITS + new as u32 * LOST_PREDICTION_BITS
            } else if self.can_turn() && self.turns.contains(&(3 * leaf.first + way)) {
                0
            } else {
                START_BITS
            };
            let mut path = Path { ways: [way as u8; LEAF_TRIANGLES], count: 1 };
            search.extend(bits, &mut path, leaf.left & !(1 << (way / 3)));
        }
        search.best.expect("each start ends a path").1
    }

    /// Appends a triangle of a leaf of the old cluster to the new one.
    fn append(&mut self, old: &ClusterMesh, leaf: usize, way: usize, new: &mut ClusterMesh) {
        let first = self.leaves[leaf].first;
        let corners @ [a, b, x] = turned(old, 3 * first + way);
        let triangle = corners.map(|v| {
            let number = &mut self.number[usize::from(v)];
            if *number == NONE {
                *number = new.vertices.len() as u8;
                new.vertices.push(old.vertices[usize::from(v)]);
            }
            *number
        });
        let goes_on = new.triangles.last().is_some_and(|&last| turn(last, triangle).is_some());
        self.run = if goes_on && self.can_turn() { self.run + 1 } else { 1 };
        self.leaves[leaf].left &= !(1 << (way / 3));
        self.turns.clear();
        for (from, to) in [(x, b), (a, x)] {
            for way in self.edges.ways(from, to) {
                let leaf = &mut self.leaves[usize::from(self.leaf_of[way / 3])];
                let local = way - 3 * leaf.first;
                leaf.gates |= 1 << local;
                if leaf.left >> (local / 3) & 1 == 1 {
                    self.turns.push(way);
                }
            }
        }
        new.triangles.push(triangle);
        new.materials.push(old.materials[first + way / 3]);
        if let Some(&corners) = old.colours.get(first + way / 3) {
            new.colours.push(from_way(corners, way));
        }
        if let Some(&corners) = old.normals.get(first + way / 3) {
            new.normals.push(from_way(corners, way));
        }
    }
}

/// Corners from the one on that a way begins with.
fn from_way<T>([a, b, c]: [T; 3], way: usize) -> [T; 3] {
    match way % 3 {
        0 => [a, b, c],
        1 => [b, c, a],
        _ => [c, a, b],
    }
}
