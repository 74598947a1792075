//! `Probe`: steps of traversal on their own, for benchmarks: the tests of nodes, of leaf boxes and of triangles,
//! without the way that leads to them.
//!
//! Invariant: each ray is tested against all that was collected, met or not.

use super::Ray;
use super::arithmetic::Arithmetic;
use super::lattice_ray::LatticeFrame;
use super::pages::AllResident;
use super::scalar::Scalar;
use super::steps::{ProbeStep, Steps};
use trex_store::PageFile;
use trex_store::cluster::{FrameRef, FrameView};
use trex_store::layout::PageKind;

/// Nodes and clusters of a file, rays, and the arithmetic that tests them.
pub struct Probe<'a> {
    arithmetic: Arithmetic,
    steps: Steps<'a>,
}

impl<'a> Probe<'a> {
    /// A probe of what the pages of a file hold, and of those of `rays` that come to its box.
    ///
    /// # Panics
    /// When `arithmetic` does not fit the file or the machine.
    pub fn new(file: &PageFile, pages: &'a AllResident, rays: &[Ray], arithmetic: Arithmetic) -> Probe<'a> {
        arithmetic.check(file);
        let frame = LatticeFrame::new(file);
        let rays = rays.iter().filter_map(|ray| frame.enter(ray)).collect();
        let mut probe = Probe { arithmetic, steps: Steps { frame, nodes: vec![], clusters: vec![], rays } };
        for (page, _) in (0..).zip(file.pages()).filter(|(_, entry)| entry.kind == PageKind::Mesh) {
            let view = FrameView::new(pages.frame(page));
            (0..view.root_count()).for_each(|slot| probe.collect(&view, view.root(slot)));
        }
        probe
    }

    fn collect(&mut self, view: &FrameView<'a>, at: FrameRef) {
        if at.is_cluster() {
            return self.steps.clusters.push(view.cluster(at));
        }
        let node = view.node(at);
        self.steps.nodes.push(node);
        node.child[..usize::from(node.child_count)]
            .iter()
            .for_each(|&word| self.collect(view, FrameRef(word)));
    }

    /// Count of tests that [`Probe::run`] makes.
    pub fn test_count(&self, step: ProbeStep) -> u64 {
        self.steps.test_count(step)
    }

    /// Makes all tests of `step`. Gives the count of boxes, or triangles, that are met.
    pub fn run(&self, step: ProbeStep) -> u64 {
        match self.arithmetic {
            #[cfg(target_arch = "x86_64")]
            Arithmetic::Avx2 => super::simd::probe(&self.steps, step),
            Arithmetic::Scalar => self.steps.count_with::<Scalar<f32>>(step),
            Arithmetic::Deep => self.steps.count_with::<Scalar<f64>>(step),
        }
    }
}
