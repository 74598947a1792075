//! The order in which a cluster is told: triangles within their leaf, leaves, rotations and vertex numbers are free,
//! so they are chosen for the topology code.
//!
//! ```text
//! while leaves are left: the leaf with the cheapest first triangle
//!     while it has triangles: the one that is told in the fewest bits, rotated so that its gate comes first
//! vertices are numbered as they are met
//! ```
//!
//! Greedy; lost: keeping the leaves' order (0.1 to 0.3 bits a triangle more).
//!
//! Invariants: 1. each leaf keeps its triangles; 2. orientation is kept; 3. the
//! result depends on the cluster alone.

use super::code::apex;
use super::topology::{Step, Walk, bit_count};
use super::{ClusterMesh, encode};
use crate::layout::{CLUSTER_VERTICES, LEAF_TRIANGLES};

/// What a new vertex that no gate predicts costs more, bits: about an edge length an axis.
const LOST_PREDICTION_BITS: u32 = 5;
/// No number yet; no gate yet.
const NONE: u8 = u8::MAX;

/// Memory to choose orders with, reused from cluster to cluster.
pub(crate) struct Orderer {
    walk: Walk,
    /// `newest[a][b]` = 1 + index of the newest gate from a to b, in new numbers; 0 = none.
    newest: Vec<[u16; CLUSTER_VERTICES]>,
    /// New number by old one.
    number: [u8; CLUSTER_VERTICES],
    /// What the triangles so far take on disk.
    topology_bits: u32,
}

/// A cluster in coding order.
pub(crate) struct Ordered {
    pub(crate) mesh: ClusterMesh,
    /// Bits of its topology on disk, at most.
    topology_bits: u32,
}

impl Ordered {
    /// Bytes that a page sets aside for it: what it takes in a frame, or on disk where that is more (many triangles
    /// over few vertices that share no edges).
    pub(crate) fn page_bytes(&self) -> usize {
        self.mesh.frame_bytes().max(encode::disk_bytes_most(&self.mesh, self.topology_bits))
    }
}

/// A way to tell a triangle of the old cluster next.
#[derive(Clone, Copy)]
struct Candidate {
    bits: u32,
    rotation: usize,
    step: Step,
}

impl Default for Orderer {
    fn default() -> Orderer {
        Orderer {
            walk: Walk::new(),
            newest: vec![[0; CLUSTER_VERTICES]; CLUSTER_VERTICES],
            number: [NONE; CLUSTER_VERTICES],
            topology_bits: 0,
        }
    }
}

impl Orderer {
    /// The same cluster in coding order.
    pub(crate) fn ordered(&mut self, old: &ClusterMesh) -> Ordered {
        self.walk.restart();
        self.newest.iter_mut().for_each(|row| row.fill(0));
        self.number.fill(NONE);
        self.topology_bits = 0;
        let mut new = ClusterMesh::default();
        new.triangles.reserve(old.triangles.len());
        let mut first = 0;
        let mut leaves: Vec<Vec<usize>> = Vec::with_capacity(old.leaf_sizes.len());
        for &size in &old.leaf_sizes {
            leaves.push((first..first + usize::from(size)).collect());
            first += usize::from(size);
        }
        while !leaves.is_empty() {
            let mut leaf = leaves.remove(self.next_leaf(old, &leaves));
            new.leaf_sizes.push(leaf.len() as u8);
            while !leaf.is_empty() {
                let candidates = leaf.iter().map(|&t| self.cheapest(old.triangles[t]));
                let (at, candidate) =
                    candidates.enumerate().min_by_key(|(_, c)| c.bits).expect("a leaf is not empty");
                let t = leaf.remove(at);
                self.tell(old, t, candidate, &mut new);
            }
        }
        Ordered { mesh: new, topology_bits: self.topology_bits }
    }

    /// The leaf to go on with: index into `leaves`. Where all are full but one, that one comes last: the plain sizes.
    fn next_leaf(&self, old: &ClusterMesh, leaves: &[Vec<usize>]) -> usize {
        let is_full = |leaf: &Vec<usize>| leaf.len() == LEAF_TRIANGLES;
        let is_plain = leaves.iter().filter(|leaf| !is_full(leaf)).count() == 1;
        let candidates = leaves.iter().enumerate().filter(|(_, leaf)| !is_plain || is_full(leaf));
        let bits = |leaf: &[usize]| leaf.iter().map(|&t| self.cheapest(old.triangles[t]).bits).min();
        candidates.min_by_key(|(_, leaf)| bits(leaf)).map_or(0, |(at, _)| at)
    }

    fn cheapest(&self, old: [u8; 3]) -> Candidate {
        let triangle = old.map(|v| self.number[usize::from(v)]);
        let is_known = triangle.map(|v| v != NONE);
        let known = is_known.iter().filter(|&&k| k).count() as u32;
        let lost = LOST_PREDICTION_BITS * (3 - known);
        let mut best =
            Candidate { bits: bit_count(Step::Free, (1 << known) - 1) + lost, rotation: 0, step: Step::Free };
        for rotation in 0..3 {
            let [a, b, x] = [0, 1, 2].map(|c| triangle[(rotation + c) % 3]);
            if a == NONE || b == NONE {
                continue;
            }
            let newest = usize::from(self.newest[usize::from(a)][usize::from(b)]);
            if newest == 0 {
                continue;
            }
            let apex = if x == NONE { apex::NEW } else { self.walk.apex((a, b), x) };
            let step = Step::Across { ago: self.walk.counts.gates - newest, apex };
            let bits = bit_count(step, 0);
            if bits < best.bits {
                best = Candidate { bits, rotation, step };
            }
        }
        best
    }

    /// Appends triangle `t` of the old cluster to the new one.
    fn tell(&mut self, old: &ClusterMesh, t: usize, candidate: Candidate, new: &mut ClusterMesh) {
        let corners = [0, 1, 2].map(|c| old.triangles[t][(candidate.rotation + c) % 3]);
        let triangle = corners.map(|v| {
            let number = &mut self.number[usize::from(v)];
            if *number == NONE {
                *number = new.vertices.len() as u8;
                new.vertices.push(old.vertices[usize::from(v)]);
            }
            *number
        });
        self.topology_bits += bit_count(candidate.step, self.walk.known(triangle));
        self.walk.step(triangle, candidate.step);
        let count = self.walk.counts.gates as u16;
        let [a, b, x] = triangle.map(usize::from);
        if let Step::Free = candidate.step {
            self.newest[b][a] = count - 2;
            self.newest[a][x] = count - 1;
            self.newest[x][b] = count;
        } else {
            self.newest[x][b] = count - 1;
            self.newest[a][x] = count;
        }
        new.triangles.push(triangle);
        new.materials.push(old.materials[t]);
    }
}
