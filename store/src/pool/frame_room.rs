//! `FrameRoom`: a frame as a page is installed into it, and `FrameBlocks`: which of its memory is there.
//!
//! ```text
//! frame = block 0 | block 1 | ..                .. | last block
//!         head ->  what is written, then grows       <- tail: what is still packed
//! ```
//!
//! Invariant: who writes to a frame has said before how far.

use crate::error::Result;
use crate::io::ALIGN_BYTES;

/// What memory of frames is counted by: what the kernel gives and takes.
pub(super) const BLOCK_BYTES: usize = ALIGN_BYTES;

/// Blocks more than is typical that a frame keeps all the same.
const SURPLUS: usize = 3;

/// Blocks of a frame for which there is memory: from its begin, and at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FrameBlocks {
    pub(super) head: u32,
    pub(super) tail: u32,
}

impl FrameBlocks {
    /// The blocks that hold so many bytes at the begin of a frame of `frame_bytes`, and so many at its end.
    pub(super) fn of([head, tail]: [usize; 2], frame_bytes: usize) -> FrameBlocks {
        assert!(head <= frame_bytes && tail <= frame_bytes);
        let blocks = frame_bytes / BLOCK_BYTES;
        let tail = tail.div_ceil(BLOCK_BYTES);
        FrameBlocks { head: head.div_ceil(BLOCK_BYTES).min(blocks - tail) as u32, tail: tail as u32 }
    }

    /// These, and of those that a frame of `all` blocks `had` so many that there are `typical` ones together.
    pub(super) fn keeping(self, had: FrameBlocks, typical: usize, all: usize) -> FrameBlocks {
        // For a few blocks the call costs more than they hold.
        let most = if had.count() <= typical + SURPLUS { had.count() } else { typical };
        let room = most.min(all).saturating_sub(self.count()) as u32;
        let tail = had.tail.saturating_sub(self.tail).min(room);
        let head = had.head.saturating_sub(self.head).min(room - tail);
        FrameBlocks { head: self.head + head, tail: self.tail + tail }
    }

    /// How many there are.
    pub(super) fn count(self) -> usize {
        (self.head + self.tail) as usize
    }
}

/// Takes memory for so many bytes at the begin of a frame and so many at its end, or says why not.
type Take<'a> = &'a mut dyn FnMut([usize; 2]) -> Result<()>;

/// A frame without content, of which memory is taken before it is written.
pub struct FrameRoom<'a> {
    frame: &'a mut [u8],
    take: Option<Take<'a>>,
}

impl<'a> From<&'a mut [u8]> for FrameRoom<'a> {
    /// A frame whose memory is all there.
    fn from(frame: &'a mut [u8]) -> FrameRoom<'a> {
        FrameRoom { frame, take: None }
    }
}

impl<'a> FrameRoom<'a> {
    /// A frame of a pool.
    pub(super) fn of_pool(frame: &'a mut [u8], take: Take<'a>) -> FrameRoom<'a> {
        FrameRoom { frame, take: Some(take) }
    }

    /// All of the frame, to write.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit) when there is no room for it now.
    pub fn whole(&mut self) -> Result<&mut [u8]> {
        let all = self.frame.len();
        self.ends(all, 0)
    }

    /// The frame, of which so many bytes may be written at its begin and so many at its end: none in between. Said once
    /// more, it gives back what was taken and is not needed.
    ///
    /// # Errors
    /// As [`FrameRoom::whole`].
    pub fn ends(&mut self, head: usize, tail: usize) -> Result<&mut [u8]> {
        match &mut self.take {
            Some(take) => take([head, tail])?,
            None => assert!(head <= self.frame.len() && tail <= self.frame.len()),
        }
        Ok(self.frame)
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    /// All that a frame of six blocks can have had, and come to need.
    #[test]
    fn what_is_kept_fits_the_frame_beside_what_is_needed() {
        const ALL: u32 = 6;
        let all = || (0..=ALL).flat_map(|head| (0..=ALL - head).map(move |tail| FrameBlocks { head, tail }));
        for (needed, had) in all().flat_map(|needed| all().map(move |had| (needed, had))) {
            for typical in 0..=ALL as usize + 1 {
                let kept = needed.keeping(had, typical, ALL as usize);
                assert!(kept.head >= needed.head && kept.tail >= needed.tail);
                assert!(kept.head <= needed.head.max(had.head) && kept.tail <= needed.tail.max(had.tail));
                assert!(kept.count() <= needed.count().max(typical + SURPLUS).min(ALL as usize));
            }
        }
    }
}
