//! Batches of rays through the octree: as many at once as the machine has lanes for.
//!
//! ```text
//! rays -> queue -> lanes (`avx2`), or one by one where the machine has no AVX2 -> answers, in any order
//! ```
//!
//! Lanes that are done take the next ray, so a batch should have many times more rays than the 32 that are under way.
//! Neighbouring rays should follow each other: they read the same nodes.
//!
//! Invariant: answers are those of [`VoxelScene::intersect`] and [`VoxelScene::occluded`], bit for bit.

#[cfg(target_arch = "x86_64")]
use super::avx2;
use super::traverse::{Entry, Found, GRay, VoxelHit, VoxelScene};

impl VoxelScene<'_> {
    /// [`VoxelScene::intersect`] of each ray, to its place in `hits`.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn intersect_batch(&self, rays: &[GRay], hits: &mut [Option<VoxelHit>]) {
        assert_eq!(rays.len(), hits.len(), "a place for each answer");
        self.answer_batch(rays, |ray, hit| hits[ray] = hit);
    }

    /// [`VoxelScene::occluded`] of each ray, to its place in `occluded`.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn occluded_batch(&self, rays: &[GRay], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len(), "a place for each answer");
        self.answer_batch(rays, |ray, hit| occluded[ray] = hit.is_some());
    }

    fn answer_batch(&self, rays: &[GRay], mut answer: impl FnMut(usize, Option<VoxelHit>)) {
        #[cfg(target_arch = "x86_64")]
        if avx2::is_available() && avx2::fits(self.octree()) {
            return avx2::walk_all(&mut Queue { scene: self, rays, taken: 0, answer });
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
