//! The loader: one I/O thread that turns wants into reads, and a few threads that decode what arrives.
//!
//! ```text
//! Requests --best + neighbours--> Slot (frames taken, staging taken) --Reader--> arrival --> JobQueue
//!                                   ^                                                           |
//!                                   '--- idle <--- install | damage, one bump per page <--------'
//! ```
//!
//! Unsafe code stands here because a decoder writes to the frame of the page that it loads.
//!
//! Invariants
//! 1. A slot of staging and a frame for each page are held before the read is submitted.
//! 2. A slot is idle, being read, waiting for a decoder, or in the hands of one: there are never more of any of these
//!    than slots, so no queue can overflow and nothing is allocated per read.
//! 3. A page in READING stands in exactly one slot, or in `split`: single flight.
//! 4. A panic of one of these threads ends the pool: whoever waits is told (`failure.rs`), nobody idles.
//! 5. Of pages that nobody waits for at most [`AHEAD_MOST`] reads are under way or wait for a decoder, which they have
//!    for themselves and which gives way to all other threads, until somebody waits for one of them. They get frames
//!    that nobody wants.
//! 6. A failed read of several pages is repeated page by page: one bad sector costs one page.
//! 7. A page that needs more of its frame than was expected, and finds no room, is read again when it is wanted again.
//! 8. A page that does not match its hash is read once more, by the store's own way, before it counts as damaged.
#![allow(unsafe_code)]

use super::frame_room::{BLOCK_BYTES, FrameBlocks, FrameRoom};
use super::jobs::{PARTS_MAX, Part, Slot};
use super::requests::Requests;
use super::shared::PoolState;
use super::signal::lock;
use super::stats::count;
use crate::error::{Code, Error, Result};
use crate::io::{Arrival, Extent, Reader, Wait};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Bytes between two extents that are read and thrown away to save one read. At 16 KiB the transfer costs what the
/// saved request does on a fast SSD (about 10 us); behind HTTP, 0 to 128 KiB make no difference, since pages that are
/// wanted together stand side by side or far apart.
const GAP_MAX_BYTES: u64 = 16 << 10;

/// Reads of pages that nobody waits for, from their begin to the end of their decoding. More would fill the queue of
/// the disk, which a page that is waited for has to pass; decoders are busy with fewer.
const AHEAD_MOST: usize = 4;

/// Niceness of the decoder of pages that nobody waits for: the last.
const NICENESS: i32 = 19;

/// Sleep of the loader when every frame is pinned, should the wake-up by `unpin` ever be late.
const STARVED_SLEEP: Duration = Duration::from_millis(10);

/// Most damaged pages whose errors are kept. All are counted.
pub(super) const DAMAGE_MAX: usize = 1024;

/// The I/O thread.
pub(super) struct Loader<'a> {
    shared: &'a PoolState,
    reader: Reader,
    /// Slots being read, by id.
    reading: Vec<Option<Slot>>,
    /// Pages of reads that failed, to be read one by one. They have their frames.
    split: Vec<Part>,
    merge_bytes: u64,
    starved: bool,
    /// What is known of the backend's troubles.
    notice: Option<String>,
}

enum Fill {
    Ready(Extent),
    Nothing,
    /// Demand is queued and every frame is busy.
    Starved,
}

impl<'a> Loader<'a> {
    pub(super) fn new(shared: &'a PoolState, reader: Reader, slots: usize, merge_bytes: u64) -> Loader<'a> {
        Loader {
            shared,
            reader,
            reading: (0..slots).map(|_| None).collect(),
            split: Vec::with_capacity(slots * PARTS_MAX),
            merge_bytes,
            starved: false,
            notice: None,
        }
    }

    /// Works until the pool stops. Reads in flight are waited for by the drop of the reader.
    pub(super) fn run(&mut self) {
        let mut arrivals = Vec::with_capacity(self.reading.len());
        while !self.shared.stop.load(Ordering::Acquire) {
            self.pump();
            if self.reader.in_flight() > 0 {
                self.reader.complete(Wait::One, &mut arrivals);
                self.publish_stats();
                for arrival in arrivals.drain(..) {
                    self.arrived(arrival);
                }
            } else {
                self.shared.bell.wait(self.starved.then_some(STARVED_SLEEP));
            }
        }
    }

    /// Pays frames that are owed, then submits as many reads as there are wants and permits for.
    fn pump(&mut self) {
        let shared = self.shared;
        let pay_debt = || lock(&shared.clock).pay_debt(&shared.words, &shared.arena).then_some(());
        let in_debt = shared.starved.try_twice(pay_debt).is_none();
        if shared.ahead.load(Ordering::Acquire) > 0 {
            let hurried = shared.jobs.hurry(|slot| shared.are_asked(&slot.parts));
            shared.ahead.fetch_sub(hurried, Ordering::AcqRel);
        }
        let mut saturated = false;
        while self.reader.room() > 0 {
            let Some(mut slot) = lock(&shared.idle).pop() else { break };
            match self.fill(&mut slot) {
                Fill::Ready(extent) => self.submit(slot, extent),
                other => {
                    saturated = matches!(other, Fill::Starved);
                    lock(&shared.idle).push(slot);
                    break;
                }
            }
        }
        if saturated && !shared.saturated.load(Ordering::Relaxed) {
            count(&shared.counters.saturated);
        }
        shared.saturated.store(saturated, Ordering::Relaxed);
        self.starved = saturated || in_debt;
        shared.starved.set(self.starved);
    }

    fn submit(&mut self, mut slot: Slot, extent: Extent) {
        let staging = slot.staging.take().expect("an idle slot without staging");
        let id = slot.id;
        slot.offset = extent.offset;
        self.reading[id as usize] = Some(slot);
        self.reader.submit(id, extent, staging);
    }

    /// Chooses what the slot reads, and takes the frames for it.
    fn fill(&mut self, slot: &mut Slot) -> Fill {
        let shared = self.shared;
        slot.parts.clear();
        slot.is_ahead = false;
        if let Some(part) = self.split.pop() {
            slot.parts.push(part);
            return Fill::Ready(shared.store.extent(part.page));
        }
        let mut requests = lock(&shared.requests);
        let mut clock = lock(&shared.clock);
        let Some((page, weight)) = requests.best() else { return Fill::Nothing };
        if weight == 0 && shared.ahead.load(Ordering::Acquire) >= AHEAD_MOST {
            return Fill::Nothing;
        }
        let is_ahead = weight == 0;
        let mut take = |page| {
            let (blocks, words, arena) = (shared.blocks_of(page), &shared.words, &shared.arena);
            if is_ahead {
                clock.take_ahead(page, blocks, words, arena)
            } else {
                clock.take(page, blocks, words, arena)
            }
        };
        let frame = if is_ahead {
            let Some(frame) = take(page) else { return Fill::Nothing };
            slot.is_ahead = true;
            shared.ahead.fetch_add(1, Ordering::AcqRel);
            frame
        } else {
            let Some(frame) = shared.starved.try_twice(|| take(page)) else { return Fill::Starved };
            frame
        };
        let mut extent = shared.store.extent(page);
        shared.begin(&mut requests, slot, Part { page, frame });

        // Neighbours on disk, first behind and then before, while they lie near and somebody wants them.
        for step in [1, -1] {
            let mut near = page;
            while slot.parts.len() < PARTS_MAX
                && let Some(next) = near.checked_add_signed(step)
                && requests.contains(next)
                && let Some(joined) = join(extent, shared.store.extent(next), self.merge_bytes)
                && let Some(frame) = take(next)
            {
                shared.begin(&mut requests, slot, Part { page: next, frame });
                (extent, near) = (joined, next);
            }
        }
        Fill::Ready(extent)
    }

    /// A read has come back: to a decoder with it, or once more page by page.
    fn arrived(&mut self, arrival: Arrival) {
        let mut slot = self.reading[arrival.tag as usize].take().expect("an arrival without a slot");
        slot.staging = Some(arrival.staging);
        match arrival.result {
            Ok(range) => {
                slot.start = range.start;
                if slot.is_ahead && self.shared.are_asked(&slot.parts) {
                    self.shared.end_ahead(&mut slot);
                }
                self.shared.jobs.push(slot);
                return;
            }
            Err(error) if slot.parts.len() == 1 => self.shared.end(slot.parts[0], Err(error)),
            Err(_) => self.split.extend_from_slice(&slot.parts),
        }
        self.shared.put_back(slot);
    }

    fn publish_stats(&mut self) {
        let (stats, counters) = (self.reader.stats(), &self.shared.counters);
        counters.reads.store(stats.reads - stats.retries, Ordering::Relaxed);
        counters.read_retries.store(stats.retries, Ordering::Relaxed);
        counters.bytes_read.store(stats.bytes, Ordering::Relaxed);
        let description = self.reader.describe();
        if description.notice != self.notice {
            self.notice.clone_from(&description.notice);
            lock(&self.shared.io).clone_from(description);
        }
    }
}

/// Lets other threads go before this one. A processor that is busy with what nobody waits for would be given to the
/// loader only at the end of its time slice: p99 of a page that is waited for beside a full queue was 1.4 to 2.5 ms.
fn give_way() {
    // Of Linux alone a priority is a thread's; elsewhere it would be the process'. One that is refused costs time only.
    if cfg!(target_os = "linux") {
        let _ = rustix::process::setpriority_process(None, NICENESS);
    }
}

/// One read for both, when they lie near enough and do not overlap.
fn join(a: Extent, b: Extent, max_bytes: u64) -> Option<Extent> {
    let (first, second) = if a.offset <= b.offset { (a, b) } else { (b, a) };
    let gap = second.offset.checked_sub(first.end())?;
    let bytes = second.end() - first.offset;
    let near = gap <= GAP_MAX_BYTES && bytes <= max_bytes;
    near.then_some(Extent { offset: first.offset, stored_bytes: bytes as u32 })
}

impl PoolState {
    /// QUEUED to READING.
    fn begin(&self, requests: &mut Requests, slot: &mut Slot, part: Part) {
        requests.take(part.page, part.frame, &self.words);
        let view = self.words[part.page as usize].view();
        count(&self.counters.pages_read);
        if view.ahead {
            count(&self.counters.ahead_issued);
        }
        if view.generation != 0 {
            count(&self.counters.refaults);
        }
        slot.parts.push(part);
    }

    /// READING to RESIDENT or DAMAGED, or back to ABSENT where there was no room, and the word goes round.
    fn end(&self, part: Part, result: Result<()>) {
        let word = &self.words[part.page as usize];
        match result {
            Ok(()) => word.install(),
            Err(error) if error.code() == Code::MemoryLimit => {
                word.abandon();
                lock(&self.clock).give_back(part.frame, &self.arena);
            }
            Err(error) => {
                // Before the word says it: who sees a damaged page finds its error.
                self.keep_damage(part.page, error);
                word.damage();
                lock(&self.clock).give_back(part.frame, &self.arena);
            }
        }
        self.progress.bump();
    }

    /// Counts a damaged page, and keeps its error while there are few.
    pub(super) fn keep_damage(&self, page: u32, error: Error) {
        let mut damage = lock(&self.damage);
        if damage.iter().all(|(known, _)| *known != page) {
            count(&self.counters.damaged);
            if damage.len() < DAMAGE_MAX {
                damage.push((page, error));
            }
        }
    }

    /// A decode thread, of slots that nobody waits for or of the others: works until the pool stops.
    pub(super) fn decode(&self, is_ahead: bool) {
        if is_ahead {
            give_way();
        }
        let mut scratch = Vec::new();
        while let Some(mut slot) = self.jobs.pop(is_ahead) {
            let mut done = 0;
            while done < slot.parts.len() {
                let part = slot.parts[done];
                let result = self.install(&mut slot, part, &mut scratch);
                self.end(part, result);
                done += 1;
                if is_ahead && self.are_asked(&slot.parts[done..]) {
                    break;
                }
            }
            slot.parts.drain(..done);
            if slot.parts.is_empty() {
                self.put_back(slot);
                self.bell.ring();
            } else {
                self.end_ahead(&mut slot);
                self.jobs.push(slot);
            }
        }
    }

    /// True when somebody waits for one of these pages, which are read ahead.
    fn are_asked(&self, parts: &[Part]) -> bool {
        parts.iter().any(|part| !self.words[part.page as usize].view().ahead)
    }

    /// Somebody waits for a page of `slot`, which was read ahead.
    fn end_ahead(&self, slot: &mut Slot) {
        slot.is_ahead = false;
        self.ahead.fetch_sub(1, Ordering::AcqRel);
    }

    /// A slot is idle again.
    fn put_back(&self, mut slot: Slot) {
        if slot.is_ahead {
            self.end_ahead(&mut slot);
        }
        lock(&self.idle).push(slot);
    }

    /// Checks and decodes a page of `slot`; one that is damaged is read again first, in its place.
    fn install(&self, slot: &mut Slot, part: Part, scratch: &mut Vec<u8>) -> Result<()> {
        let extent = self.store.extent(part.page);
        let at = slot.start + (extent.offset - slot.offset) as usize;
        let staging = slot.staging.as_mut().expect("a slot that arrived without staging");
        let stored = &mut staging[at..at + extent.stored_bytes as usize];
        // SAFETY: the page is READING, and stands in this slot alone (invariant 3), which this thread owns.
        let frame = unsafe { self.arena.frame_mut(part.frame) };
        let take = &mut |ends| self.settle(part, ends);
        let frame = &mut FrameRoom::of_pool(frame, take);
        let first = self.store.install(part.page, stored, frame, scratch);
        if !first.as_ref().is_err_and(|error| error.code() == Code::Damaged) {
            return first;
        }
        count(&self.counters.reads_again);
        match self.store.read_again(part.page, stored) {
            Ok(true) => self.store.install(part.page, stored, frame, scratch),
            _ => first,
        }
    }

    /// Blocks that `page` takes of a frame when it comes, as far as is known.
    fn blocks_of(&self, page: u32) -> usize {
        self.blocks[page as usize].load(Ordering::Relaxed).into()
    }

    /// Takes what a page needs of its frame, so many bytes at its begin and so many at its end.
    fn settle(&self, part: Part, ends: [usize; 2]) -> Result<()> {
        let needed = FrameBlocks::of(ends, self.arena.frame_bytes());
        self.blocks[part.page as usize].store(needed.count() as u16, Ordering::Relaxed);
        let [had, blocks] = lock(&self.clock).blocks(part.frame, needed);
        // SAFETY: as in `install`.
        unsafe { self.arena.release_middle(part.frame, had, blocks) };
        let has_room = lock(&self.clock).settle(part.frame, [needed, blocks], &self.words, &self.arena);
        has_room.then_some(()).ok_or_else(|| {
            Error::new(Code::MemoryLimit, "no room for a page among those in use")
                .at_place(format!("page {}", part.page))
                .numbers(format!("{} blocks of {BLOCK_BYTES} bytes", blocks.count()))
                .next("ask again when others are let go")
        })
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn extents_join_when_near() {
        let extent = |offset, stored_bytes| Extent { offset, stored_bytes };
        let max = 256 << 10;
        assert_eq!(join(extent(10, 5), extent(15, 7), max), Some(extent(10, 12)));
        assert_eq!(join(extent(15, 7), extent(10, 5), max), Some(extent(10, 12)));
        assert_eq!(join(extent(0, 1), extent(1 + GAP_MAX_BYTES, 1), max), Some(extent(0, 2 + (16 << 10))));
        assert_eq!(join(extent(0, 1), extent(2 + GAP_MAX_BYTES, 1), max), None);
        assert_eq!(join(extent(0, 10), extent(9, 5), max), None);
        assert_eq!(join(extent(0, 200_000), extent(200_000, 100_000), max), None);
    }
}
