//! Policies of eviction: how many pages each reads of a trace, into so many frames of one page each.
//!
//! Invariant: a page is read when it is asked for and is in no frame; none is read ahead.

use super::trace::PageTrace;
use std::collections::{BTreeMap, BTreeSet};

/// The scores of the pool's clock (`store/src/pool/word.rs`): of a page that has come, and the best.
const SCORE_FIRST: u8 = 2;
const SCORE_MAX: u8 = 3;

/// The pool's clock: whoever asks raises the score of the page, the hand lowers it and takes pages that have none.
pub(super) fn clock(trace: &PageTrace, frames: usize) -> u64 {
    let (mut ring, mut hand, mut read) = (Vec::<u32>::with_capacity(frames), 0, 0);
    // Of pages that are in the ring.
    let mut scores = vec![None; trace.page_end()];
    for page in trace.pages() {
        if scores[page as usize].is_none() {
            read += 1;
            if ring.len() < frames {
                ring.push(page);
            } else {
                loop {
                    let at = hand % frames;
                    hand = at + 1;
                    let score: &mut Option<u8> = &mut scores[ring[at] as usize];
                    *score = score.expect("it is in the ring").checked_sub(1);
                    if score.is_none() {
                        ring[at] = page;
                        break;
                    }
                }
            }
            scores[page as usize] = Some(SCORE_FIRST);
        }
        let score = scores[page as usize].as_mut().expect("it has come");
        *score = (*score + 1).min(SCORE_MAX);
    }
    read
}

/// Least recently used: the page that nobody has asked for the longest goes.
pub(super) fn lru(trace: &PageTrace, frames: usize) -> u64 {
    let mut last = vec![None; trace.page_end()];
    let (mut by_age, mut read) = (BTreeMap::new(), 0);
    for (now, page) in trace.pages().enumerate() {
        match last[page as usize].replace(now) {
            Some(before) => drop(by_age.remove(&before)),
            None => {
                read += 1;
                if by_age.len() == frames {
                    let (_, oldest) = by_age.pop_first().expect("there is a frame");
                    last[oldest as usize] = None;
                }
            }
        }
        by_age.insert(now, page);
    }
    read
}

/// Belady's optimum: the page that is asked for again the latest goes.
pub(super) fn optimum(trace: &PageTrace, frames: usize) -> u64 {
    let mut next = vec![usize::MAX; trace.len()];
    let mut seen = vec![usize::MAX; trace.page_end()];
    for (now, page) in trace.pages().enumerate().rev() {
        next[now] = std::mem::replace(&mut seen[page as usize], now);
    }
    // When each page of a frame is asked for again, and its number, by which those that never are differ.
    let mut held = BTreeSet::new();
    let mut again = vec![None; trace.page_end()];
    let mut read = 0;
    for (now, page) in trace.pages().enumerate() {
        match again[page as usize] {
            Some(at) => drop(held.remove(&(at, page))),
            None => {
                read += 1;
                if held.len() == frames {
                    let (_, latest) = held.pop_last().expect("there is a frame");
                    again[latest as usize] = None;
                }
            }
        }
        again[page as usize] = Some(next[now]);
        held.insert((next[now], page));
    }
    read
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg64;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use std::collections::HashMap;

    /// Fewest pages that anybody can read who evicts only when a page has to come: all choices are tried.
    fn fewest(
        pages: &[u32],
        held: &[u32],
        frames: usize,
        known: &mut HashMap<(usize, Vec<u32>), u64>,
    ) -> u64 {
        let Some((page, rest)) = pages.split_first() else { return 0 };
        if held.contains(page) {
            return fewest(rest, held, frames, known);
        }
        let key = (pages.len(), held.to_vec());
        if let Some(&count) = known.get(&key) {
            return count;
        }
        let with = |left: &[u32]| {
            let mut held = [left, &[*page]].concat();
            held.sort_unstable();
            held
        };
        let count = if held.len() < frames {
            fewest(rest, &with(held), frames, known)
        } else {
            let without = |gone: usize| [&held[..gone], &held[gone + 1..]].concat();
            (0..held.len()).map(|gone| fewest(rest, &with(&without(gone)), frames, known)).min().unwrap()
        };
        known.insert(key, count + 1);
        count + 1
    }

    /// The list moved to the front, as textbooks have it.
    fn lru_by_list(pages: &[u32], frames: usize) -> u64 {
        let (mut list, mut read) = (Vec::<u32>::new(), 0);
        for &page in pages {
            match list.iter().position(|&other| other == page) {
                Some(at) => drop(list.remove(at)),
                None => read += 1,
            }
            list.insert(0, page);
            list.truncate(frames);
        }
        read
    }

    #[test]
    fn the_reference_string_of_textbooks_has_its_counts() {
        // Silberschatz, Galvin and Gagne, "Operating System Concepts", section on page replacement: three frames.
        let pages = [7, 0, 1, 2, 0, 3, 0, 4, 2, 3, 0, 3, 2, 1, 2, 0, 1, 7, 0, 1];
        let trace = PageTrace::of(&pages);
        assert_eq!((lru(&trace, 3), optimum(&trace, 3)), (12, 9));
    }

    #[test]
    fn the_optimum_is_the_fewest_of_all_choices_and_nobody_reads_less() {
        let mut rng = Pcg64::seed_from_u64(7);
        for frames in 1..=4 {
            for _ in 0..40 {
                let pages: Vec<u32> = (0..24).map(|_| rng.next_u64() as u32 % 7).collect();
                let trace = PageTrace::of(&pages);
                let best = optimum(&trace, frames);
                assert_eq!(best, fewest(&pages, &[], frames, &mut HashMap::new()), "{pages:?} in {frames}");
                assert_eq!(lru(&trace, frames), lru_by_list(&pages, frames), "{pages:?} in {frames}");
                assert!(lru(&trace, frames) >= best && clock(&trace, frames) >= best);
            }
        }
    }

    #[test]
    fn the_clock_passes_a_page_as_often_as_it_has_scores() {
        // Three times each: both have the best score, and the hand goes round three times before it takes the first.
        let trace = PageTrace::of(&[0, 1, 0, 1, 0, 1, 2, 1]);
        assert_eq!(clock(&trace, 2), 3);
        // Page 2 takes the frame of page 0 after three rounds, which leave page 1 without a score: it goes next.
        let trace = PageTrace::of(&[0, 1, 2, 0, 2, 0]);
        assert_eq!((clock(&trace, 2), clock(&trace, 3)), (4, 3));
        // By hand; other scores, first in first out, and LRU read 6 or 8 of these.
        let trace = PageTrace::of(&[0, 4, 0, 2, 1, 2, 4, 2, 4, 4, 0, 4, 3, 1, 1]);
        assert_eq!((clock(&trace, 3), lru(&trace, 3)), (7, 8));
    }
}
