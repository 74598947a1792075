//! Plain mapped reads: the file is mapped, and threads touch the bytes of each extent, as programs do that leave memory
//! to the system.
//!
//! Unsafe code stands here because a mapped file can change under the mapping.
//!
//! Invariant: each extent is touched once, all of its 4 KiB pages, by whichever thread takes it next.
#![allow(unsafe_code)]

use super::clock::Clock;
use super::pages::Pages;
use anyhow::Context;
use memmap2::{Advice, Mmap};
use std::fs::File;
use std::hint::black_box;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use trex_store::Error;

/// How the bytes of an extent come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MapTouch {
    /// By faults, by as many threads as there are workers; the system reads ahead as it likes.
    Faults,
    /// By faults, after `MADV_RANDOM`: nothing is read ahead.
    RandomFaults,
    /// Each extent by `MADV_POPULATE_READ` (Linux 5.14), by as many threads as reads are in flight elsewhere.
    Populate,
}

impl MapTouch {
    /// All.
    pub(super) const ALL: [MapTouch; 3] = [MapTouch::Faults, MapTouch::RandomFaults, MapTouch::Populate];
}

/// Bytes of a page of memory.
const MEMORY_PAGE: usize = 4096;

/// Touches all extents of a round. Gives wall time and processor time.
pub(super) fn read(
    pages: &Pages<'_>,
    touch: MapTouch,
    (depth, workers): (usize, usize),
) -> anyhow::Result<(Duration, Duration)> {
    let path = pages.file.path();
    let file = File::open(path).map_err(|error| Error::io("open", path, &error))?;
    // SAFETY: the file is one that we have built or that was named for this measurement; nobody changes it meanwhile.
    let map = unsafe { Mmap::map(&file) }.map_err(|error| Error::io("map", path, &error))?;
    if touch != MapTouch::Faults {
        map.advise(Advice::Random).context("the mapping takes no advice")?;
    }
    let threads = if touch == MapTouch::Populate { depth } else { workers };
    let next = AtomicUsize::new(0);
    let clock = Clock::start();
    let sums: anyhow::Result<Vec<u64>> = std::thread::scope(|scope| {
        let worker = |_| scope.spawn(|| touch_all(&map, pages, touch, &next));
        let workers: Vec<_> = (0..threads).map(worker).collect();
        workers.into_iter().map(|worker| worker.join().expect("a worker that ends")).collect()
    });
    black_box(sums?);
    Ok(clock.spent())
}

fn touch_all(map: &Mmap, pages: &Pages<'_>, touch: MapTouch, next: &AtomicUsize) -> anyhow::Result<u64> {
    let mut sum = 0;
    while let Some(extent) = pages.extents.get(next.fetch_add(1, Ordering::Relaxed)) {
        let (first, end) = (extent.offset as usize, extent.end() as usize);
        let start = first / MEMORY_PAGE * MEMORY_PAGE;
        if touch == MapTouch::Populate {
            map.advise_range(Advice::PopulateRead, start, end - start).context("MADV_POPULATE_READ")?;
        }
        sum += (start..end).step_by(MEMORY_PAGE).map(|at| u64::from(map[at.max(first)])).sum::<u64>();
    }
    Ok(sum)
}
