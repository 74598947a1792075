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
//! Invariants: 1. answers are those of [`LowerScene::intersect`] with the same pages, bit for bit; a crowd costs time
//! and changes none; 2. lanes visit each ray's way three times on average, at most: all, all again with all pages let
//! go, and from then on half as many each time; 3. a ray alone is answered or blocked with room for one page, so that
//! waiting for pages ends when it does one by one.

use super::batch::PacketWidth;
use super::lower::{LowerHit, LowerScene};
#[cfg(target_arch = "x86_64")]
use super::simd::{self, LowerQueue, Outcome};
use crate::trace::{Answer, Pages, Ray};
use trex_store::octree::Refinement;

impl LowerScene<'_> {
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
        self.answer_batch(width, rays, pages, |ray, answer| answers[ray] = answer);
    }

    fn answer_batch(
        &self,
        width: PacketWidth,
        rays: &[Ray],
        pages: &mut impl Pages,
        mut answer: impl FnMut(usize, Answer<Option<LowerHit>>),
    ) {
        assert!(width.is_available(), "{width:?} on a machine without it");
        let mut waiting: Vec<u32> = (0..rays.len() as u32).collect();
        #[cfg(target_arch = "x86_64")]
        if width != PacketWidth::One && simd::fits(self.upper().octree()) {
            // Before the first time others may have left no room.
            for time in 0.. {
                let crowded = self.walk_lanes(width, (rays, &waiting), pages, &mut answer);
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
        for index in waiting {
            answer(index as usize, self.intersect(&rays[index as usize], pages));
        }
    }

    /// Answers waiting rays in lanes; those that are crowded out are left.
    #[cfg(target_arch = "x86_64")]
    fn walk_lanes(
        &self,
        width: PacketWidth,
        (rays, waiting): (&[Ray], &[u32]),
        pages: &mut impl Pages,
        answer: &mut impl FnMut(usize, Answer<Option<LowerHit>>),
    ) -> Vec<u32> {
        let (mut crowded, mut wanted) = (Vec::new(), Vec::new());
        let tell = |ray: u32, outcome| match outcome {
            Outcome::Hit(hit) => answer(ray as usize, Answer::Exact(Some(hit))),
            Outcome::Miss => answer(ray as usize, Answer::Exact(None)),
            Outcome::Missing(page, hit) => {
                wanted.push(page);
                answer(ray as usize, hit.map_or(Answer::Blocked, |hit| Answer::Exact(Some(hit))));
            }
            Outcome::Crowded => crowded.push(ray),
        };
        match self.links().refinement() {
            Refinement::None => unreachable!("links lead to finer leaves"),
            Refinement::By4 => {
                walk_all(width, LowerQueue::<_, 1>::new(self, (rays, waiting), &*pages, tell));
            }
            Refinement::By16 => {
                walk_all(width, LowerQueue::<_, 2>::new(self, (rays, waiting), &*pages, tell));
            }
        }
        wanted.into_iter().for_each(|page| pages.want(page));
        crowded
    }
}

#[cfg(target_arch = "x86_64")]
fn walk_all<A: FnMut(u32, Outcome), const FINER: u32>(
    width: PacketWidth,
    mut queue: LowerQueue<'_, A, FINER>,
) {
    match width {
        PacketWidth::One => unreachable!("one ray takes no lanes"),
        PacketWidth::Eight => simd::avx2::walk_all(&mut queue),
        PacketWidth::Sixteen => simd::avx512::walk_all(&mut queue),
    }
}
