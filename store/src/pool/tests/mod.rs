//! The pool against a naive oracle: the page's content follows from its number, so every pinned frame can be checked.

mod ahead;
mod failure;
mod limits;
mod parts;
mod stress;

use super::*;
use crate::budget::{Budget, RESERVE_BYTES};
use crate::error::{Code, Error, Result};
use crate::io::{Backend, DirectChoice, Extent, Fault, FaultPlan, IoChoice, IoOptions, Memory};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

const FRAME_BYTES: usize = 64 << 10;
const FRAME: u64 = FRAME_BYTES as u64;

/// A file of pages whose frames hold a pattern of the page's number: stored as number, length and bytes of a seed.
struct Synthetic {
    extents: Vec<Extent>,
    bytes: Arc<[u8]>,
    /// How often each page was installed.
    installs: Vec<AtomicU32>,
}

impl Synthetic {
    fn new(pages: u32, seed: u64) -> Arc<Synthetic> {
        let mut random = Pcg64Mcg::new(u128::from(seed));
        let (mut extents, mut bytes) = (Vec::new(), vec![0xEE; 4321]);
        for page in 0..pages {
            let stored_bytes = 16 + random.next_u32() % (12 << 10);
            extents.push(Extent { offset: bytes.len() as u64, stored_bytes });
            let start = bytes.len();
            bytes.resize(start + stored_bytes as usize, 0);
            random.fill_bytes(&mut bytes[start..]);
            bytes[start..start + 4].copy_from_slice(&page.to_le_bytes());
            let hash = xxhash_rust::xxh3::xxh3_64(&bytes[start + 12..]);
            bytes[start + 4..start + 12].copy_from_slice(&hash.to_le_bytes());
            // Now and then a gap: near, or too far to be read together.
            let gap = [0, 0, 0, 100, 40_000][random.next_u32() as usize % 5];
            bytes.resize(bytes.len() + gap, 0);
        }
        let installs = (0..pages).map(|_| AtomicU32::new(0)).collect();
        Arc::new(Synthetic { extents, bytes: bytes.into(), installs })
    }

    fn memory(&self, align_bytes: usize) -> Box<dyn Backend> {
        Box::new(Memory::new(Arc::clone(&self.bytes), 8, align_bytes))
    }

    fn faulty(&self, plan: FaultPlan) -> Box<dyn Backend> {
        Box::new(Fault::new(self.memory(crate::io::ALIGN_BYTES), plan))
    }

    fn installs(&self, page: u32) -> u32 {
        self.installs[page as usize].load(Ordering::Relaxed)
    }
}

impl PageStore for Synthetic {
    fn page_count(&self) -> u32 {
        self.extents.len() as u32
    }

    fn extent(&self, page: u32) -> Extent {
        self.extents[page as usize]
    }

    fn install(
        &self,
        page: u32,
        stored: &[u8],
        frame: &mut FrameRoom<'_>,
        _scratch: &mut Vec<u8>,
    ) -> Result<()> {
        let hash = u64::from_le_bytes(stored[4..12].try_into().unwrap());
        if stored[..4] != page.to_le_bytes() || hash != xxhash_rust::xxh3::xxh3_64(&stored[12..]) {
            return Err(Error::new(Code::Damaged, "the hash of a page is wrong")
                .at_byte(Path::new("synthetic"), self.extent(page).offset));
        }
        self.installs[page as usize].fetch_add(1, Ordering::Relaxed);
        for (index, word) in frame.whole()?.chunks_exact_mut(8).enumerate() {
            word.copy_from_slice(&pattern(page, index).to_le_bytes());
        }
        Ok(())
    }

    fn frame_bytes(&self) -> usize {
        FRAME_BYTES
    }
}

fn pattern(page: u32, index: usize) -> u64 {
    (u64::from(page) << 32 | index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

#[track_caller]
fn check_frame(page: u32, frame: &[u8]) {
    for (index, word) in frame.chunks_exact(8).enumerate() {
        let word = u64::from_le_bytes(word.try_into().unwrap());
        assert!(word == pattern(page, index), "word {index} of page {page} is another's");
    }
}

fn options(frames: u64) -> PoolOptions {
    PoolOptions { frames_bytes: frames * FRAME, staging_slots: 6, ..PoolOptions::default() }
}

fn pool_of(store: &Arc<Synthetic>, backend: Box<dyn Backend>, frames: u64) -> PagePool {
    pool_with(store, backend, &options(frames))
}

fn pool_with(store: &Arc<Synthetic>, backend: Box<dyn Backend>, options: &PoolOptions) -> PagePool {
    let store: Arc<dyn PageStore> = Arc::clone(store) as Arc<dyn PageStore>;
    PagePool::with_backend(store, backend, Path::new("synthetic"), &Budget::unlimited(), options).unwrap()
}

fn want(page: u32) -> Want {
    Want { page, weight: 1 }
}

/// Sleeps until `done`, for at most ten seconds.
#[track_caller]
fn wait_until(pool: &PagePool, what: &str, done: impl Fn() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(10), "{what} never came: {:?}", pool.stats());
        pool.wait_for_progress(pool.epoch(), Duration::from_millis(1));
    }
}

#[test]
fn pages_come_when_wanted_and_hold_what_the_file_says() {
    for align in [1, crate::io::ALIGN_BYTES] {
        let store = Synthetic::new(40, 1);
        let pool = pool_of(&store, store.memory(align), 40);
        assert!(pool.pin(7).is_none());
        let wants: Vec<Want> = (0..40).map(want).collect();
        pool.submit(0, &wants);
        for page in 0..40 {
            check_frame(page, &pool.pin_blocking(page).unwrap());
            assert_eq!(store.installs(page), 1);
        }
        pool.submit(0, &wants);
        let stats = pool.stats();
        assert_eq!((stats.pages_read, stats.refaults, stats.evictions, stats.queued), (40, 0, 0, 0));
        assert!(stats.reads < 40, "neighbours were not read together: {stats:?}");
        assert_eq!((stats.misses, stats.queue_peak), (1, 40));
    }
}

#[test]
fn few_frames_serve_many_pages() {
    let store = Synthetic::new(200, 2);
    let pool = pool_of(&store, store.memory(1), FRAMES_MIN as u64);
    let pages: Vec<u32> = (0..200).chain((0..200).rev()).collect();
    pool.fetch_blocking(&pages).unwrap();
    let stats = pool.stats();
    assert!(stats.refaults > 100 && stats.evictions > 300, "{stats:?}");
    assert_eq!(stats.frames, FRAMES_MIN as u64);
}

/// The clock, spelled out for one caller: page to score, and a ring of pages under a hand.
struct NaiveClock {
    score: std::collections::HashMap<u32, u32>,
    ring: Vec<u32>,
    hand: usize,
    frames: usize,
    reads: u64,
}

impl NaiveClock {
    fn touch(&mut self, page: u32) {
        if !self.score.contains_key(&page) {
            self.reads += 1;
            if self.ring.len() < self.frames {
                self.ring.push(page);
            } else {
                self.replace(page);
            }
            self.score.insert(page, 2);
        }
        let score = self.score.get_mut(&page).unwrap();
        *score = (*score + 1).min(3);
    }

    fn replace(&mut self, page: u32) {
        loop {
            self.hand %= self.ring.len();
            let victim = self.ring[self.hand];
            self.hand += 1;
            match self.score.get_mut(&victim).unwrap() {
                0 => {
                    self.score.remove(&victim);
                    self.ring[self.hand - 1] = page;
                    return;
                }
                score => *score -= 1,
            }
        }
    }
}

#[test]
fn one_caller_sees_a_plain_clock() {
    let store = Synthetic::new(60, 16);
    let pool = pool_of(&store, store.memory(1), 12);
    let mut oracle =
        NaiveClock { score: Default::default(), ring: Vec::new(), hand: 0, frames: 12, reads: 0 };
    let mut random = Pcg64Mcg::new(5);
    for _ in 0..3000 {
        // The smaller the number, the hotter the page.
        let page = (random.next_u32() % 60).min(random.next_u32() % 60).min(random.next_u32() % 60);
        check_frame(page, &pool.pin_blocking(page).unwrap());
        oracle.touch(page);
    }
    let resident = |page: &u32| pool.state(*page) == PageState::Resident;
    let mut expected: Vec<u32> = oracle.ring.clone();
    expected.sort_unstable();
    assert_eq!((0..60).filter(resident).collect::<Vec<_>>(), expected);
    let stats = pool.stats();
    assert_eq!((stats.pages_read, stats.evictions), (oracle.reads, oracle.reads - 12));
    let installs: u64 = (0..60).map(|page| u64::from(store.installs(page))).sum();
    assert_eq!(installs, oracle.reads);
}

/// Threads pin, want and unpin at random; every frame is compared whole while pinned. A resize runs beside them.
#[test]
fn a_page_that_many_want_is_read_once() {
    let store = Synthetic::new(50, 4);
    let plan = FaultPlan { delay: Duration::from_millis(1), ..FaultPlan::default() };
    let pool = pool_of(&store, store.faulty(plan), 50);
    std::thread::scope(|scope| {
        for origin in 0..4 {
            let pool = &pool;
            scope.spawn(move || {
                for page in 0..50 {
                    pool.submit(origin, &[want(page)]);
                    check_frame(page, &pool.pin_blocking(page).unwrap());
                }
            });
        }
    });
    assert!((0..50).all(|page| store.installs(page) == 1));
    assert_eq!(pool.stats().pages_read, 50);
}

#[test]
fn a_damaged_page_is_marked_and_the_others_come() {
    let store = Synthetic::new(30, 8);
    let mut bytes = store.bytes.to_vec();
    bytes[store.extents[11].end() as usize - 1] ^= 4;
    let pool = pool_of(&store, Box::new(Memory::new(bytes.into(), 8, 1)), 30);
    let error = pool.fetch_blocking(&(0..30).collect::<Vec<_>>()).unwrap_err();
    assert_eq!(error.code(), Code::Damaged);
    assert!(pool.is_damaged(11) && pool.pin(11).is_none());
    pool.submit(0, &[want(11)]);
    assert_eq!(pool.state(11), PageState::Damaged);
    let damage = pool.damage();
    assert_eq!((damage.len(), damage[0].0, pool.stats().damaged), (1, 11, 1));
    for page in (0..30).filter(|&page| page != 11) {
        check_frame(page, &pool.pin(page).expect("a neighbour of the damaged page is missing"));
    }
}

/// One bad sector under a read of many pages costs the pages that touch it, and no others.
#[test]
fn a_broken_range_costs_its_own_pages_only() {
    let store = Synthetic::new(60, 9);
    let broken = store.extents[30].offset..store.extents[30].offset + 1;
    let plan = FaultPlan { broken: Some(broken.clone()), ..FaultPlan::default() };
    let pool = pool_of(&store, store.faulty(plan), 60);
    let error = pool.fetch_blocking(&(0..60).collect::<Vec<_>>()).unwrap_err();
    assert_eq!(error.code(), Code::Io);
    let align = crate::io::ALIGN_BYTES as u64;
    for page in 0..60 {
        let extent = store.extents[page as usize];
        let hit =
            extent.offset / align * align < broken.end && broken.start < extent.end().next_multiple_of(align);
        assert_eq!(pool.is_damaged(page), hit, "page {page}");
    }
}

#[test]
fn passing_faults_leave_no_trace_but_a_count() {
    let store = Synthetic::new(100, 10);
    // Pages that lie side by side are read together, so there may be few reads.
    let plan = FaultPlan { seed: 3, error_per_1024: 30, short_per_1024: 600, ..FaultPlan::default() };
    let pool = pool_of(&store, store.faulty(plan), 20);
    pool.fetch_blocking(&(0..100).collect::<Vec<_>>()).unwrap();
    assert!(pool.damage().is_empty(), "{:?}", pool.damage());
    assert!(pool.stats().read_retries > 0);
}

#[test]
fn dropping_with_wants_and_reads_in_flight_ends() {
    for delay_ms in [0, 3] {
        let store = Synthetic::new(100, 12);
        let delay = Duration::from_millis(delay_ms);
        let pool = pool_of(&store, store.faulty(FaultPlan { delay, ..FaultPlan::default() }), 50);
        pool.submit(0, &(0..100).map(want).collect::<Vec<_>>());
        drop(pool);
    }
}

#[test]
#[should_panic(expected = "another pool's")]
fn a_token_works_with_its_own_pool_only() {
    let store = Synthetic::new(4, 14);
    let (one, other) = (pool_of(&store, store.memory(1), 4), pool_of(&store, store.memory(1), 4));
    one.fetch_blocking(&[0]).unwrap();
    other.unpin(one.try_pin(0).unwrap());
}

/// The same through the real backends, from a real file.
#[test]
fn real_files_through_every_backend() {
    let store = Synthetic::new(120, 15);
    let mut file = tempfile::NamedTempFile::new_in(env!("CARGO_MANIFEST_DIR")).unwrap();
    file.write_all(&store.bytes).unwrap();
    file.as_file().sync_all().unwrap();
    for io in [IoChoice::Uring, IoChoice::Pread, IoChoice::Mmap] {
        for direct in [DirectChoice::Auto, DirectChoice::Off] {
            let options = PoolOptions { io: IoOptions { io, direct, ..IoOptions::default() }, ..options(16) };
            let shared: Arc<dyn PageStore> = Arc::clone(&store) as Arc<dyn PageStore>;
            let pool = match PagePool::open(shared, file.path(), &Budget::unlimited(), &options) {
                Ok(pool) => pool,
                Err(error) if io == IoChoice::Uring => {
                    let _ = writeln!(std::io::stderr(), "NOT RUN: {io:?} {direct:?}: {error}");
                    continue;
                }
                Err(error) => panic!("{error}"),
            };
            let mut random = Pcg64Mcg::new(1);
            for _ in 0..400 {
                let page = random.next_u32() % 120;
                check_frame(page, &pool.pin_blocking(page).unwrap());
            }
            pool.fetch_blocking(&(0..120).collect::<Vec<_>>()).unwrap();
            assert!(pool.stats().bytes_read > 0, "{:?}", pool.io());
        }
    }
}
