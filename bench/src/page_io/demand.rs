//! Pages that somebody waits for, one after the other: alone, and while others are asked for ahead, as many as the pool
//! queues, and without end.
//!
//! Invariant: a page that is waited for is not among those that are asked for ahead: all of them come from the disk.

use super::clock::Clock;
use super::pages::Pages;
use hdrhistogram::Histogram;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use trex_store::Error;
use trex_store::pool::{PagePool, Want};

/// One page of so many is waited for; no more than so many.
const SHARE: usize = 8;
const MOST: usize = 1 << 10;
/// Callers of the pool: who waits, and who asks ahead.
const DEMAND: usize = 0;
const AHEAD: usize = 1;
/// Looks again at the latest after so long.
const PATIENCE: Duration = Duration::from_millis(20);
/// Time between two lists of pages that are asked for ahead.
const ROUND: Duration = Duration::from_millis(10);
/// Pages that are asked for ahead at a time: more than the queue takes; and how many of them are others the next time.
const ASKED: usize = 5000;
const STEP: usize = 64;

/// Waits for some of the pages, and tells how long each took, microseconds. Gives how many there were, and how
/// long all of them took, without what it takes to begin and to end with those asked for ahead.
pub(super) fn wait_for_some(
    pool: &PagePool,
    pages: &Pages<'_>,
    is_busy: bool,
    latencies: &mut Histogram<u64>,
) -> anyhow::Result<(usize, (Duration, Duration))> {
    let waited = &pages.order[..(pages.order.len() / SHARE).clamp(1, MOST)];
    let ahead = &pages.order[waited.len()..];
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        if is_busy && !ahead.is_empty() {
            let thread = std::thread::Builder::new().name("trex-ask-ahead".into());
            let spawned = thread.spawn_scoped(scope, || ask_ahead(pool, ahead, &done));
            spawned.map_err(|error| Error::thread_refused("the pages asked for ahead", &error))?;
            // Until the queue is full.
            while pool.stats().pages_read == 0 {
                std::thread::sleep(ROUND);
            }
        }
        let (clock, mut wall) = (Clock::start(), Duration::ZERO);
        let all_came: anyhow::Result<()> = waited.iter().try_for_each(|&page| {
            let took = wait(pool, page)?;
            wall += took;
            latencies.saturating_record(took.as_micros() as u64);
            Ok(())
        });
        let (_, cpu) = clock.spent();
        done.store(true, Ordering::Relaxed);
        all_came.map(|()| (waited.len(), (wall, cpu)))
    })
}

/// Waits until `page` is there.
fn wait(pool: &PagePool, page: u32) -> anyhow::Result<Duration> {
    let begin = Instant::now();
    loop {
        let epoch = pool.epoch();
        pool.submit(DEMAND, &[Want { page, weight: u32::MAX }]);
        if pool.pin(page).is_some() {
            return Ok(begin.elapsed());
        }
        anyhow::ensure!(!pool.is_damaged(page), "page {page} is damaged: run trex verify");
        pool.wait_for_progress(epoch, PATIENCE);
    }
}

/// Asks for so many of `pages` at a time, some others each time and round and round: always more than the queue holds.
fn ask_ahead(pool: &PagePool, pages: &[u32], done: &AtomicBool) {
    let all: Vec<Want> = pages.iter().map(|&page| Want { page, weight: 0 }).collect();
    let mut asked: Vec<Want> = Vec::with_capacity(ASKED);
    for first in (0..all.len()).cycle().step_by(STEP) {
        if done.load(Ordering::Relaxed) {
            break;
        }
        asked.clear();
        asked.extend(all.iter().cycle().skip(first).take(ASKED.min(all.len())));
        pool.submit(AHEAD, &asked);
        std::thread::sleep(ROUND);
    }
    pool.submit(AHEAD, &[]);
    pool.submit(AHEAD, &[]);
}
