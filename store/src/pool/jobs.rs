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
    /// Nobody waits for any of them.
    pub(super) is_ahead: bool,
}

impl Slot {
    pub(super) fn new(id: u32, bytes: usize) -> Result<Slot> {
        let staging = Some(StagingBuffer::new(bytes)?);
        let parts = Vec::with_capacity(PARTS_MAX);
        Ok(Slot { id, staging, offset: 0, start: 0, parts, is_ahead: false })
    }
}

/// Slots that have arrived and wait for a decoder: those that somebody waits for, and the others, which have one of
/// their own.
#[derive(Default)]
pub(super) struct JobQueue {
    demand: JobLine,
    ahead: JobLine,
}

#[derive(Default)]
struct JobLine {
    state: Mutex<LineState>,
    ready: Condvar,
}

#[derive(Default)]
struct LineState {
    slots: VecDeque<Slot>,
    sleepers: usize,
    stop: bool,
}

impl JobQueue {
    /// A slot that has arrived.
    pub(super) fn push(&self, slot: Slot) {
        self.line(slot.is_ahead).push(slot);
    }

    /// The next slot that somebody waits for, or that nobody does; `None` once stopped.
    pub(super) fn pop(&self, is_ahead: bool) -> Option<Slot> {
        self.line(is_ahead).pop()
    }

    /// Takes those of the slots that nobody waited for to the others of which `is_wanted` says so. Gives how many.
    pub(super) fn hurry(&self, is_wanted: impl Fn(&Slot) -> bool) -> usize {
        let (mut ahead, mut count) = (lock_always(&self.ahead.state), 0);
        for _ in 0..ahead.slots.len() {
            let Some(slot) = ahead.slots.pop_front() else { break };
            if is_wanted(&slot) {
                self.demand.push(Slot { is_ahead: false, ..slot });
                count += 1;
            } else {
                ahead.slots.push_back(slot);
            }
        }
        count
    }

    pub(super) fn stop(&self) {
        self.demand.stop();
        self.ahead.stop();
    }

    fn line(&self, is_ahead: bool) -> &JobLine {
        if is_ahead { &self.ahead } else { &self.demand }
    }
}

impl JobLine {
    fn push(&self, slot: Slot) {
        let mut state = lock_always(&self.state);
        state.slots.push_back(slot);
        if state.sleepers > 0 {
            self.ready.notify_one();
        }
    }

    fn pop(&self) -> Option<Slot> {
        let mut state = lock_always(&self.state);
        loop {
            if state.stop {
                return None;
            }
            if let Some(slot) = state.slots.pop_front() {
                return Some(slot);
            }
            state.sleepers += 1;
            state = self.ready.wait(state).unwrap_or_else(PoisonError::into_inner);
            state.sleepers -= 1;
        }
    }

    fn stop(&self) {
        lock_always(&self.state).stop = true;
        self.ready.notify_all();
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;
    use crate::io::ALIGN_BYTES;

    #[test]
    fn what_somebody_waits_for_comes_first() {
        let queue = JobQueue::default();
        for id in 0..4 {
            queue.push(Slot { is_ahead: id != 3, ..Slot::new(id, ALIGN_BYTES).unwrap() });
        }
        assert_eq!(queue.hurry(|slot| slot.id == 1), 1);
        assert_eq!(queue.hurry(|_| false), 0);
        let next = |is_ahead| {
            let slot = queue.pop(is_ahead).unwrap();
            assert_eq!(slot.is_ahead, is_ahead);
            slot.id
        };
        assert_eq!([next(false), next(false), next(true), next(true)], [3, 1, 0, 2]);
        queue.stop();
        assert!(queue.pop(false).is_none() && queue.pop(true).is_none());
    }
}
