//! Unpacking clusters of a page into its frame: one that a ray asks for, all of them, or those that are left when the
//! heap comes to the packed page.
//!
//! Whoever asks first takes the lock, decodes, and releases the word; who asks meanwhile waits for as long as a cluster
//! takes, some microseconds. No other ray looks at the lock.
//!
//! Unsafe code stands here because a frame is written while others read what stands in it already.
//!
//! Invariants: 1. a cluster is unpacked once, by who holds the lock; 2. of clusters that are damaged, or larger than
//! their boxes, nothing is traced.
#![allow(unsafe_code)]

use super::FRAME_TAIL_BYTES;
use super::bits::{Window, window};
use super::disk_page::DiskPage;
use super::fields::Machine;
use super::frame::SharedFrame;
use super::frame_ref::FrameRef;
use super::install_cluster::ClusterInstaller;
use super::install_leaves::ROOM_BYTES;
use super::view::ClusterView;
use crate::io::ALIGN_BYTES;
use crate::layout::FRAME_BYTES;
use std::sync::atomic::{AtomicU32, Ordering};

/// An atomic word: the standard one, or that of the model checker.
pub(crate) trait AtomicWord {
    /// Reads it, and what was written before it was stored.
    fn load_acquire(&self) -> u32;
    /// Stores it behind all that was written before.
    fn store_release(&self, value: u32);
    /// From 0 to 1. False where it was 1.
    fn try_take(&self) -> bool;
    /// Lets others run.
    fn pause();
}

impl AtomicWord for AtomicU32 {
    fn load_acquire(&self) -> u32 {
        self.load(Ordering::Acquire)
    }

    fn store_release(&self, value: u32) {
        self.store(value, Ordering::Release);
    }

    fn try_take(&self) -> bool {
        self.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed).is_ok()
    }

    fn pause() {
        std::thread::yield_now();
    }
}

/// The right to unpack into a frame.
struct FrameLock<'a, W: AtomicWord>(&'a W);

impl<'a, W: AtomicWord> FrameLock<'a, W> {
    fn new(lock: &'a W) -> FrameLock<'a, W> {
        while !lock.try_take() {
            W::pause();
        }
        FrameLock(lock)
    }
}

impl<W: AtomicWord> Drop for FrameLock<'_, W> {
    fn drop(&mut self) {
        self.0.store_release(0);
    }
}

/// Runs `make` under `lock`, unless somebody has made what `word` leads to: `is_made` says so of its value.
pub(crate) fn make_once<W: AtomicWord, T>(
    (lock, word): (&W, &W),
    is_made: impl Fn(u32) -> bool,
    make: impl FnOnce() -> T,
) -> Option<T> {
    let _held = FrameLock::new(lock);
    (!is_made(word.load_acquire())).then(make)
}

/// Why a cluster was not unpacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UnpackError {
    /// It is damaged, as is said in words, and lost from now on.
    Damaged(&'static str),
    /// There is no memory for it now.
    NoRoom,
}

impl From<&'static str> for UnpackError {
    fn from(what: &'static str) -> UnpackError {
        UnpackError::Damaged(what)
    }
}

/// Takes memory for so many bytes at the begin of a frame. False when there is none.
type Grow<'a> = &'a dyn Fn(usize) -> bool;

/// Unpacks cluster `index` of the page in `frame`, unless it is there: a page of a model with so many materials.
pub(crate) fn unpack(
    frame: SharedFrame<'_>,
    index: usize,
    material_count: usize,
    grow: Grow<'_>,
) -> Result<(), UnpackError> {
    let is_made = |word: u32| word == FrameRef::LOST.0 || !FrameRef(word).is_packed();
    let made = make_once((frame.lock_word(), frame.cluster_word(index)), is_made, || {
        // SAFETY: the lock is held; the borrow ends before the heap comes there.
        let packed = unsafe { frame.packed() };
        let mut unpacker = Unpacker::new(Machine::best(), frame, packed, material_count)?;
        let bytes = unpacker.decode(index)?;
        let [heap_end, packed_at] =
            [frame.heap_end(), frame.packed_at()].map(|at| at.load(Ordering::Relaxed));
        let end = heap_end as usize + bytes;
        if end <= packed_at as usize {
            grow_to(frame, end, grow)?;
            unpacker.place(index, bytes);
            return Ok(());
        }
        // No room beside the packed page. What is left of it is unpacked from a copy.
        grow_to(frame, packed_at as usize, grow)?;
        let packed = packed.to_vec();
        frame.packed_at().store(FRAME_BYTES as u32, Ordering::Relaxed);
        frame.heap_room().store(FRAME_BYTES as u32, Ordering::Relaxed);
        Ok(Unpacker::new(Machine::best(), frame, &packed, material_count)?.unpack_rest()?)
    });
    made.unwrap_or(Ok(()))
}

/// Sees to it that there is memory for the heap up to `end`, which is not behind the packed page. The lock is held.
fn grow_to(frame: SharedFrame<'_>, end: usize, grow: Grow<'_>) -> Result<(), UnpackError> {
    if end > frame.heap_room().load(Ordering::Relaxed) as usize {
        // Where the packed page begins there is memory already.
        let packed_from = frame.packed_at().load(Ordering::Relaxed) as usize / ALIGN_BYTES * ALIGN_BYTES;
        if !grow(end.min(packed_from)) {
            return Err(UnpackError::NoRoom);
        }
        frame.heap_room().store(end.next_multiple_of(ALIGN_BYTES) as u32, Ordering::Relaxed);
    }
    Ok(())
}

/// Who holds the lock of a frame, or has it alone.
pub(super) struct Unpacker<'a> {
    frame: SharedFrame<'a>,
    page: DiskPage<'a>,
    installer: ClusterInstaller,
    material_count: usize,
    room: [u8; ROOM_BYTES],
}

impl<'a> Unpacker<'a> {
    pub(super) fn new(
        machine: Machine,
        frame: SharedFrame<'a>,
        packed: &'a [u8],
        material_count: usize,
    ) -> Result<Unpacker<'a>, &'static str> {
        let page = DiskPage::read(packed)?;
        let installer = ClusterInstaller::new(machine, &page.head, frame.lattice_bits());
        Ok(Unpacker { frame, page, installer, material_count, room: [0; ROOM_BYTES] })
    }

    /// Unpacks all that is packed. A cluster that is damaged is lost; the first of them is told.
    pub(super) fn unpack_rest(&mut self) -> Result<(), &'static str> {
        let mut all = Ok(());
        for index in 0..self.page.cluster_count {
            if FrameRef(self.frame.cluster_word(index).load(Ordering::Relaxed)).is_packed() {
                all = all.and(self.unpack(index));
            }
        }
        all
    }

    /// Unpacks a cluster of a page of which nothing packed is left in the frame.
    fn unpack(&mut self, index: usize) -> Result<(), &'static str> {
        let bytes = self.decode(index)?;
        if self.frame.heap_end().load(Ordering::Relaxed) as usize + bytes > FRAME_BYTES {
            self.lose(index);
            return Err("a page does not fit its frame");
        }
        self.place(index, bytes);
        Ok(())
    }

    /// Puts a cluster that was decoded on the heap, where there is room for it.
    fn place(&mut self, index: usize, bytes: usize) {
        let at = self.frame.heap_end().load(Ordering::Relaxed) as usize;
        // SAFETY: what lies between the heap and the packed page is the caller's.
        unsafe { self.frame.write(at, &self.room[..bytes]) };
        self.frame.heap_end().store((at + bytes) as u32, Ordering::Relaxed);
        self.frame.cluster_word(index).store(FrameRef::cluster(at).0, Ordering::Release);
    }

    fn lose(&self, index: usize) {
        self.frame.cluster_word(index).store(FrameRef::LOST.0, Ordering::Release);
    }

    /// Decodes a cluster to `room`. Gives the bytes that it takes in the frame; one that is damaged is lost.
    fn decode(&mut self, index: usize) -> Result<usize, &'static str> {
        let bytes = self.decode_entry(index).inspect_err(|_| self.lose(index))?;
        Ok(bytes + FRAME_TAIL_BYTES)
    }

    fn decode_entry(&mut self, index: usize) -> Result<usize, &'static str> {
        let entry = self.page.entry(index, self.frame.lattice_bits())?;
        let [packed_at, first_triangle, _] = self.frame.note(index);
        let mut tail = [0; size_of::<Window>()];
        let window = window(&self.page.bytes[packed_at..], &mut tail);
        let installed = self.installer.install((window, &entry), first_triangle, &mut self.room)?;
        if usize::from(ClusterView::new(&self.room).greatest_material()) >= self.material_count {
            return Err("a cluster has a material that the model has not");
        }
        Ok(installed)
    }
}
