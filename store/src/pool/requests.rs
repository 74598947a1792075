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
//! 2. At most `capacity` pages are queued. What finds no room takes that of a weaker one, or is refused and counted;
//!    its origin asks again with the next round anyway.
//! 3. `order` holds every page of the table under its weight, and no other, best last.
//! 4. What is allocated is bounded by `capacity`, and leased with it.

use super::want::{ORIGINS_MAX, Want};
use super::word::{PageState, Word};
use std::cmp::Reverse;
use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap};

struct Request {
    weight: u32,
    /// Origins that asked in their present round, and in the one before.
    now: u64,
    before: u64,
    /// Somebody sleeps until it comes: never dropped.
    held: bool,
}

/// Sorted ascending: the best comes last. Ties go to the lower page, which is the earlier one on disk.
type Key = (u32, Reverse<u32>);

/// The table of wants.
pub(super) struct Requests {
    table: HashMap<u32, Request>,
    order: BTreeSet<Key>,
    capacity: usize,
    counts: RequestCounts,
}

/// What became of wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequestCounts {
    pub(super) dropped: u64,
    pub(super) refused: u64,
    /// Asked for while they were read ahead.
    pub(super) late: u64,
    pub(super) peak: u64,
}

impl Requests {
    /// Bytes of the tables for one queued page; keys stand in a tree whose nodes may be half full.
    pub(super) const BYTES_PER_WANT: u64 = 92;

    pub(super) fn new(capacity: usize) -> Requests {
        Requests {
            table: HashMap::with_capacity(capacity),
            order: BTreeSet::new(),
            capacity,
            counts: RequestCounts::default(),
        }
    }

    /// Replaces the want-list of `origin`. True when there is something to read, or wanted of what is read ahead.
    pub(super) fn submit(&mut self, origin: usize, wants: &[Want], words: &[Word]) -> bool {
        assert!(origin < ORIGINS_MAX, "origin {origin} of {ORIGINS_MAX}");
        let (bit, late_before) = (1 << origin, self.counts.late);
        for request in self.table.values_mut() {
            request.before = request.before & !bit | request.now & bit;
            request.now &= !bit;
        }
        for want in wants {
            self.add(want, bit, words);
        }
        let before = self.table.len();
        self.table.retain(|&page, request| {
            let wanted = request.held || request.now | request.before != 0;
            if !wanted {
                words[page as usize].unqueue();
                self.order.remove(&(request.weight, Reverse(page)));
            }
            wanted
        });
        self.counts.dropped += (before - self.table.len()) as u64;
        !self.table.is_empty() || self.counts.late > late_before
    }

    /// Wants `page` until it has been read, whatever the rounds say. False when there is no room.
    pub(super) fn hold(&mut self, page: u32, words: &[Word]) -> bool {
        self.add(&Want { page, weight: 1 }, 0, words);
        match self.table.get_mut(&page) {
            Some(request) => {
                request.held = true;
                true
            }
            None => words[page as usize].view().state != PageState::Absent,
        }
    }

    fn add(&mut self, want: &Want, bit: u64, words: &[Word]) {
        let word = &words[want.page as usize];
        match word.view().state {
            PageState::Reading => {
                self.counts.late += u64::from(want.weight > 0 && word.ask());
                return;
            }
            PageState::Resident | PageState::Damaged => return,
            PageState::Absent if self.table.len() >= self.capacity => {
                self.counts.refused += 1;
                if !self.displace(want.weight, words) {
                    return;
                }
            }
            PageState::Absent | PageState::Queued => {}
        }
        match self.table.entry(want.page) {
            Entry::Occupied(entry) => {
                let request = entry.into_mut();
                // The only origin may change its mind; several are merged to the strongest.
                let alone =
                    (request.now | request.before) & !bit == 0 && request.now & bit == 0 && !request.held;
                let weight = if alone { want.weight } else { request.weight.max(want.weight) };
                if weight != request.weight {
                    self.order.remove(&(request.weight, Reverse(want.page)));
                    self.order.insert((weight, Reverse(want.page)));
                    request.weight = weight;
                }
                request.now |= bit;
            }
            Entry::Vacant(entry) => {
                let queued = word.enqueue();
                assert!(queued.is_ok(), "a page that is not in the table is {queued:?}");
                entry.insert(Request { weight: want.weight, now: bit, before: 0, held: false });
                self.order.insert((want.weight, Reverse(want.page)));
                self.counts.peak = self.counts.peak.max(self.table.len() as u64);
            }
        }
    }

    /// Takes the room of the weakest page, if that is weaker than `weight`.
    fn displace(&mut self, weight: u32, words: &[Word]) -> bool {
        let weaker = self.order.iter().take_while(|(other, _)| *other < weight);
        let key = weaker.copied().find(|(_, Reverse(page))| !self.table[page].held);
        if let Some(key @ (_, Reverse(page))) = key {
            self.order.remove(&key);
            self.table.remove(&page);
            words[page as usize].unqueue();
        }
        key.is_some()
    }

    /// The page to be read next, and its weight.
    pub(super) fn best(&self) -> Option<(u32, u32)> {
        self.order.last().map(|&(weight, Reverse(page))| (page, weight))
    }

    /// True when `page` is queued.
    pub(super) fn contains(&self, page: u32) -> bool {
        self.table.contains_key(&page)
    }

    /// Takes `page` out, to be read into `frame`.
    pub(super) fn take(&mut self, page: u32, frame: u32, words: &[Word]) {
        let request = self.table.remove(&page).expect("a page that is not queued");
        self.order.remove(&(request.weight, Reverse(page)));
        words[page as usize].begin_read(frame, request.weight == 0);
    }

    /// Pages queued now.
    pub(super) fn len(&self) -> usize {
        self.table.len()
    }

    /// What became of wants so far.
    pub(super) fn counts(&self) -> RequestCounts {
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
        Requests::new(10)
    }

    fn want(page: u32, weight: u32) -> Want {
        Want { page, weight }
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
    fn weight_then_place_on_disk() {
        let (mut requests, words) = (requests(), words());
        let wants = [want(1, 0), want(2, 1), want(4, 5), want(3, 5), want(5, 7)];
        requests.submit(0, &wants, &words);
        assert_eq!(drain(&mut requests, &words), [5, 3, 4, 2, 1]);
    }

    #[test]
    fn what_several_want_has_the_greatest_weight() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, 2), want(2, 3), want(3, 4)], &words);
        requests.submit(1, &[want(1, 9), want(2, 1)], &words);
        assert_eq!(drain(&mut requests, &words), [1, 3, 2]);
    }

    #[test]
    fn unwanted_for_two_rounds_is_dropped() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, 0), want(2, 0)], &words);
        requests.submit(1, &[want(2, 0)], &words);
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
    fn the_bound_holds() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(0, 0), want(1, 0)], &words);
        requests.submit(1, &(0..50).map(|page| want(page, 1)).collect::<Vec<_>>(), &words);
        assert_eq!((requests.len(), requests.counts().refused), (10, 40));
        assert_eq!(requests.counts().peak, 10);
        assert_eq!(drain(&mut requests, &words), (0..10).collect::<Vec<_>>());
    }

    #[test]
    fn a_full_table_keeps_the_strongest_and_what_is_held() {
        let (mut requests, words) = (requests(), words());
        assert!(requests.hold(40, &words));
        let wants: Vec<Want> = (0..30).map(|page| want(page, page % 5)).collect();
        requests.submit(0, &wants, &words);
        // Whoever came first: six of weight 4, three of weight 3, and the one that is held.
        let weights: Vec<u32> = requests.table.values().map(|request| request.weight).collect();
        let count = |weight| weights.iter().filter(|other| **other == weight).count();
        assert_eq!([4, 3, 1].map(count), [6, 3, 1]);
        assert!(!requests.hold(41, &words), "there is no room but that of stronger ones");
        let queued = |page: &usize| words[*page].view().state == PageState::Queued;
        assert_eq!((0..100).filter(queued).count(), 10);
        let found = drain(&mut requests, &words);
        assert_eq!((&found[..6], found[9]), (&[4, 9, 14, 19, 24, 29][..], 40));
        assert!(requests.order.is_empty() && (0..100).filter(queued).count() == 0);
    }

    #[test]
    fn the_only_origin_may_change_its_mind() {
        let (mut requests, words) = (requests(), words());
        requests.submit(0, &[want(1, 9), want(2, 5)], &words);
        requests.submit(0, &[want(1, 1), want(2, 5)], &words);
        assert_eq!(drain(&mut requests, &words), [2, 1]);
    }
}
