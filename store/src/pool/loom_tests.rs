//! The pool under the model checker, every interleaving of up to so many preemptions (CONTRIBUTING.md):
//!
//! ```text
//! word      a pin, an eviction and an install share a frame; two hands evict one page
//! bell      a ring before the sleep is not lost; progress: an arrival neither
//! queue     each slot comes to one decoder, and the end to all
//! requests  two origins want a page that the loader takes: it is read once
//! clock     frames are owed while a page is pinned: the unpin wakes the loader, which pays
//! cluster   two rays ask for a packed one: it is unpacked once, and who sees its word sees all of it
//! ```
//!
//! Unsafe code stands here because loom's cells hand out pointers, and frames are given back to the kernel.

use super::clock::Clock;
use super::frames::FrameArena;
use super::jobs::{JobQueue, Slot};
use super::requests::Requests;
use super::signal::{ArrivalCount, Bell, StarvationFlag, lock};
use super::sync::{AtomicBool, AtomicU64, Mutex, Ordering};
use super::want::Want;
use super::word::{CoolOutcome, PageState, SCORE_FIRST, Word};
use crate::budget::Budget;
use crate::cluster::{AtomicWord, make_once};
use crate::io::ALIGN_BYTES;
use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::thread;
use std::time::Duration;

/// Two pages that share one frame. loom's cell fails the test when a read and a write of it can overlap.
struct TwoPages {
    words: [Word; 2],
    frame: UnsafeCell<u64>,
}

fn use_page(shared: &TwoPages, page: usize) {
    if shared.words[page].try_pin(false).is_some() {
        // The frame holds this page's bytes for as long as it is pinned.
        shared.frame.with(|bytes| assert_eq!(read(bytes), page as u64));
        shared.words[page].unpin();
    }
}

#[allow(unsafe_code)]
fn read(bytes: *const u64) -> u64 {
    // SAFETY: loom checks that no write overlaps; the cell outlives the call.
    unsafe { *bytes }
}

#[allow(unsafe_code)]
fn write(bytes: *mut u64, value: u64) {
    // SAFETY: loom checks that nothing overlaps; the cell outlives the call.
    unsafe { *bytes = value }
}

fn load(shared: &TwoPages, page: usize) {
    shared.words[page].enqueue().unwrap();
    shared.words[page].begin_read(0, false);
    shared.frame.with_mut(|bytes| write(bytes, page as u64));
    shared.words[page].install();
}

fn shared_with_page_0() -> Arc<TwoPages> {
    let shared = Arc::new(TwoPages { words: [Word::absent(), Word::absent()], frame: UnsafeCell::new(9) });
    load(&shared, 0);
    for _ in 0..SCORE_FIRST {
        assert_eq!(shared.words[0].cool(), CoolOutcome::Warm);
    }
    shared
}

/// One thread pins page 0, one pins page 1, one evicts page 0 and installs page 1 into its frame.
#[test]
fn loom_pin_against_evict_against_install() {
    loom::model(|| {
        let shared = shared_with_page_0();
        let readers: Vec<_> = [0, 1]
            .map(|page| {
                let shared = Arc::clone(&shared);
                thread::spawn(move || use_page(&shared, page))
            })
            .into_iter()
            .collect();
        // Twice: a pin may have raised the score from 0 to 1.
        let evicted = (0..2).any(|_| shared.words[0].cool() == CoolOutcome::Evicted);
        if evicted {
            load(&shared, 1);
        }
        for reader in readers {
            reader.join().unwrap();
        }
    });
}

/// Two hands, one page: only one of them gets the frame.
#[test]
fn loom_two_evictions_give_one_frame() {
    loom::model(|| {
        let shared = shared_with_page_0();
        let other = Arc::clone(&shared);
        let theirs = thread::spawn(move || other.words[0].cool() == CoolOutcome::Evicted);
        let ours = shared.words[0].cool() == CoolOutcome::Evicted;
        assert!(ours ^ theirs.join().unwrap());
    });
}

/// Rings, with what there is to see told before.
#[test]
fn loom_a_ring_is_not_slept_through() {
    loom::model(|| {
        let shared = Arc::new((AtomicBool::new(false), Bell::default()));
        let other = Arc::clone(&shared);
        let ringer = thread::spawn(move || {
            other.0.store(true, Ordering::Relaxed);
            other.1.ring();
        });
        while !shared.0.load(Ordering::Relaxed) {
            shared.1.wait(None);
        }
        ringer.join().unwrap();
    });
}

/// Two sleepers, one arrival.
#[test]
fn loom_an_arrival_wakes_all() {
    loom::model(|| {
        let shared = Arc::new((AtomicBool::new(false), ArrivalCount::default()));
        let sleepers = [0, 1].map(|_| {
            let shared = Arc::clone(&shared);
            thread::spawn(move || {
                loop {
                    let epoch = shared.1.epoch();
                    if shared.0.load(Ordering::Relaxed) {
                        return;
                    }
                    shared.1.wait(epoch, Duration::from_secs(3600));
                }
            })
        });
        shared.0.store(true, Ordering::Relaxed);
        shared.1.bump();
        sleepers.into_iter().for_each(|sleeper| sleeper.join().unwrap());
    });
}

/// A decoder of slots that somebody waits for, and one of the others; two of these, one of those; the end.
#[test]
fn loom_each_slot_comes_to_one_decoder() {
    loom::model(|| {
        let queue = Arc::new(JobQueue::default());
        let taken = Arc::new(AtomicU64::new(0));
        let decoders = [false, true].map(|is_ahead| {
            let (queue, taken) = (Arc::clone(&queue), Arc::clone(&taken));
            thread::spawn(move || {
                let mut ids = Vec::new();
                while let Some(slot) = queue.pop(is_ahead) {
                    assert_eq!(slot.is_ahead, is_ahead);
                    ids.push(slot.id);
                    if taken.fetch_add(1, Ordering::AcqRel) == 2 {
                        queue.stop();
                    }
                }
                ids
            })
        });
        for id in 0..3 {
            let slot = Slot::new(id, ALIGN_BYTES).unwrap();
            queue.push(Slot { is_ahead: id < 2, ..slot });
        }
        let mut ids = decoders.map(|decoder| decoder.join().unwrap()).concat();
        ids.sort_unstable();
        assert_eq!(ids, [0, 1, 2]);
    });
}

/// Two origins, one page, one loader.
#[test]
fn loom_a_page_that_two_want_is_read_once() {
    loom::model(|| {
        let shared = Arc::new((Mutex::new(Requests::new(4)), [Word::absent()]));
        let origins = [0, 1].map(|origin| {
            let shared = Arc::clone(&shared);
            thread::spawn(move || {
                lock(&shared.0).submit(origin, &[Want { page: 0, weight: 1 }], &shared.1);
            })
        });
        let load = || {
            let mut requests = lock(&shared.0);
            let (page, _) = requests.best()?;
            requests.take(page, 0, &shared.1);
            drop(requests);
            shared.1[0].install();
            Some(())
        };
        let early = u32::from(load().is_some());
        origins.into_iter().for_each(|origin| origin.join().unwrap());
        let late = u32::from(load().is_some());
        assert_eq!((early + late, shared.1[0].view().state), (1, PageState::Resident));
    });
}

/// What owes a frame, and who holds it.
struct FrameDebt {
    words: [Word; 2],
    clock: Mutex<Clock>,
    arena: FrameArena,
    starved: StarvationFlag,
    bell: Bell,
}

/// One page is pinned, and the limit shrinks: the loader sleeps, without a time to wake up, until the last unpin.
#[test]
fn loom_an_unpin_wakes_who_owes_frames() {
    loom::model(|| {
        let budget = Budget::new(u64::MAX);
        let words = [Word::absent(), Word::absent()];
        let arena = FrameArena::reserve(2, ALIGN_BYTES).unwrap();
        let mut clock = Clock::new(2, ALIGN_BYTES, budget.lease("frames", 0).unwrap());
        clock.set_frames(2, &words, &arena).unwrap();
        for (page, word) in words.iter().enumerate() {
            word.enqueue().unwrap();
            word.begin_read(clock.take(page as u32, 1, &words, &arena).unwrap(), false);
            word.install();
        }
        words[0].try_pin(false).unwrap();
        let clock = Mutex::new(clock);
        let owing = Arc::new(FrameDebt {
            words,
            clock,
            arena,
            starved: StarvationFlag::new(),
            bell: Bell::default(),
        });
        let other = Arc::clone(&owing);
        let holder = thread::spawn(move || {
            if other.words[0].unpin() && other.starved.is_set() {
                other.bell.ring();
            }
        });
        lock(&owing.clock).set_frames(0, &owing.words, &owing.arena).unwrap();
        let pay_debt = || lock(&owing.clock).pay_debt(&owing.words, &owing.arena).then_some(());
        while owing.starved.try_twice(pay_debt).is_none() {
            owing.bell.wait(None);
        }
        holder.join().unwrap();
        let clock = lock(&owing.clock);
        assert_eq!((clock.live(), clock.owed(), clock.evicted), (0, 0, 2));
        assert!(owing.words.iter().all(|word| word.view().state == PageState::Absent));
    });
}

impl AtomicWord for loom::sync::atomic::AtomicU32 {
    fn load_acquire(&self) -> u32 {
        self.load(Ordering::Acquire)
    }

    fn store_release(&self, value: u32) {
        self.store(value, Ordering::Release);
    }

    fn try_take(&self) -> bool {
        self.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed).is_ok()
    }

    fn pause() {
        thread::yield_now();
    }
}

/// Two clusters of a frame, and where the heap ends.
struct TwoClusters {
    lock: loom::sync::atomic::AtomicU32,
    words: [loom::sync::atomic::AtomicU32; 2],
    heap: [UnsafeCell<u64>; 2],
    heap_end: UnsafeCell<u64>,
}

impl TwoClusters {
    fn read(&self, index: usize) {
        let word = &self.words[index];
        if word.load_acquire() == 0 {
            make_once(
                (&self.lock, word),
                |word| word != 0,
                || {
                    let at = self.heap_end.with(read);
                    self.heap[at as usize].with_mut(|bytes| write(bytes, 70 + index as u64));
                    self.heap_end.with_mut(|end| write(end, at + 1));
                    word.store_release(1 + at as u32);
                },
            );
        }
        let at = word.load_acquire() as usize - 1;
        self.heap[at].with(|bytes| assert_eq!(read(bytes), 70 + index as u64));
    }
}

/// One thread asks for one cluster and then for the other, one the other way round.
#[test]
fn loom_clusters_are_unpacked_once() {
    loom::model(|| {
        let zero = || loom::sync::atomic::AtomicU32::new(0);
        let shared = Arc::new(TwoClusters {
            lock: zero(),
            words: [zero(), zero()],
            heap: [UnsafeCell::new(0), UnsafeCell::new(0)],
            heap_end: UnsafeCell::new(0),
        });
        let other = {
            let shared = Arc::clone(&shared);
            thread::spawn(move || [1, 0].iter().for_each(|&index| shared.read(index)))
        };
        [0, 1].iter().for_each(|&index| shared.read(index));
        other.join().unwrap();
        shared.heap_end.with(|end| assert_eq!(read(end), 2));
    });
}
