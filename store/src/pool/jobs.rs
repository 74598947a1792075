//! `Slot`: a read on its way from the disk to a decoder; `JobQueue`: those that wait for one.
//!
//! Invariant: there are never more slots than were made at open, so the queue cannot overflow.

use super::signal::lock_always;
use crate::error::Result;
use crate::io::Staging;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, PoisonError};

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
    pub(super) staging: Option<Staging>,
    /// Where the read begins in the file.
    pub(super) offset: u64,
    /// Where it begins in `staging`, once it has arrived.
    pub(super) start: usize,
    pub(super) parts: Vec<Part>,
}

impl Slot {
    pub(super) fn new(id: u32, bytes: usize) -> Result<Slot> {
        let staging = Some(Staging::new(bytes)?);
        Ok(Slot { id, staging, offset: 0, start: 0, parts: Vec::with_capacity(PARTS_MAX) })
    }
}

/// Slots that have arrived and wait for a decoder.
#[derive(Default)]
pub(super) struct JobQueue {
    state: Mutex<JobState>,
    ready: Condvar,
}

#[derive(Default)]
struct JobState {
    slots: VecDeque<Slot>,
    sleepers: usize,
    stop: bool,
}

impl JobQueue {
    /// A slot that has arrived.
    pub(super) fn push(&self, slot: Slot) {
        let mut state = lock_always(&self.state);
        state.slots.push_back(slot);
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
            state.sleepers += 1;
            state = self.ready.wait(state).unwrap_or_else(PoisonError::into_inner);
            state.sleepers -= 1;
        }
    }

    pub(super) fn stop(&self) {
        lock_always(&self.state).stop = true;
        self.ready.notify_all();
    }
}
