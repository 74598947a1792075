//! `Clock`: which frames there are, who owns them, and who loses his.
//!
//! ```text
//!   retired  --set_limit grows-->  free  --take-->  owned (in the ring, under the hand)
//!      ^                            |                 |
//!      '------- set_limit shrinks --'---- evicted ----'
//! ```
//!
//! Lost: passing over half of the pages, in runs of 32, but every 8th or 32nd round, so that of views which alternate
//! and do not fit together each keeps a part: as many or more pages were read, and the slowest responses took half as
//! long again.
//!
//! Unsafe code stands here because frames without an owner are given back to the kernel.
//!
//! Invariants
//! 1. `live = free + ring`, all frames = live + retired. Memory is leased for all live frames, before they are used.
//! 2. A frame is in `ring` exactly while a READING or RESIDENT page owns it.
//! 3. The hand never spins: one call looks at no more than four rounds (three scores and the eviction), and at one
//!    round where all is busy.
//! 4. Frames owed (a limit that shrank while pages were pinned) are paid before anybody gets a frame.
#![allow(unsafe_code)]

use super::frames::FrameArena;
use super::word::{CoolOutcome, Word};
use crate::budget::Lease;

const NOBODY: u32 = u32::MAX;

/// The frames and the hand.
pub(super) struct Clock {
    owner: Vec<u32>,
    ring: Vec<u32>,
    free: Vec<u32>,
    retired: Vec<u32>,
    hand: usize,
    owed: usize,
    lease: Lease,
    /// Pages that lost their frame.
    pub(super) evicted: u64,
}

impl Clock {
    /// A clock over `frames_max` frames, all retired. `lease` is empty.
    pub(super) fn new(frames_max: usize, lease: Lease) -> Clock {
        Clock {
            owner: vec![NOBODY; frames_max],
            ring: Vec::with_capacity(frames_max),
            free: Vec::with_capacity(frames_max),
            retired: (0..frames_max as u32).rev().collect(),
            hand: 0,
            owed: 0,
            lease,
            evicted: 0,
        }
    }

    /// Bytes of this struct's tables for one frame.
    pub(super) const BYTES_PER_FRAME: u64 = 16;

    /// Frames that memory is leased for.
    pub(super) fn live(&self) -> usize {
        self.ring.len() + self.free.len()
    }

    /// Frames above the limit that are pinned still.
    pub(super) fn owed(&self) -> usize {
        self.owed
    }

    /// Most frames that the pool can ever have.
    pub(super) fn frames_max(&self) -> usize {
        self.owner.len()
    }

    /// Sets the number of frames. Growing leases first; shrinking evicts and releases what it can and owes the rest.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit) when the budget has no room; nothing is changed then.
    pub(super) fn set_frames(
        &mut self,
        frames: usize,
        words: &[Word],
        arena: &FrameArena,
    ) -> crate::Result<()> {
        assert!(frames <= self.frames_max());
        let live = self.live();
        if frames >= live {
            let more = frames - live;
            self.lease.grow("page frames", (more * arena.frame_bytes()) as u64)?;
            self.owed = 0;
            let from = self.retired.len() - more;
            self.free.extend(self.retired.drain(from..).rev());
        } else {
            self.owed = live - frames;
            self.pay(words, arena);
        }
        Ok(())
    }

    /// A frame for `page`: a free one, or one whose page is evicted. `None` when all are busy.
    pub(super) fn take(&mut self, page: u32, words: &[Word], arena: &FrameArena) -> Option<u32> {
        self.pay(words, arena);
        if self.owed > 0 {
            return None;
        }
        if let Some(frame) = self.free.pop() {
            self.owner[frame as usize] = page;
            self.ring.push(frame);
            return Some(frame);
        }
        let at = self.sweep(words)?;
        let frame = self.ring[at];
        self.owner[frame as usize] = page;
        Some(frame)
    }

    /// Retires what is owed, as far as pins allow. True when nothing is owed any more.
    pub(super) fn pay_debt(&mut self, words: &[Word], arena: &FrameArena) -> bool {
        self.pay(words, arena);
        self.owed == 0
    }

    /// The frame of a page that turned out damaged comes back.
    pub(super) fn give_back(&mut self, frame: u32, arena: &FrameArena) {
        let at = self.ring.iter().position(|&other| other == frame).expect("a frame that nobody owns");
        self.disown(at);
        self.free.push(frame);
        self.pay_with_free(arena);
    }

    /// Moves the hand until it has evicted a page. The position of its frame in the ring.
    fn sweep(&mut self, words: &[Word]) -> Option<usize> {
        let count = self.ring.len();
        let mut busy_in_a_row = 0;
        for _ in 0..count * 4 {
            let at = if self.hand < count { self.hand } else { 0 };
            self.hand = at + 1;
            match words[self.owner[self.ring[at] as usize] as usize].cool() {
                CoolOutcome::Evicted => {
                    self.evicted += 1;
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

    /// Retires what is owed, as far as frames can be had.
    fn pay(&mut self, words: &[Word], arena: &FrameArena) {
        self.pay_with_free(arena);
        while self.owed > 0 {
            let Some(at) = self.sweep(words) else { return };
            let frame = self.disown(at);
            self.free.push(frame);
            self.pay_with_free(arena);
        }
    }

    fn pay_with_free(&mut self, arena: &FrameArena) {
        while self.owed > 0
            && let Some(frame) = self.free.pop()
        {
            // SAFETY: the frame was free: no page owns it, and this clock is locked.
            unsafe { arena.release(frame) };
            self.retired.push(frame);
            self.owed -= 1;
            let live = self.live();
            self.lease.shrink_to((live * arena.frame_bytes()) as u64);
        }
    }

    fn disown(&mut self, at: usize) -> u32 {
        let frame = self.ring.swap_remove(at);
        self.owner[frame as usize] = NOBODY;
        frame
    }
}
