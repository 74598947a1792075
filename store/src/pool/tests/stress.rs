//! Many callers, few frames, faults: every pinned frame holds what its page says. `TREX_STORM_SECONDS` asks for a
//! longer storm than a normal run has.

use super::*;

const PAGES: u32 = 300;
/// Frames that a caller pins at most.
const HELD: u64 = 4;
/// Rounds of the storm of a normal run take so long.
const STORM: Duration = Duration::from_secs(2);

/// So many callers, each so often, while the limit changes all the time.
fn stress(seed: u64, callers: usize, times: u32, plan: FaultPlan) -> PoolStats {
    let store = Synthetic::new(PAGES, seed);
    let frames_least = callers as u64 * HELD + 2;
    let options = PoolOptions { frames_bytes_max: Some((frames_least + 50) * FRAME), ..options(24) };
    let pool = pool_with(&store, store.faulty(plan), &options);
    let checked = AtomicU32::new(0);
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..callers)
            .map(|origin| {
                let (pool, checked) = (&pool, &checked);
                scope.spawn(move || stress_worker(pool, seed, (origin, times), checked))
            })
            .collect();
        let (pool, stop) = (&pool, &stop);
        let resizer = scope.spawn(move || {
            let mut random = Pcg64Mcg::new(u128::from(seed) + 99);
            while !stop.load(Ordering::Relaxed) {
                // Never below what the callers pin and one frame that moves.
                let frames = frames_least + u64::from(random.next_u32() % 50);
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
    wait_until(&pool, "the last page", || pool.stats().queued == 0);
    let stats = pool.stats();
    assert!(checked.into_inner() > times / 2, "{stats:?}");
    let installs: u64 = (0..PAGES).map(|page| u64::from(store.installs(page))).sum();
    assert!(installs <= stats.pages_read, "{installs} of {stats:?}");
    stats
}

#[test]
fn stress_with_few_frames() {
    let plan = FaultPlan { seed: 5, short_per_1024: 50, interrupt_per_1024: 50, ..FaultPlan::default() };
    let stats = stress(3, 3, 1500, plan);
    assert!(stats.refaults > 0 && stats.damaged == 0, "{stats:?}");
}

/// Eight callers, and all faults at once, with other rates in each round: nobody hangs, and no frame is another's.
#[test]
fn storm() {
    let seconds = std::env::var("TREX_STORM_SECONDS").ok().map(|seconds| seconds.parse().unwrap());
    let (begin, mut rounds, mut damaged) = (Instant::now(), 0, 0);
    while begin.elapsed() < seconds.map_or(STORM, Duration::from_secs) {
        let mut random = Pcg64Mcg::new(rounds);
        let mut rate = |most: u32| random.next_u32() % (most + 1);
        let plan = FaultPlan {
            seed: rounds as u64,
            error_per_1024: rate(4),
            interrupt_per_1024: rate(100),
            short_per_1024: rate(100),
            flip_per_1024: rate(4),
            late_per_1024: rate(800),
            delay: Duration::from_micros(u64::from(rate(300))),
            ..FaultPlan::default()
        };
        let stats = stress(rounds as u64, 8, 200, plan);
        damaged += stats.damaged;
        rounds += 1;
    }
    assert!(rounds > 1 && (damaged > 0 || rounds < 10), "{rounds} rounds, {damaged} pages damaged");
}

fn stress_worker(pool: &PagePool, seed: u64, (origin, times): (usize, u32), checked: &AtomicU32) {
    let mut random = Pcg64Mcg::new((u128::from(seed) << 8) + origin as u128 + 17);
    let mut held: Vec<PinToken> = Vec::new();
    for _ in 0..times {
        let wants: Vec<Want> =
            (0..6).map(|weight| Want { page: random.next_u32() % PAGES, weight: weight % 3 }).collect();
        pool.submit(origin, &wants);
        let epoch = pool.epoch();
        for want in &wants {
            if let Some(token) = pool.try_pin(want.page) {
                check_frame(want.page, pool.bytes(&token));
                checked.fetch_add(1, Ordering::Relaxed);
                held.push(token);
            }
            if held.len() as u64 == HELD {
                let token = held.swap_remove(random.next_u32() as usize % HELD as usize);
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
