//! Many callers, few frames, faults: every pinned frame holds what its page says.

use super::*;

#[test]
fn stress_with_few_frames() {
    let store = Synthetic::new(300, 3);
    let plan = FaultPlan { seed: 5, short_per_1024: 50, interrupt_per_1024: 50, ..FaultPlan::default() };
    let options = PoolOptions { frames_bytes_max: Some(64 * FRAME), ..options(24) };
    let pool = pool_with(&store, store.faulty(plan), &options);
    let checked = AtomicU32::new(0);
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..3_usize)
            .map(|origin| {
                let (pool, checked) = (&pool, &checked);
                scope.spawn(move || stress_worker(pool, origin, checked))
            })
            .collect();
        let (pool, stop) = (&pool, &stop);
        let resizer = scope.spawn(move || {
            let mut random = Pcg64Mcg::new(99);
            while !stop.load(Ordering::Relaxed) {
                // Never below what the workers pin (3 x 4) and one frame that moves.
                let frames = 14 + u64::from(random.next_u32() % 50);
                let count = pool.set_limit(frames * FRAME).unwrap();
                assert_eq!(count.frames - count.owed, frames as usize);
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        for worker in workers {
            worker.join().unwrap();
        }
        stop.store(true, Ordering::Relaxed);
        resizer.join().unwrap();
    });
    let stats = pool.stats();
    assert!(checked.into_inner() > 1000 && stats.refaults > 0, "{stats:?}");
    assert_eq!(stats.damaged, 0, "{:?}", pool.damage());
    let installs: u64 = (0..300).map(|page| u64::from(store.installs(page))).sum();
    wait_until(&pool, "the last page", || pool.stats().queued == 0);
    assert!(installs <= pool.stats().pages_read);
}

fn stress_worker(pool: &PagePool, origin: usize, checked: &AtomicU32) {
    let mut random = Pcg64Mcg::new(origin as u128 + 17);
    let mut held: Vec<PinToken> = Vec::new();
    for _ in 0..1500 {
        let wants: Vec<Want> =
            (0..6).map(|weight| Want { page: random.next_u32() % 300, weight: weight % 3 }).collect();
        pool.submit(origin, &wants);
        let epoch = pool.epoch();
        for want in &wants {
            if let Some(token) = pool.try_pin(want.page) {
                check_frame(want.page, pool.bytes(&token));
                checked.fetch_add(1, Ordering::Relaxed);
                held.push(token);
            }
            if held.len() == 4 {
                let token = held.swap_remove(random.next_u32() as usize % 4);
                check_frame(token.page(), pool.bytes(&token));
                pool.unpin(token);
            }
        }
        pool.wait_for_progress(epoch, Duration::from_micros(200));
    }
    for token in held {
        check_frame(token.page(), pool.bytes(&token));
        pool.unpin(token);
    }
    pool.submit(origin, &[]);
    pool.submit(origin, &[]);
}
