//! Rays answered to the end, whatever pages they wait for: for callers that bring rays of their own.
//!
//! ```text
//! chunk of rays -> all together -> answered | blocked -> request, wait, again, those that are left
//!                                            four rounds without an answer: one alone (`Retry`)
//! ```
//!
//! Invariant: answers do not depend on the pages that were there, nor on the rays beside.

use super::{Advance, Answer, Hit, MeshTracer, PagedTracer, Ray, Retry, ShadedHit, WAIT};
use std::cell::RefCell;

/// Rays that are asked together, at most.
const CHUNK: usize = 1024;

/// Closest hits of `rays`, in their order, appended to `hits`. False when `stop` said so before all were answered.
pub fn intersect_all<T: PagedTracer>(
    tracer: &mut T,
    rays: &[Ray],
    stop: &dyn Fn() -> bool,
    hits: &mut Vec<Option<Hit>>,
) -> bool {
    let single = |tracer: &mut T, ray: &Ray| tracer.intersect(ray);
    let mut chunks = rays.chunks(CHUNK);
    chunks.all(|rays| !stop() && answer(tracer, rays, (stop, hits), T::intersect_coherent, single))
}

/// As [`intersect_all`], with what shades each hit.
pub fn intersect_shaded_all<T: PagedTracer>(
    tracer: &mut T,
    rays: &[Ray],
    stop: &dyn Fn() -> bool,
    hits: &mut Vec<Option<ShadedHit>>,
) -> bool {
    let single = |tracer: &mut T, ray: &Ray| tracer.intersect_shaded(ray);
    let together = |tracer: &mut T, rays: &[Ray], answers: &mut Vec<_>| {
        let mut hits = Vec::with_capacity(rays.len());
        tracer.intersect_coherent(rays, &mut hits);
        answers.extend(hits.into_iter().map(|hit| tracer.shade_answer(hit)));
    };
    let mut chunks = rays.chunks(CHUNK);
    chunks.all(|rays| !stop() && answer(tracer, rays, (stop, hits), together, single))
}

/// Answers whether each of `rays` meets anything, in their order, appended to `answers`. False when `stop` said so
/// before all were answered.
pub fn occluded_all<T: PagedTracer>(
    tracer: &mut T,
    rays: &[Ray],
    stop: &dyn Fn() -> bool,
    answers: &mut Vec<bool>,
) -> bool {
    let single = |tracer: &mut T, ray: &Ray| tracer.occluded(ray);
    let mut chunks = rays.chunks(CHUNK);
    chunks.all(|rays| !stop() && answer(tracer, rays, (stop, answers), T::occluded_coherent, single))
}

/// All hits of `rays`, see [`PagedMesh::crossings`](super::PagedMesh::crossings): those of one after those of
/// the other,
/// appended to `hits`, and how many each has, appended to `counts`. False when `stop` said so before all were answered.
pub fn crossings_all(
    tracer: &mut MeshTracer,
    rays: &[Ray],
    stop: &dyn Fn() -> bool,
    counts: &mut Vec<usize>,
    hits: &mut Vec<Hit>,
) -> bool {
    // In the order in which rays are answered: those that wait for pages come later.
    let found = RefCell::new(Vec::new());
    let single = |tracer: &mut MeshTracer, ray: &Ray| {
        let found = &mut *found.borrow_mut();
        let first = found.len();
        tracer.crossings(ray, found).map(|()| (first, found.len()))
    };
    let together = |tracer: &mut MeshTracer, rays: &[Ray], answers: &mut Vec<_>| {
        answers.extend(rays.iter().map(|ray| single(tracer, ray)));
    };
    rays.chunks(CHUNK).all(|rays| {
        let mut ranges = Vec::with_capacity(rays.len());
        if stop() || !answer(tracer, rays, (stop, &mut ranges), together, single) {
            return false;
        }
        let mut found = found.borrow_mut();
        for (first, end) in ranges {
            counts.push(end - first);
            hits.extend_from_slice(&found[first..end]);
        }
        found.clear();
        true
    })
}

fn answer<T: PagedTracer, A: Copy + Default>(
    tracer: &mut T,
    rays: &[Ray],
    (stop, answers): (&dyn Fn() -> bool, &mut Vec<A>),
    together: impl Fn(&mut T, &[Ray], &mut Vec<Answer<A>>),
    single: impl Fn(&mut T, &Ray) -> Answer<A>,
) -> bool {
    let first = answers.len();
    answers.resize(first + rays.len(), A::default());
    let answers = &mut answers[first..];
    let (mut waiting, mut retry): (Vec<usize>, _) = ((0..rays.len()).collect(), Retry::default());
    let (mut asked, mut found) = (rays.to_vec(), Vec::with_capacity(rays.len()));
    tracer.begin_tile();
    loop {
        found.clear();
        together(tracer, &asked, &mut found);
        let before = waiting.len();
        let mut place = 0;
        waiting.retain(|&ray| {
            let found = found[place];
            place += 1;
            match found {
                Answer::Exact(answer) => answers[ray] = answer,
                Answer::Blocked => return true,
            }
            false
        });
        if waiting.is_empty() {
            return true;
        }
        if stop() {
            return false;
        }
        if retry.is_stuck(waiting.len() < before) {
            let ray = waiting.remove(0);
            let longest = || (!stop()).then_some(WAIT);
            let is_done = retry.alone(tracer, longest, |tracer| match single(tracer, &rays[ray]) {
                Answer::Exact(answer) => {
                    answers[ray] = answer;
                    Advance::Done
                }
                Answer::Blocked => Advance::Blocked,
            });
            if !is_done {
                return false;
            }
        } else {
            tracer.request_missing();
            retry.wait(tracer, WAIT);
        }
        tracer.begin_tile();
        asked.clear();
        asked.extend(waiting.iter().map(|&ray| rays[ray]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::Tracer;
    use std::collections::BTreeSet;
    use std::time::Duration;

    /// A floor at z = 0 whose tiles of unit side are pages; `room` of them can be there at a time.
    struct Floor {
        here: Vec<i64>,
        room: usize,
        wanted: BTreeSet<i64>,
    }

    impl Tracer for Floor {
        fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
            let page = ray.origin[0] as i64;
            if !self.here.contains(&page) {
                self.wanted.insert(page);
                return Answer::Blocked;
            }
            let hit = Hit { t: ray.origin[2], triangle: page as u32, ..Hit::default() };
            Answer::Exact((ray.direction[2] < 0.0).then_some(hit))
        }

        fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
            self.intersect(ray).map(|hit| hit.is_some())
        }
    }

    impl PagedTracer for Floor {
        fn begin_tile(&mut self) {}

        fn request_missing(&mut self) -> usize {
            let wanted = std::mem::take(&mut self.wanted);
            self.here.extend(&wanted);
            self.here.drain(..self.here.len().saturating_sub(self.room));
            wanted.len()
        }

        fn wait(&mut self, _: Duration) {}
    }

    fn rays() -> Vec<Ray> {
        let ray = |i: u32| Ray {
            origin: [f64::from(i * 37 % 200) + 0.5, 0.5, f64::from(i) + 1.0],
            direction: [0.0, 0.0, if i.is_multiple_of(3) { 1.0 } else { -1.0 }],
            t_max: f64::INFINITY,
        };
        (0..3000).map(ray).collect()
    }

    #[test]
    fn all_are_answered_in_order_however_little_room_there_is() {
        for room in [1, 7, 1000] {
            let mut floor = Floor { here: vec![], room, wanted: BTreeSet::new() };
            let (mut hits, mut are_hit) = (vec![], vec![]);
            assert!(intersect_all(&mut floor, &rays(), &|| false, &mut hits));
            assert!(occluded_all(&mut floor, &rays(), &|| false, &mut are_hit));
            for (i, (hit, is_hit)) in hits.iter().zip(&are_hit).enumerate() {
                let expected = (!i.is_multiple_of(3)).then_some((i as f64 + 1.0, i as u32 * 37 % 200));
                assert_eq!(hit.map(|hit| (hit.t, hit.triangle)), expected, "{room}");
                assert_eq!(*is_hit, expected.is_some());
            }
            assert_eq!(hits.len(), 3000);
        }
    }

    #[test]
    fn a_stop_ends_what_waits() {
        let mut floor = Floor { here: vec![], room: 1, wanted: BTreeSet::new() };
        assert!(!intersect_all(&mut floor, &rays(), &|| true, &mut vec![]));
    }

    /// Where every page was there a stop was not asked for before the last ray.
    #[test]
    fn a_stop_ends_what_need_not_wait() {
        let mut floor = Floor { here: (0..200).collect(), room: 200, wanted: BTreeSet::new() };
        let asked = std::cell::Cell::new(0);
        let second = || asked.replace(asked.get() + 1) == 1;
        let mut hits = vec![];
        assert!(!intersect_all(&mut floor, &rays(), &second, &mut hits));
        assert_eq!(hits.len(), CHUNK, "of 3000 rays one chunk was answered");
    }
}
