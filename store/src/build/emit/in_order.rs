//! `InOrder`: items that are built side by side in a pool of threads, and taken one by one, in order.
//!
//! ```text
//! next index -> workers: tasks of the pool -> bounded channel -> take(0, ..), take(1, ..), ..: the caller's thread
//! ```
//!
//! A worker waits for its turn while it holds a thread of the pool. So it must not hand work to that pool itself: a
//! thread that waits for such work may begin another worker on top of this one, and then neither gets its turn.
//!
//! Invariants: 1. `take` is given every item once, in order, whatever the number of workers; 2. at most [`WINDOW`]
//! finished items a worker wait for their turn; 3. nobody waits for one that is gone: an error, an interrupt and a
//! panic stop all workers.

use crate::error::Result;
use crate::progress::Interrupt;
use rayon::ThreadPool;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Condvar, Mutex};
use std::time::Duration;

/// Items that may be finished ahead of their turn, per worker.
pub(super) const WINDOW: usize = 3;
/// Longest sleep before a look at the interrupt.
const GLANCE: Duration = Duration::from_millis(100);

/// Who builds how many items.
pub(crate) struct InOrder<'a> {
    pub(crate) pool: &'a ThreadPool,
    /// Tasks of the pool, at least 1.
    pub(crate) worker_count: usize,
    pub(crate) item_count: usize,
    pub(crate) interrupt: &'a Interrupt,
}

/// Whose turn it is.
struct Turns {
    item_count: usize,
    /// Most items between the one that is taken and one that is begun.
    window: usize,
    next: AtomicUsize,
    is_stopped: AtomicBool,
    taken: Mutex<usize>,
    moved: Condvar,
}

impl InOrder<'_> {
    /// Calls `begin` once in each worker for what builds the item of an index, and `take` with all items in order.
    ///
    /// # Errors
    /// The first of a worker's or of `take`, and the interrupt.
    ///
    /// # Panics
    /// With a worker's panic; and on a thread of the pool, which would wait for itself.
    pub(crate) fn run<T: Send, B: FnMut(usize) -> Result<T>>(
        &self,
        begin: impl Fn() -> B + Sync,
        take: impl FnMut(usize, T) -> Result<()>,
    ) -> Result<()> {
        assert!(self.pool.current_thread_index().is_none(), "a thread of the pool would wait for itself");
        let turns = Turns {
            item_count: self.item_count,
            window: WINDOW * self.worker_count,
            next: AtomicUsize::new(0),
            is_stopped: AtomicBool::new(false),
            taken: Mutex::new(0),
            moved: Condvar::new(),
        };
        self.pool.in_place_scope(|scope| {
            let (sender, results) = sync_channel(self.worker_count);
            for _ in 0..self.worker_count {
                let (sender, turns, begin) = (sender.clone(), &turns, &begin);
                scope.spawn(move |_| {
                    let _stop = StopInPanic(turns);
                    let mut build = begin();
                    while let Some(index) = turns.claim() {
                        if sender.send((index, build(index))).is_err() {
                            return;
                        }
                    }
                });
            }
            drop(sender);
            let _stop = StopInPanic(&turns);
            let outcome = self.take_all(&turns, &results, take);
            turns.stop();
            // Those who wait to send, too.
            drop(results);
            outcome
        })
    }

    /// Takes items until no worker is left.
    fn take_all<T>(
        &self,
        turns: &Turns,
        results: &Receiver<(usize, Result<T>)>,
        mut take: impl FnMut(usize, T) -> Result<()>,
    ) -> Result<()> {
        let mut waiting = BTreeMap::new();
        let mut turn = 0;
        loop {
            self.interrupt.check()?;
            let (index, result) = match results.recv_timeout(GLANCE) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            };
            waiting.insert(index, result?);
            while let Some(item) = waiting.remove(&turn) {
                take(turn, item)?;
                turn += 1;
                turns.advance(turn);
            }
        }
    }
}

impl Turns {
    /// The next item to be built, as soon as it may be; `None` when there is none.
    fn claim(&self) -> Option<usize> {
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        if index >= self.item_count {
            return None;
        }
        let mut taken = self.taken.lock().expect("no panic while held");
        while index >= *taken + self.window && !self.is_stopped() {
            taken = self.moved.wait_timeout(taken, GLANCE).expect("as above").0;
        }
        (!self.is_stopped()).then_some(index)
    }

    /// The items before `turn` are taken.
    fn advance(&self, turn: usize) {
        *self.taken.lock().expect("no panic while held") = turn;
        self.moved.notify_all();
    }

    fn stop(&self) {
        self.is_stopped.store(true, Ordering::Relaxed);
        self.moved.notify_all();
    }

    fn is_stopped(&self) -> bool {
        self.is_stopped.load(Ordering::Relaxed)
    }
}

/// Stops all when its thread panics: the item that a worker had begun never comes, the taker takes none any more.
struct StopInPanic<'a>(&'a Turns);

impl Drop for StopInPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::{Code, Error};
    use rayon::ThreadPoolBuilder;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    const ITEMS: usize = 60;

    /// What was taken of [`ITEMS`] squares, by so many workers, and the end of it; `meet` is asked before each.
    fn squares(worker_count: usize, meet: impl Fn(usize) -> Result<()> + Sync) -> (Vec<usize>, Result<()>) {
        let pool = ThreadPoolBuilder::new().num_threads(worker_count).build().unwrap();
        let line = InOrder { pool: &pool, worker_count, item_count: ITEMS, interrupt: &Interrupt::default() };
        let (begun, mut taken) = (AtomicUsize::new(0), Vec::new());
        let outcome = line.run(
            || {
                |index| {
                    begun.fetch_add(1, Ordering::SeqCst);
                    meet(index)?;
                    Ok(index * index)
                }
            },
            |index, square| {
                // Those that wait for their turn, this one, and one that each worker is at.
                let ahead = begun.load(Ordering::SeqCst) - taken.len();
                assert!(ahead <= WINDOW * worker_count, "{ahead} begun, {worker_count} workers");
                assert_eq!(square, index * index);
                taken.push(index);
                Ok(())
            },
        );
        (taken, outcome)
    }

    fn failed() -> Error {
        Error::new(Code::Io, "this item cannot be built")
    }

    #[test]
    fn all_are_taken_in_order_by_any_number_of_workers() {
        for worker_count in [1, 2, 5] {
            // The first of each ten comes last.
            let late = |index: usize| {
                std::thread::sleep(Duration::from_millis(if index.is_multiple_of(10) { 8 } else { 0 }));
                Ok(())
            };
            let (taken, outcome) = squares(worker_count, late);
            assert!(outcome.is_ok() && taken.iter().copied().eq(0..ITEMS), "{worker_count}: {taken:?}");
        }
    }

    #[test]
    fn an_error_stops_all() {
        for worker_count in [1, 2, 5] {
            let (taken, outcome) =
                squares(worker_count, |index| if index == 23 { Err(failed()) } else { Ok(()) });
            assert_eq!(outcome.unwrap_err().what(), failed().what());
            assert!(taken.len() <= 23 && taken.iter().copied().eq(0..taken.len()), "{taken:?}");
        }
    }

    /// The others used to wait for the item of the one that was gone, and the taker for them, for ever.
    #[test]
    fn a_panic_ends_the_wait_of_all_and_is_the_callers() {
        for worker_count in [1, 2, 5] {
            let lost = |index| if index == 23 { panic!("item 23 is lost") } else { Ok(()) };
            let panic = catch_unwind(AssertUnwindSafe(|| squares(worker_count, lost))).unwrap_err();
            assert_eq!(panic.downcast_ref::<&str>(), Some(&"item 23 is lost"), "{worker_count}");
        }
        let pool = ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let line =
            InOrder { pool: &pool, worker_count: 2, item_count: ITEMS, interrupt: &Interrupt::default() };
        let lost = |index, _| if index == 7 { panic!("the taker is lost") } else { Ok(()) };
        let panic = catch_unwind(AssertUnwindSafe(|| line.run(|| Ok, lost))).unwrap_err();
        assert_eq!(panic.downcast_ref::<&str>(), Some(&"the taker is lost"));
    }

    #[test]
    fn an_interrupt_and_an_error_of_the_taker_stop_all() {
        let pool = ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let interrupt = Interrupt::default();
        let line = InOrder { pool: &pool, worker_count: 3, item_count: usize::MAX, interrupt: &interrupt };
        let refuse = |index, _| if index == 7 { Err(failed()) } else { Ok(()) };
        assert_eq!(line.run(|| Ok, refuse).unwrap_err().what(), failed().what());
        let raise = |index, _| {
            if index == 7 {
                interrupt.raise();
            }
            Ok(())
        };
        assert_eq!(line.run(|| Ok, raise).unwrap_err().code(), Code::Interrupted);
    }
}
