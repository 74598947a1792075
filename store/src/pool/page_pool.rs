//! `PagePool`: opens the pool, starts and joins its threads, and answers its callers. See the folder's text.

use super::clock::Clock;
use super::failure::Failure;
use super::frame_room::BLOCK_BYTES;
use super::frames::FrameArena;
use super::jobs::{JobQueue, Slot};
use super::loader::Loader;
use super::options::{FRAMES_MIN, PoolOptions, PoolPlan};
use super::requests::Requests;
use super::shared::PoolState;
use super::signal::{ArrivalCount, Bell, StarvationFlag, lock};
use super::stats::{Counters, PoolStats};
use super::sync::Mutex;
use super::want::{PageStore, Want};
use super::word::{PageState, Word};
use crate::budget::{Budget, Lease, RESERVE_BYTES};
use crate::error::{Code, Error, Result};
use crate::io::{Backend, IoDescription, Reader};
use crate::layout::{FRAME_BYTES, STORED_BYTES};
use crate::next_step::{NextStep, Setting};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// The number of frames after [`PagePool::set_limit`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameCount {
    /// Frames that memory is leased for.
    pub frames: usize,
    /// How many of them are above the limit and pinned: released as soon as they are unpinned and the loader passes.
    pub owed: usize,
}

/// Pages of one file, in frames. See the folder's text. Dropping it waits for reads in flight and joins its threads.
///
/// ```
/// use std::{path::Path, sync::Arc, time::Duration};
/// use trex_store::io::{Extent, Memory};
/// use trex_store::pool::{FrameRoom, PagePool, PageStore, PoolOptions, Want};
/// use trex_store::{Budget, Result};
///
/// /// A file whose page `i` is the one byte at offset `i`, and fills its frame with it.
/// struct Bytes;
/// impl PageStore for Bytes {
///     fn page_count(&self) -> u32 {
///         100
///     }
///     fn extent(&self, page: u32) -> Extent {
///         Extent { offset: page.into(), stored_bytes: 1 }
///     }
///     fn install(&self, _: u32, stored: &[u8], frame: &mut FrameRoom, _: &mut Vec<u8>) -> Result<()> {
///         frame.whole()?.fill(stored[0]);
///         Ok(())
///     }
///     fn frame_bytes(&self) -> usize {
///         64 << 10
///     }
/// }
///
/// let file = Memory::new((0..100).collect(), 8, 1);
/// let options = PoolOptions { frames_bytes: 1 << 20, ..PoolOptions::default() };
/// let budget = Budget::new(64 << 20);
/// let pool = PagePool::with_backend(Arc::new(Bytes), Box::new(file), Path::new("bytes"), &budget, &options)?;
///
/// // Never blocking: want, do other work, look again.
/// pool.submit(0, &[Want { page: 42, weight: 3 }]);
/// let mut epoch = 0;
/// let pin = loop {
///     match pool.pin(42) {
///         Some(pin) => break pin,
///         None => epoch = pool.wait_for_progress(epoch, Duration::from_millis(10)),
///     }
/// };
/// assert_eq!(pin[5], 42);
///
/// // Or blocking, for simple callers.
/// assert_eq!(pool.pin_blocking(7)?[0], 7);
/// # Ok::<(), trex_store::Error>(())
/// ```
pub struct PagePool {
    pub(super) shared: Arc<PoolState>,
    budget: Budget,
    threads: Vec<JoinHandle<()>>,
    tables: Lease,
    /// Most whole frames that the limit can be set to.
    frames_most: usize,
}

impl PagePool {
    /// Opens `path` by the ladder of [`crate::io::open`] and starts the pool's threads.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] when the budget has no room for tables, staging and the frames asked for;
    /// [`Code::Usage`] for options out of range; those of [`crate::io::open`].
    pub fn open(
        store: Arc<dyn PageStore>,
        path: &Path,
        budget: &Budget,
        options: &PoolOptions,
    ) -> Result<PagePool> {
        let backend = store.backend(path, &options.io)?;
        PagePool::with_backend(store, backend, path, budget, options)
    }

    /// As [`PagePool::open`], over a backend that is open already; `path` is for messages.
    ///
    /// # Errors
    /// As [`PagePool::open`].
    pub fn with_backend(
        store: Arc<dyn PageStore>,
        backend: Box<dyn Backend>,
        path: &Path,
        budget: &Budget,
        options: &PoolOptions,
    ) -> Result<PagePool> {
        let plan = PoolPlan::new(&*store, options)?;
        let tables = budget.lease("tables and staging of the page pool", plan.overhead_bytes)?;
        let frames_lease = budget.lease("page frames", 0)?;
        let reader = Reader::new(backend, path);
        let slots: Result<Vec<Slot>> =
            (0..options.staging_slots).map(|id| Slot::new(id as u32, plan.slot_bytes)).collect();
        let clock = Clock::new(plan.frames_max, store.frame_bytes(), frames_lease);
        let blocks = |page| AtomicU16::new(store.expected_bytes(page).div_ceil(BLOCK_BYTES) as u16);
        let shared = Arc::new(PoolState {
            words: (0..store.page_count()).map(|_| Word::absent()).collect(),
            blocks: (0..store.page_count()).map(blocks).collect(),
            arena: FrameArena::reserve(plan.frames_max, store.frame_bytes())?,
            requests: Mutex::new(Requests::new(options.queue_capacity)),
            clock: Mutex::new(clock),
            idle: Mutex::new(slots?),
            jobs: JobQueue::default(),
            bell: Bell::default(),
            progress: ArrivalCount::default(),
            damage: Mutex::new(Vec::new()),
            io: Mutex::new(reader.describe().clone()),
            failure: Failure::default(),
            counters: Counters::default(),
            ahead: AtomicUsize::new(0),
            starved: StarvationFlag::new(),
            saturated: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            store,
        });
        let mut pool = PagePool {
            shared,
            budget: budget.clone(),
            threads: Vec::new(),
            tables,
            frames_most: plan.frames_most,
        };
        pool.set_limit(options.frames_bytes)?;
        pool.start(reader, options)?;
        Ok(pool)
    }

    /// Bytes of the budget that a pool over `store` takes beside its frames, and the fewest with which it works:
    /// `(overhead, overhead + FRAMES_MIN frames)`.
    ///
    /// # Errors
    /// [`Code::Usage`] for options out of range.
    pub fn smallest_bytes(store: &dyn PageStore, options: &PoolOptions) -> Result<(u64, u64)> {
        let plan = PoolPlan::new(store, options)?;
        let frames_bytes = (FRAMES_MIN * store.frame_bytes()) as u64;
        Ok((plan.overhead_bytes, plan.overhead_bytes + frames_bytes))
    }

    /// Bytes of the budget that a pool over a page file of so many pages takes beside its frames, at most: pages may be
    /// shorter than the format allows.
    ///
    /// # Errors
    /// [`Code::Usage`] for options out of range.
    pub fn overhead_bytes(page_count: u32, options: &PoolOptions) -> Result<u64> {
        Ok(PoolPlan::of((page_count, STORED_BYTES as u32), FRAME_BYTES, options)?.overhead_bytes)
    }

    fn start(&mut self, reader: Reader, options: &PoolOptions) -> Result<()> {
        let mut spawn = |name: String, work: Box<dyn FnOnce() + Send>| -> Result<()> {
            let thread = std::thread::Builder::new().name(name).spawn(work);
            let thread = thread.map_err(|error| Error::thread_refused("the page pool", &error))?;
            self.threads.push(thread);
            Ok(())
        };
        let shared = Arc::clone(&self.shared);
        let (slots, merge_bytes) = (options.staging_slots, u64::from(options.merge_bytes));
        let io = move || {
            let mut loader = Loader::new(&shared, reader, slots, merge_bytes);
            shared.guard(|| loader.run());
        };
        spawn("trex-load-0".into(), Box::new(io))?;
        for index in 1..=options.decode_threads {
            let shared = Arc::clone(&self.shared);
            spawn(format!("trex-load-{index}"), Box::new(move || shared.guard(|| shared.decode(false))))?;
        }
        let shared = Arc::clone(&self.shared);
        spawn("trex-load-ahead".into(), Box::new(move || shared.guard(|| shared.decode(true))))?;
        Ok(())
    }

    /// Pages of the file.
    pub fn page_count(&self) -> u32 {
        self.shared.words.len() as u32
    }

    /// True where pages come from afar: many reads have to be under way at once.
    pub fn is_far(&self) -> bool {
        self.shared.store.is_far()
    }

    /// Which backend reads now, why, and what went wrong with the one before it.
    pub fn io(&self) -> IoDescription {
        lock(&self.shared.io).clone()
    }

    /// What `page` is doing. It may have changed when the call returns.
    pub fn state(&self, page: u32) -> PageState {
        self.shared.words[page as usize].view().state
    }

    /// True for a page that will never come: go on without it.
    pub fn is_damaged(&self, page: u32) -> bool {
        self.state(page) == PageState::Damaged
    }

    /// Damaged pages with their errors, at most the first 1024; [`PoolStats::damaged`] counts all.
    pub fn damage(&self) -> Vec<(u32, Error)> {
        lock(&self.shared.damage).clone()
    }

    /// True while demand waits and every frame is pinned or being read.
    pub fn is_saturated(&self) -> bool {
        self.shared.saturated.load(Ordering::Relaxed)
    }

    /// Replaces the want-list of `origin` (a caller's number, below [`super::ORIGINS_MAX`]): call it once per frame
    /// or round. A page that an origin leaves out twice in a row is dropped, unless another wants it. Wants for
    /// pages that are resident, on their way or damaged are ignored. A page wanted by several gets the greatest
    /// weight.
    ///
    /// # Panics
    /// When there is no such page or origin.
    pub fn submit(&self, origin: usize, wants: &[Want]) {
        if lock(&self.shared.requests).submit(origin, wants, &self.shared.words) {
            self.shared.bell.ring();
        }
    }

    /// Arrivals so far, damaged ones included.
    pub fn epoch(&self) -> u64 {
        self.shared.progress.epoch()
    }

    /// Sleeps until a page has arrived since `epoch`, at most `timeout`. The epoch then. Take the epoch first, look
    /// at pages after: so no arrival is missed.
    ///
    /// # Panics
    /// When a thread of the pool has panicked: nothing would ever come. [`PagePool::failure`] says what it was.
    pub fn wait_for_progress(&self, epoch: u64, timeout: Duration) -> u64 {
        let now = self.shared.progress.wait(epoch, timeout);
        if let Some(error) = self.failure() {
            panic!("no page will come: {error}");
        }
        now
    }

    /// Why no page will come any more: one of the pool's threads has panicked. Pages that are resident stay.
    pub fn failure(&self) -> Option<Error> {
        self.shared.failure.get()
    }

    /// Sets the memory for frames, in bytes: takes it from the budget, or evicts and gives it back to the kernel. More
    /// than the addresses reserved at open is cut to that. Frames that are pinned now are owed.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] below [`FRAMES_MIN`] frames, or when the budget has no room; nothing is changed then.
    pub fn set_limit(&self, frames_bytes: u64) -> Result<FrameCount> {
        let frame_bytes = self.shared.arena.frame_bytes() as u64;
        let mut clock = lock(&self.shared.clock);
        let frames = (frames_bytes / frame_bytes).min(self.frames_most as u64) as usize;
        if frames < FRAMES_MIN {
            let held = clock.live() as u64 * frame_bytes;
            let others = self.budget.used_bytes().saturating_sub(held) + RESERVE_BYTES;
            let smallest = others + FRAMES_MIN as u64 * frame_bytes;
            return Err(Error::new(Code::MemoryLimit, "too little memory for page frames")
                .at_setting(Setting::MemoryLimit)
                .numbers(format!("{frames_bytes} bytes, {FRAMES_MIN} frames of {frame_bytes} needed"))
                .next(NextStep::RaiseLimit { bytes: smallest })
                .smallest_limit(smallest));
        }
        clock.set_frames(frames, &self.shared.words, &self.shared.arena)?;
        let count = FrameCount { frames: clock.live(), owed: clock.owed() };
        drop(clock);
        self.shared.bell.ring();
        Ok(count)
    }

    /// How many frames there are now.
    pub fn frames(&self) -> FrameCount {
        let clock = lock(&self.shared.clock);
        FrameCount { frames: clock.live(), owed: clock.owed() }
    }

    /// About how many pages find room together: more than whole frames where pages take parts of theirs.
    pub fn room(&self) -> usize {
        lock(&self.shared.clock).room().min(self.shared.words.len())
    }

    /// Bytes that it has leased: tables, staging and frames.
    pub fn leased_bytes(&self) -> u64 {
        let clock = lock(&self.shared.clock);
        self.tables.bytes() + (clock.live() * self.shared.arena.frame_bytes()) as u64
    }

    /// Counters of the pool so far.
    pub fn stats(&self) -> PoolStats {
        let requests = lock(&self.shared.requests);
        let (counts, queued) = (requests.counts(), requests.len() as u64);
        drop(requests);
        let clock = lock(&self.shared.clock);
        PoolStats {
            evictions: clock.evicted,
            ahead_late: counts.late,
            ahead_wasted: clock.wasted,
            frames: clock.live() as u64,
            pages: clock.owned() as u64,
            frames_owed: clock.owed() as u64,
            wants_dropped: counts.dropped,
            wants_refused: counts.refused,
            queue_peak: counts.peak,
            queued,
            ..self.shared.counters.snapshot()
        }
    }
}

impl Drop for PagePool {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        self.shared.bell.ring();
        self.shared.jobs.stop();
        for thread in self.threads.drain(..) {
            // A panic in there was reported by its hook; dropping goes on.
            let _ = thread.join();
        }
        self.leak_if_pinned();
    }
}
