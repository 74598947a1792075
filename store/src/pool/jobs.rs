//! `Slot`: a read on its way from the disk to a decoder; `JobQueue`: those that wait for one.
//!
//! Invariant: there are never more slots than were made at open, so the queue cannot overflow.

use super::signal::lock_always;
use super::sync::{Condvar, Mutex};
use crate::error::Result;
use crate::io::StagingBuffer;
use std::collections::VecDeque;
use std::sync::PoisonError;

/// Pages of one read. Bounds the time from its first page to its last.
pub(super) const PARTS_MAX: usize = 32;

/// One page of a read.
#[derive(Clone, Copy)]
pub(super) struct Part {
    pub(super) page: u32,
    pub(super) frame: u32,
}

/// One read: a staging buffer and the pages that come with it.
pub(super) struct Slot {
    pub(super) id: u32,
    /// `None` while the backend has it.
    pub(super) staging: Option<StagingBuffer>,
    /// Where the read begins in the file.
    pub(super) offset: u64,
    /// Where it begins in `staging`, once it has arrived.
    pub(super) start: usize,
    pub(super) parts: Vec<Part>,
    /// How many of them are done.
    pub(super) done: usize,
    /// Nobody waits for any of them.
    pub(super) is_ahead: bool,
}

impl Slot {
    pub(super) fn new(id: u32, bytes: usize) -> Result<Slot> {
        let staging = Some(StagingBuffer::new(bytes)?);
        let parts = Vec::with_capacity(PARTS_MAX);
        Ok(Slot { id, staging, offset: 0, start: 0, parts, done: 0, is_ahead: false })
    }
}

/// Slots that have arrived and wait for a decoder. Those that somebody waits for come first; of the others at most so
/// many are given out at a time: decoders that do not wait for a page to end, and processors for who waits.
pub(super) struct JobQueue {
    state: Mutex<JobState>,
    ready: Condvar,
    ahead_most: usize,
}

#[derive(Default)]
struct JobState {
    slots: VecDeque<Slot>,
    ahead: VecDeque<Slot>,
    /// Slots of `ahead` that decoders have.
    ahead_out: usize,
    sleepers: usize,
    stop: bool,
}

impl JobQueue {
    /// For so many decoders.
    pub(super) fn new(decoders: usize) -> JobQueue {
        JobQueue { state: Mutex::default(), ready: Condvar::new(), ahead_most: (decoders / 2).max(1) }
    }

    /// A slot that has arrived.
    pub(super) fn push(&self, slot: Slot) {
        let mut state = lock_always(&self.state);
        if slot.is_ahead {
            state.ahead.push_back(slot)
        } else {
            state.slots.push_back(slot)
        }
        if state.sleepers > 0 {
            self.ready.notify_one();
        }
    }

    /// The next slot; `None` once stopped.
    pub(super) fn pop(&self) -> Option<Slot> {
        let mut state = lock_always(&self.state);
        loop {
            if state.stop {
                return None;
            }
            if let Some(slot) = state.slots.pop_front() {
                return Some(slot);
            }
            if state.ahead_out < self.ahead_most
                && let Some(slot) = state.ahead.pop_front()
            {
                state.ahead_out += 1;
                return Some(slot);
            }
            state.sleepers += 1;
            state = self.ready.wait(state).unwrap_or_else(PoisonError::into_inner);
            state.sleepers -= 1;
        }
    }

    /// Whether a decoder leaves a slot that nobody waits for: somebody waits for another.
    pub(super) fn is_urgent(&self) -> bool {
        !lock_always(&self.state).slots.is_empty()
    }

    /// A decoder has no more to do with a slot that nobody waits for; it comes back where it is not done. Who says so
    /// asks for the next one.
    pub(super) fn end_ahead(&self, unfinished: Option<Slot>) {
        let mut state = lock_always(&self.state);
        state.ahead_out -= 1;
        state.ahead.extend(unfinished);
    }

    pub(super) fn stop(&self) {
        lock_always(&self.state).stop = true;
        self.ready.notify_all();
    }
}
