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
use crate::trace::bvh::{
    Best, Ended, Entry, Goal, Missing, OpenPage, PageVisit, Pending, STACK, Scene, Stack, t_above, walk,
};
use crate::trace::kernel::Kernel;
use crate::trace::pages::{Page, Pages};
use crate::trace::scalar::{Real, Scalar};
use std::arch::x86_64::*;
use trex_store::cluster::{FrameRef, FrameView, Node, TopRef};
use trex_store::layout::NODE_WIDTH;

/// Rays of a packet: what a register holds.
pub(in crate::trace) const PACKET_RAYS: usize = 8;
/// Count of rays left at a node, or fewer, that go on by themselves.
const SPLIT: u32 = 2;

/// A number per ray.
type Row = [f32; PACKET_RAYS];

/// An entry of the stack: where to go on with which rays, and where its box begins for each.
#[derive(Clone, Copy)]
struct Waiting {
    t: Row,
    word: u32,
    /// A bit a ray.
    rays: u32,
}

/// Room for a packet; and what came of the last one, for the rays that reached the model's box, in their order.
pub(in crate::trace) struct PacketRoom {
    waiting: Box<[Waiting; STACK]>,
    /// Rays and what they found.
    pub(in crate::trace) ended: Vec<Ended>,
    /// Index of each among the rays that were asked.
    pub(in crate::trace) places: Vec<usize>,
    pub(in crate::trace) missing: [Missing; PACKET_RAYS],
}

impl Default for PacketRoom {
    fn default() -> PacketRoom {
        PacketRoom {
            waiting: Box::new([Waiting { t: [0.0; PACKET_RAYS], word: 0, rays: 0 }; STACK]),
            ended: Vec::with_capacity(PACKET_RAYS),
            places: Vec::with_capacity(PACKET_RAYS),
            missing: std::array::from_fn(|_| Missing::none()),
        }
    }
}

/// Rays as box tests see them: see `Slabs`; a row an axis.
struct Boxes {
    cell: [__m256i; 3],
    inverse: [__m256; 3],
    start_near: [__m256; 3],
    start_far: [__m256; 3],
    /// Axes along which the direction of all rays is negative.
    negative: [bool; 3],
}

/// The packet under way.
struct Packet<'a> {
    boxes: Boxes,
    plain: [Scalar<f32>; PACKET_RAYS],
    /// Kernels of the rays that have gone on by themselves.
    kernels: [Option<Avx2>; PACKET_RAYS],
    goal: Goal,
    /// The t of the best hit of each; below all where one is enough and found.
    t_max: Row,
    ended: &'a mut [Ended],
    missing: &'a mut [Missing; PACKET_RAYS],
    waiting: &'a mut [Waiting; STACK],
    len: usize,
}

/// Traces up to eight rays; `room` holds their answers.
///
/// # Safety
/// The caller runs with AVX2 and FMA.
#[inline(always)]
pub(in crate::trace) unsafe fn trace_packet<P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    stack: &mut Stack,
    (rays, goal): (&[Ray], Goal),
    room: &mut PacketRoom,
) {
    let PacketRoom { waiting, ended, places, missing } = room;
    ended.clear();
    places.clear();
    for (place, ray) in rays.iter().enumerate() {
        if let Some(ray) = scene.frame.enter(ray) {
            ended.push(Ended { ray, found: None });
            places.push(place);
        }
    }
    let count = ended.len().min(PACKET_RAYS);
    if count == 0 {
        return;
    }
    let mut plain = [Scalar::new(&scene.frame, &ended[0].ray); PACKET_RAYS];
    let (mut together, mut t_max) = (1, [0.0; PACKET_RAYS]);
    t_max[0] = t_above(ended[0].ray.t_max);
    for i in 1..count {
        plain[i] = Scalar::new(&scene.frame, &ended[i].ray);
        together |= u32::from(plain[i].slabs.negative == plain[0].slabs.negative) << i;
        t_max[i] = t_above(ended[i].ray.t_max);
    }
    missing[..count].iter_mut().for_each(Missing::clear);
    let mut pending = Pending { entries: &mut stack.entries, len: 0 };
    let mut packet = Packet {
        // SAFETY: by the contract.
        boxes: unsafe { Boxes::new(&plain) },
        plain,
        kernels: [const { None }; PACKET_RAYS],
        goal,
        t_max,
        ended,
        missing,
        waiting,
        len: 0,
    };
    let root = scene.file.superblock().root;
    packet.put(Waiting { t: [0.0; PACKET_RAYS], word: root, rays: together });
    while let Some(at) = packet.pop_above(0) {
        if at.rays.count_ones() <= SPLIT {
            packet.alone(scene, pages, &mut pending, at);
            continue;
        }
        match TopRef::from_word(at.word) {
            TopRef::Node(index) => packet.node(&scene.file.top()[index as usize], scene, at.rays),
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first_triangle = scene.file.pages()[page as usize].first_triangle;
                    let page = OpenPage { frame: FrameView::new(frame), page, first_triangle };
                    packet.page(&page, slot, scene, &mut pending, at);
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
        packet.alone(scene, pages, &mut pending, Waiting { t: [0.0; PACKET_RAYS], word: root, rays: others });
    }
}

impl Packet<'_> {
    /// Rays that go on by themselves.
    #[inline(always)]
    fn alone<P: Pages>(&mut self, scene: &Scene<'_>, pages: &mut P, pending: &mut Pending<'_>, at: Waiting) {
        for i in bits(at.rays) {
            let kernel = self.kernels[i].get_or_insert_with(|| Avx2::from_scalar(&self.plain[i]));
            let Ended { ray, found } = &mut self.ended[i];
            let mut best = Best { t: self.t_max[i], found: *found };
            let from = Entry::new(at.t[i], at.word);
            walk(scene, pages, kernel, (ray, self.goal), from, pending, &mut best, &mut self.missing[i]);
            *found = best.found;
            self.settle(i, best.t);
        }
    }

    /// Traverses a page under the root in `slot`.
    #[inline(always)]
    fn page(
        &mut self,
        page: &OpenPage<'_>,
        slot: u32,
        scene: &Scene<'_>,
        pending: &mut Pending<'_>,
        at: Waiting,
    ) {
        let floor = self.len;
        self.put(Waiting { word: page.frame.root(slot as usize).0, ..at });
        while let Some(at) = self.pop_above(floor) {
            let word = FrameRef(at.word);
            if !word.is_cluster() && at.rays.count_ones() > SPLIT {
                self.node(page.frame.node(word), scene, at.rays);
                continue;
            }
            for i in bits(at.rays) {
                let kernel = self.kernels[i].get_or_insert_with(|| Avx2::from_scalar(&self.plain[i]));
                let Ended { ray, found } = &mut self.ended[i];
                let mut best = Best { t: self.t_max[i], found: *found };
                let visit = PageVisit { page: *page, ray, goal: self.goal };
                visit.under(kernel, Entry::new(at.t[i], at.word), pending, &mut best);
                *found = best.found;
                self.settle(i, best.t);
            }
        }
    }

    /// Takes over how far ray `i` still looks.
    #[inline(always)]
    fn settle(&mut self, i: usize, t: f32) {
        let is_done = self.goal == Goal::Any && self.ended[i].found.is_some();
        self.t_max[i] = if is_done { -1.0 } else { t };
    }

    /// The topmost that still matters to some of its rays, and to which.
    #[inline(always)]
    fn pop_above(&mut self, floor: usize) -> Option<Waiting> {
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
    fn put(&mut self, at: Waiting) {
        debug_assert!(self.len < STACK, "depth was checked when the tables were read");
        self.waiting[self.len % STACK] = at;
        self.len += 1;
    }

    /// Puts the children of a node that some of `rays` meet, the nearest on top.
    #[inline(always)]
    fn node(&mut self, node: &Node, scene: &Scene<'_>, rays: u32) {
        let mut t = [[0.0; PACKET_RAYS]; NODE_WIDTH];
        // SAFETY: the caller runs with AVX2 and FMA.
        let met = unsafe { self.boxes.meet(node, scene.frame.node_shift, &self.t_max, &mut t) };
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
            let waiting = Waiting { t: t[child], word: node.child[child], rays: (*new >> 8) as u32 & 0xff };
            self.put(waiting);
        }
    }
}

impl Boxes {
    /// # Safety
    /// The caller runs with AVX2.
    #[inline(always)]
    unsafe fn new(rays: &[Scalar<f32>; PACKET_RAYS]) -> Boxes {
        let mut cell = [[0i32; PACKET_RAYS]; 3];
        let (mut inverse, mut near, mut far) =
            ([[0.0; PACKET_RAYS]; 3], [[0.0; PACKET_RAYS]; 3], [[0.0; PACKET_RAYS]; 3]);
        for (i, ray) in rays.iter().enumerate() {
            for a in 0..3 {
                cell[a][i] = ray.cell[a] as i32;
                inverse[a][i] = ray.slabs.inverse[a];
                near[a][i] = ray.slabs.start_near[a];
                far[a][i] = ray.slabs.start_far[a];
            }
        }
        // SAFETY: rows of eight numbers; the caller runs with AVX2.
        unsafe {
            let zero = _mm256_setzero_ps();
            let mut boxes = Boxes {
                cell: [_mm256_setzero_si256(); 3],
                inverse: [zero; 3],
                start_near: [zero; 3],
                start_far: [zero; 3],
                negative: rays[0].slabs.negative,
            };
            for a in 0..3 {
                boxes.cell[a] = _mm256_loadu_si256(cell[a].as_ptr().cast());
                boxes.inverse[a] = _mm256_loadu_ps(inverse[a].as_ptr());
                boxes.start_near[a] = _mm256_loadu_ps(near[a].as_ptr());
                boxes.start_far[a] = _mm256_loadu_ps(far[a].as_ptr());
            }
            boxes
        }
    }

    /// The children of a node: which rays meet each, and where. The same sums as `Slabs::meet`.
    ///
    /// # Safety
    /// The caller runs with AVX2 and FMA.
    #[inline(always)]
    unsafe fn meet(
        &self,
        node: &Node,
        shift: u32,
        t_max: &Row,
        t: &mut [Row; NODE_WIDTH],
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

/// The places of the bits that are set.
#[inline(always)]
fn bits(mut word: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = word.trailing_zeros() as usize;
        word &= word.wrapping_sub(1);
        (place < PACKET_RAYS).then_some(place)
    })
}
