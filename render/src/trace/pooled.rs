//! `PooledPages`: the pages of one worker, from the pool: its pins, and its one want-list. The mesh tracer and the
//! G-stage borrow them.
//!
//! A worker pins a page when a ray first needs it and keeps it until its next tile begins, so that a look-up
//! costs one table access, and a blocked ray finds its pages again. When its share of the frames is used up it
//! lets all go but the one it needs now.
//!
//! Invariants: 1. at most `pins_max` pages are pinned by this worker; 2. the want-list holds each page that blocked a
//! ray of what is shown, whatever traced it, until the page has come or many later ones have been asked for; 3. once
//! the work is to stop, a ray looks up at most [`LOOK_UPS_UNASKED`] pages more, and waits for none.

use super::PagedTracer;
use super::paged_mesh::PagedMesh;
use super::pages::{Page, Pages};
use super::retry::WAIT;
use super::want_list::{WANTS_MAX, WantList};
use super::{OpenParts, Parts};
use std::cell::{Cell, OnceCell};
use std::sync::Arc;
use std::time::{Duration, Instant};
use trex_store::pool::{PagePool, PageState, PinToken, Seat, Seats, Want};
use trex_store::{PageFile, Result, StopSignal};

/// Longest that a ray on its way waits for a page: longer than disks take, unless something is wrong with them.
const PATIENCE: Duration = Duration::from_secs(1);
/// Look-ups of pages from one question whether to stop to the next: less than a millisecond, however many triangles
/// a ray meets in each.
const LOOK_UPS_UNASKED: u32 = 32;
/// Most pages that a worker asks for ahead.
const AHEAD_MAX: usize = 256;

/// Pages of a pool, pinned by one worker.
pub struct PooledPages {
    pool: Arc<PagePool>,
    /// Per page: 1 + its place in `pins`, or 0.
    pinned: Vec<Cell<u16>>,
    /// The first `pin_count` are there. Cells, so that one more can be pinned while frames of others are borrowed.
    pins: Vec<OnceCell<PinToken>>,
    pin_count: Cell<usize>,
    pins_max: usize,
    seat: Seat,
    wants: WantList,
    /// Pages that rays of a view to come have missed, asked for behind all others.
    ahead: Vec<Want>,
    /// True while rays are of a view to come.
    looks_ahead: bool,
    /// Pages asked for since demand was forgotten, a bit each.
    used: Vec<Cell<u64>>,
    epoch: u64,
    /// True while pages that are missing are waited for.
    is_patient: bool,
    stop: StopSignal,
    /// Look-ups until it is asked whether to stop.
    look_ups_left: u32,
}

impl PooledPages {
    /// Pages for the worker at `seat`, which may pin its share of the frames.
    pub fn new(pool: &Arc<PagePool>, seat: Seat) -> PooledPages {
        let pins_max = pins_max(pool, &seat);
        PooledPages {
            pool: pool.clone(),
            pinned: vec![Cell::new(0); pool.page_count() as usize],
            pins: empty_pins(pool, pins_max),
            pin_count: Cell::new(0),
            pins_max,
            seat,
            wants: WantList::new(pool.page_count() as usize),
            ahead: Vec::new(),
            looks_ahead: false,
            used: vec![Cell::new(0); (pool.page_count() as usize).div_ceil(64)],
            epoch: pool.epoch(),
            is_patient: false,
            stop: StopSignal::default(),
            look_ups_left: 1,
        }
    }

    /// Bytes that one worker's table takes for a file of `page_count` pages.
    pub fn bytes(page_count: usize, pins_max: usize) -> u64 {
        let table = 2 * page_count + page_count / 8;
        let pins = size_of::<OnceCell<PinToken>>() * pins_max.min(page_count);
        // The pages asked for ahead, and a list of all.
        let ahead = (2 * AHEAD_MAX + WANTS_MAX) * size_of::<Want>();
        (table + pins + WantList::bytes(page_count) + ahead) as u64
    }

    fn unpin_all(&mut self) {
        let held = &mut self.pins[..self.pin_count.take()];
        for pin in held.iter_mut().filter_map(OnceCell::take) {
            self.pinned[pin.page() as usize].set(0);
            self.pool.unpin(pin);
        }
    }

    /// Hands the want-list to the pool. Gives how many pages are on it.
    fn submit(&mut self) -> usize {
        let PooledPages { pool, wants, ahead, seat, .. } = self;
        let list = wants.hand_over(|page| is_awaited(pool, page));
        ahead.retain(|want| is_awaited(pool, want.page));
        if ahead.is_empty() {
            pool.submit(seat.number(), list);
        } else {
            pool.submit(seat.number(), &[list, ahead].concat());
        }
        list.len()
    }

    /// Waits for one page, for [`PATIENCE`] at most.
    fn bring(&mut self, page: u32) {
        let until = Instant::now() + PATIENCE;
        while is_awaited(&self.pool, page) && Instant::now() < until && !self.stop.is_due() {
            self.pool.submit(self.seat.number(), &[Want { page, weight: 1 }]);
            self.epoch = self.pool.wait_for_progress(self.epoch, WAIT);
        }
    }

    /// Asks whether to stop; when it is time, each look-up asks from then on.
    #[cold]
    fn is_stopped(&mut self) -> bool {
        let is_due = self.stop.is_due();
        self.look_ups_left = if is_due { 1 } else { LOOK_UPS_UNASKED };
        is_due
    }

    /// Forgets what was asked for: nothing that has not been begun is read for it.
    fn forget(&mut self) {
        self.used.fill(Cell::new(0));
        self.wants.clear();
        // What is not wanted for two rounds is dropped; views to come are still to come.
        for _ in 0..2 {
            self.pool.submit(self.seat.number(), &self.ahead);
        }
    }

    fn demand(&self, pages: &mut Vec<u64>) -> usize {
        pages.resize(self.used.len(), 0);
        for (sum, used) in pages.iter_mut().zip(&self.used) {
            *sum |= used.get();
        }
        let room = self.pool.room();
        if room < self.pool.page_count() as usize { room } else { 0 }
    }
}

/// True when a page may still come.
fn is_awaited(pool: &PagePool, page: u32) -> bool {
    matches!(pool.state(page), PageState::Absent | PageState::Queued | PageState::Reading)
}

impl Pages for PooledPages {
    #[inline]
    fn page(&mut self, page: u32) -> Page<'_> {
        self.look_ups_left -= 1;
        if self.look_ups_left == 0 && self.is_stopped() {
            return Page::Missing;
        }
        if self.pinned[page as usize].get() == 0 && self.pin_count.get() >= self.pins_max {
            self.unpin_all();
        }
        if self.is_patient {
            self.bring(page);
        }
        self.hold(page).expect("there is room for one")
    }

    #[inline]
    fn hold(&self, page: u32) -> Option<Page<'_>> {
        let pinned = &self.pinned[page as usize];
        let place = usize::from(pinned.get());
        if place > 0 {
            let pin = self.pins[place - 1].get().expect("it is pinned");
            return Some(Page::Ready(self.pool.frame(pin)));
        }
        if !self.looks_ahead {
            let used = &self.used[page as usize / 64];
            used.set(used.get() | 1 << (page % 64));
        }
        let place = self.pin_count.get();
        if place >= self.pins_max {
            return None;
        }
        let token = if self.looks_ahead { self.pool.try_pin_ahead(page) } else { self.pool.try_pin(page) };
        let Some(token) = token else {
            let is_damaged = self.pool.is_damaged(page);
            return Some(if is_damaged { Page::Damaged } else { Page::Missing });
        };
        let pin = self.pins[place].get_or_init(|| token);
        self.pin_count.set(place + 1);
        pinned.set(place as u16 + 1);
        Some(Page::Ready(self.pool.frame(pin)))
    }

    fn let_go(&mut self) {
        self.unpin_all();
    }

    fn want(&mut self, page: u32) {
        if !self.looks_ahead {
            self.wants.add(page);
        } else if self.ahead.len() < AHEAD_MAX && self.ahead.iter().all(|want| want.page != page) {
            self.ahead.push(Want { page, weight: 0 });
        }
    }
}

impl Drop for PooledPages {
    fn drop(&mut self) {
        self.unpin_all();
    }
}

impl PagedTracer for PagedMesh<PooledPages> {
    fn begin_tile(&mut self) {
        let pages = self.pages_mut();
        pages.unpin_all();
        // The limit may have changed, and the count of those who share it.
        pages.pins_max = pins_max(&pages.pool, &pages.seat);
        if pages.pins.len() != pages.pins_max.min(pages.pool.page_count() as usize) {
            pages.pins = empty_pins(&pages.pool, pages.pins_max);
        }
    }

    fn request_missing(&mut self) -> usize {
        self.pages_mut().submit()
    }

    fn set_patient(&mut self, is_patient: bool) {
        self.pages_mut().is_patient = is_patient;
    }

    fn look_ahead(&mut self, looks_ahead: bool) {
        self.pages_mut().looks_ahead = looks_ahead;
    }

    fn awaits_ahead(&self) -> bool {
        let PooledPages { pool, ahead, .. } = self.pages();
        ahead.iter().any(|want| is_awaited(pool, want.page))
    }

    fn forget_ahead(&mut self) {
        self.pages_mut().ahead.clear();
    }

    fn stop_by(&mut self, stop: &StopSignal) {
        let pages = self.pages_mut();
        (pages.stop, pages.look_ups_left) = (stop.clone(), 1);
    }

    fn show(&mut self, parts: &Arc<Parts>) {
        PagedMesh::show(self, parts);
    }

    fn open_parts(&self) -> OpenParts {
        PagedMesh::open_parts(self)
    }

    fn frames_from_afar(&self) -> Option<usize> {
        let PooledPages { pool, seat, .. } = self.pages();
        pool.is_far().then(|| pins_max(pool, seat))
    }

    fn wait(&mut self, longest: Duration) {
        let pages = self.pages_mut();
        pages.epoch = pages.pool.wait_for_progress(pages.epoch, longest);
    }

    fn demand(&self, pages: &mut Vec<u64>) -> usize {
        self.pages().demand(pages)
    }

    fn forget_demand(&mut self) {
        self.pages_mut().forget();
    }
}

/// The tracer of a file's mesh through a pool.
pub type MeshTracer = PagedMesh<PooledPages>;

/// Tracers of `file` for `workers` threads over a pool that nobody else uses.
///
/// # Panics
/// For more workers than a pool has origins.
pub fn pooled_tracers(file: &Arc<PageFile>, pool: &Arc<PagePool>, workers: usize) -> Vec<MeshTracer> {
    seated_tracers(file, pool, &Arc::default(), workers).expect("a pool has an origin for each worker")
}

/// Tracers of `file` for `workers` threads over a pool that they share with those at other `seats`.
///
/// # Errors
/// Those of [`Seats::assign`].
pub fn seated_tracers(
    file: &Arc<PageFile>,
    pool: &Arc<PagePool>,
    seats: &Arc<Seats>,
    workers: usize,
) -> Result<Vec<MeshTracer>> {
    // All are seated before any looks at its share.
    let seats: Result<Vec<Seat>> = (0..workers).map(|_| seats.assign()).collect();
    Ok(seats?.into_iter().map(|seat| PagedMesh::new(file, PooledPages::new(pool, seat))).collect())
}

/// Two frames are left for arrivals.
fn pins_max(pool: &PagePool, seat: &Seat) -> usize {
    (pool.frames().frames.saturating_sub(2) / seat.workers()).clamp(1, usize::from(u16::MAX) - 1)
}

fn empty_pins(pool: &PagePool, pins_max: usize) -> Vec<OnceCell<PinToken>> {
    std::iter::repeat_with(OnceCell::new).take(pins_max.min(pool.page_count() as usize)).collect()
}
