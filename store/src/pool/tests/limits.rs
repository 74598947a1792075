//! Frames: saturation, limits that change, leases.

use super::*;

#[test]
fn saturated_until_somebody_unpins() {
    let store = Synthetic::new(20, 5);
    let pool = pool_of(&store, store.memory(1), 4);
    let mut pins: Vec<Pin> = (0..4).map(|page| pool.pin_blocking(page).unwrap()).collect();
    assert!(!pool.is_saturated());
    pool.submit(0, &[want(10)]);
    wait_until(&pool, "saturation", || pool.is_saturated());
    assert_eq!((pool.state(10), pool.stats().saturated), (PageState::Queued, 1));
    pins.remove(2);
    check_frame(10, &pool.pin_blocking(10).unwrap());
    wait_until(&pool, "the end of saturation", || !pool.is_saturated());
    assert_eq!(pool.state(2), PageState::Absent);
    for pin in &pins {
        check_frame(pin.page(), pin);
    }
}

#[test]
fn the_limit_shrinks_and_grows_with_its_lease() {
    let store = Synthetic::new(64, 6);
    let budget = Budget::new(RESERVE_BYTES + (64 << 20));
    let shared: Arc<dyn PageStore> = Arc::clone(&store) as Arc<dyn PageStore>;
    let options = PoolOptions { frames_bytes_max: Some(64 * FRAME), ..options(32) };
    let path = Path::new("synthetic");
    let pool = PagePool::with_backend(shared, store.memory(1), path, &budget, &options).unwrap();
    let overhead = PagePool::smallest_bytes(&*store, &options).unwrap().0;
    assert_eq!(budget.used_bytes(), overhead + 32 * FRAME);

    let pins: Vec<Pin> = (0..20).map(|page| pool.pin_blocking(page).unwrap()).collect();
    pool.fetch_blocking(&(20..64).collect::<Vec<_>>()).unwrap();
    assert_eq!(pool.set_limit(8 * FRAME).unwrap(), FrameCount { frames: 20, owed: 12 });
    assert_eq!(budget.used_bytes(), overhead + 20 * FRAME);
    for pin in pins {
        check_frame(pin.page(), &pin);
    }
    // Paid without anybody asking for a page.
    wait_until(&pool, "the debt", || pool.frames() == FrameCount { frames: 8, owed: 0 });
    assert_eq!(budget.used_bytes(), overhead + 8 * FRAME);

    assert_eq!(pool.set_limit(1000 * FRAME).unwrap(), FrameCount { frames: 64, owed: 0 });
    pool.fetch_blocking(&(0..64).collect::<Vec<_>>()).unwrap();
    assert!((0..64).all(|page| pool.state(page) == PageState::Resident));
    assert_eq!(pool.set_limit(FRAME).unwrap_err().code(), Code::MemoryLimit);
    let _rest = budget.lease("others", budget.free_bytes()).unwrap();
    pool.set_limit(10 * FRAME).unwrap();
    let _rest = budget.lease("others", budget.free_bytes()).unwrap();
    assert_eq!(pool.set_limit(11 * FRAME).unwrap_err().code(), Code::MemoryLimit);
    assert_eq!(pool.frames(), FrameCount { frames: 10, owed: 0 });
    drop((pool, _rest));
}

#[test]
fn nothing_stays_leased_after_drop() {
    let store = Synthetic::new(8, 7);
    let budget = Budget::new(RESERVE_BYTES + (64 << 20));
    let shared: Arc<dyn PageStore> = Arc::clone(&store) as Arc<dyn PageStore>;
    let path = Path::new("synthetic");
    let pool =
        PagePool::with_backend(Arc::clone(&shared), store.memory(1), path, &budget, &options(8)).unwrap();
    pool.fetch_blocking(&[1, 2]).unwrap();
    drop(pool);
    assert_eq!(budget.used_bytes(), 0);
    let tight = Budget::new(RESERVE_BYTES + 1);
    let error = PagePool::with_backend(shared, store.memory(1), path, &tight, &options(8)).err().unwrap();
    assert_eq!(error.code(), Code::MemoryLimit);
    assert!(error.smallest_limit_bytes().is_some());
}
