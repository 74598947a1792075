//! A frame that holds a page of the mesh: its memory, which many threads read and unpack clusters into, and the view by
//! which rays read it.
//!
//! ```text
//! frame  = root_count u16 | node_count u16 | cluster_count u16 | triangle_count u16 | end of the heap u32 | lock u32
//!        | begin of the packed page u32 | lattice bits u32 | room for the heap u32 | 4 zeros
//!        | roots u32 (FrameRef) | nodes, 144 bytes each | notes, a cluster each | heap -> ... <- packed page
//! note   = begin in the packed page u16 | triangles before it u16 | where the word that leads to it stands, / 4, u16
//! heap   = clusters in the order in which they were unpacked, 8 zeros behind each
//! ```
//!
//! A word that leads to a cluster tells first that it is packed, and which it is, later where it stands. When the heap
//! comes to the packed page, all that is left of it is unpacked at once: then nothing of it is left.
//!
//! Unsafe code stands here because a frame is written while others read it.
//!
//! Invariants: 1. a frame in here was filled by `install`, which checked every count and index; 2. of what changes,
//! words are atomic, and the rest belongs to who holds the lock; 3. a cluster is written before the word that leads to
//! it is released, and never again; 4. what is lent of a frame as bytes does not change while it is borrowed.
#![allow(unsafe_code)]

use super::frame_ref::FrameRef;
use super::node::{FrameNode, Node};
use super::view::ClusterView;
use super::{CLUSTER_HEAD_BYTES, FRAME_TAIL_BYTES};
use crate::layout::FRAME_BYTES;
use std::marker::PhantomData;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, Ordering};

/// Bytes of a frame before its roots.
pub(crate) const FRAME_HEADER_BYTES: usize = 32;
/// Bytes of what is noted of a cluster.
pub(super) const NOTE_BYTES: usize = 6;
/// Where the words of a node begin in it.
pub(super) const NODE_WORDS_AT: usize = Node::BYTES - 4 * crate::layout::NODE_WIDTH;

const HEAP_END_AT: usize = 8;
const LOCK_AT: usize = 12;
const PACKED_AT: usize = 16;
const LATTICE_BITS_AT: usize = 20;
const HEAP_ROOM_AT: usize = 24;

/// Where the parts of a frame begin that follow from its counts.
pub(super) struct FrameParts {
    pub(super) nodes: usize,
    pub(super) notes: usize,
    pub(super) heap: usize,
}

impl FrameParts {
    pub(super) fn new(root_count: usize, node_count: usize, cluster_count: usize) -> FrameParts {
        let nodes = (FRAME_HEADER_BYTES + 4 * root_count).next_multiple_of(8);
        let notes = nodes + node_count * Node::BYTES;
        FrameParts { nodes, notes, heap: notes + cluster_count * NOTE_BYTES }
    }
}

/// The memory of a frame that others may read and unpack into.
#[derive(Clone, Copy)]
pub struct SharedFrame<'a> {
    base: NonNull<u8>,
    lent: PhantomData<&'a AtomicU32>,
}

// SAFETY: it is a reference to memory of which all that changes is atomic, or belongs to who holds the lock.
unsafe impl Send for SharedFrame<'_> {}
// SAFETY: as above.
unsafe impl Sync for SharedFrame<'_> {}

impl<'a> SharedFrame<'a> {
    /// A frame that nobody else reads.
    ///
    /// # Panics
    /// When it has not the bytes of a frame, or does not begin at a multiple of 4.
    pub fn new(bytes: &'a mut [u8]) -> SharedFrame<'a> {
        assert!(bytes.len() == FRAME_BYTES && bytes.as_ptr().addr().is_multiple_of(4));
        SharedFrame { base: NonNull::from(bytes).cast(), lent: PhantomData }
    }

    /// A frame of a pool.
    ///
    /// # Safety
    /// `base` is the first of [`FRAME_BYTES`] bytes, a multiple of 4, that stay for `'a` and are written through
    /// [`SharedFrame`] alone.
    pub(crate) unsafe fn at(base: NonNull<u8>) -> SharedFrame<'a> {
        SharedFrame { base, lent: PhantomData }
    }

    /// The word at a byte offset that is a multiple of 4.
    #[inline(always)]
    pub(super) fn word(self, at: usize) -> &'a AtomicU32 {
        assert!(at <= FRAME_BYTES - 4 && at.is_multiple_of(4));
        // SAFETY: inside of the frame and aligned; such words are read and written as atomics alone.
        unsafe { self.base.add(at).cast().as_ref() }
    }

    #[inline(always)]
    fn number(self, at: usize) -> usize {
        // SAFETY: numbers of two bytes are written before the frame is shared.
        usize::from(unsafe { self.base.add(at).cast::<u16>().read_unaligned() })
    }

    pub(super) fn root_count(self) -> usize {
        self.number(0)
    }

    pub(super) fn cluster_count(self) -> usize {
        self.number(4)
    }

    pub(super) fn parts(self) -> FrameParts {
        FrameParts::new(self.number(0), self.number(2), self.number(4))
    }

    /// What is noted of a cluster: its begin in the packed page, triangles before it, and where its word stands.
    pub(super) fn note(self, index: usize) -> [usize; 3] {
        assert!(index < self.cluster_count());
        let at = self.parts().notes + NOTE_BYTES * index;
        [self.number(at), self.number(at + 2), 4 * self.number(at + 4)]
    }

    /// Where the word stands that leads to a cluster.
    pub(super) fn cluster_word(self, index: usize) -> &'a AtomicU32 {
        self.word(self.note(index)[2])
    }

    /// The word that is 0 unless somebody unpacks.
    pub(super) fn lock_word(self) -> &'a AtomicU32 {
        self.word(LOCK_AT)
    }

    /// Where the heap ends; changed by who holds the lock.
    pub(super) fn heap_end(self) -> &'a AtomicU32 {
        self.word(HEAP_END_AT)
    }

    /// Where the packed page begins, the frame's end where nothing is left of it; changed by who holds the lock.
    pub(super) fn packed_at(self) -> &'a AtomicU32 {
        self.word(PACKED_AT)
    }

    pub(super) fn lattice_bits(self) -> u32 {
        self.word(LATTICE_BITS_AT).load(Ordering::Relaxed)
    }

    /// How far the heap may go for now: there is memory for so much; changed by who holds the lock.
    pub(super) fn heap_room(self) -> &'a AtomicU32 {
        self.word(HEAP_ROOM_AT)
    }

    /// Says where the heap begins and how far it may go, and where the packed page begins, of a frame that nobody else
    /// reads.
    pub(super) fn begin(self, heap: Range<usize>, packed: usize, lattice_bits: u32) {
        for (at, value) in [
            (HEAP_END_AT, heap.start),
            (HEAP_ROOM_AT, heap.end),
            (PACKED_AT, packed),
            (LATTICE_BITS_AT, lattice_bits as usize),
        ] {
            self.word(at).store(value as u32, Ordering::Relaxed);
        }
    }

    /// The packed page.
    ///
    /// # Safety
    /// The caller holds the lock, and writes nothing there while it borrows.
    pub(super) unsafe fn packed(self) -> &'a [u8] {
        let at = self.packed_at().load(Ordering::Relaxed) as usize;
        // SAFETY: by the contract.
        unsafe { self.bytes(at..FRAME_BYTES) }
    }

    /// Bytes that do not change any more.
    ///
    /// # Safety
    /// Nobody writes to them while they are borrowed.
    #[inline(always)]
    pub(super) unsafe fn bytes(self, range: Range<usize>) -> &'a [u8] {
        assert!(range.start <= range.end && range.end <= FRAME_BYTES);
        // SAFETY: inside of the frame; unchanged by the contract.
        unsafe { std::slice::from_raw_parts(self.base.add(range.start).as_ptr(), range.len()) }
    }

    /// Writes bytes that nobody reads yet.
    ///
    /// # Safety
    /// Nobody else reads or writes there.
    pub(super) unsafe fn write(self, at: usize, bytes: &[u8]) {
        assert!(at + bytes.len() <= FRAME_BYTES);
        // SAFETY: inside of the frame, and the caller's alone; `bytes` is not of this frame.
        unsafe { self.base.add(at).copy_from_nonoverlapping(NonNull::from(bytes).cast(), bytes.len()) };
    }
}

/// Who unpacks clusters of the frames of a pool, and is told when one is damaged.
pub trait Unpack: Sync {
    /// True where the frame of `page` holds clusters that are unpacked on demand.
    fn is_unpacked_later(&self, page: u32) -> bool;

    /// Unpacks a cluster of `page`; one that is damaged is lost.
    fn unpack(&self, page: u32, frame: SharedFrame<'_>, cluster: usize);
}

/// A frame as it is lent: that of a pool, or one whose page was unpacked whole.
#[derive(Clone, Copy)]
pub struct Frame<'a> {
    memory: SharedFrame<'a>,
    page: u32,
    unpack: Option<&'a dyn Unpack>,
}

impl<'a> From<&'a [u8]> for Frame<'a> {
    /// A frame that nobody writes to.
    ///
    /// # Panics
    /// When it has not the bytes of a frame, or does not begin at a multiple of 4.
    fn from(bytes: &'a [u8]) -> Frame<'a> {
        assert!(bytes.len() == FRAME_BYTES && bytes.as_ptr().addr().is_multiple_of(4));
        let memory = SharedFrame { base: NonNull::from(bytes).cast(), lent: PhantomData };
        Frame { memory, page: 0, unpack: None }
    }
}

impl<'a> From<&'a Vec<u8>> for Frame<'a> {
    fn from(bytes: &'a Vec<u8>) -> Frame<'a> {
        Frame::from(&bytes[..])
    }
}

impl<'a> Frame<'a> {
    /// The frame of `page`, whose clusters `unpack` unpacks.
    #[inline(always)]
    pub(crate) fn of_page(memory: SharedFrame<'a>, page: u32, unpack: &'a dyn Unpack) -> Frame<'a> {
        Frame { memory, page, unpack: Some(unpack) }
    }

    /// All of its bytes.
    ///
    /// # Panics
    /// For the frame of a page whose clusters are unpacked on demand: others may write to it.
    #[inline]
    pub fn bytes(self) -> &'a [u8] {
        assert!(self.unpack.is_none_or(|unpack| !unpack.is_unpacked_later(self.page)), "others may write");
        // SAFETY: nothing is unpacked into it.
        unsafe { self.memory.bytes(0..FRAME_BYTES) }
    }
}

/// A frame that holds a page of the mesh.
#[derive(Clone, Copy)]
pub struct FrameView<'a> {
    frame: Frame<'a>,
}

impl<'a> FrameView<'a> {
    /// A view of a frame that `install` filled. Its methods panic on one that it did not.
    #[inline(always)]
    pub fn new(frame: impl Into<Frame<'a>>) -> FrameView<'a> {
        FrameView { frame: frame.into() }
    }

    /// Count of roots.
    pub fn root_count(&self) -> usize {
        self.frame.memory.root_count()
    }

    /// Where root `slot` stands. Panics when `slot` is not below `root_count`.
    #[inline(always)]
    pub fn root(&self, slot: usize) -> FrameRef {
        assert!(slot < self.root_count());
        FrameRef(self.frame.memory.word(FRAME_HEADER_BYTES + 4 * slot).load(Ordering::Acquire))
    }

    /// Triangles in the page.
    pub fn triangle_count(&self) -> usize {
        self.frame.memory.number(6)
    }

    /// Bytes of the frame up to the end of what is unpacked.
    pub fn used_bytes(&self) -> usize {
        self.frame.memory.heap_end().load(Ordering::Relaxed) as usize
    }

    /// The node at `at`.
    #[inline(always)]
    pub fn node(&self, at: FrameRef) -> &'a FrameNode {
        assert!(at.offset() <= FRAME_BYTES - Node::BYTES && at.offset().is_multiple_of(4));
        // SAFETY: inside of the frame and aligned; boxes do not change any more, and words are atomic.
        unsafe { self.frame.memory.base.add(at.offset()).cast().as_ref() }
    }

    /// The cluster at `at`, which is unpacked where it is not yet; `None` where it is damaged.
    #[inline(always)]
    pub fn cluster(&self, at: FrameRef) -> Option<ClusterView<'a>> {
        let at = if at.is_packed() { self.unpacked(at)? } else { at };
        Some(self.cluster_at(at.offset()))
    }

    #[inline(always)]
    fn cluster_at(&self, at: usize) -> ClusterView<'a> {
        // SAFETY: whoever knows the place of a cluster acquired it, and it is never written again.
        let head = unsafe { self.frame.memory.bytes(at..at + CLUSTER_HEAD_BYTES) };
        let end = at + ClusterView::new(head).frame_bytes() + FRAME_TAIL_BYTES;
        // SAFETY: as above.
        ClusterView::new(unsafe { self.frame.memory.bytes(at..end) })
    }

    /// Where a packed cluster stands when it is unpacked.
    #[cold]
    #[inline(never)]
    fn unpacked(&self, at: FrameRef) -> Option<FrameRef> {
        let Frame { memory, page, unpack } = self.frame;
        if at == FrameRef::LOST {
            return None;
        }
        unpack.expect("the frame of a pool, or a page that was unpacked whole").unpack(
            page,
            memory,
            at.offset(),
        );
        let now = FrameRef(memory.cluster_word(at.offset()).load(Ordering::Acquire));
        (!now.is_packed()).then_some(now)
    }

    fn cluster_of_index(&self, index: usize) -> Option<ClusterView<'a>> {
        self.cluster(FrameRef(self.frame.memory.cluster_word(index).load(Ordering::Acquire)))
    }

    /// The cluster that holds triangle `index` of the page; `None` where that is damaged, or there is no such triangle.
    pub fn cluster_with(&self, index: usize) -> Option<ClusterView<'a>> {
        let memory = self.frame.memory;
        let (count, triangle_count) = (memory.cluster_count(), self.triangle_count());
        if index >= triangle_count {
            return None;
        }
        // Clusters have about as many triangles each.
        let mut at = index * count / triangle_count;
        while memory.note(at)[1] > index {
            at -= 1;
        }
        while at + 1 < count && memory.note(at + 1)[1] <= index {
            at += 1;
        }
        let cluster = self.cluster_of_index(at)?;
        (index < cluster.first_triangle() + cluster.triangle_count()).then_some(cluster)
    }

    /// The greatest index of a material in the page.
    pub fn greatest_material(&self) -> u16 {
        let mut greatest = 0;
        self.for_each_cluster(|cluster| greatest = greatest.max(cluster.greatest_material()));
        greatest
    }

    /// Calls `visit` for every cluster that is not damaged, in the order in which they are stored.
    pub fn for_each_cluster(&self, mut visit: impl FnMut(ClusterView<'a>)) {
        for index in 0..self.frame.memory.cluster_count() {
            if let Some(cluster) = self.cluster_of_index(index) {
                visit(cluster);
            }
        }
    }
}
