//! Batches of rays through the upper octree and the units below it: as `batch`, in lanes that go from upper leaves into
//! frames and back.
//!
//! ```text
//! rays -> queue -> lanes (`simd`): pages are held until all have ended
//!   met a voxel, met nothing  -> answer
//!   a page is missing         -> blocked, or a stand-in; afterwards the page is recorded as wanted
//!   no more can be held       -> crowded: when all others have ended, all pages are let go and the crowded go again
//!                                       -> fewer than half of them were answered: the rest goes one by one
//! ```
//!
//! Invariants: 1. answers are those of [`LowerScene::intersect`], and of [`LowerScene::answer`] for rays with cones,
//! with the same pages, bit for bit; a crowd costs time and changes none; 2. lanes visit each ray's way three times on
//! average, at most: all, all again with all pages let go, and from then on half as many each time; 3. a ray alone is
//! answered or blocked with room for one page, so that waiting for pages ends when it does one by one.

use super::batch::PacketWidth;
use super::g_ray::{GAnswer, GRay};
use super::lower::{LowerFound, LowerHit, LowerScene};
#[cfg(target_arch = "x86_64")]
use super::simd::{self, LowerQueue, Outcome};
use super::traverse::Entry;
use crate::trace::{Answer, Pages, Ray};
use trex_store::octree::Refinement;

impl LowerScene<'_> {
    /// Bytes of what a ray of a batch has found.
    pub(crate) const FOUND_BYTES: usize = size_of::<Answer<Option<LowerFound>>>();

    /// [`LowerScene::intersect`] of each ray, to its place in `answers`. Pages that are there stay held until others
    /// are looked up, so that what is behind a hit can be read.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn intersect_batch(
        &self,
        rays: &[Ray],
        pages: &mut impl Pages,
        answers: &mut [Answer<Option<LowerHit>>],
    ) {
        self.intersect_batch_with(PacketWidth::widest(), rays, pages, answers);
    }

    /// [`LowerScene::intersect`] of each ray, with a chosen width.
    ///
    /// # Panics
    /// When rays and answers differ in length, or the machine has no such width.
    pub fn intersect_batch_with(
        &self,
        width: PacketWidth,
        rays: &[Ray],
        pages: &mut impl Pages,
        answers: &mut [Answer<Option<LowerHit>>],
    ) {
        assert_eq!(rays.len(), answers.len(), "a place for each answer");
        let cube = self.cube();
        let entry = |ray: usize| cube.enter(&rays[ray]);
        let waiting = (0..rays.len() as u32).collect();
        self.walk_batch(width, (waiting, &entry), pages, |ray, found| answers[ray] = self.hit_of(found));
    }

    /// [`LowerScene::answer`] of each ray, to its place in `answers`.
    pub(crate) fn answer_batch(&self, rays: &[&GRay], pages: &mut impl Pages, answers: &mut [GAnswer]) {
        let width = PacketWidth::for_rays(rays.len());
        let (finest, upper): (Vec<u32>, Vec<u32>) =
            (0..rays.len() as u32).partition(|&ray| rays[ray as usize].kind().asks_units());
        let entry = |ray: usize| Entry::of(rays[ray]);
        self.upper().walk_batch(width, (upper.len(), |at: usize| entry(upper[at] as usize)), |at, found| {
            let ray = upper[at] as usize;
            answers[ray] = self.upper().answer_of(rays[ray], found.map(|(_, found)| found).as_ref());
        });
        let mut all_found = vec![Answer::Exact(None); rays.len()];
        self.walk_parts(width, (rays, finest), pages, &mut all_found);
        for ((ray, found), answer) in rays.iter().zip(&all_found).zip(answers) {
            if ray.kind().asks_units() {
                *answer = self.answer_of(ray, found, pages);
            }
        }
    }

    /// Walks rays that ask units through the leaves of each level that their cones let them read, finest first; what
    /// each found goes to its place.
    fn walk_parts(
        &self,
        width: PacketWidth,
        (rays, mut unanswered): (&[&GRay], Vec<u32>),
        pages: &mut impl Pages,
        all_found: &mut [Answer<Option<LowerFound>>],
    ) {
        let mut starts = vec![0.0f32; rays.len()];
        for part in self.parts() {
            let is_inside = |&ray: &u32| {
                let (from, ray) = (starts[ray as usize], rays[ray as usize]);
                from < ray.reach(part.next) && from <= ray.t_max
            };
            let inside: Vec<u32> = unanswered.iter().copied().filter(is_inside).collect();
            let entry =
                |ray: usize| Entry::of(&rays[ray].part(starts[ray], rays[ray].reach(part.next), part.side));
            let mut note = |ray: usize, mut found: Answer<Option<LowerFound>>| {
                if let Answer::Exact(Some(found)) = &mut found {
                    found.found.t = starts[ray] + part.side * found.found.t;
                }
                all_found[ray] = found;
            };
            match part.lower {
                Some(lower) => lower.walk_batch(width, (inside.clone(), &entry), pages, note),
                None => {
                    let entry = |at: usize| entry(inside[at] as usize);
                    self.upper().walk_batch(width, (inside.len(), entry), |at, found| {
                        let found = found.map(|(_, found)| LowerFound::of_upper(found));
                        note(inside[at] as usize, Answer::Exact(found));
                    });
                }
            }
            unanswered.retain(|&ray| matches!(all_found[ray as usize], Answer::Exact(None)));
            inside.iter().for_each(|&ray| starts[ray as usize] = rays[ray as usize].reach(part.next));
        }
    }

    /// Walks the rays that wait, which `entry` gives by index; calls `answer` with the index of each and what it found.
    fn walk_batch(
        &self,
        width: PacketWidth,
        (mut waiting, entry): (Vec<u32>, &impl Fn(usize) -> Option<Entry>),
        pages: &mut impl Pages,
        mut answer: impl FnMut(usize, Answer<Option<LowerFound>>),
    ) {
        assert!(width.is_available(), "{width:?} on a machine without it");
        #[cfg(target_arch = "x86_64")]
        if width != PacketWidth::One && simd::fits(self.upper().octree()) && !waiting.is_empty() {
            // Before the first time others may have left no room.
            for time in 0.. {
                let crowded = self.walk_lanes(width, (&waiting, entry), pages, &mut answer);
                let is_worth_it = time == 0 || 2 * crowded.len() <= waiting.len();
                waiting = crowded;
                if waiting.is_empty() {
                    return;
                }
                pages.let_go();
                if !is_worth_it {
                    break;
                }
            }
        }
        for ray in waiting {
            let found =
                entry(ray as usize).map_or(Answer::Exact(None), |entry| self.walk(&entry, pages, &mut ()));
            answer(ray as usize, found);
        }
    }

    /// Answers waiting rays in lanes; those that are crowded out are left.
    #[cfg(target_arch = "x86_64")]
    fn walk_lanes(
        &self,
        width: PacketWidth,
        (waiting, entry): (&[u32], &impl Fn(usize) -> Option<Entry>),
        pages: &mut impl Pages,
        answer: &mut impl FnMut(usize, Answer<Option<LowerFound>>),
    ) -> Vec<u32> {
        let (mut crowded, mut wanted) = (Vec::new(), Vec::new());
        let tell = |ray: u32, outcome| match outcome {
            Outcome::Hit(found) => answer(ray as usize, Answer::Exact(Some(found))),
            Outcome::Miss => answer(ray as usize, Answer::Exact(None)),
            Outcome::Missing(page, found) => {
                wanted.push(page);
                answer(ray as usize, found.map_or(Answer::Blocked, |found| Answer::Exact(Some(found))));
            }
            Outcome::Crowded => crowded.push(ray),
        };
        match self.refinement {
            Refinement::None => unreachable!("links lead to finer leaves"),
            Refinement::By4 => {
                walk_all(width, LowerQueue::<_, _, 1>::new(self, (waiting, entry), &*pages, tell));
            }
            Refinement::By16 => {
                walk_all(width, LowerQueue::<_, _, 2>::new(self, (waiting, entry), &*pages, tell));
            }
        }
        wanted.into_iter().for_each(|page| pages.want(page));
        crowded
    }
}

#[cfg(target_arch = "x86_64")]
fn walk_all<E: Fn(usize) -> Option<Entry>, A: FnMut(u32, Outcome), const FINER: u32>(
    width: PacketWidth,
    mut queue: LowerQueue<'_, E, A, FINER>,
) {
    match width {
        PacketWidth::One => unreachable!("one ray takes no lanes"),
        PacketWidth::Eight => simd::avx2::walk_all(&mut queue),
        PacketWidth::Sixteen => simd::avx512::walk_all(&mut queue),
    }
}
