//! Traversal of the top tree and of pages, front to back, for closest and for any hit.
//!
//! ```text
//! stack = root
//! pop the nearest; behind the best hit? drop it
//!   node of the top tree  -> push the children that the ray meets, farthest first
//!   page root             -> page there?    nodes and clusters of the page, on a stack of their own
//!                            page missing?  record it and where its box begins, and go on
//! the answer is exact when no recorded box begins before the hit
//! ```
//!
//! Lost, on the 20M iso-surface: rays in turns, 8 or 16 of them, with what each needs next fetched ahead (incoherent
//! rays no faster: they wait for instructions, not for memory); children put without a branch on their number (single
//! primary rays 16 % slower); huge pages under the frames (no faster). On 5M triangles of a plant and of a CAD set:
//! children in any order where any hit will do (no faster: what sorting takes, the nearest give back). On 20M: in
//! packets the boxes of a cluster with all rays before any of its leaves (primary rays of a plant 5 % faster, others
//! within noise).
//!
//! Invariants: 1. no allocation, lock, system call or disk access; 2. one page is in use at a time, so pins of others
//! may move; 3. stacks cannot overflow: depth is checked when tables and pages are read (`layout::TREE_DEPTH`); 4. of
//! hits with equal t the one with the lower triangle id wins, so that the answer does not depend on order; 5. what
//! kernels report counts by its refined place: a plate that the ray leaves can seem to lie far ahead in f32.

use super::Ray;
use super::attribute_pages::AttributePages;
use super::kernel::{Kernel, TrianglesMet};
use super::lattice_ray::{LatticeFrame, RefinedHit, Span};
use super::pages::{Page, Pages};
use super::parts::is_hidden;
use super::stack::{Stack, StackEntry, VisitStack};
use std::sync::Arc;
use trex_store::PageFile;
use trex_store::cluster::{
    CLUSTER_HEAD_BYTES, ClusterView, FrameRef, FrameView, LEAF_PLANES, TopRef, TreeNode,
};

/// Most pages recorded for one ray, the nearest; more than that many are asked for when the ray comes again.
const MISSING_PER_RAY: usize = 16;
/// Cache lines that are fetched ahead of a cluster's leaves: mostly most of its indices and vertices.
const BODY_LINES: usize = 9;

/// The goal of the traversal of rays.
pub(super) trait Goal {
    /// True where any hit is enough: then it is not told where it is.
    const IS_ANY: bool;
    /// True when triangles of hidden materials are passed by.
    const PASSES_HIDDEN: bool = false;
}

/// The closest hit.
pub(super) struct ClosestHit;

/// Any hit.
pub(super) struct AnyHit;

/// The closest hit on a material that is shown.
pub(super) struct ClosestShownHit;

/// Any hit on a material that is shown.
pub(super) struct AnyShownHit;

impl Goal for ClosestShownHit {
    const IS_ANY: bool = false;
    const PASSES_HIDDEN: bool = true;
}

impl Goal for AnyShownHit {
    const IS_ANY: bool = true;
    const PASSES_HIDDEN: bool = true;
}

impl Goal for ClosestHit {
    const IS_ANY: bool = false;
}

impl Goal for AnyHit {
    const IS_ANY: bool = true;
}

/// Pages that a ray met and that were not there: id and where the box begins.
#[derive(Clone, Debug)]
pub(super) struct MissingPages {
    pub(super) pages: [(u32, f64); MISSING_PER_RAY],
    pub(super) count: usize,
    /// Least entry of all.
    pub(super) nearest: f64,
}

impl MissingPages {
    /// An empty list.
    pub(super) fn none() -> MissingPages {
        MissingPages { pages: [(0, 0.0); MISSING_PER_RAY], count: 0, nearest: f64::INFINITY }
    }

    /// Empties the list for the next ray.
    pub(super) fn clear(&mut self) {
        (self.count, self.nearest) = (0, f64::INFINITY);
    }

    /// The nearest one is always among those recorded: a ray that waits for it has asked for it.
    pub(super) fn add(&mut self, page: u32, t: f64) {
        self.nearest = self.nearest.min(t);
        if self.count < MISSING_PER_RAY {
            self.pages[self.count] = (page, t);
            self.count += 1;
            return;
        }
        let farthest =
            self.pages.iter_mut().max_by(|a, b| a.1.total_cmp(&b.1)).expect("there is room for some");
        if t < farthest.1 {
            *farthest = (page, t);
        }
    }
}

/// The scene that is traced: the tables of a file, and its lattice as rays see it.
pub(super) struct LatticeScene {
    pub(super) file: Arc<PageFile>,
    pub(super) frame: LatticeFrame,
    /// Where hits have their colours and shading normals from; `None` for a file without.
    pub(super) attributes: Option<AttributePages>,
    /// Materials that are hidden, a bit each: see [`super::parts`].
    pub(super) hidden: Vec<u64>,
}

/// The best hit so far.
#[derive(Clone, Copy)]
pub(super) struct Best {
    /// t of the best hit or the ray's end, rounded up.
    pub(super) t: f32,
    pub(super) found: Option<Found>,
}

impl Best {
    /// No hit yet.
    pub(super) fn new(span: &Span) -> Best {
        Best { t: t_above(span.t_max), found: None }
    }
}

/// A ray that came to the model's box, and what it found.
#[derive(Clone, Copy, Debug)]
pub(super) struct RayEnd {
    pub(super) span: Span,
    pub(super) found: Option<Found>,
}

/// Traces one ray; `None` where it misses the model's box. `missing` is filled; a hit in front of all missing boxes is
/// exact.
#[inline(always)]
pub(super) fn trace_ray<K: Kernel, P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    ray: &Ray,
    missing: &mut MissingPages,
) -> Option<RayEnd> {
    let (span, kernel) = K::enter(&scene.frame, ray)?;
    let mut pending = VisitStack { entries: &mut stack.entries, len: 0 };
    let mut best = Best::new(&span);
    let root = StackEntry::new(0.0, scene.file.superblock().root);
    walk::<K, P, G>(scene, pages, &kernel, &span, root, &mut pending, &mut best, missing);
    Some(RayEnd { span, found: best.found })
}

/// Traverses what is under an entry of the top tree.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // Of one ray, all of it in registers.
pub(super) fn walk<K: Kernel, P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    kernel: &K,
    span: &Span,
    from: StackEntry,
    pending: &mut VisitStack<'_>,
    best: &mut Best,
    missing: &mut MissingPages,
) {
    let mut next = Some(from);
    while let Some(at) = next.or_else(|| pending.pop_above(0, best.t)) {
        next = None;
        match TopRef::from_word(at.word()) {
            TopRef::Node(index) => {
                let node = &scene.file.top()[index as usize];
                let met = kernel.node(node.boxes(), best.t);
                next = pending.push(met.mask, |child| met.entry(child, node.word(child)));
            }
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first_triangle = scene.file.pages()[page as usize].first_triangle;
                    let frame = FrameView::new(frame);
                    let page = OpenPage { frame, page, first_triangle };
                    let visit = PageVisit { page, span, hidden: &scene.hidden };
                    let root = StackEntry::new(at.t(), frame.root(slot as usize).0);
                    visit.under::<K, G>(kernel, root, pending, best);
                    if G::IS_ANY && best.found.is_some() {
                        pending.len = 0;
                    }
                }
                Page::Missing => missing.add(page, at.t().into()),
                Page::Damaged => {}
            },
        }
    }
}

/// A lattice t as kernels compare with it: rounded up.
#[inline(always)]
pub(super) fn t_above(t: f64) -> f32 {
    (t as f32).next_up()
}

/// A hit of a kernel, refined.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub(super) refined: RefinedHit,
    pub(super) page: u32,
    /// Store id of the triangle.
    pub(super) triangle: u32,
    pub(super) material: u16,
}

impl Found {
    /// A hit of which nothing is asked.
    const UNTOLD: Found = Found {
        refined: RefinedHit { t: 0.0, normal: [0.0; 3], size: 0.0, weights: [1.0, 0.0, 0.0] },
        page: 0,
        triangle: 0,
        material: 0,
    };
}

/// A page that is there.
#[derive(Clone, Copy)]
pub(super) struct OpenPage<'a> {
    pub(super) frame: FrameView<'a>,
    /// Index of the page.
    pub(super) page: u32,
    /// Store id of its first triangle.
    pub(super) first_triangle: u32,
}

/// A page while a ray is in it.
pub(super) struct PageVisit<'a> {
    pub(super) page: OpenPage<'a>,
    pub(super) span: &'a Span,
    pub(super) hidden: &'a [u64],
}

impl PageVisit<'_> {
    /// Traverses what is under an entry of the page.
    #[inline(always)]
    pub(super) fn under<K: Kernel, G: Goal>(
        &self,
        kernel: &K,
        from: StackEntry,
        pending: &mut VisitStack<'_>,
        best: &mut Best,
    ) {
        let floor = pending.len;
        let mut next = Some(from);
        while let Some(at) = next.or_else(|| pending.pop_above(floor, best.t)) {
            next = None;
            let at = FrameRef(at.word());
            if !at.is_cluster() {
                let node = self.page.frame.node(at);
                let met = kernel.node(node.boxes(), best.t);
                next = pending.push(met.mask, |child| met.entry(child, node.word(child)));
                continue;
            }
            let Some(cluster) = self.page.frame.cluster(at) else { continue };
            self.cluster::<K, G>(kernel, cluster, pending, best);
            if G::IS_ANY && best.found.is_some() {
                pending.len = floor;
                return;
            }
        }
    }

    /// Tests the leaves of a cluster, nearest first.
    #[inline(always)]
    fn cluster<K: Kernel, G: Goal>(
        &self,
        kernel: &K,
        cluster: ClusterView<'_>,
        pending: &mut VisitStack<'_>,
        best: &mut Best,
    ) {
        let floor = pending.len;
        let met = kernel.leaf_boxes(&cluster, best.t);
        if met.mask != 0 {
            let body = CLUSTER_HEAD_BYTES + LEAF_PLANES * cluster.leaf_count();
            K::prefetch(cluster.bytes(), body, BODY_LINES);
        }
        let mut next = pending.push(met.mask, |leaf| met.entry(leaf, leaf as u32));
        while let Some(at) = next.or_else(|| pending.pop_above(floor, best.t)) {
            next = None;
            let leaf = at.word() as usize;
            let t_sure = if G::IS_ANY && !G::PASSES_HIDDEN { self.span.t_sure } else { 0.0 };
            let TrianglesMet { met: mut mask, sure } = kernel.triangles(&cluster, leaf, (best.t, t_sure));
            if G::IS_ANY && !G::PASSES_HIDDEN && sure != 0 {
                best.found = Some(Found::UNTOLD);
                return;
            }
            while mask != 0 {
                let place = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let index = cluster.leaf_first(leaf) + place;
                if G::PASSES_HIDDEN && is_hidden(self.hidden, cluster.material(index).into()) {
                    continue;
                }
                let refined = kernel.refine(&cluster, leaf, place);
                if !self.span.holds(refined.t) {
                    continue;
                }
                if G::IS_ANY {
                    best.found = Some(Found::UNTOLD);
                    return;
                }
                let triangle = self.page.first_triangle + (cluster.first_triangle() + index) as u32;
                if best.found.is_none_or(|f| (refined.t, triangle) < (f.refined.t, f.triangle)) {
                    best.t = t_above(refined.t);
                    let (page, material) = (self.page.page, cluster.material(index));
                    best.found = Some(Found { refined, page, triangle, material });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_missing_pages_the_nearest_are_kept() {
        let mut missing = MissingPages::none();
        for page in 0..100 {
            missing.add(page, f64::from(page * 37 % 100));
        }
        let mut kept: Vec<f64> = missing.pages[..missing.count].iter().map(|(_, t)| *t).collect();
        kept.sort_by(f64::total_cmp);
        assert_eq!(kept, (0..MISSING_PER_RAY as u32).map(f64::from).collect::<Vec<_>>());
        assert_eq!(missing.nearest, 0.0);
    }
}
