//! `Failure`: the panic of one of the pool's threads, told to all who wait for pages.
//!
//! ```text
//! thread: guard(work) --panic--> Failure::set -> stop -> everybody wakes
//!                                                         pin_blocking: Err(bug)   wait_for_progress: panics, too
//! ```
//!
//! Invariants: 1. the first failure is the one that is kept; 2. it is set before the other threads are told to stop,
//! so who wakes finds it; 3. asking for it is one load as long as there is none.

use super::Shared;
use super::signal::lock_always;
use crate::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

/// Why the pool has ended, if it has.
#[derive(Default)]
pub(super) struct Failure {
    is_set: AtomicBool,
    error: Mutex<Option<Error>>,
}

impl Failure {
    pub(super) fn get(&self) -> Option<Error> {
        if self.is_set.load(Ordering::Acquire) { lock_always(&self.error).clone() } else { None }
    }

    fn set(&self, error: Error) {
        lock_always(&self.error).get_or_insert(error);
        self.is_set.store(true, Ordering::Release);
    }
}

impl Shared {
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
