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

use super::strips::{self, turn};
use super::{ClusterMesh, encode};
use crate::layout::{CLUSTER_VERTICES, LEAF_TRIANGLES};

/// What a start of a strip takes, bits, about: a gate.
const START_BITS: u32 = 10;
/// What a new vertex that no gate predicts costs more, bits: about an edge length an axis.
const LOST_PREDICTION_BITS: u32 = 5;
/// Triangles that the search for a path may visit.
const VISITS_MOST: u32 = 200;
/// No number yet.
const NONE: u8 = u8::MAX;

/// Memory to choose orders with, reused from cluster to cluster.
pub(crate) struct Orderer {
    /// True where a triangle opened the edge from a to b, `[a][b]`, in new numbers.
    opened: Vec<[bool; CLUSTER_VERTICES]>,
    /// New number by old one.
    number: [u8; CLUSTER_VERTICES],
}

/// A cluster in coding order.
pub(crate) struct Ordered {
    pub(crate) mesh: ClusterMesh,
    /// Bits of its topology on disk.
    topology_bits: u32,
}

impl Ordered {
    /// Bytes that a page sets aside for it: what it takes in a frame, or on disk where that is more (many triangles
    /// over few vertices that share no edges).
    pub(crate) fn page_bytes(&self) -> usize {
        self.mesh.frame_bytes().max(encode::disk_bytes_most(&self.mesh, self.topology_bits))
    }
}

/// A triangle of a leaf, told from one of its edges on: corner `edge` is its first.
#[derive(Clone, Copy)]
struct Turned {
    triangle: u8,
    edge: u8,
}

/// A leaf that is not told yet.
struct Leaf {
    /// Its first triangle in the old cluster, and how many it has.
    first: usize,
    count: usize,
    /// Who shares an edge with whom: `[triangle][edge]`, the other one from this edge on.
    across: [[Option<Turned>; 3]; LEAF_TRIANGLES],
    /// Bit i: triangle i is not told yet.
    left: u8,
}

impl Leaf {
    fn new(old: &ClusterMesh, first: usize, count: usize) -> Leaf {
        let edge = |t: usize, e: usize| (old.triangles[first + t][e], old.triangles[first + t][(e + 1) % 3]);
        let mut across = [[None; 3]; LEAF_TRIANGLES];
        for (i, j) in (0..count).flat_map(|i| (0..i).map(move |j| (i, j))) {
            for (e, f) in (0..3).flat_map(|e| (0..3).map(move |f| (e, f))) {
                let (a, b) = edge(i, e);
                if edge(j, f) == (b, a) && across[i][e].is_none() && across[j][f].is_none() {
                    across[i][e] = Some(Turned { triangle: j as u8, edge: f as u8 });
                    across[j][f] = Some(Turned { triangle: i as u8, edge: e as u8 });
                }
            }
        }
        Leaf { first, count, across, left: u8::MAX >> (LEAF_TRIANGLES - count) }
    }

    /// All ways to tell a triangle that is not told yet.
    fn ways(&self) -> impl Iterator<Item = Turned> {
        let left = self.left;
        let there = (0..LEAF_TRIANGLES as u8).filter(move |i| left >> i & 1 == 1);
        there.flat_map(|triangle| (0..3).map(move |edge| Turned { triangle, edge }))
    }

    /// In how many parts these triangles fall, where edges hold them together.
    fn part_count(&self, mut triangles: u8) -> u32 {
        let mut count = 0;
        while triangles != 0 {
            let mut front = triangles & triangles.wrapping_neg();
            triangles &= !front;
            while front != 0 {
                let across = self.across[front.trailing_zeros() as usize].iter().flatten();
                let near = across.fold(0, |near, other| near | 1 << other.triangle) & triangles;
                front = front & (front - 1) | near;
                triangles &= !near;
            }
            count += 1;
        }
        count
    }

    /// The triangles of `old` as told.
    fn corners(&self, old: &ClusterMesh, way: Turned) -> [u8; 3] {
        let triangle = old.triangles[self.first + usize::from(way.triangle)];
        [0, 1, 2].map(|c| triangle[(usize::from(way.edge) + c) % 3])
    }
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
    ways: [Turned; LEAF_TRIANGLES],
    count: usize,
}

/// The search for the cheapest path.
struct Search<'a> {
    leaf: &'a Leaf,
    best: Option<(u32, Path)>,
    /// Triangles that the search may still visit.
    visits_left: u32,
}

impl Search<'_> {
    /// Goes on from the end of `path`, of which the start takes `bits`; `left` are the triangles that it leaves.
    fn go_on(&mut self, bits: u32, path: &mut Path, left: u8) {
        let end = path.ways[path.count - 1];
        let mut is_end = true;
        for edge in [1, 2] {
            let next = self.leaf.across[usize::from(end.triangle)][usize::from(end.edge + edge) % 3];
            let Some(next) = next.filter(|next| left >> next.triangle & 1 == 1) else { continue };
            is_end = false;
            if self.visits_left == 0 {
                break;
            }
            self.visits_left -= 1;
            path.ways[path.count] = next;
            path.count += 1;
            self.go_on(bits, path, left & !(1 << next.triangle));
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

/// What the triangles told so far leave to the next one.
struct Told<'a> {
    new: &'a ClusterMesh,
    /// Triangles of the strip under way.
    run: usize,
}

impl Default for Orderer {
    fn default() -> Orderer {
        Orderer {
            opened: vec![[false; CLUSTER_VERTICES]; CLUSTER_VERTICES],
            number: [NONE; CLUSTER_VERTICES],
        }
    }
}

impl Orderer {
    /// The same cluster in coding order.
    pub(crate) fn ordered(&mut self, old: &ClusterMesh) -> Ordered {
        self.opened.iter_mut().for_each(|row| row.fill(false));
        self.number.fill(NONE);
        let mut new = ClusterMesh::default();
        new.triangles.reserve(old.triangles.len());
        let mut first = 0;
        let mut leaves: Vec<Leaf> = Vec::with_capacity(old.leaf_sizes.len());
        for &size in &old.leaf_sizes {
            leaves.push(Leaf::new(old, first, usize::from(size)));
            first += usize::from(size);
        }
        let mut run = 0;
        while !leaves.is_empty() {
            let told = Told { new: &new, run };
            let mut leaf = leaves.swap_remove(self.next_leaf(old, &leaves, &told));
            new.leaf_sizes.push(leaf.count as u8);
            while leaf.left != 0 {
                let path = self.cheapest_path(old, &leaf, &Told { new: &new, run });
                for &way in &path.ways[..path.count] {
                    leaf.left &= !(1 << way.triangle);
                    let goes_on = self.tell(old, &leaf, way, &mut new);
                    run = if goes_on && run < strips::STRIP_TRIANGLES { run + 1 } else { 1 };
                }
            }
        }
        let topology_bits = strips::bit_count(&new.triangles);
        Ordered { mesh: new, topology_bits }
    }

    /// The leaf to go on with: index into `leaves`. Where all are full but one, that one comes last: the plain sizes.
    fn next_leaf(&self, old: &ClusterMesh, leaves: &[Leaf], told: &Told<'_>) -> usize {
        let is_full = |leaf: &Leaf| leaf.count == LEAF_TRIANGLES;
        let is_plain = leaves.iter().filter(|leaf| !is_full(leaf)).count() == 1;
        let candidates = leaves.iter().enumerate().filter(|(_, leaf)| !is_plain || is_full(leaf));
        let best = |leaf: &Leaf| leaf.ways().map(|way| self.start(leaf.corners(old, way), told)).min();
        candidates.min_by_key(|(_, leaf)| (best(leaf), leaf.first)).map_or(0, |(at, _)| at)
    }

    /// The path to tell next.
    fn cheapest_path(&self, old: &ClusterMesh, leaf: &Leaf, told: &Told<'_>) -> Path {
        let least = leaf.ways().map(|way| self.start(leaf.corners(old, way), told)).min();
        let most = least.expect("a leaf is not empty").max(Start::Gate);
        let mut search = Search { leaf, best: None, visits_left: VISITS_MOST };
        for way in leaf.ways() {
            let corners = leaf.corners(old, way);
            let start = self.start(corners, told);
            if start > most {
                continue;
            }
            let bits = match start {
                Start::Turn => 0,
                Start::Gate => START_BITS,
                Start::Free => {
                    let new = corners[..2].iter().filter(|&&v| self.number[usize::from(v)] == NONE).count();
                    START_BITS + new as u32 * LOST_PREDICTION_BITS
                }
            };
            let mut path = Path { ways: [way; LEAF_TRIANGLES], count: 1 };
            search.go_on(bits, &mut path, leaf.left & !(1 << way.triangle));
        }
        search.best.expect("each start ends a path").1
    }

    /// How a triangle of the old cluster could be told next, as it stands.
    fn start(&self, old: [u8; 3], told: &Told<'_>) -> Start {
        let [a, b, x] = old.map(|v| self.number[usize::from(v)]);
        if a == NONE || b == NONE || !self.opened[usize::from(a)][usize::from(b)] {
            return Start::Free;
        }
        let goes_on = told.run < strips::STRIP_TRIANGLES
            && told.new.triangles.last().is_some_and(|&last| turn(last, [a, b, x]).is_some());
        if goes_on { Start::Turn } else { Start::Gate }
    }

    /// Appends a triangle of a leaf of the old cluster to the new one; says whether it hangs on the one before it.
    fn tell(&mut self, old: &ClusterMesh, leaf: &Leaf, way: Turned, new: &mut ClusterMesh) -> bool {
        let triangle @ [a, b, x] = leaf.corners(old, way).map(|v| {
            let number = &mut self.number[usize::from(v)];
            if *number == NONE {
                *number = new.vertices.len() as u8;
                new.vertices.push(old.vertices[usize::from(v)]);
            }
            *number
        });
        let goes_on = new.triangles.last().is_some_and(|&last| turn(last, triangle).is_some());
        for (from, to) in [(x, b), (a, x)] {
            self.opened[usize::from(from)][usize::from(to)] = true;
        }
        new.triangles.push(triangle);
        new.materials.push(old.materials[leaf.first + usize::from(way.triangle)]);
        goes_on
    }
}
