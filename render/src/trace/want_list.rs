//! `WantList`: the pages that block the rays of one worker, on the mesh and in the units alike: what it asks the pool
//! for.
//!
//! ```text
//! a ray is blocked by a page -> add                     fresh: each page once, with how many rays it has blocked
//! hand_over                  -> those that blocked the most rays join the awaited ones; what has come leaves
//! ```
//!
//! Invariants: 1. `fresh` holds each page once, and `rays` counts those pages alone; 2. `awaited` holds each page once,
//! and at most [`WANTS_MAX`]: the oldest leave first.

use std::cmp::Reverse;
use trex_store::pool::Want;

/// Most pages that one worker asks for at a time.
pub(super) const WANTS_MAX: usize = 512;
/// Pages that may join the list at a time: the rays that the others block still wait, and ask for them again.
const JOINING_MAX: usize = WANTS_MAX / 2;

/// Pages that block rays.
#[derive(Debug)]
pub(super) struct WantList {
    /// Pages that blocked rays since the list was last handed over.
    fresh: Vec<u32>,
    /// By page, how many rays it has blocked since then; 0 for one that is not fresh.
    rays: Vec<u32>,
    /// Pages that were asked for, and the most rays that each blocked at a time.
    awaited: Vec<Want>,
}

impl WantList {
    /// An empty list, for a file of `page_count` pages.
    pub(super) fn new(page_count: usize) -> WantList {
        WantList { fresh: Vec::new(), rays: vec![0; page_count], awaited: Vec::new() }
    }

    /// Bytes of the list of a file of so many pages, at most: the table; the fresh ones, which grow by doubling; the
    /// awaited ones, and a copy of all that join them.
    pub(super) fn bytes(page_count: usize) -> usize {
        3 * size_of::<u32>() * page_count + size_of::<Want>() * (page_count + 2 * WANTS_MAX)
    }

    /// Learns that a page blocks one ray more.
    pub(super) fn add(&mut self, page: u32) {
        let rays = &mut self.rays[page as usize];
        if *rays == 0 {
            self.fresh.push(page);
        }
        *rays = rays.saturating_add(1);
    }

    /// The pages to ask for: those that still wait by `is_awaited`, with the fresh ones that blocked the most rays.
    pub(super) fn hand_over(&mut self, is_awaited: impl Fn(u32) -> bool) -> &[Want] {
        let WantList { fresh, rays, awaited } = self;
        let want = |page: u32| Want { page, weight: std::mem::take(&mut rays[page as usize]) };
        let mut joining: Vec<Want> = fresh.drain(..).map(want).collect();
        joining.sort_unstable_by_key(|want| (Reverse(want.weight), want.page));
        joining.truncate(JOINING_MAX);
        awaited.retain(|want| is_awaited(want.page));
        for want in joining {
            match awaited.iter_mut().find(|other| other.page == want.page) {
                Some(other) => other.weight = other.weight.max(want.weight),
                None => awaited.push(want),
            }
        }
        awaited.drain(..awaited.len().saturating_sub(WANTS_MAX));
        awaited
    }

    /// Forgets all of it.
    pub(super) fn clear(&mut self) {
        for page in self.fresh.drain(..) {
            self.rays[page as usize] = 0;
        }
        self.awaited.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn handed(list: &mut WantList, is_awaited: impl Fn(u32) -> bool) -> Vec<(u32, u32)> {
        list.hand_over(is_awaited).iter().map(|want| (want.page, want.weight)).collect()
    }

    /// There were two lists, each with a rule of its own for pages that are in both: the mesh tracer's counted rays,
    /// the pool's kept the greater count.
    #[test]
    fn a_page_is_wanted_once_by_the_most_rays_that_it_blocked_at_a_time() {
        let mut list = WantList::new(9);
        [3, 5, 3, 3, 7, 5].into_iter().for_each(|page| list.add(page));
        assert_eq!(handed(&mut list, |_| true), [(3, 3), (5, 2), (7, 1)]);
        [7, 3, 7, 7, 7].into_iter().for_each(|page| list.add(page));
        assert_eq!(handed(&mut list, |page| page != 5), [(3, 3), (7, 4)], "page 5 has come");
        assert_eq!(handed(&mut list, |_| true), [(3, 3), (7, 4)], "nothing is counted twice");
        list.add(1);
        list.clear();
        assert_eq!(handed(&mut list, |_| true), []);
        list.add(1);
        assert_eq!(handed(&mut list, |_| true), [(1, 1)], "what is forgotten counts from 1");
    }

    #[test]
    fn the_list_is_bounded_and_drops_what_is_oldest() {
        let pages = 3 * WANTS_MAX as u32;
        let mut list = WantList::new(pages as usize);
        for first in 0..3 {
            (0..pages).skip(first * WANTS_MAX).take(WANTS_MAX).for_each(|page| list.add(page));
            let list = handed(&mut list, |_| true);
            assert_eq!(list.len(), WANTS_MAX.min((first + 1) * JOINING_MAX));
            assert_eq!(list.last(), Some(&((first * WANTS_MAX + JOINING_MAX) as u32 - 1, 1)));
        }
        assert_eq!(handed(&mut list, |_| true)[0], (WANTS_MAX as u32, 1), "pages of the first turn are gone");
    }
}
