//! `Steps`: the tests that a probe makes, and how many of them are met.

use super::kernel::Kernel;
use super::lattice_ray::{LatticeFrame, LatticeRay};
use trex_store::cluster::{ClusterView, Node};

/// A test that a probe makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeStep {
    /// A ray against the eight boxes of a node.
    Node,
    /// A ray against the boxes of a cluster's leaves.
    LeafBoxes,
    /// A ray against the triangles of a leaf.
    Triangles,
}

/// Nodes, clusters and rays; each ray is tested against all of them.
pub(super) struct Steps<'a> {
    pub(super) frame: LatticeFrame,
    pub(super) nodes: Vec<&'a Node>,
    pub(super) clusters: Vec<ClusterView<'a>>,
    pub(super) rays: Vec<LatticeRay>,
}

impl Steps<'_> {
    /// Count of tests that [`Steps::count_with`] makes.
    pub(super) fn test_count(&self, step: ProbeStep) -> u64 {
        let per_ray = match step {
            ProbeStep::Node => self.nodes.len(),
            ProbeStep::LeafBoxes => self.clusters.len(),
            ProbeStep::Triangles => self.clusters.iter().map(ClusterView::leaf_count).sum(),
        };
        (per_ray * self.rays.len()) as u64
    }

    /// Makes all tests of `step`. Gives the count of boxes, or triangles, that are met.
    #[inline(always)]
    pub(super) fn count_with<K: Kernel>(&self, step: ProbeStep) -> u64 {
        let mut met = 0;
        for ray in &self.rays {
            let (kernel, end) = (K::new(&self.frame, ray), ray.t_max as f32);
            match step {
                ProbeStep::Node => {
                    for node in &self.nodes {
                        met += u64::from(kernel.node(node, end).mask.count_ones());
                    }
                }
                ProbeStep::LeafBoxes => {
                    for cluster in &self.clusters {
                        met += u64::from(kernel.leaf_boxes(cluster, end).mask.count_ones());
                    }
                }
                ProbeStep::Triangles => {
                    for cluster in &self.clusters {
                        for leaf in 0..cluster.leaf_count() {
                            met += u64::from(kernel.triangles(cluster, leaf, end).count_ones());
                        }
                    }
                }
            }
        }
        met
    }
}
