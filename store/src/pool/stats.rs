//! `PoolStats` and the counters behind it.
//!
//! Invariant: counting a hit writes to a cache line of the calling thread's stripe, never to one line that all threads
//! share.

use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};

/// Stripes of the hot counters. More threads than this share some.
const STRIPES: usize = 16;

/// Counters of a pool since it was opened. Counts only grow, except for the ones that say `now`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PoolStats {
    /// Pins that found their page.
    pub hits: u64,
    /// Pins that did not.
    pub misses: u64,
    /// Pages that lost their frame.
    pub evictions: u64,
    /// Bytes that came from the file, with what alignment adds.
    pub bytes_read: u64,
    /// Reads sent to the backend, each of one page or of several that lie together.
    pub reads: u64,
    /// Reads that had to be repeated or continued, those of pages that did not match their hash among them.
    pub read_retries: u64,
    /// Pages read.
    pub pages_read: u64,
    /// Pages read that had been evicted before.
    pub refaults: u64,
    /// Pages read ahead: nobody waited for them when they were begun.
    pub ahead_issued: u64,
    /// Those of them that were there when somebody first asked for them.
    pub ahead_used: u64,
    /// Those that somebody asked for while they were being read.
    pub ahead_late: u64,
    /// Those that lost their frame before anybody had asked for them.
    pub ahead_wasted: u64,
    /// Wants that nobody had for two rounds.
    pub wants_dropped: u64,
    /// Wants that found the queue full.
    pub wants_refused: u64,
    /// Times that a wanted page found every frame pinned.
    pub saturated: u64,
    /// Most wants queued at once.
    pub queue_peak: u64,
    /// Wants queued, now.
    pub queued: u64,
    /// Damaged pages met.
    pub damaged: u64,
    /// Whole frames that memory is leased for, now.
    pub frames: u64,
    /// Pages that have a frame, or a part of one, now.
    pub pages: u64,
    /// Frames above the limit that are pinned still, now.
    pub frames_owed: u64,
}

#[derive(Default)]
#[repr(align(128))]
struct Stripe {
    hits: AtomicU64,
    misses: AtomicU64,
}

/// Counters that several threads add to.
#[derive(Default)]
pub(super) struct Counters {
    stripes: [Stripe; STRIPES],
    pub(super) bytes_read: AtomicU64,
    pub(super) reads: AtomicU64,
    pub(super) read_retries: AtomicU64,
    /// Pages that were read again since they did not match their hash.
    pub(super) reads_again: AtomicU64,
    pub(super) pages_read: AtomicU64,
    pub(super) refaults: AtomicU64,
    pub(super) ahead_issued: AtomicU64,
    pub(super) ahead_used: AtomicU64,
    pub(super) saturated: AtomicU64,
    pub(super) damaged: AtomicU64,
}

impl Counters {
    pub(super) fn hit(&self) {
        self.stripe().hits.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn miss(&self) {
        self.stripe().misses.fetch_add(1, Ordering::Relaxed);
    }

    fn stripe(&self) -> &Stripe {
        thread_local!(static HERE: u8 = const { 0 });
        // Where a thread keeps its locals tells threads apart; the odd factor spreads the high bits.
        let here = HERE.with(|here| std::ptr::from_ref(here) as usize as u64);
        &self.stripes[(here.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 60) as usize % STRIPES]
    }

    /// The part of the snapshot that these counters know.
    pub(super) fn snapshot(&self) -> PoolStats {
        let sum = |of: fn(&Stripe) -> &AtomicU64| -> u64 {
            self.stripes.iter().map(|stripe| of(stripe).load(Ordering::Relaxed)).sum()
        };
        let now = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        PoolStats {
            hits: sum(|stripe| &stripe.hits),
            misses: sum(|stripe| &stripe.misses),
            bytes_read: now(&self.bytes_read),
            reads: now(&self.reads),
            read_retries: now(&self.read_retries) + now(&self.reads_again),
            pages_read: now(&self.pages_read),
            refaults: now(&self.refaults),
            ahead_issued: now(&self.ahead_issued),
            ahead_used: now(&self.ahead_used),
            saturated: now(&self.saturated),
            damaged: now(&self.damaged),
            ..PoolStats::default()
        }
    }
}

/// Adds one.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}
