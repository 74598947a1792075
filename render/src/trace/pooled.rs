//! `PooledPages`: pages from the pool, held by pins of one worker; and what the frame loop asks of such a tracer.
//!
//! A worker pins a page when a ray first needs it and keeps it until its next tile begins, so that a look-up
//! costs one table access, and a blocked ray finds its pages again. When its share of the frames is used up it
//! lets all go but the one it needs now.
//!
//! Invariants: 1. at most `pins_max` pages are pinned by this worker; 2. the want-list of a worker holds each
//! page that blocked a ray, until the page has come or `WANTS_MAX` later ones have been asked for.

use super::paged::PagedMesh;
use super::pages::{Page, Pages};
use crate::frame::PagedTracer;
use std::time::Duration;
use trex_store::PageFile;
use trex_store::pool::{Class, PagePool, PageState, PinToken, Want};

/// Most pages that one worker asks for at a time.
const WANTS_MAX: usize = 512;
/// Longest sleep of `wait`: arrivals wake it earlier.
const WAIT: Duration = Duration::from_millis(50);

/// Pages of a pool, pinned by one worker.
pub struct PooledPages<'a> {
    pool: &'a PagePool,
    /// Per page: 1 + its place in `pins`, or 0.
    pinned: Vec<u16>,
    pins: Vec<PinToken>,
    pins_max: usize,
    /// The worker's number: the origin of its want-list.
    origin: usize,
    wants: Vec<(u32, u32)>,
    epoch: u64,
}

impl<'a> PooledPages<'a> {
    /// Pages for worker `origin`, which may pin `pins_max` pages at a time.
    ///
    /// # Panics
    /// When `pins_max` is 0.
    pub fn new(pool: &'a PagePool, origin: usize, pins_max: usize) -> PooledPages<'a> {
        assert!(pins_max > 0, "a ray needs a page");
        let pins_max = pins_max.min(usize::from(u16::MAX) - 1);
        PooledPages {
            pool,
            pinned: vec![0; pool.page_count() as usize],
            pins: Vec::with_capacity(pins_max.min(pool.page_count() as usize)),
            pins_max,
            origin,
            wants: Vec::new(),
            epoch: pool.epoch(),
        }
    }

    /// Bytes that one worker's table takes for a file of `page_count` pages.
    pub fn bytes(page_count: usize, pins_max: usize) -> u64 {
        (2 * page_count + size_of::<PinToken>() * pins_max.min(page_count) + 16 * WANTS_MAX) as u64
    }

    fn unpin_all(&mut self) {
        for pin in self.pins.drain(..) {
            self.pinned[pin.page() as usize] = 0;
            self.pool.unpin(pin);
        }
    }

    /// Joins the pages that blocked rays to those still awaited, and hands the list to the pool.
    fn submit(&mut self, blocked: &[(u32, u32)]) -> usize {
        let pool = self.pool;
        let awaited = |page: u32| {
            matches!(pool.state(page), PageState::Absent | PageState::Queued | PageState::Reading)
        };
        self.wants.retain(|&(page, _)| awaited(page));
        for &(page, rays) in blocked {
            match self.wants.iter_mut().find(|(wanted, _)| *wanted == page) {
                Some((_, weight)) => *weight = rays.max(*weight),
                None => self.wants.push((page, rays)),
            }
        }
        if self.wants.len() > WANTS_MAX {
            self.wants.drain(..self.wants.len() - WANTS_MAX);
        }
        let list: Vec<Want> =
            self.wants.iter().map(|&(page, weight)| Want { page, class: Class::Urgent, weight }).collect();
        pool.submit(self.origin, &list);
        list.len()
    }
}

impl Pages for PooledPages<'_> {
    #[inline]
    fn page(&mut self, page: u32) -> Page<'_> {
        let place = usize::from(self.pinned[page as usize]);
        if place > 0 {
            return Page::Ready(self.pool.bytes(&self.pins[place - 1]));
        }
        if self.pins.len() == self.pins_max {
            self.unpin_all();
        }
        let Some(token) = self.pool.try_pin(page) else {
            return if self.pool.is_damaged(page) { Page::Damaged } else { Page::Missing };
        };
        self.pins.push(token);
        self.pinned[page as usize] = self.pins.len() as u16;
        Page::Ready(self.pool.bytes(&self.pins[self.pins.len() - 1]))
    }
}

impl Drop for PooledPages<'_> {
    fn drop(&mut self) {
        self.unpin_all();
    }
}

impl PagedTracer for PagedMesh<'_, PooledPages<'_>> {
    fn begin_tile(&mut self, _tile: u32) {
        self.pages_mut().unpin_all();
    }

    fn request_missing(&mut self) -> usize {
        let mut blocked = Vec::new();
        self.take_wanted(&mut blocked);
        self.pages_mut().submit(&blocked)
    }

    fn wait(&mut self) {
        let pages = self.pages_mut();
        pages.epoch = pages.pool.wait_for_progress(pages.epoch, WAIT);
    }
}

/// Tracers for `workers` threads over one pool. Each may pin its share of the frames; two are left for arrivals.
pub fn tracers<'a>(
    file: &'a PageFile,
    pool: &'a PagePool,
    workers: usize,
) -> Vec<PagedMesh<'a, PooledPages<'a>>> {
    let pins_max = (pool.frames().frames.saturating_sub(2) / workers).max(1);
    (0..workers).map(|worker| PagedMesh::new(file, PooledPages::new(pool, worker, pins_max))).collect()
}
