//! Steps of traversal on their own, for benchmarks: the tests of nodes, of leaf boxes and of triangles, without the way
//! that leads to them.
//!
//! Invariant: each ray is tested against all that was collected, met or not.

use super::kernel::Kernel;
use super::pages::AllResident;
use super::ray::{Frame, LatticeRay};
use super::scalar::Scalar;
use super::{Arithmetic, Ray};
use trex_store::PageFile;
use trex_store::cluster::{ClusterView, FrameRef, FrameView, Node};
use trex_store::layout::PageKind;

/// What is tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A ray against the eight boxes of a node.
    Node,
    /// A ray against the boxes of a cluster's leaves.
    LeafBoxes,
    /// A ray against the triangles of a leaf.
    Triangles,
}

/// Nodes, clusters and rays.
pub struct Probe<'a> {
    arithmetic: Arithmetic,
    frame: Frame,
    nodes: Vec<&'a Node>,
    clusters: Vec<ClusterView<'a>>,
    rays: Vec<LatticeRay>,
}

impl<'a> Probe<'a> {
    /// What the pages of a file hold, and those of `rays` that come to its box.
    ///
    /// # Panics
    /// As [`super::PagedMesh::with_arithmetic`].
    pub fn new(file: &PageFile, pages: &'a AllResident, rays: &[Ray], arithmetic: Arithmetic) -> Probe<'a> {
        arithmetic.check(file);
        let frame = Frame::of(file);
        let rays = rays.iter().filter_map(|ray| frame.enter(ray)).collect();
        let mut probe = Probe { arithmetic, frame, nodes: vec![], clusters: vec![], rays };
        for (page, _) in (0..).zip(file.pages()).filter(|(_, entry)| entry.kind == PageKind::Mesh) {
            let view = FrameView::new(pages.frame(page));
            (0..view.root_count()).for_each(|slot| probe.collect(&view, view.root(slot)));
        }
        probe
    }

    fn collect(&mut self, view: &FrameView<'a>, at: FrameRef) {
        if at.is_cluster() {
            return self.clusters.push(view.cluster(at));
        }
        let node = view.node(at);
        self.nodes.push(node);
        node.child[..usize::from(node.child_count)]
            .iter()
            .for_each(|&word| self.collect(view, FrameRef(word)));
    }

    /// How many tests [`Probe::run`] makes.
    pub fn test_count(&self, step: Step) -> u64 {
        let of_a_ray = match step {
            Step::Node => self.nodes.len(),
            Step::LeafBoxes => self.clusters.len(),
            Step::Triangles => self.clusters.iter().map(ClusterView::leaf_count).sum(),
        };
        (of_a_ray * self.rays.len()) as u64
    }

    /// Makes them all: how many boxes, or triangles, are met.
    pub fn run(&self, step: Step) -> u64 {
        match self.arithmetic {
            #[cfg(target_arch = "x86_64")]
            Arithmetic::Avx2 => super::avx2::probe(self, step),
            Arithmetic::Scalar => self.count_with::<Scalar<f32>>(step),
            Arithmetic::Deep => self.count_with::<Scalar<f64>>(step),
        }
    }

    #[inline(always)]
    pub(super) fn count_with<K: Kernel>(&self, step: Step) -> u64 {
        let mut met = 0;
        for ray in &self.rays {
            let (kernel, end) = (K::new(&self.frame, ray), ray.t_max as f32);
            match step {
                Step::Node => {
                    for node in &self.nodes {
                        met += u64::from(kernel.node(node, end).mask.count_ones());
                    }
                }
                Step::LeafBoxes => {
                    for cluster in &self.clusters {
                        met += u64::from(kernel.leaf_boxes(cluster, end).mask.count_ones());
                    }
                }
                Step::Triangles => {
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
