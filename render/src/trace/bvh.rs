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
//! Invariants: 1. no allocation, lock, system call or disk access; 2. one page is in use at a time, so pins of others may
//! move; 3. stacks cannot overflow: depth is checked when tables and pages are read (`layout::TREE_DEPTH`);
//! 4. of hits with equal t the one with the lower triangle id wins, so that the answer does not depend on order;
//! 5. what kernels report counts by its refined place: a plate that the ray leaves can seem to lie far ahead in f32.

use super::kernel::{Kernel, Lanes};
use super::pages::{Page, Pages};
use super::ray::{Frame, LatticeRay};
use trex_store::PageFile;
use trex_store::cluster::{ClusterView, FrameRef, FrameView, TopRef};
use trex_store::layout::{LEAF_TRIANGLES, NODE_WIDTH, TREE_DEPTH};

/// Most pages recorded for one ray, the nearest; more than that many are asked for when the ray comes again.
const MISSING_PER_RAY: usize = 16;
/// A node replaces itself by up to eight entries, at every level of the top tree and of a page; then 16 leaves.
const STACK: usize = 2 * TREE_DEPTH * (NODE_WIDTH - 1) + 2 + 2 * NODE_WIDTH;

/// What the traversal of one ray looks for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Goal {
    Closest,
    Any,
}

/// Pages that a ray met and that were not there: id and where the box begins.
#[derive(Clone, Debug)]
pub(super) struct Missing {
    pub(super) pages: [(u32, f64); MISSING_PER_RAY],
    pub(super) count: usize,
    /// Least entry of all.
    pub(super) nearest: f64,
}

impl Missing {
    pub(super) fn none() -> Missing {
        Missing { pages: [(0, 0.0); MISSING_PER_RAY], count: 0, nearest: f64::INFINITY }
    }

    /// The nearest one is always among those recorded: a ray that waits for it has asked for it.
    fn add(&mut self, page: u32, t: f64) {
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

/// What is traced: the tables of a file, and its lattice as rays see it.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) file: &'a PageFile,
    pub(super) frame: Frame,
}

/// The best hit so far.
#[derive(Clone, Copy)]
struct Best<T> {
    /// Its t or the ray's end, rounded up.
    t: T,
    found: Option<Found>,
}

/// Traces one ray. `missing` is filled; a hit in front of all missing boxes is exact.
#[inline(always)]
pub(super) fn trace<K: Kernel, P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    stack: &mut Stack<K::T>,
    (ray, goal): (&LatticeRay, Goal),
    missing: &mut Missing,
) -> Option<Found> {
    let kernel = K::new(&scene.frame, ray);
    let mut best = Best { t: K::t_end(ray.t_max), found: None };
    stack.entries.clear();
    stack.push(K::t_end(0.0), scene.file.superblock().root);
    while let Some((t, word)) = stack.pop_above(0) {
        if t > best.t {
            continue;
        }
        match TopRef::from_word(word) {
            TopRef::Node(index) => {
                let node = &scene.file.top()[index as usize];
                stack.push_lanes(kernel.node(node, best.t), &node.child);
            }
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first = scene.file.pages()[page as usize].first_triangle;
                    let frame = FrameView::new(frame);
                    let seen = PageVisit { frame, page, first_triangle: first, ray, goal };
                    seen.root(&kernel, slot, stack, &mut best);
                    if goal == Goal::Any && best.found.is_some() {
                        break;
                    }
                }
                Page::Missing => missing.add(page, t.into()),
                Page::Damaged => {}
            },
        }
    }
    best.found
}

/// A hit.
#[derive(Clone, Copy)]
pub(super) struct Found {
    /// Lattice t, refined.
    pub(super) t: f64,
    pub(super) page: u32,
    /// Store id.
    pub(super) triangle: u32,
    pub(super) corners: [[i64; 3]; 3],
    pub(super) material: u16,
}

/// A page while a ray is in it.
struct PageVisit<'a> {
    frame: FrameView<'a>,
    page: u32,
    /// Store id of its first triangle.
    first_triangle: u32,
    ray: &'a LatticeRay,
    goal: Goal,
}

impl PageVisit<'_> {
    /// Traverses the subtree under the root in `slot`.
    #[inline(always)]
    fn root<K: Kernel>(&self, kernel: &K, slot: u32, stack: &mut Stack<K::T>, best: &mut Best<K::T>) {
        let floor = stack.entries.len();
        stack.push(K::t_end(0.0), self.frame.root(slot as usize).0);
        while let Some((t, word)) = stack.pop_above(floor) {
            if t > best.t {
                continue;
            }
            let at = FrameRef(word);
            if !at.is_cluster() {
                let node = self.frame.node(at);
                stack.push_lanes(kernel.node(node, best.t), &node.child);
                continue;
            }
            self.cluster(kernel, self.frame.cluster(at), stack, best);
            if self.goal == Goal::Any && best.found.is_some() {
                return;
            }
        }
    }

    /// Tests the leaves of a cluster, nearest first.
    #[inline(always)]
    fn cluster<K: Kernel>(
        &self,
        kernel: &K,
        cluster: ClusterView<'_>,
        stack: &mut Stack<K::T>,
        best: &mut Best<K::T>,
    ) {
        const LEAF: [u32; 8] = [0, 1, 2, 3, 4, 5, 6, 7];
        let floor = stack.entries.len();
        stack.push_lanes(kernel.leaf_boxes(&cluster, 0, best.t), &LEAF);
        if cluster.leaf_count() > 8 {
            stack.push_lanes(kernel.leaf_boxes(&cluster, 1, best.t), &LEAF.map(|leaf| leaf + 8));
        }
        while let Some((t, leaf)) = stack.pop_above(floor) {
            if t > best.t {
                continue;
            }
            let mut mask = kernel.triangles(&cluster, leaf as usize, best.t);
            while mask != 0 {
                let index = leaf as usize * LEAF_TRIANGLES + mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let corners = cluster.triangle(index);
                let Some(t) = self.ray.reach(corners) else { continue };
                let triangle = self.first_triangle + (cluster.first_triangle() + index) as u32;
                if best.found.is_none_or(|found| (t, triangle) < (found.t, found.triangle)) {
                    best.t = K::t_end(t);
                    let (page, material) = (self.page, cluster.material(index));
                    best.found = Some(Found { t, page, triangle, corners, material });
                    if self.goal == Goal::Any {
                        stack.entries.truncate(floor);
                        return;
                    }
                }
            }
        }
    }
}

/// Entries with their entry t; the nearest of a node on top. One for top tree, page and cluster together: each
/// level works above the `floor` where it began.
pub(super) struct Stack<T> {
    entries: Vec<(T, u32)>,
}

impl<T: Copy + PartialOrd> Stack<T> {
    pub(super) fn new() -> Stack<T> {
        Stack { entries: Vec::with_capacity(STACK) }
    }

    fn push(&mut self, t: T, word: u32) {
        debug_assert!(self.entries.len() < STACK, "depth was checked when the tables were read");
        self.entries.push((t, word));
    }

    fn pop_above(&mut self, floor: usize) -> Option<(T, u32)> {
        if self.entries.len() > floor { self.entries.pop() } else { None }
    }

    /// Pushes the lanes that are set, farthest first.
    #[inline(always)]
    fn push_lanes(&mut self, lanes: Lanes<T>, words: &[u32; 8]) {
        let first = self.entries.len();
        let mut mask = lanes.mask;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            self.push(lanes.t[lane], words[lane]);
            let mut at = self.entries.len() - 1;
            while at > first && self.entries[at - 1].0 < self.entries[at].0 {
                self.entries.swap(at - 1, at);
                at -= 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_missing_pages_the_nearest_are_kept() {
        let mut missing = Missing::none();
        for page in 0..100 {
            missing.add(page, f64::from(page * 37 % 100));
        }
        let mut kept: Vec<f64> = missing.pages[..missing.count].iter().map(|(_, t)| *t).collect();
        kept.sort_by(f64::total_cmp);
        assert_eq!(kept, (0..MISSING_PER_RAY as u32).map(f64::from).collect::<Vec<_>>());
        assert_eq!(missing.nearest, 0.0);
    }
}
