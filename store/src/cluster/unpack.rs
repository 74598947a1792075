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
use super::frame::{FrameRef, SharedFrame};
use super::install_cluster::ClusterInstaller;
use super::install_leaves::ROOM_BYTES;
use super::view::ClusterView;
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

/// Unpacks cluster `index` of the page in `frame`, unless it is there: a page of a model with so many materials. Says
/// in words what is wrong with a damaged one, which is lost then.
pub(crate) fn unpack(
    frame: SharedFrame<'_>,
    index: usize,
    material_count: usize,
) -> Result<(), &'static str> {
    let is_made = |word: u32| word == FrameRef::LOST.0 || !FrameRef(word).is_packed();
    let made = make_once((frame.lock_word(), frame.cluster_word(index)), is_made, || {
        // SAFETY: the lock is held; the borrow ends before the heap comes there.
        let packed = unsafe { frame.packed() };
        let mut unpacker = Unpacker::new(Machine::best(), frame, packed, material_count)?;
        if unpacker.unpack(index)? {
            return Ok(());
        }
        // No room beside the packed page. What is left of it is unpacked from a copy.
        let packed = packed.to_vec();
        frame.packed_at().store(FRAME_BYTES as u32, Ordering::Relaxed);
        Unpacker::new(Machine::best(), frame, &packed, material_count)?.unpack_rest()
    });
    made.unwrap_or(Ok(()))
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
                let one = self
                    .unpack(index)
                    .and_then(|fits| fits.then_some(()).ok_or("a page does not fit its frame"));
                if one.is_err() {
                    self.frame.cluster_word(index).store(FrameRef::LOST.0, Ordering::Release);
                }
                all = all.and(one);
            }
        }
        all
    }

    /// Unpacks a cluster. False when there is no room for it.
    fn unpack(&mut self, index: usize) -> Result<bool, &'static str> {
        let word = self.frame.cluster_word(index);
        let bytes = self.decode(index).inspect_err(|_| word.store(FrameRef::LOST.0, Ordering::Release))?;
        let bytes = bytes + FRAME_TAIL_BYTES;
        let at = self.frame.heap_end().load(Ordering::Relaxed) as usize;
        if at + bytes > self.frame.packed_at().load(Ordering::Relaxed) as usize {
            return Ok(false);
        }
        // SAFETY: what lies between the heap and the packed page is the caller's.
        unsafe { self.frame.write(at, &self.room[..bytes]) };
        self.frame.heap_end().store((at + bytes) as u32, Ordering::Relaxed);
        word.store(FrameRef::cluster(at).0, Ordering::Release);
        Ok(true)
    }

    /// Decodes a cluster to `room`. Gives its bytes there.
    fn decode(&mut self, index: usize) -> Result<usize, &'static str> {
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
