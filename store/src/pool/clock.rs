//! `Clock`: which frames have memory, who owns them, and who loses his.
//!
//! ```text
//!   unused (no memory) --take--> owned (in the ring, under the hand): blocks at its begin and at its end
//!      ^                           |   ^   '- settle: what the page needs;  grow: clusters are unpacked
//!      |                           |   '----- taken over by the next page, with its blocks
//!      '-------- evicted ----------'
//! ```
//!
//! A frame is a range of addresses; memory is counted in blocks of it. So as many pages are there as their blocks find
//! room, and there are more frames than whole ones would fit.
//!
//! Lost: passing over half of the pages, in runs of 32, but every 8th or 32nd round, so that of views which alternate
//! and do not fit together each keeps a part: as many or more pages were read, and the slowest responses took half as
//! long again.
//!
//! Unsafe code stands here because frames without an owner are given back to the kernel.
//!
//! Invariants
//! 1. `used` is the sum of what is counted for the frames of the ring, and at most what is leased, which is the limit
//!    unless memory is owed. Memory is leased and counted before it is used.
//! 2. A frame is in `ring` exactly while a READING or RESIDENT page owns it; others have no memory.
//! 3. The hand never spins: one sweep looks at no more than four rounds (three scores and the eviction), and at one
//!    round where all is busy.
//! 4. Memory owed (a limit that shrank while pages were pinned) is paid before anybody gets a frame. Until then each
//!    page that is pinned may grow to a whole frame.
//! 5. While no more pages are pinned than whole frames fit, a pinned page finds room to grow, at the latest when the
//!    pages that are being read have come.
#![allow(unsafe_code)]

use super::frame_room::{BLOCK_BYTES, FrameBlocks};
use super::frames::FrameArena;
use super::word::{CoolOutcome, PageState, View, Word};
use crate::budget::Lease;

const NOBODY: u32 = u32::MAX;

/// One block of `Clock::typical`: so many evictions, by and by, make what it says.
const TYPICAL_ONE: usize = 64;

/// A frame.
#[derive(Clone, Copy)]
struct HeldFrame {
    owner: u32,
    /// For which there is memory.
    blocks: FrameBlocks,
    /// Blocks that are counted for it: those, or more while it is being read.
    counted: u32,
    /// Blocks that its page has asked for.
    asked: u32,
}

impl HeldFrame {
    const UNUSED: HeldFrame =
        HeldFrame { owner: NOBODY, blocks: FrameBlocks { head: 0, tail: 0 }, counted: 0, asked: 0 };
}

/// The frames and the hand.
pub(super) struct Clock {
    frames: Vec<HeldFrame>,
    ring: Vec<u32>,
    unused: Vec<u32>,
    hand: usize,
    /// Blocks of a whole frame.
    whole: usize,
    /// In blocks.
    limit: usize,
    used: usize,
    leased: usize,
    lease: Lease,
    /// What pages have come to ask for of late when they lose their frame, blocks times [`TYPICAL_ONE`].
    typical: usize,
    /// Pages that lost their frame.
    pub(super) evicted: u64,
    /// Those of them that were read ahead, and that nobody had asked for.
    pub(super) wasted: u64,
}

/// How the hand passes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Hand {
    /// Pages lose a score each time.
    Cools,
    /// Pages that have a score left stay as they are.
    TakesCold,
}

impl Clock {
    /// A clock over `frames_max` frames, without memory. `lease` is empty.
    pub(super) fn new(frames_max: usize, frame_bytes: usize, lease: Lease) -> Clock {
        Clock {
            frames: vec![HeldFrame::UNUSED; frames_max],
            ring: Vec::with_capacity(frames_max),
            unused: (0..frames_max as u32).rev().collect(),
            hand: 0,
            whole: frame_bytes / BLOCK_BYTES,
            limit: 0,
            used: 0,
            leased: 0,
            lease,
            typical: 0,
            evicted: 0,
            wasted: 0,
        }
    }

    /// Bytes of this struct's tables for one frame.
    pub(super) const BYTES_PER_FRAME: u64 = (size_of::<HeldFrame>() + 2 * size_of::<u32>()) as u64;

    /// Whole frames that memory is leased for.
    pub(super) fn live(&self) -> usize {
        self.leased.div_ceil(self.whole)
    }

    /// Whole frames above the limit, of pages that are pinned still.
    pub(super) fn owed(&self) -> usize {
        (self.leased - self.limit).div_ceil(self.whole)
    }

    /// Blocks that are counted.
    #[cfg(test)]
    pub(super) fn used(&self) -> usize {
        self.used
    }

    /// Pages that have a frame.
    pub(super) fn owned(&self) -> usize {
        self.ring.len()
    }

    /// About how many pages find room together: as many as there are where all find it.
    pub(super) fn room(&self) -> usize {
        match self.used {
            0 => self.live(),
            used => (self.leased * self.ring.len() / used).max(self.live()),
        }
    }

    /// Sets the limit to that of so many whole frames. Growing leases first; shrinking evicts and releases what it can
    /// and owes the rest.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit) when the budget has no room; nothing is changed then.
    pub(super) fn set_frames(
        &mut self,
        frames: usize,
        words: &[Word],
        arena: &FrameArena,
    ) -> crate::Result<()> {
        let limit = frames * self.whole;
        if limit >= self.leased {
            self.lease.grow("page frames", ((limit - self.leased) * BLOCK_BYTES) as u64)?;
            self.leased = limit;
        }
        self.limit = limit;
        self.pay_debt(words, arena);
        Ok(())
    }

    /// A frame for `page`, with so many blocks counted for it: an unused one, or one whose page is evicted. `None` when
    /// all are busy.
    pub(super) fn take(
        &mut self,
        page: u32,
        blocks: usize,
        words: &[Word],
        arena: &FrameArena,
    ) -> Option<u32> {
        self.take_by(Hand::Cools, page, blocks, (words, arena))
    }

    /// As [`Clock::take`], for a page that nobody waits for: of those that are there only the cold ones go, which
    /// nobody has asked for since the hand came by.
    pub(super) fn take_ahead(
        &mut self,
        page: u32,
        blocks: usize,
        words: &[Word],
        arena: &FrameArena,
    ) -> Option<u32> {
        self.take_by(Hand::TakesCold, page, blocks, (words, arena))
    }

    fn take_by(
        &mut self,
        hand: Hand,
        page: u32,
        blocks: usize,
        (words, arena): (&[Word], &FrameArena),
    ) -> Option<u32> {
        if !self.pay_debt(words, arena) {
            return None;
        }
        loop {
            if self.used + blocks <= self.limit
                && let Some(frame) = self.unused.pop()
            {
                self.used += blocks;
                self.frames[frame as usize] =
                    HeldFrame { owner: page, counted: blocks as u32, ..HeldFrame::UNUSED };
                self.ring.push(frame);
                return Some(frame);
            }
            let at = self.sweep(hand, words)?;
            let frame = self.ring[at];
            let held = &mut self.frames[frame as usize];
            let counted = blocks.max(held.counted as usize);
            let used = self.used - held.counted as usize + counted;
            if used <= self.limit {
                (held.owner, held.counted, held.asked, self.used) = (page, counted as u32, 0, used);
                return Some(frame);
            }
            self.release(at, arena);
        }
    }

    /// The blocks of a frame into which a page is being read, and those of them that stay when the page needs so many:
    /// pages come to ask for most of these, and who takes blocks back and forth asks the kernel, which stops the other
    /// processors for it.
    pub(super) fn blocks(&self, frame: u32, needed: FrameBlocks) -> [FrameBlocks; 2] {
        let had = self.frames[frame as usize].blocks;
        let typical = self.typical.div_ceil(TYPICAL_ONE);
        [had, needed.keeping(had, typical, self.whole)]
    }

    /// Counts for a frame into which a page is being read the `blocks` that it holds now, of which `needed` are asked
    /// for. Others were given back. False when there is no room.
    pub(super) fn settle(
        &mut self,
        frame: u32,
        [needed, blocks]: [FrameBlocks; 2],
        words: &[Word],
        arena: &FrameArena,
    ) -> bool {
        let counted = self.frames[frame as usize].counted as usize;
        if !self.make_room(blocks.count().saturating_sub(counted), words, arena) {
            return false;
        }
        self.used = self.used - counted + blocks.count();
        let held = &mut self.frames[frame as usize];
        (held.blocks, held.counted) = (blocks, blocks.count() as u32);
        held.asked = needed.count() as u32;
        true
    }

    /// Counts blocks at the begin of the frame of a pinned page, up to `head` of them. False when there is no room.
    pub(super) fn grow(&mut self, frame: u32, head: u32, words: &[Word], arena: &FrameArena) -> bool {
        let FrameBlocks { head: now, tail } = self.frames[frame as usize].blocks;
        let more = head.min(self.whole as u32 - tail).saturating_sub(now);
        if !self.make_room(more as usize, words, arena) {
            return false;
        }
        self.used += more as usize;
        let held = &mut self.frames[frame as usize];
        held.blocks.head += more;
        held.counted += more;
        held.asked = held.asked.max(head + tail);
        true
    }

    /// Retires what is owed, as far as pins allow. True when nothing is owed any more.
    pub(super) fn pay_debt(&mut self, words: &[Word], arena: &FrameArena) -> bool {
        if self.leased == self.limit {
            return true;
        }
        while self.used.max(self.promised(words)) > self.limit
            && let Some(at) = self.sweep(Hand::Cools, words)
        {
            self.release(at, arena);
        }
        let busy = self.used.max(self.promised(words));
        self.leased = busy.clamp(self.limit, self.leased);
        self.lease.shrink_to((self.leased * BLOCK_BYTES) as u64);
        self.leased == self.limit
    }

    /// The frame of a page that did not come comes back.
    pub(super) fn give_back(&mut self, frame: u32, arena: &FrameArena) {
        let at = self.ring.iter().position(|&other| other == frame).expect("a frame that nobody owns");
        self.release(at, arena);
    }

    /// Blocks that pages which cannot be evicted now may come to use.
    fn promised(&self, words: &[Word]) -> usize {
        let of = |&frame: &u32| {
            let held = &self.frames[frame as usize];
            match words[held.owner as usize].view() {
                View { pins: 1.., .. } => self.whole,
                View { state: PageState::Reading, .. } => held.counted as usize,
                _ => 0,
            }
        };
        self.ring.iter().map(of).sum()
    }

    /// Evicts until so many blocks are free. False when nothing more can be evicted.
    fn make_room(&mut self, blocks: usize, words: &[Word], arena: &FrameArena) -> bool {
        while self.used + blocks > self.leased {
            let Some(at) = self.sweep(Hand::Cools, words) else { return false };
            self.release(at, arena);
        }
        true
    }

    /// Moves the hand until it has evicted a page. The position of its frame in the ring.
    fn sweep(&mut self, hand: Hand, words: &[Word]) -> Option<usize> {
        let count = self.ring.len();
        let mut busy_in_a_row = 0;
        let rounds = if hand == Hand::Cools { 4 } else { 1 };
        for _ in 0..count * rounds {
            let at = if self.hand < count { self.hand } else { 0 };
            self.hand = at + 1;
            let word = &words[self.frames[self.ring[at] as usize].owner as usize];
            let outcome = if hand == Hand::Cools { word.cool() } else { word.take_cold() };
            match outcome {
                CoolOutcome::Evicted | CoolOutcome::Wasted => {
                    self.evicted += 1;
                    self.wasted += u64::from(outcome == CoolOutcome::Wasted);
                    let asked = self.frames[self.ring[at] as usize].asked as usize;
                    self.typical = self.typical - self.typical / TYPICAL_ONE + asked;
                    return Some(at);
                }
                CoolOutcome::Warm => busy_in_a_row = 0,
                CoolOutcome::Busy => {
                    busy_in_a_row += 1;
                    if busy_in_a_row == count {
                        return None;
                    }
                }
            }
        }
        None
    }

    /// Takes a frame out of the ring, and gives its memory back to the kernel.
    fn release(&mut self, at: usize, arena: &FrameArena) {
        let frame = self.ring.swap_remove(at);
        // SAFETY: no page owns the frame any more, and this clock is locked.
        unsafe { arena.release(frame) };
        self.used -= self.frames[frame as usize].counted as usize;
        self.frames[frame as usize] = HeldFrame::UNUSED;
        self.unused.push(frame);
    }
}
