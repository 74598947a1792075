//! Batches of rays through the octree: as many side by side as the machine has lanes for.
//!
//! ```text
//! rays -> queue -> lanes (`lanes`, `avx512`, `avx2`), or one by one where the machine has neither -> answers, in any order
//! ```
//!
//! Lanes that are done take the next ray, so a batch should have many times more rays than the 32 or 64 that are under way.
//! Neighbouring rays should follow each other: they read the same nodes.
//!
//! Invariant: answers are those of [`VoxelScene::intersect`] and [`VoxelScene::occluded`], bit for bit.

use super::traverse::{Entry, Found, GRay, VoxelHit, VoxelScene};
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512, lanes};

/// How many rays of a batch go side by side. All give the same answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// One: any machine.
    One,
    /// Eight: AVX2.
    Eight,
    /// Sixteen: AVX-512 with VPOPCNTDQ.
    Sixteen,
}

impl Width {
    /// All, the fastest last.
    pub const ALL: [Width; 3] = [Width::One, Width::Eight, Width::Sixteen];

    /// True where the machine has what it takes.
    pub fn is_available(self) -> bool {
        match self {
            Width::One => true,
            #[cfg(target_arch = "x86_64")]
            Width::Eight => avx2::is_available(),
            #[cfg(target_arch = "x86_64")]
            Width::Sixteen => avx512::is_available(),
            #[cfg(not(target_arch = "x86_64"))]
            Width::Eight | Width::Sixteen => false,
        }
    }

    /// The fastest one that the machine has.
    pub fn widest() -> Width {
        Width::ALL.into_iter().rfind(|width| width.is_available()).unwrap_or(Width::One)
    }
}

impl VoxelScene<'_> {
    /// [`VoxelScene::intersect`] of each ray, to its place in `hits`.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn intersect_batch(&self, rays: &[GRay], hits: &mut [Option<VoxelHit>]) {
        self.intersect_batch_with(Width::widest(), rays, hits);
    }

    /// The same with a chosen width.
    ///
    /// # Panics
    /// When rays and hits differ in length, or the machine has no such width.
    pub fn intersect_batch_with(&self, width: Width, rays: &[GRay], hits: &mut [Option<VoxelHit>]) {
        assert_eq!(rays.len(), hits.len(), "a place for each answer");
        self.answer_batch(width, rays, |ray, hit| hits[ray] = hit);
    }

    /// [`VoxelScene::occluded`] of each ray, to its place in `occluded`.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn occluded_batch(&self, rays: &[GRay], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len(), "a place for each answer");
        self.answer_batch(Width::widest(), rays, |ray, hit| occluded[ray] = hit.is_some());
    }

    fn answer_batch(&self, width: Width, rays: &[GRay], mut answer: impl FnMut(usize, Option<VoxelHit>)) {
        assert!(width.is_available(), "{width:?} on a machine without it");
        #[cfg(target_arch = "x86_64")]
        if lanes::fits(self.octree()) {
            match width {
                Width::One => {}
                Width::Eight => return avx2::walk_all(&mut Queue { scene: self, rays, taken: 0, answer }),
                Width::Sixteen => {
                    return avx512::walk_all(&mut Queue { scene: self, rays, taken: 0, answer });
                }
            }
        }
        for (index, ray) in rays.iter().enumerate() {
            answer(index, self.intersect(ray));
        }
    }
}

/// Rays that wait, and where answers go.
pub(super) struct Queue<'a, A> {
    pub(super) scene: &'a VoxelScene<'a>,
    rays: &'a [GRay],
    /// Rays before this one are answered or under way.
    taken: usize,
    answer: A,
}

impl<A: FnMut(usize, Option<VoxelHit>)> Queue<'_, A> {
    /// The next ray that enters the cube; those before it that do not are answered.
    #[inline(always)]
    pub(super) fn next(&mut self) -> Option<(usize, Entry)> {
        while let Some(ray) = self.rays.get(self.taken) {
            let index = self.taken;
            self.taken += 1;
            match self.scene.enter(ray) {
                Some(entry) => return Some((index, entry)),
                None => (self.answer)(index, None),
            }
        }
        None
    }

    /// What the walk of `ray` found, with its distance to the cube.
    #[inline(always)]
    pub(super) fn answer(&mut self, ray: usize, found: Option<(f64, Found)>) {
        (self.answer)(ray, found.map(|(t_in, found)| self.scene.hit_of(t_in, &found)));
    }
}
