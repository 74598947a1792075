//! `Failure`: the panic of one of the pool's threads, told to all who wait for pages.
//!
//! ```text
//! thread: PoolState::guard(work) --panic--> Failure::set -> stop -> everybody wakes
//!                                                         pin_blocking: Err(bug)   wait_for_progress: panics, too
//! ```
//!
//! Invariants: 1. the first failure is the one that is kept; 2. it is set before the other threads are told to stop,
//! so who wakes finds it; 3. asking for it is one load as long as there is none.

use super::signal::lock_always;
use super::sync::Mutex;
use crate::error::Error;
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

    pub(super) fn set(&self, error: Error) {
        lock_always(&self.error).get_or_insert(error);
        self.is_set.store(true, Ordering::Release);
    }
}
