//! Pages that nobody waits for: which frames they get, and what becomes of them.

use super::*;

fn ahead(page: u32) -> Want {
    Want { page, weight: 0 }
}

#[track_caller]
fn check_counts(pool: &PagePool, [issued, used, late, wasted]: [u64; 4]) {
    let stats = pool.stats();
    let counted = [stats.ahead_issued, stats.ahead_used, stats.ahead_late, stats.ahead_wasted];
    assert_eq!(counted, [issued, used, late, wasted]);
}

#[test]
fn pages_read_ahead_get_frames_that_nobody_wants() {
    let store = Synthetic::new(60, 9);
    let pool = pool_of(&store, store.memory(1), 16);
    let is_there = |page: u32| pool.state(page) == PageState::Resident;
    for page in 0..16 {
        drop(pool.pin_blocking(page).unwrap());
    }
    // Each has been asked for since the hand came by.
    pool.submit(1, &[ahead(20), ahead(21)]);
    std::thread::sleep(Duration::from_millis(50));
    check_counts(&pool, [0; 4]);
    assert!((0..16).all(is_there));
    pool.submit(1, &[]);
    pool.submit(1, &[]);
    // For this one the hand takes the scores of all, and one of the pages; one is asked for since.
    drop(pool.pin_blocking(30).unwrap());
    let cold: Vec<u32> = (0..16).filter(|&page| is_there(page)).collect();
    assert_eq!(cold.len(), 15);
    drop(pool.pin(cold[3]).unwrap());
    let all: Vec<Want> = (31..60).map(ahead).collect();
    wait_until(&pool, "what is read ahead", || {
        pool.submit(1, &all);
        pool.stats().ahead_issued >= 29
    });
    assert!(is_there(30) && is_there(cold[3]), "what has a score stays");
}

#[test]
fn what_becomes_of_pages_read_ahead_is_counted() {
    let store = Synthetic::new(40, 5);
    let pool = pool_of(&store, store.memory(1), 16);
    pool.submit(0, &[ahead(1), ahead(2), ahead(3)]);
    wait_until(&pool, "three pages", || (1..4).all(|page| pool.state(page) == PageState::Resident));
    check_counts(&pool, [3, 0, 0, 0]);
    // Who looks ahead asks for nothing.
    let token = pool.try_pin_ahead(1).unwrap();
    check_frame(1, pool.bytes(&token));
    pool.unpin(token);
    check_counts(&pool, [3, 0, 0, 0]);
    assert_eq!((pool.stats().hits, pool.stats().misses), (0, 0));
    for _ in 0..2 {
        drop(pool.pin(1).unwrap());
        check_counts(&pool, [3, 1, 0, 0]);
    }
    // Others take all frames: of the two that nobody asked for nothing came.
    for page in 10..40 {
        drop(pool.pin_blocking(page).unwrap());
    }
    check_counts(&pool, [3, 1, 0, 2]);
}

/// The one page is held back until it has been asked for.
#[test]
fn a_page_asked_for_while_it_is_read_ahead_is_late() {
    let store = Synthetic::new(9, 5);
    let plan = FaultPlan { delay: Duration::from_millis(1), ..FaultPlan::default() };
    let pool = pool_of(&store, store.faulty(plan), 16);
    let mut late = 0;
    for page in 0..9 {
        pool.submit(0, &[ahead(page)]);
        while matches!(pool.state(page), PageState::Absent | PageState::Queued) {}
        let is_read = pool.state(page) == PageState::Reading;
        pool.submit(0, &[want(page)]);
        wait_until(&pool, "a page", || pool.state(page) == PageState::Resident);
        let stats = pool.stats();
        drop(pool.pin(page).unwrap());
        // Late or in time, and never both.
        assert_eq!(pool.stats().ahead_used + stats.ahead_late, u64::from(page) + 1);
        assert!(is_read || stats.ahead_late == late);
        late = stats.ahead_late;
    }
}
