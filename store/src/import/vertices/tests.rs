//! The cache against a plain array: what fits, what does not, and budgets too tight for either.

use super::*;
use crate::budget::{Budget, RESERVE_BYTES};
use rand_pcg::{Pcg64, rand_core::Rng};

fn position(index: u64) -> [f64; 3] {
    [index as f64 + 0.1, -(index as f64) / 3.0, 1e7 + index as f64]
}

fn options(cache_bytes: u64) -> ImportOptions {
    let mut options = ImportOptions::unlimited(&std::env::temp_dir());
    options.vertex_cache_bytes = cache_bytes;
    options
}

/// Pushes `count` vertices with look-ups in between, and looks all up in a random order.
fn check_growing(count: u64, options: &ImportOptions) -> VertexCache {
    let mut cache = VertexCache::growing(options).unwrap();
    let mut random = Pcg64::new(1, count.into());
    for index in 0..count {
        cache.push(position(index)).unwrap();
        if index % 97 == 0 {
            let other = random.next_u64() % (index + 1);
            assert_eq!(cache.get(other).unwrap(), position(other));
        }
    }
    for _ in 0..4 * count.min(5000) {
        let index = random.next_u64() % count;
        assert_eq!(cache.get(index).unwrap(), position(index));
    }
    cache
}

#[test]
fn what_fits_is_never_written() {
    let cache = check_growing(20_000, &options(u64::MAX));
    assert!(matches!(cache.backing, Backing::Spool { scratch: None, .. }));
    assert_eq!(cache.lookups_and_misses().1, 0);
}

#[test]
fn what_does_not_fit_comes_back_the_same() {
    for blocks in [1, 2, 3, 7] {
        let cache =
            check_growing(20_001, &options(blocks * (SPOOL_BLOCK_BYTES as u64 + FRAME_OVERHEAD_BYTES)));
        assert_eq!(cache.frames.len() as u64, blocks.max(MIN_FRAMES as u64));
        assert!(cache.lookups_and_misses().1 > 0);
    }
}

#[test]
fn a_tight_budget_makes_a_small_cache() {
    let mut options = options(u64::MAX);
    options.budget = Budget::new(RESERVE_BYTES + 4 * SPOOL_BLOCK_BYTES as u64);
    let cache = check_growing(20_001, &options);
    assert_eq!(cache.frames.len(), 2);
    assert!(options.budget.peak_bytes() <= options.budget.ledger_bytes());
    options.budget = Budget::new(RESERVE_BYTES + 2 * SPOOL_BLOCK_BYTES as u64 + 200);
    VertexCache::growing(&options).unwrap().push([0.0; 3]).unwrap();
    options.budget = Budget::new(RESERVE_BYTES + SPOOL_BLOCK_BYTES as u64);
    let refused = VertexCache::growing(&options).unwrap().push([0.0; 3]);
    assert_eq!(refused.unwrap_err().code(), Code::MemoryLimit);
}
