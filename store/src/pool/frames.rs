//! `FrameArena`: the memory of the frames, at addresses that are fixed at open.
//!
//! Unsafe code stands here because many threads read and write frames through one arena; who may do so when is told
//! by the page word, not by a borrow.
//!
//! Invariants: 1. frame `i` is `frame_bytes` bytes at a fixed address, aligned to 4096; 2. an untouched or released
//! frame costs no memory; 3. a frame is written only by the loader of the page that is READING into it, and read only
//! under a pin (see `word.rs`, invariants 2 and 3); clusters are unpacked into it under a pin (`cluster::frame`).
#![allow(unsafe_code)]

use super::frame_room::{BLOCK_BYTES, FrameBlocks};
use crate::cluster::SharedFrame;
use crate::error::Result;
use crate::io::Region;
use crate::layout::FRAME_BYTES;

/// A range of addresses for the most frames that the pool can ever have.
pub(super) struct FrameArena {
    region: Region,
    frame_bytes: usize,
}

impl FrameArena {
    /// Reserves addresses for `frames` frames; commits nothing.
    pub(super) fn reserve(frames: usize, frame_bytes: usize) -> Result<FrameArena> {
        Ok(FrameArena { region: Region::reserve(frames * frame_bytes)?, frame_bytes })
    }

    /// Bytes of one frame.
    pub(super) fn frame_bytes(&self) -> usize {
        self.frame_bytes
    }

    /// Where the first frame begins.
    #[cfg(test)]
    pub(super) fn begin(&self) -> usize {
        self.region.at(0).addr().get()
    }

    /// The memory of a frame, into which clusters may be unpacked.
    ///
    /// # Panics
    /// When the frames of the pool are not those of page files.
    ///
    /// # Safety
    /// The page that owns the frame is RESIDENT and pinned for as long as it is borrowed.
    #[inline(always)]
    pub(super) unsafe fn shared(&self, frame: u32) -> SharedFrame<'_> {
        assert!(self.frame_bytes == FRAME_BYTES);
        // SAFETY: a whole frame of the mapping, that stays by the contract.
        unsafe { SharedFrame::at(self.region.at(frame as usize * FRAME_BYTES)) }
    }

    /// The bytes of a frame.
    ///
    /// # Safety
    /// The page that owns the frame is RESIDENT and pinned for as long as the slice lives, and nothing of it is
    /// unpacked.
    pub(super) unsafe fn frame(&self, frame: u32) -> &[u8] {
        let start = self.region.at(frame as usize * self.frame_bytes);
        // SAFETY: inside of the mapping (`at` checks the first byte, the region is whole frames); nobody writes to
        // the frame of a pinned page.
        unsafe { std::slice::from_raw_parts(start.as_ptr(), self.frame_bytes) }
    }

    /// The bytes of a frame, to write.
    ///
    /// # Safety
    /// The page that owns the frame is READING, and the caller alone loads it, for as long as the slice lives.
    #[allow(clippy::mut_from_ref)]
    pub(super) unsafe fn frame_mut(&self, frame: u32) -> &mut [u8] {
        let start = self.region.at(frame as usize * self.frame_bytes);
        // SAFETY: as above; by the contract nobody else has a reference into the frame.
        unsafe { std::slice::from_raw_parts_mut(start.as_ptr(), self.frame_bytes) }
    }

    /// Gives the memory of a frame that `had` it back to the kernel, but for what it `needs`.
    ///
    /// # Safety
    /// The page that owns the frame is READING, and the caller alone loads it.
    pub(super) unsafe fn release_middle(&self, frame: u32, had: FrameBlocks, needs: FrameBlocks) {
        let all = (self.frame_bytes / BLOCK_BYTES) as u32;
        let middle = needs.head..all - needs.tail;
        if had.head > middle.start || all - had.tail < middle.end {
            let [at, bytes] =
                [middle.start, middle.end - middle.start].map(|blocks| blocks as usize * BLOCK_BYTES);
            // SAFETY: nobody reads the frame, and its writer says that this part is not needed.
            unsafe { self.region.release(frame as usize * self.frame_bytes + at, bytes) }
        }
    }

    /// Gives the memory of a frame back to the kernel.
    ///
    /// # Safety
    /// No page owns the frame, and none will before the call returns.
    pub(super) unsafe fn release(&self, frame: u32) {
        // SAFETY: a frame without an owner has no readers and no writer.
        unsafe { self.region.release(frame as usize * self.frame_bytes, self.frame_bytes) }
    }
}
