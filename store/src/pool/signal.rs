//! How the pool's threads and its callers wake each other.
//!
//! Invariants: 1. nobody pays a system call to wake a thread that is awake; 2. a ring before the sleep is not lost.

use super::sync::{AtomicBool, Condvar, Mutex, MutexGuard, Ordering, fence};
use std::sync::PoisonError;
use std::time::{Duration, Instant};

/// Locks; a thread that panicked while it held the lock is our bug.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("a thread of the pool panicked")
}

/// Locks what is whole between any two statements, so that a panic elsewhere does not matter: flags and counts that
/// wake others must work while a panic is told.
pub(super) fn lock_always<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Wakes one thread: the loader.
#[derive(Default)]
pub(super) struct Bell {
    state: Mutex<BellState>,
    wake: Condvar,
}

#[derive(Default)]
struct BellState {
    rung: bool,
    asleep: bool,
}

impl Bell {
    /// Wakes the sleeper, or keeps him from falling asleep once.
    pub(super) fn ring(&self) {
        let mut state = lock_always(&self.state);
        state.rung = true;
        if state.asleep {
            self.wake.notify_one();
        }
    }

    /// Sleeps until rung, at most `timeout` when there is one.
    pub(super) fn wait(&self, timeout: Option<Duration>) {
        let mut state = lock_always(&self.state);
        state.asleep = true;
        while !state.rung {
            let Some(timeout) = timeout else {
                state = self.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            state = self.wake.wait_timeout(state, timeout).unwrap_or_else(PoisonError::into_inner).0;
            break;
        }
        *state = BellState::default();
    }
}

/// Whether the loader waits for an unpin: `unpin` rings the bell then.
pub(super) struct StarvationFlag(AtomicBool);

impl StarvationFlag {
    pub(super) fn new() -> StarvationFlag {
        StarvationFlag(AtomicBool::new(false))
    }

    pub(super) fn set(&self, is_starved: bool) {
        self.0.store(is_starved, Ordering::SeqCst);
    }

    /// Asked after an unpin.
    pub(super) fn is_set(&self) -> bool {
        // loom takes no order of SeqCst accesses for granted, of fences alone. Elsewhere one would cost each unpin.
        #[cfg(loom)]
        fence(Ordering::SeqCst);
        self.0.load(Ordering::SeqCst)
    }

    /// Tries again after telling `unpin` to ring: who unpins from here on sees the flag, and who unpinned before is
    /// seen by the second try. So no unpin is slept through.
    pub(super) fn try_twice<T>(&self, mut attempt: impl FnMut() -> Option<T>) -> Option<T> {
        attempt().or_else(|| {
            self.set(true);
            fence(Ordering::SeqCst);
            attempt()
        })
    }
}

/// Counts arrivals, and lets many threads sleep until the next one.
#[derive(Default)]
pub(super) struct ArrivalCount {
    state: Mutex<ProgressState>,
    wake: Condvar,
}

#[derive(Default)]
struct ProgressState {
    epoch: u64,
    sleepers: usize,
    given_up: bool,
}

impl ArrivalCount {
    /// One more arrival.
    pub(super) fn bump(&self) {
        let mut state = lock_always(&self.state);
        state.epoch += 1;
        if state.sleepers > 0 {
            self.wake.notify_all();
        }
    }

    /// Wakes all without an arrival: none will come.
    pub(super) fn give_up(&self) {
        lock_always(&self.state).given_up = true;
        self.wake.notify_all();
    }

    /// Arrivals so far.
    pub(super) fn epoch(&self) -> u64 {
        lock_always(&self.state).epoch
    }

    /// Sleeps while the count is `epoch` and more may come, at most `timeout`. The count then.
    pub(super) fn wait(&self, epoch: u64, timeout: Duration) -> u64 {
        let deadline = Instant::now() + timeout;
        let mut state = lock_always(&self.state);
        state.sleepers += 1;
        while state.epoch == epoch && !state.given_up {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            state = self.wake.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        state.sleepers -= 1;
        state.epoch
    }
}
