//! Batches of rays through the octree: as many side by side as the machine has lanes for.
//!
//! ```text
//! rays -> queue -> lanes (`simd`), or one by one where the machine has neither -> answers, in any order
//! ```
//!
//! Lanes that are done take the next ray, so a batch should have many times more rays than the 32 or 64 that are
//! under way. Neighbouring rays should follow each other: they read the same nodes.
//!
//! Invariant: answers are those of [`VoxelScene::intersect`] and [`VoxelScene::occluded`], bit for bit.

#[cfg(target_arch = "x86_64")]
use super::simd::{self, UpperQueue};
use super::traverse::{VoxelHit, VoxelScene};
use crate::trace::Ray;

/// The count of rays of a batch that go side by side. All widths give the same answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketWidth {
    /// One: any machine.
    One,
    /// Eight: AVX2.
    Eight,
    /// Sixteen: AVX-512 with VPOPCNTDQ.
    Sixteen,
}

impl PacketWidth {
    /// The widths, the fastest last.
    pub const ALL: [PacketWidth; 3] = [PacketWidth::One, PacketWidth::Eight, PacketWidth::Sixteen];

    /// True where the machine has the instructions for it.
    pub fn is_available(self) -> bool {
        match self {
            PacketWidth::One => true,
            #[cfg(target_arch = "x86_64")]
            PacketWidth::Eight => simd::avx2::is_available(),
            #[cfg(target_arch = "x86_64")]
            PacketWidth::Sixteen => simd::avx512::is_available(),
            #[cfg(not(target_arch = "x86_64"))]
            PacketWidth::Eight | PacketWidth::Sixteen => false,
        }
    }

    /// The fastest width that the machine has.
    pub fn widest() -> PacketWidth {
        PacketWidth::ALL.into_iter().rfind(|width| width.is_available()).unwrap_or(PacketWidth::One)
    }
}

impl VoxelScene<'_> {
    /// [`VoxelScene::intersect`] of each ray, to its place in `hits`.
    ///
    /// # Panics
    /// When the two differ in length.
    pub fn intersect_batch(&self, rays: &[Ray], hits: &mut [Option<VoxelHit>]) {
        self.intersect_batch_with(PacketWidth::widest(), rays, hits);
    }

    /// [`VoxelScene::intersect`] of each ray, with a chosen width.
    ///
    /// # Panics
    /// When rays and hits differ in length, or the machine has no such width.
    pub fn intersect_batch_with(&self, width: PacketWidth, rays: &[Ray], hits: &mut [Option<VoxelHit>]) {
        assert_eq!(rays.len(), hits.len(), "a place for each answer");
        self.answer_batch(width, rays, |ray, hit| hits[ray] = hit);
    }

    /// Calls `answer` with the index of each ray and [`VoxelScene::intersect`] of it, in any order.
    pub(crate) fn each_in_batch(&self, rays: &[Ray], answer: impl FnMut(usize, Option<VoxelHit>)) {
        self.answer_batch(PacketWidth::widest(), rays, answer);
    }

    fn answer_batch(
        &self,
        width: PacketWidth,
        rays: &[Ray],
        mut answer: impl FnMut(usize, Option<VoxelHit>),
    ) {
        assert!(width.is_available(), "{width:?} on a machine without it");
        #[cfg(target_arch = "x86_64")]
        if simd::fits(self.octree()) {
            match width {
                PacketWidth::One => {}
                PacketWidth::Eight => return simd::avx2::walk_all(&mut UpperQueue::new(self, rays, answer)),
                PacketWidth::Sixteen => {
                    return simd::avx512::walk_all(&mut UpperQueue::new(self, rays, answer));
                }
            }
        }
        for (index, ray) in rays.iter().enumerate() {
            answer(index, self.intersect(ray));
        }
    }
}
