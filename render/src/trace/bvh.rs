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
//! primary rays 16 % slower); huge pages under the frames (no faster).
//!
//! Invariants: 1. no allocation, lock, system call or disk access; 2. one page is in use at a time, so pins of others
//! may move; 3. stacks cannot overflow: depth is checked when tables and pages are read (`layout::TREE_DEPTH`); 4. of
//! hits with equal t the one with the lower triangle id wins, so that the answer does not depend on order; 5. what
//! kernels report counts by its refined place: a plate that the ray leaves can seem to lie far ahead in f32.

use super::Ray;
use super::kernel::{Kernel, Lanes};
use super::lattice_ray::{LatticeFrame, LatticeRay};
use super::pages::{Page, Pages};
use trex_store::PageFile;
use trex_store::cluster::{CLUSTER_HEAD_BYTES, ClusterView, FrameRef, FrameView, LEAF_PLANES, TopRef};
use trex_store::layout::{CLUSTER_LEAVES, NODE_WIDTH, TREE_DEPTH};

/// Most pages recorded for one ray, the nearest; more than that many are asked for when the ray comes again.
const MISSING_PER_RAY: usize = 16;
/// A node replaces itself by up to eight entries, at every level of the top tree and of a page; then 16 leaves. A
/// power of two, so that places need no check.
pub(super) const STACK: usize = (2 * TREE_DEPTH * (NODE_WIDTH - 1) + 2 + CLUSTER_LEAVES).next_power_of_two();

/// Cache lines that are fetched ahead of a cluster's leaves: mostly most of its indices and vertices.
const BODY_LINES: usize = 9;

/// The goal of the traversal of one ray.
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
    /// An empty list.
    pub(super) fn none() -> Missing {
        Missing { pages: [(0, 0.0); MISSING_PER_RAY], count: 0, nearest: f64::INFINITY }
    }

    /// Empties the list for the next ray.
    #[cfg(target_arch = "x86_64")]
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
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) file: &'a PageFile,
    pub(super) frame: LatticeFrame,
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
    pub(super) fn new(ray: &LatticeRay) -> Best {
        Best { t: t_above(ray.t_max), found: None }
    }
}

/// A ray that came to the model's box, and what it found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ended {
    pub(super) ray: LatticeRay,
    pub(super) found: Option<Found>,
}

/// Traces one ray; `None` where it misses the model's box. `missing` is filled; a hit in front of all missing boxes is
/// exact.
#[inline(always)]
pub(super) fn trace_ray<K: Kernel, P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    stack: &mut Stack,
    (ray, goal): (&Ray, Goal),
    missing: &mut Missing,
) -> Option<Ended> {
    let ray = scene.frame.enter(ray)?;
    let kernel = K::new(&scene.frame, &ray);
    let mut pending = Pending { entries: &mut stack.entries, len: 0 };
    let mut best = Best::new(&ray);
    let root = Entry::new(0.0, scene.file.superblock().root);
    walk(scene, pages, &kernel, (&ray, goal), root, &mut pending, &mut best, missing);
    Some(Ended { ray, found: best.found })
}

/// Traverses what is under an entry of the top tree.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // Of one ray, all of it in registers.
pub(super) fn walk<K: Kernel, P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    kernel: &K,
    (ray, goal): (&LatticeRay, Goal),
    from: Entry,
    pending: &mut Pending<'_>,
    best: &mut Best,
    missing: &mut Missing,
) {
    let mut next = Some(from);
    while let Some(at) = next.or_else(|| pending.pop_above(0, best.t)) {
        next = None;
        match TopRef::from_word(at.word()) {
            TopRef::Node(index) => {
                let node = &scene.file.top()[index as usize];
                let met = kernel.node(node, best.t);
                next = pending.push(met.mask, |child| met.entry(child, node.child[child % NODE_WIDTH]));
            }
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first_triangle = scene.file.pages()[page as usize].first_triangle;
                    let frame = FrameView::new(frame);
                    let page = OpenPage { frame, page, first_triangle };
                    let visit = PageVisit { page, ray, goal };
                    let root = Entry::new(at.t(), frame.root(slot as usize).0);
                    visit.under(kernel, root, pending, best);
                    if goal == Goal::Any && best.found.is_some() {
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
    /// Lattice t, refined.
    pub(super) t: f64,
    pub(super) page: u32,
    /// Store id of the triangle.
    pub(super) triangle: u32,
    pub(super) corners: [[i64; 3]; 3],
    pub(super) material: u16,
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
    pub(super) ray: &'a LatticeRay,
    pub(super) goal: Goal,
}

impl PageVisit<'_> {
    /// Traverses what is under an entry of the page.
    #[inline(always)]
    pub(super) fn under<K: Kernel>(
        &self,
        kernel: &K,
        from: Entry,
        pending: &mut Pending<'_>,
        best: &mut Best,
    ) {
        let floor = pending.len;
        let mut next = Some(from);
        while let Some(at) = next.or_else(|| pending.pop_above(floor, best.t)) {
            next = None;
            let at = FrameRef(at.word());
            if !at.is_cluster() {
                let node = self.page.frame.node(at);
                let met = kernel.node(node, best.t);
                next = pending.push(met.mask, |child| met.entry(child, node.child[child % NODE_WIDTH]));
                continue;
            }
            self.cluster(kernel, self.page.frame.cluster(at), pending, best);
            if self.goal == Goal::Any && best.found.is_some() {
                pending.len = floor;
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
        pending: &mut Pending<'_>,
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
            let mut mask = kernel.triangles(&cluster, leaf, best.t);
            while mask != 0 {
                let place = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let corners = cluster.triangle(leaf, place);
                let Some(t) = self.ray.reach(corners) else { continue };
                let index = cluster.leaf_first(leaf) + place;
                let triangle = self.page.first_triangle + (cluster.first_triangle() + index) as u32;
                if best.found.is_none_or(|found| (t, triangle) < (found.t, found.triangle)) {
                    best.t = t_above(t);
                    let (page, material) = (self.page.page, cluster.material(index));
                    best.found = Some(Found { t, page, triangle, corners, material });
                    if self.goal == Goal::Any {
                        return;
                    }
                }
            }
        }
    }
}

/// An entry of the stack: where to go on, and the t where its box begins, in one number that is ordered by t.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry(u64);

impl Entry {
    /// `t >= 0`: the bits of such numbers are ordered as they are.
    #[inline(always)]
    pub(super) fn new(t: f32, word: u32) -> Entry {
        Entry(u64::from(t.to_bits()) << 32 | u64::from(word))
    }

    #[inline(always)]
    fn t(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    #[inline(always)]
    fn word(self) -> u32 {
        self.0 as u32
    }
}

impl<const N: usize> Lanes<N> {
    #[inline(always)]
    fn entry(&self, lane: usize, word: u32) -> Entry {
        Entry::new(self.t[lane % N], word)
    }
}

/// Room for the entries of one ray at a time.
pub(super) struct Stack {
    pub(super) entries: Box<[Entry; STACK]>,
}

impl Stack {
    /// An empty stack.
    pub(super) fn new() -> Stack {
        Stack { entries: Box::new([Entry(0); STACK]) }
    }
}

/// The stack of what is left to visit; the nearest of a node on top. One for top tree, page and cluster together:
/// each level works above the `floor` where it began.
pub(super) struct Pending<'a> {
    pub(super) entries: &'a mut [Entry; STACK],
    pub(super) len: usize,
}

impl Pending<'_> {
    /// The topmost entry that begins before `t_max`.
    #[inline(always)]
    fn pop_above(&mut self, floor: usize, t_max: f32) -> Option<Entry> {
        let last = Entry::new(t_max, u32::MAX);
        while self.len > floor {
            self.len -= 1;
            let entry = self.entries[self.len % STACK];
            if entry <= last {
                return Some(entry);
            }
        }
        None
    }

    #[inline(always)]
    fn put(&mut self, entry: Entry) {
        debug_assert!(self.len < STACK, "depth was checked when the tables were read");
        self.entries[self.len % STACK] = entry;
        self.len += 1;
    }

    /// Gives the nearest of the lanes that are set and puts the others, farthest first.
    #[inline(always)]
    fn push(&mut self, mut mask: u32, entry: impl Fn(usize) -> Entry) -> Option<Entry> {
        let count = mask.count_ones();
        let mut take = || {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask.wrapping_sub(1);
            entry(lane)
        };
        match count {
            0 => None,
            1 => Some(take()),
            2 => {
                let (a, b) = (take(), take());
                self.put(a.max(b));
                Some(a.min(b))
            }
            count => {
                let first = self.len;
                for _ in 0..count {
                    let new = take();
                    let mut at = self.len;
                    self.put(new);
                    while at > first && self.entries[(at - 1) % STACK] < new {
                        self.entries[at % STACK] = self.entries[(at - 1) % STACK];
                        at -= 1;
                    }
                    self.entries[at % STACK] = new;
                }
                self.len -= 1;
                Some(self.entries[self.len % STACK])
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
