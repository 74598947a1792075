//! `Requests`: the pages that are wanted and not yet being read: the want-lists of all origins, merged.
//!
//! ```text
//!   round k   origin asks for a page    -> now
//!   round k+1 origin does not           -> now becomes before
//!   round k+2 origin does not           -> before ends; no other origin wants it: dropped
//! ```
//!
//! Invariants
//! 1. A page is in the table exactly while its word is QUEUED; both change under this struct's lock.
//! 2. At most `capacity` pages are queued, at most half of that by prefetch and background. What finds no room is
//!    refused and counted; its origin asks again with the next round anyway.
//! 3. `order` holds every page of the table, best last, or is marked dirty; it may hold pages that have left.
//! 4. Nothing is allocated after `new`.

use super::want::{Class, ORIGINS_MAX, PREDICTORS, Want, predictor_of};
use super::word::{PageState, Word};
use std::cmp::Reverse;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

struct Request {
    class: Class,
    weight: u32,
    /// Origins that asked in their present round, and in the one before.
    now: u64,
    before: u64,
    /// Somebody sleeps until it comes: never dropped.
    held: bool,
    /// Who asked first.
    by: u8,
}

/// Sorted ascending: the best comes last. Ties go to the lower page, which is the earlier one on disk.
type Key = (Reverse<Class>, u32, Reverse<u32>);

/// The table of wants.
pub(super) struct Requests {
    table: HashMap<u32, Request>,
    order: Vec<Key>,
    dirty: bool,
    capacity: usize,
    counts: Counts,
    /// By frame: see [`super::clock::Clock`].
    guessed_by: Arc<[AtomicU8]>,
}

/// What became of wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) dropped: u64,
    pub(super) refused: u64,
    /// By predictor; the last is for all others.
    pub(super) late: [u64; PREDICTORS + 1],
    pub(super) peak: u64,
}

impl Requests {
    /// Bytes of the tables for one queued page.
    pub(super) const BYTES_PER_WANT: u64 = 80;

    pub(super) fn new(capacity: usize, guessed_by: Arc<[AtomicU8]>) -> Requests {
        Requests {
            table: HashMap::with_capacity(capacity),
            order: Vec::with_capacity(capacity),
            dirty: false,
            capacity,
            counts: Counts::default(),
            guessed_by,
        }
    }

    /// Replaces the want-list of `origin`. True when there is something to read.
    pub(super) fn submit(&mut self, origin: usize, wants: &[Want], words: &[Word]) -> bool {
        assert!(origin < ORIGINS_MAX, "origin {origin} of {ORIGINS_MAX}");
        let bit = 1 << origin;
        for request in self.table.values_mut() {
            request.before = request.before & !bit | request.now & bit;
            request.now &= !bit;
        }
        for want in wants {
            self.add(want, (bit, predictor_of(origin)), words);
        }
        let before = self.table.len();
        self.table.retain(|&page, request| {
            let wanted = request.held || request.now | request.before != 0;
            if !wanted {
                words[page as usize].unqueue();
            }
            wanted
        });
        self.counts.dropped += (before - self.table.len()) as u64;
        self.dirty = true;
        !self.table.is_empty()
    }

    /// Wants `page` until it has been read, whatever the rounds say. False when there is no room.
    pub(super) fn hold(&mut self, page: u32, words: &[Word]) -> bool {
        self.add(&Want { page, class: Class::Urgent, weight: 0 }, (0, PREDICTORS as u8), words);
        match self.table.get_mut(&page) {
            Some(request) => {
                request.held = true;
                self.dirty = true;
                true
            }
            None => words[page as usize].view().state != PageState::Absent,
        }
    }

    fn add(&mut self, want: &Want, (bit, by): (u64, u8), words: &[Word]) {
        let word = &words[want.page as usize];
        let room = if want.class.is_low() { self.capacity / 2 } else { self.capacity };
        match word.view().state {
            PageState::Resident | PageState::Damaged => return,
            PageState::Reading => {
                let by = self.guessed_by[word.view().frame as usize].load(Ordering::Relaxed);
                self.counts.late[usize::from(by)] += u64::from(word.promote(want.class));
                return;
            }
            PageState::Absent if self.table.len() >= room => {
                self.counts.refused += 1;
                return;
            }
            PageState::Absent | PageState::Queued => {}
        }
        match self.table.entry(want.page) {
            Entry::Occupied(entry) => {
                let request = entry.into_mut();
                let is_late = request.class == Class::Prefetch && !want.class.is_low();
                self.counts.late[usize::from(request.by)] += u64::from(is_late);
                // The only origin may change its mind; several are merged to the strongest.
                let alone =
                    (request.now | request.before) & !bit == 0 && request.now & bit == 0 && !request.held;
                if alone || want.class < request.class {
                    (request.class, request.weight) = (want.class, want.weight);
                } else if want.class == request.class {
                    request.weight = request.weight.max(want.weight);
                }
                request.now |= bit;
            }
            Entry::Vacant(entry) => {
                let queued = word.enqueue();
                assert!(queued.is_ok(), "a page that is not in the table is {queued:?}");
                let Want { class, weight, .. } = *want;
                entry.insert(Request { class, weight, now: bit, before: 0, held: false, by });
                self.counts.peak = self.counts.peak.max(self.table.len() as u64);
            }
        }
    }

    /// The page to be read next.
    pub(super) fn best(&mut self) -> Option<(u32, Class)> {
        if self.dirty {
            self.order.clear();
            let keys = self.table.iter();
            self.order.extend(keys.map(|(&page, want)| (Reverse(want.class), want.weight, Reverse(page))));
            self.order.sort_unstable();
            self.dirty = false;
        }
        while let Some(&(Reverse(class), _, Reverse(page))) = self.order.last() {
            if self.table.contains_key(&page) {
                return Some((page, class));
            }
            self.order.pop();
        }
        None
    }

    /// The class in which `page` is wanted, if it is queued.
    pub(super) fn class_of(&self, page: u32) -> Option<Class> {
        self.table.get(&page).map(|request| request.class)
    }

    /// Takes `page` out, to be read into `frame`. The predictor that asked first.
    pub(super) fn take(&mut self, page: u32, frame: u32, words: &[Word]) -> u8 {
        let request = self.table.remove(&page).expect("a page that is not queued");
        self.guessed_by[frame as usize].store(request.by, Ordering::Relaxed);
        words[page as usize].begin_read(frame, request.class);
        request.by
    }

    /// Pages queued now.
    pub(super) fn len(&self) -> usize {
        self.table.len()
    }

    /// What became of wants so far.
    pub(super) fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    fn words() -> Vec<Word> {
        (0..100).map(|_| Word::absent()).collect()
    }

    fn requests() -> Requests {
        Requests::new(10, (0..100).map(|_| AtomicU8::new(PREDICTORS as u8)).collect())
    }

    fn want(page: u32, class: Class, weight: u32) -> Want {
        Want { page, class, weight }
    }

    fn drain(requests: &mut Requests, words: &[Word]) -> Vec<u32> {
        let mut pages = Vec::new();
        while let Some((page, _)) = requests.best() {
            requests.take(page, 0, words);
            pages.push(page);
        }
        pages
    }

    #[test]
    fn class_then_weight_then_place_on_disk() {
        let (mut requests, words) = (requests(), words());
        let wants = [
            want(1, Class::Background, 9),
            want(2, Class::Urgent, 1),
            want(4, Class::Urgent, 5),
            want(3, Class::Urgent, 5),
            want(5, Class::Prefetch, 7),
            want(6, Class::Normal, 0),
        ];
        requests.submit(0, &wants, &words);
        assert_eq!(drain(&mut requests, &words), [3, 4, 2, 6, 5, 1]);
    }

    #[test]
    fn unwanted_for_two_rounds_is_dropped() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, Class::Normal, 0), want(2, Class::Normal, 0)], &words);
        requests.submit(1, &[want(2, Class::Urgent, 0)], &words);
        assert!(requests.hold(3, &words));
        requests.submit(0, &[], &words);
        assert_eq!(requests.len(), 3);
        requests.submit(0, &[], &words);
        assert_eq!((requests.len(), requests.counts().dropped), (2, 1));
        assert_eq!(words[1].view().state, PageState::Absent);
        requests.submit(1, &[], &words);
        requests.submit(1, &[], &words);
        assert_eq!(drain(&mut requests, &words), [3]);
    }

    #[test]
    fn the_bound_holds_and_leaves_room_for_demand() {
        let (mut requests, words) = (requests(), words());
        let wants = |class, pages: std::ops::Range<u32>| -> Vec<Want> {
            pages.map(|page| want(page, class, 0)).collect()
        };
        requests.submit(0, &wants(Class::Prefetch, 0..50), &words);
        assert_eq!((requests.len(), requests.counts().refused), (5, 45));
        requests.submit(1, &wants(Class::Urgent, 50..100), &words);
        assert_eq!((requests.len(), requests.counts().refused), (10, 90));
        assert_eq!(requests.counts().peak, 10);
    }

    #[test]
    fn demand_for_a_queued_prefetch_is_late() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, Class::Prefetch, 0), want(2, Class::Prefetch, 1)], &words);
        requests.submit(1, &[want(1, Class::Urgent, 0)], &words);
        assert_eq!((requests.best(), requests.counts().late), (Some((1, Class::Urgent)), [0, 0, 0, 1]));
    }

    #[test]
    fn the_only_origin_may_change_its_mind() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, Class::Urgent, 9), want(2, Class::Normal, 0)], &words);
        requests.submit(0, &[want(1, Class::Background, 1), want(2, Class::Normal, 0)], &words);
        assert_eq!(drain(&mut requests, &words), [2, 1]);
    }
}
