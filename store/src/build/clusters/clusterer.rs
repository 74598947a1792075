//! `Clusterer`: the triangles of a chunk in clusters, and the binary SAH tree above these.
//!
//! Invariants: 1. every triangle ends in exactly one cluster; 2. boxes in the tree are exact unions of lattice boxes.

use super::sah::{Prim, Rule, Splitter};
use crate::build::scratch::TriangleList;
use crate::cluster::{ClusterMesh, LatticeBox, Normal, Orderer, WHITE};
use crate::layout::{CLUSTER_LEAVES, CLUSTER_TRIANGLES, CLUSTER_VERTICES, LEAF_TRIANGLES};

/// A node of the binary tree over a chunk's clusters.
#[derive(Clone, Copy, Debug)]
pub(crate) enum BinaryNode {
    Cluster(u32),
    Split(u32, u32),
}

/// Clusters, in coding order, and the tree above them; the last node is the root.
#[derive(Default)]
pub(crate) struct Clusters {
    pub(crate) clusters: Vec<ClusterMesh>,
    /// By cluster: bytes to set aside for it in a page.
    pub(crate) page_bytes: Vec<usize>,
    pub(crate) tree: Vec<(LatticeBox, BinaryNode)>,
}

/// Memory to make clusters with, reused from chunk to chunk.
#[derive(Default)]
pub(crate) struct Clusterer {
    splitter: Splitter,
    orderer: Orderer,
    /// The cluster under way.
    mesh: ClusterMesh,
}

impl Clusterer {
    /// The clusters of triangles, whose primitives are reordered.
    pub(crate) fn clusters(&mut self, prims: &mut [Prim], triangles: &TriangleList) -> Clusters {
        let mut out = Clusters::default();
        self.grow(prims, triangles, 0, &mut out);
        out
    }

    /// Adds the subtree over `prims`, which hangs under `depth` splits; gives its node.
    fn grow(
        &mut self,
        prims: &mut [Prim],
        triangles: &TriangleList,
        depth: usize,
        out: &mut Clusters,
    ) -> u32 {
        let rule = Rule { leaf: LEAF_TRIANGLES, quantum: LEAF_TRIANGLES, depth };
        if prims.len() <= CLUSTER_TRIANGLES {
            self.mesh.leaf_sizes.clear();
            order_leaves(&mut self.splitter, prims, rule, &mut self.mesh.leaf_sizes);
            if self.mesh.leaf_sizes.len() <= CLUSTER_LEAVES && weld(prims, triangles, &mut self.mesh) {
                let ordered = self.orderer.ordered(&self.mesh);
                out.tree.push((ordered.mesh.bounds(), BinaryNode::Cluster(out.clusters.len() as u32)));
                out.page_bytes.push(ordered.page_bytes());
                out.clusters.push(ordered.mesh);
                return out.tree.len() as u32 - 1;
            }
        }
        let quantum = if prims.len() > CLUSTER_TRIANGLES { CLUSTER_TRIANGLES } else { LEAF_TRIANGLES };
        let cut = self.splitter.split(prims, Rule { quantum, ..rule });
        let (left, right) = prims.split_at_mut(cut);
        let left = self.grow(left, triangles, depth + 1, out);
        let right = self.grow(right, triangles, depth + 1, out);
        let bounds = out.tree[left as usize].0.join(&out.tree[right as usize].0);
        out.tree.push((bounds, BinaryNode::Split(left, right)));
        out.tree.len() as u32 - 1
    }
}

/// Orders primitives by leaves, tight ones; appends the size of each.
fn order_leaves(splitter: &mut Splitter, prims: &mut [Prim], rule: Rule, sizes: &mut Vec<u8>) {
    if prims.len() <= LEAF_TRIANGLES {
        prims.sort_unstable_by_key(|prim| prim.index);
        sizes.push(prims.len() as u8);
        return;
    }
    let cut = splitter.split(prims, rule);
    let (left, right) = prims.split_at_mut(cut);
    order_leaves(splitter, left, rule, sizes);
    order_leaves(splitter, right, rule, sizes);
}

/// Welds the primitives' corners into `cluster`; false when they are more than it can hold. Vertices stand in the
/// order of first use.
fn weld(prims: &[Prim], triangles: &TriangleList, cluster: &mut ClusterMesh) -> bool {
    const SLOTS: usize = 4 * CLUSTER_TRIANGLES;
    const FREE: u8 = 255;
    const { assert!(CLUSTER_VERTICES <= FREE as usize && SLOTS > CLUSTER_VERTICES) }
    let mut slots = [FREE; SLOTS];
    cluster.vertices.clear();
    cluster.triangles.clear();
    cluster.materials.clear();
    cluster.colours.clear();
    cluster.normals.clear();
    let has = triangles.attributes();
    for prim in prims {
        let triangle = &triangles.triangles[prim.index as usize];
        let mut corners = [0; 3];
        for (corner, q) in triangle.q.iter().enumerate() {
            let mut slot = hash(q) % SLOTS;
            corners[corner] = loop {
                match slots[slot] {
                    FREE if cluster.vertices.len() == CLUSTER_VERTICES => return false,
                    FREE => {
                        slots[slot] = cluster.vertices.len() as u8;
                        cluster.vertices.push(*q);
                        break slots[slot];
                    }
                    index if cluster.vertices[index as usize] == *q => break index,
                    _ => slot = (slot + 1) % SLOTS,
                }
            };
        }
        cluster.triangles.push(corners);
        cluster.materials.push(triangle.material);
        let attributes = triangles.attributes_of(prim.index as usize);
        if has.colours {
            cluster.colours.push(attributes.colours);
        }
        if has.normals {
            cluster.normals.push(attributes.normals);
        }
    }
    if cluster.colours.iter().all(|corners| *corners == [WHITE; 3]) {
        cluster.colours.clear();
    }
    if cluster.normals.iter().all(|corners| *corners == [Normal::NONE; 3]) {
        cluster.normals.clear();
    }
    true
}

fn hash(q: &[i64; 3]) -> usize {
    let mix = q.iter().fold(0u64, |h, &v| (h ^ v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(23));
    (mix >> 20) as usize
}
