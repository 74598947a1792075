//! `Retry`: how work goes on that waits for pages, whatever the work is: samples of tiles, photons of a batch.
//!
//! ```text
//! rounds over all that waits: each asks its ray again -> some are answered: on
//!                                                     -> none: wait for pages; STALLED_ROUNDS of these: one goes alone
//! alone: ask one ray, request, wait, ask again, until the piece of work is done
//! ```
//!
//! Why it ends, however few frames there are: a piece of work keeps what it has, so only rays count. Alone it wants the
//! pages of ONE ray; `begin_tile` is called only when that ray was answered, so the tracer may keep each page that came
//! for it; every try finds at least one page more, and a ray crosses finitely many. Where these are more than there are
//! frames, pages that came go again for those that come: after [`TRIES_MAX`] tries of a ray the tracer is patient, and
//! waits for each page while the ray is on its way, which takes room for one. A page that cannot be had must be
//! answered for (a coarser form, an error), never Blocked for ever.
//!
//! Invariants: 1. nothing sleeps longer than [`WAIT`], but for a patient tracer, a second a page; 2. work that is
//! interrupted alone can go on alone.

use super::PagedTracer;
use std::time::Duration;

/// Rounds without one answer, after each of which pages were waited for, before one goes alone: late pages are more
/// likely than lack of room.
const STALLED_ROUNDS: u32 = 4;
/// Tries of one ray alone before its pages are waited for one by one: until then all that is seen to be missing is
/// asked for together.
const TRIES_MAX: u32 = 8;
/// Longest sleep for pages: arrivals wake it earlier.
pub(crate) const WAIT: Duration = Duration::from_millis(50);

/// The result of one more try at a piece of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Advance {
    /// The piece of work is done.
    Done,
    /// A ray was answered, and the next one is blocked.
    Answered,
    /// The ray is still blocked.
    Blocked,
}

/// Counts rounds and waits of one worker.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Retry {
    stalled: u32,
    /// Times that pages were waited for.
    pub(crate) waits: u64,
}

impl Retry {
    /// Learns of a round over all that waits; true when it is time for one to go alone.
    pub(crate) fn is_stuck(&mut self, has_advanced: bool) -> bool {
        self.stalled = if has_advanced { 0 } else { self.stalled + 1 };
        let is_stuck = self.stalled == STALLED_ROUNDS;
        if is_stuck {
            self.stalled = 0;
        }
        is_stuck
    }

    /// Sleeps until a page has come, or for `longest`.
    pub(crate) fn wait<T: PagedTracer>(&mut self, tracer: &mut T, longest: Duration) {
        self.waits += 1;
        tracer.wait(longest);
    }

    /// Takes a piece of work to its end with the pages of one ray at a time; false when it was interrupted before.
    /// `longest` is asked how long to sleep, and `None` interrupts.
    pub(crate) fn alone<T: PagedTracer>(
        &mut self,
        tracer: &mut T,
        longest: impl Fn() -> Option<Duration>,
        mut advance: impl FnMut(&mut T) -> Advance,
    ) -> bool {
        tracer.begin_tile();
        let mut tries = 0;
        let is_done = loop {
            match advance(tracer) {
                Advance::Done => break true,
                Advance::Answered => {
                    tracer.begin_tile();
                    tries = 0;
                }
                Advance::Blocked => {
                    let Some(longest) = longest() else { break false };
                    tracer.request_missing();
                    self.wait(tracer, longest);
                    tries += 1;
                }
            }
            tracer.set_patient(tries >= TRIES_MAX);
        };
        tracer.set_patient(false);
        is_done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{Answer, Hit, Ray, Tracer};

    /// Has the page of a ray only when it was asked for twice and nothing was begun in between.
    #[derive(Default)]
    struct OnePage {
        asked: u32,
        waits: u32,
    }

    impl Tracer for OnePage {
        fn intersect(&mut self, _: &Ray) -> Answer<Option<Hit>> {
            self.asked += 1;
            if self.asked > 2 { Answer::Exact(None) } else { Answer::Blocked }
        }

        fn occluded(&mut self, _: &Ray) -> Answer<bool> {
            Answer::Blocked
        }
    }

    impl PagedTracer for OnePage {
        fn begin_tile(&mut self) {
            self.asked = 0;
        }

        fn request_missing(&mut self) -> usize {
            1
        }

        fn wait(&mut self, longest: Duration) {
            assert!(longest <= WAIT);
            self.waits += 1;
        }
    }

    #[test]
    fn alone_each_ray_is_asked_until_it_is_answered() {
        let (mut tracer, mut retry, mut rays) = (OnePage::default(), Retry::default(), 0);
        let ray = Ray { origin: [0.0; 3], direction: [1.0, 0.0, 0.0], t_max: 1.0 };
        let mut advance = |tracer: &mut OnePage| match tracer.intersect(&ray) {
            Answer::Blocked => Advance::Blocked,
            Answer::Exact(_) => {
                rays += 1;
                if rays == 3 { Advance::Done } else { Advance::Answered }
            }
        };
        assert!(retry.alone(&mut tracer, || Some(WAIT), &mut advance));
        assert_eq!((rays, retry.waits, tracer.waits), (3, 6, 6));
        assert!(!retry.alone(&mut tracer, || None, |_| Advance::Blocked), "it was interrupted");
    }

    #[test]
    fn one_goes_alone_after_rounds_without_an_answer() {
        let mut retry = Retry::default();
        let rounds = [false, false, true, false, false, false, false, false];
        let stuck = rounds.map(|advanced| retry.is_stuck(advanced));
        assert_eq!(stuck, [false, false, false, false, false, false, true, false]);
    }
}
