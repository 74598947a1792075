//! Threads of the pool that panic: who waits is told at once, whichever way he waits.

use super::*;

/// Longest time in which a caller learns that nothing will come. Before, it was a minute, or never.
const TOLD_WITHIN: Duration = Duration::from_secs(1);

/// A store whose page 2 makes its decoder panic.
struct Panics(Arc<Synthetic>);

impl PageStore for Panics {
    fn page_count(&self) -> u32 {
        self.0.page_count()
    }
    fn extent(&self, page: u32) -> Extent {
        self.0.extent(page)
    }
    fn install(
        &self,
        page: u32,
        stored: &[u8],
        frame: &mut FrameRoom<'_>,
        scratch: &mut Vec<u8>,
    ) -> Result<()> {
        assert!(page != 2, "this panic belongs to the test");
        self.0.install(page, stored, frame, scratch)
    }
    fn frame_bytes(&self) -> usize {
        FRAME_BYTES
    }
}

/// A pool whose decoder panics at page 2.
fn pool_with_bad_decoder() -> PagePool {
    let store = Synthetic::new(5, 13);
    let (memory, path) = (store.memory(1), Path::new("synthetic"));
    PagePool::with_backend(Arc::new(Panics(store)), memory, path, &Budget::unlimited(), &options(5)).unwrap()
}

/// A pool whose loader panics at the second read.
fn pool_with_bad_loader() -> PagePool {
    let store = Synthetic::new(100, 13);
    let plan = FaultPlan { panic_after: Some(1), ..FaultPlan::default() };
    pool_of(&store, store.faulty(plan), 50)
}

#[track_caller]
fn check_told(error: &Error, thread: &str, with: &str) {
    assert_eq!(error.code(), Code::Bug, "{error}");
    assert!(error.place().contains(thread) && error.numbers_text().contains(with), "{error}");
    assert!(error.next_step().contains("report"), "{error}");
}

#[test]
fn a_decoder_that_panics_is_told_to_who_waits() {
    let pool = pool_with_bad_decoder();
    let start = Instant::now();
    check_told(&pool.pin_blocking(2).err().unwrap(), "trex-load-", "this panic belongs to the test");
    check_told(&pool.fetch_blocking(&[2, 2]).unwrap_err(), "trex-load-", "this panic belongs to the test");
    assert!(start.elapsed() < TOLD_WITHIN);
}

#[test]
fn a_loader_that_panics_is_told_to_who_waits() {
    let pool = pool_with_bad_loader();
    let start = Instant::now();
    let error = (0..100).find_map(|page| pool.pin_blocking(page).err()).unwrap();
    check_told(&error, "trex-load-0", "a panic on demand");
    assert!(start.elapsed() < TOLD_WITHIN);
    check_told(&pool.failure().unwrap(), "trex-load-0", "a panic on demand");
}

/// Many sleep when it happens, and all wake.
#[test]
fn whoever_sleeps_for_progress_wakes_and_panics_too() {
    for pool in [pool_with_bad_decoder(), pool_with_bad_loader()] {
        let start = Instant::now();
        let outcomes = std::thread::scope(|scope| {
            let sleepers: Vec<_> = (0..4)
                .map(|origin| {
                    let pool = &pool;
                    scope.spawn(move || {
                        let pages = pool.page_count();
                        let wants: Vec<Want> = (0..pages).map(want).collect();
                        pool.submit(origin, &wants);
                        let mut epoch = 0;
                        loop {
                            epoch = pool.wait_for_progress(epoch, Duration::from_secs(20));
                        }
                    })
                })
                .collect();
            sleepers
                .into_iter()
                .map(|sleeper: std::thread::ScopedJoinHandle<'_, ()>| sleeper.join())
                .collect::<Vec<_>>()
        });
        assert!(outcomes.iter().all(Result::is_err) && start.elapsed() < TOLD_WITHIN);
    }
}

/// What is resident stays so, and the end is clean: no second panic, nothing leased.
#[test]
fn a_dead_pool_keeps_its_pages_and_can_be_dropped() {
    let budget = Budget::unlimited();
    let before = budget.used_bytes();
    let store = Synthetic::new(100, 13);
    let plan = FaultPlan { panic_after: Some(1), ..FaultPlan::default() };
    let backend = store.faulty(plan);
    let path = Path::new("synthetic");
    let pool = PagePool::with_backend(store, backend, path, &budget, &options(50)).unwrap();
    let pin = pool.pin_blocking(7).unwrap();
    while pool.failure().is_none() {
        let _ = pool.pin_blocking(80);
    }
    check_frame(7, &pin);
    drop(pin);
    drop(pool);
    assert_eq!(budget.used_bytes(), before);
}

/// The error of a page is there before the page counts as damaged: nobody is told of a damage without its reason.
#[test]
fn who_sees_a_damaged_page_finds_its_error() {
    const PAGES: u32 = 1000;
    let store = Synthetic::new(PAGES, 14);
    for _ in 0..20 {
        let plan = FaultPlan { broken: Some(0..u64::MAX), ..FaultPlan::default() };
        let pool = pool_of(&store, store.faulty(plan), 50);
        for page in 0..PAGES {
            pool.submit(0, &[Want { page, weight: 1 }]);
            while !pool.is_damaged(page) {
                std::hint::spin_loop();
            }
            let error = pool.pin_blocking(page).err().unwrap();
            assert_eq!(error.code(), Code::Io, "page {page}: {error}");
        }
    }
}
