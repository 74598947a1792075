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

use super::g_ray::{GAnswer, GRay};
#[cfg(target_arch = "x86_64")]
use super::simd::{self, UpperQueue};
use super::traverse::{Entry, VoxelFound, VoxelHit, VoxelScene};
use crate::trace::Ray;
use std::borrow::Borrow;

/// Fewer rays than this go one by one: lanes have to be set up, and take as long for one ray as for all of them.
const LANE_RAYS_MIN: usize = 12;

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

    /// The width for so many rays of the G-stage. A ray alone takes no lanes: its pages are then looked up one by one,
    /// and waited for there, by whoever waits at all.
    pub(super) fn for_rays(count: usize) -> PacketWidth {
        if count < LANE_RAYS_MIN { PacketWidth::One } else { PacketWidth::widest() }
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
        let entry = |ray: usize| self.enter(&rays[ray]);
        self.walk_batch(width, (rays.len(), entry), |ray, found| {
            hits[ray] = found.map(|(t_in, found)| self.hit_of(t_in, &found));
        });
    }

    /// Calls `answer` with the index of each ray and [`VoxelScene::answer`] of it, in any order.
    pub(crate) fn answer_batch<R: Borrow<GRay>>(&self, rays: &[R], mut answer: impl FnMut(usize, GAnswer)) {
        let width = PacketWidth::for_rays(rays.len());
        self.walk_batch(width, (rays.len(), |ray: usize| Entry::of(rays[ray].borrow())), |ray, found| {
            let found = found.map(|(_, found)| found);
            answer(ray, self.answer_of(rays[ray].borrow(), found.as_ref()));
        });
    }

    /// Walks so many rays, which `entry` gives by index; calls `answer` with the index of each, its distance to the
    /// cube and what it found.
    pub(super) fn walk_batch(
        &self,
        width: PacketWidth,
        (count, entry): (usize, impl Fn(usize) -> Option<Entry>),
        mut answer: impl FnMut(usize, Option<(f64, VoxelFound)>),
    ) {
        assert!(width.is_available(), "{width:?} on a machine without it");
        #[cfg(target_arch = "x86_64")]
        if count > 0 && simd::fits(self.octree()) {
            let queue = UpperQueue::new(self, (count, &entry), &mut answer);
            match width {
                PacketWidth::One => {}
                PacketWidth::Eight => return simd::avx2::walk_all(&mut { queue }),
                PacketWidth::Sixteen => return simd::avx512::walk_all(&mut { queue }),
            }
        }
        for ray in 0..count {
            let entry = entry(ray);
            answer(ray, entry.and_then(|entry| Some((entry.t_in, self.walk(&entry, &mut ())?))));
        }
    }
}
