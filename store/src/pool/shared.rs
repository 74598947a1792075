//! `PoolState`: what the pool's threads and its callers share.

use super::clock::Clock;
use super::failure::Failure;
use super::frames::FrameArena;
use super::jobs::{JobQueue, Slot};
use super::requests::Requests;
use super::signal::{ArrivalCount, Bell, StarvationFlag};
use super::stats::Counters;
use super::sync::Mutex;
use super::want::PageStore;
use super::word::Word;
use crate::error::Error;
use crate::io::IoDescription;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicUsize, Ordering};

/// What the pool's threads and its callers share.
pub(super) struct PoolState {
    pub(super) store: Arc<dyn PageStore>,
    pub(super) words: Box<[Word]>,
    /// Blocks that each page took of its frame when it last came, or is expected to.
    pub(super) blocks: Box<[AtomicU16]>,
    pub(super) arena: FrameArena,
    pub(super) clock: Mutex<Clock>,
    pub(super) requests: Mutex<Requests>,
    pub(super) idle: Mutex<Vec<Slot>>,
    pub(super) jobs: JobQueue,
    pub(super) bell: Bell,
    pub(super) progress: ArrivalCount,
    /// Slots of pages that nobody waits for.
    pub(super) ahead: AtomicUsize,
    pub(super) damage: Mutex<Vec<(u32, Error)>>,
    /// How the file is read now.
    pub(super) io: Mutex<IoDescription>,
    pub(super) failure: Failure,
    pub(super) counters: Counters,
    /// The loader waits for an unpin: demand finds every frame busy, or frames are owed. `unpin` rings then.
    pub(super) starved: StarvationFlag,
    /// Demand finds every frame busy.
    pub(super) saturated: AtomicBool,
    pub(super) stop: AtomicBool,
}

impl PoolState {
    /// Does the work of one of the pool's threads; a panic in it ends the pool.
    pub(super) fn guard(&self, work: impl FnOnce()) {
        // What the work leaves half done is never looked at again, but by those who are told of the failure.
        if let Err(payload) = catch_unwind(AssertUnwindSafe(work)) {
            let thread = std::thread::current();
            self.failure.set(Error::panicked(thread.name().unwrap_or("unnamed"), &*payload));
            self.stop.store(true, Ordering::Release);
            self.jobs.stop();
            self.bell.ring();
            self.progress.give_up();
        }
    }
}
