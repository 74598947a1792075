//! Packets: eight rays that go much the same way share the nodes that they enter, the pages, and the decisions.
//!
//! ```text
//! eight rays -> those with the signs of the first: nodes together, a box against eight rays at a time
//!                 a cluster, or SPLIT rays left at a node -> each goes on by itself (`bvh.rs`)
//!            -> the others: one by one
//! ```
//!
//! Why unsafe: intrinsics, on registers and on rows of eight; `trace_packet` asks its caller for what they need.
//!
//! Invariants: 1. a ray gets the answer that it gets alone: boxes only leave out what it cannot meet, and of hits the
//! order does not matter; 2. as `bvh.rs`: no allocation, one page in use at a time, stacks that cannot overflow.
#![allow(unsafe_code)]

use super::avx2::Avx2;
use crate::trace::Ray;
use crate::trace::bvh::{Best, Goal, LatticeScene, MissingPages, OpenPage, PageVisit, RayEnd, t_above, walk};
use crate::trace::kernel::Kernel;
use crate::trace::pages::{Page, Pages};
use crate::trace::scalar::Real;
use crate::trace::stack::{STACK, Stack, StackEntry, VisitStack};
use std::arch::x86_64::*;
use trex_store::cluster::{ChildBoxes, FrameRef, FrameView, TopRef, TreeNode};
use trex_store::layout::NODE_WIDTH;

/// Rays of a packet: what a register holds.
pub(in crate::trace) const PACKET_RAYS: usize = 8;
/// Count of rays left at a node, or fewer, that go on by themselves.
const SPLIT: u32 = 2;

/// A number per ray.
type RayRow = [f32; PACKET_RAYS];

/// An entry of the stack: where to go on with which rays, and where its box begins for each.
#[derive(Clone, Copy)]
struct PacketEntry {
    t: RayRow,
    word: u32,
    /// A bit a ray.
    rays: u32,
}

/// Room for a packet; and what came of the last one, for the rays that reached the model's box, in their order.
pub(in crate::trace) struct PacketRoom {
    waiting: Box<[PacketEntry; STACK]>,
    kernels: Vec<Avx2>,
    /// Rays and what they found.
    pub(in crate::trace) ended: Vec<RayEnd>,
    /// Index of each among the rays that were asked.
    pub(in crate::trace) places: Vec<usize>,
    pub(in crate::trace) missing: [MissingPages; PACKET_RAYS],
}

impl Default for PacketRoom {
    fn default() -> PacketRoom {
        PacketRoom {
            waiting: Box::new([PacketEntry { t: [0.0; PACKET_RAYS], word: 0, rays: 0 }; STACK]),
            kernels: Vec::with_capacity(PACKET_RAYS),
            ended: Vec::with_capacity(PACKET_RAYS),
            places: Vec::with_capacity(PACKET_RAYS),
            missing: std::array::from_fn(|_| MissingPages::none()),
        }
    }
}

/// Rays as box tests see them: see `Slabs`; a row an axis.
struct PacketRays {
    cell: [__m256i; 3],
    inverse: [__m256; 3],
    start_near: [__m256; 3],
    start_far: [__m256; 3],
    /// Axes along which the direction of all rays is negative.
    negative: [bool; 3],
}

/// The packet under way.
struct PacketWalk<'a> {
    boxes: PacketRays,
    /// As many as there are rays.
    kernels: &'a [Avx2],
    /// The t of the best hit of each; below all where one is enough and found.
    t_max: RayRow,
    ended: &'a mut [RayEnd],
    missing: &'a mut [MissingPages; PACKET_RAYS],
    waiting: &'a mut [PacketEntry; STACK],
    len: usize,
}

/// Traces up to eight rays; `room` holds their answers.
///
/// # Safety
/// The caller runs with AVX2 and FMA.
#[inline(always)]
pub(in crate::trace) unsafe fn trace_packet<P: Pages, G: Goal>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    rays: &[Ray],
    room: &mut PacketRoom,
) {
    let PacketRoom { waiting, kernels, ended, places, missing } = room;
    ended.clear();
    places.clear();
    kernels.clear();
    for (place, ray) in rays.iter().take(PACKET_RAYS).enumerate() {
        if let Some((span, kernel)) = Avx2::enter(&scene.frame, ray) {
            ended.push(RayEnd { span, found: None });
            places.push(place);
            kernels.push(kernel);
        }
    }
    let Some(first) = kernels.first() else { return };
    let count = kernels.len();
    let (mut together, mut t_max) = (0, [0.0; PACKET_RAYS]);
    for (i, kernel) in kernels.iter().enumerate() {
        together |= u32::from(kernel.goes_with(first)) << i;
        t_max[i] = t_above(ended[i].span.t_max);
    }
    missing[..count].iter_mut().for_each(MissingPages::clear);
    let mut pending = VisitStack { entries: &mut stack.entries, len: 0 };
    let mut packet = PacketWalk {
        // SAFETY: by the contract.
        boxes: unsafe { PacketRays::new(kernels) },
        kernels,
        t_max,
        ended,
        missing,
        waiting,
        len: 0,
    };
    let root = scene.file.superblock().root;
    packet.put(PacketEntry { t: [0.0; PACKET_RAYS], word: root, rays: together });
    while let Some(at) = packet.pop_above(0) {
        if at.rays.count_ones() <= SPLIT {
            packet.alone::<P, G>(scene, pages, &mut pending, at);
            continue;
        }
        match TopRef::from_word(at.word) {
            TopRef::Node(index) => packet.node(&scene.file.top()[index as usize], scene, at.rays),
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first_triangle = scene.file.pages()[page as usize].first_triangle;
                    let page = OpenPage { frame: FrameView::new(frame), page, first_triangle };
                    packet.page::<G>(&page, slot, scene, &mut pending, at);
                }
                Page::Missing => {
                    for ray in bits(at.rays) {
                        packet.missing[ray].add(page, at.t[ray].into());
                    }
                }
                Page::Damaged => {}
            },
        }
    }
    let others = ((1 << count) - 1) & !together;
    if others != 0 {
        packet.alone::<P, G>(
            scene,
            pages,
            &mut pending,
            PacketEntry { t: [0.0; PACKET_RAYS], word: root, rays: others },
        );
    }
}

impl PacketWalk<'_> {
    /// Rays that go on by themselves.
    #[inline(always)]
    fn alone<P: Pages, G: Goal>(
        &mut self,
        scene: &LatticeScene,
        pages: &mut P,
        pending: &mut VisitStack<'_>,
        at: PacketEntry,
    ) {
        for i in bits(at.rays) {
            let kernel = &self.kernels[i];
            let RayEnd { span, found } = &mut self.ended[i];
            let mut best = Best { t: self.t_max[i], found: *found };
            let from = StackEntry::new(at.t[i], at.word);
            walk::<_, P, G>(scene, pages, kernel, span, from, pending, &mut best, &mut self.missing[i]);
            *found = best.found;
            self.settle::<G>(i, best.t);
        }
    }

    /// Traverses a page under the root in `slot`.
    #[inline(always)]
    fn page<G: Goal>(
        &mut self,
        page: &OpenPage<'_>,
        slot: u32,
        scene: &LatticeScene,
        pending: &mut VisitStack<'_>,
        at: PacketEntry,
    ) {
        let floor = self.len;
        self.put(PacketEntry { word: page.frame.root(slot as usize).0, ..at });
        while let Some(at) = self.pop_above(floor) {
            let word = FrameRef(at.word);
            if !word.is_cluster() && at.rays.count_ones() > SPLIT {
                self.node(page.frame.node(word), scene, at.rays);
                continue;
            }
            for i in bits(at.rays) {
                let kernel = &self.kernels[i];
                let RayEnd { span, found } = &mut self.ended[i];
                let mut best = Best { t: self.t_max[i], found: *found };
                let visit = PageVisit { page: *page, span, hidden: &scene.hidden };
                visit.under::<_, G>(kernel, StackEntry::new(at.t[i], at.word), pending, &mut best);
                *found = best.found;
                self.settle::<G>(i, best.t);
            }
        }
    }

    /// Takes over how far ray `i` still looks.
    #[inline(always)]
    fn settle<G: Goal>(&mut self, i: usize, t: f32) {
        let is_done = G::IS_ANY && self.ended[i].found.is_some();
        self.t_max[i] = if is_done { -1.0 } else { t };
    }

    /// The topmost that still matters to some of its rays, and to which.
    #[inline(always)]
    fn pop_above(&mut self, floor: usize) -> Option<PacketEntry> {
        while self.len > floor {
            self.len -= 1;
            let mut at = self.waiting[self.len % STACK];
            // SAFETY: both are rows; the caller runs with AVX2.
            at.rays &= unsafe {
                let (t, t_max) = (_mm256_loadu_ps(at.t.as_ptr()), _mm256_loadu_ps(self.t_max.as_ptr()));
                _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(t, t_max)) as u32
            };
            if at.rays != 0 {
                return Some(at);
            }
        }
        None
    }

    #[inline(always)]
    fn put(&mut self, at: PacketEntry) {
        debug_assert!(self.len < STACK, "depth was checked when the tables were read");
        self.waiting[self.len % STACK] = at;
        self.len += 1;
    }

    /// Puts the children of a node that some of `rays` meet, the nearest on top.
    #[inline(always)]
    fn node(&mut self, node: &impl TreeNode, scene: &LatticeScene, rays: u32) {
        let mut t = [[0.0; PACKET_RAYS]; NODE_WIDTH];
        // SAFETY: the caller runs with AVX2 and FMA.
        let met = unsafe { self.boxes.meet(node.boxes(), scene.frame.node_shift, &self.t_max, &mut t) };
        // By the t of one ray: rays of a packet mostly agree.
        let (first, mut count) = (self.len, 0);
        let mut order = [0u64; NODE_WIDTH];
        for child in 0..NODE_WIDTH {
            let met = met[child] & rays;
            if met == 0 {
                continue;
            }
            let nearest = t[child][met.trailing_zeros() as usize % PACKET_RAYS];
            let new = u64::from(nearest.to_bits()) << 32 | u64::from(met) << 8 | child as u64;
            let mut at = count;
            while at > 0 && order[at - 1] < new {
                order[at] = order[at - 1];
                at -= 1;
            }
            order[at] = new;
            count += 1;
        }
        debug_assert!(first + count <= STACK, "depth was checked when the tables were read");
        for new in &order[..count] {
            let child = *new as usize % NODE_WIDTH;
            let waiting =
                PacketEntry { t: t[child], word: node.word(child), rays: (*new >> 8) as u32 & 0xff };
            self.put(waiting);
        }
    }
}

impl PacketRays {
    /// Of one to eight rays; lanes behind the last mean nothing.
    ///
    /// # Safety
    /// The caller runs with AVX2.
    #[inline(always)]
    unsafe fn new(rays: &[Avx2]) -> PacketRays {
        // SAFETY: registers only; the caller runs with AVX2.
        unsafe {
            let rows = |part: fn(&Avx2) -> __m128| {
                columns(std::array::from_fn(|i| part(&rays[i.min(rays.len() - 1)])))
            };
            PacketRays {
                cell: rows(|ray| _mm_castsi128_ps(ray.cell)).map(|row| _mm256_castps_si256(row)),
                inverse: rows(|ray| ray.inverse),
                start_near: rows(|ray| ray.start_near),
                start_far: rows(|ray| ray.start_far),
                negative: rays[0].negative_axes(),
            }
        }
    }

    /// The children of a node: which rays meet each, and where. The same sums as `Slabs::meet`.
    ///
    /// # Safety
    /// The caller runs with AVX2 and FMA.
    #[inline(always)]
    unsafe fn meet(
        &self,
        node: &ChildBoxes,
        shift: u32,
        t_max: &RayRow,
        t: &mut [RayRow; NODE_WIDTH],
    ) -> [u32; NODE_WIDTH] {
        let mut planes = [[0.0f32; NODE_WIDTH]; 6];
        let mut met = [0; NODE_WIDTH];
        // SAFETY: planes are rows of eight words, `planes` and `t` rows of eight numbers.
        unsafe {
            let zero = _mm256_setzero_ps();
            let (mut step, mut near, mut far) = ([zero; 3], [zero; 3], [zero; 3]);
            for a in 0..3 {
                let (enter, leave) =
                    if self.negative[a] { (&node.hi[a], &node.lo[a]) } else { (&node.lo[a], &node.hi[a]) };
                for (row, words) in [(a, enter), (a + 3, leave)] {
                    let words = _mm_loadu_si128(words.as_ptr().cast());
                    _mm256_storeu_ps(
                        planes[row].as_mut_ptr(),
                        _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(words)),
                    );
                }
                let base = _mm256_sub_epi32(_mm256_set1_epi32(node.origin[a] << shift), self.cell[a]);
                let base = _mm256_cvtepi32_ps(base);
                let scale = f32::from_bits((127 + u32::from(node.exponent[a]) + shift) << 23);
                step[a] = _mm256_mul_ps(_mm256_set1_ps(scale), self.inverse[a]);
                near[a] = _mm256_fmadd_ps(base, self.inverse[a], self.start_near[a]);
                far[a] = _mm256_fmadd_ps(base, self.inverse[a], self.start_far[a]);
            }
            let (t_max, widen) = (_mm256_loadu_ps(t_max.as_ptr()), _mm256_set1_ps(<f32 as Real>::FAR));
            for child in 0..usize::from(node.child_count).min(NODE_WIDTH) {
                let (mut enter, mut leave) = ([zero; 3], [zero; 3]);
                for a in 0..3 {
                    enter[a] = _mm256_fmadd_ps(_mm256_broadcast_ss(&planes[a][child]), step[a], near[a]);
                    leave[a] = _mm256_fmadd_ps(_mm256_broadcast_ss(&planes[a + 3][child]), step[a], far[a]);
                }
                let enter = _mm256_max_ps(_mm256_max_ps(enter[0], enter[1]), _mm256_max_ps(enter[2], zero));
                let leave = _mm256_min_ps(_mm256_min_ps(leave[0], leave[1]), leave[2]);
                let is_met = _mm256_and_ps(
                    _mm256_cmp_ps::<_CMP_LE_OQ>(enter, _mm256_mul_ps(leave, widen)),
                    _mm256_cmp_ps::<_CMP_LE_OQ>(enter, t_max),
                );
                _mm256_storeu_ps(t[child].as_mut_ptr(), enter);
                met[child] = _mm256_movemask_ps(is_met) as u32;
            }
        }
        met
    }
}

/// The first, second and third numbers of eight vectors.
///
/// # Safety
/// The caller runs with AVX.
#[inline(always)]
unsafe fn columns(rows: [__m128; PACKET_RAYS]) -> [__m256; 3] {
    // SAFETY: registers only.
    unsafe {
        let pair = |i: usize| _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(rows[i]), rows[i + 4]);
        let [a, b, c, d] = [pair(0), pair(1), pair(2), pair(3)];
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        [
            _mm256_shuffle_ps::<0b01_00_01_00>(ab, cd),
            _mm256_shuffle_ps::<0b11_10_11_10>(ab, cd),
            _mm256_shuffle_ps::<0b01_00_01_00>(ab_high, cd_high),
        ]
    }
}

/// The places of the bits that are set.
#[inline(always)]
fn bits(mut word: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = word.trailing_zeros() as usize;
        word &= word.wrapping_sub(1);
        (place < PACKET_RAYS).then_some(place)
    })
}
