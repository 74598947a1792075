//! `GBatch`: rays of many samples that ask the voxels together, and their answers.
//!
//! Invariant: what a path asked for is there, answered, until the batch is cleared.

use super::c_ray::FarRay;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;
use crate::voxel::{VoxelHit, VoxelScene};
use glam::Vec3;
use std::ops::Range;

/// Rays of one path in a batch: bounds what a batch holds, whatever `n_shadow` and `n_gather`.
pub(super) const ASKED_MAX: u32 = 16;

/// Rays that ask the voxels, and their answers. All kinds in one: the more rays side by side, the fewer lanes stand
/// empty.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// Shadow and gather rays in the order of asking: which ray, if anything is left of it, and the weight of what it
    /// brings.
    entries: Vec<(Option<u32>, Vec3)>,
    /// Shadow and gather rays, and C-rays behind the cut of the footprint rule.
    rays: Vec<Ray>,
    answers: Vec<Option<VoxelHit>>,
}

/// The batch that is asked, and the one before, whose answers are taken meanwhile.
#[derive(Debug, Default)]
pub(crate) struct GBatches {
    pub(crate) asked: GBatch,
    pub(crate) answered: GBatch,
}

/// The part of a batch that a path has asked for.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub(super) surface: SurfaceInteraction,
    pub(super) shadow: Part,
    pub(super) gather: Part,
}

/// Entries of one kind.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    pub(super) entries: Range<u32>,
    /// The first ray that is still to be asked.
    pub(super) next: u32,
}

impl GBatch {
    /// Asks for the rest of a C-ray. Its place.
    pub(super) fn push_far(&mut self, far: &FarRay) -> u32 {
        self.rays.push(far.ray);
        self.rays.len() as u32 - 1
    }

    /// Asks for a shadow or gather ray, if anything is left of it; `weight` is what it brings.
    pub(super) fn push(&mut self, ray: Option<Ray>, weight: Vec3) {
        let place = ray.map(|ray| {
            self.rays.push(ray);
            self.rays.len() as u32 - 1
        });
        self.entries.push((place, weight));
    }

    /// The rays of a part, with their weights.
    pub(super) fn entries(&self, part: &Part) -> &[(Option<u32>, Vec3)] {
        &self.entries[part.entries.start as usize..part.entries.end as usize]
    }

    /// Entries up to now.
    pub(super) fn entry_count(&self) -> u32 {
        self.entries.len() as u32
    }

    /// The voxel that a C-ray behind the cut has met.
    pub(super) fn far_answer(&self, place: u32) -> Option<VoxelHit> {
        self.answers[place as usize]
    }

    /// A ray that was asked, and what it met.
    pub(super) fn answer(&self, ray: u32) -> (Ray, Option<VoxelHit>) {
        (self.rays[ray as usize], self.answers[ray as usize])
    }

    fn clear(&mut self) {
        self.entries.clear();
        self.rays.clear();
        self.answers.clear();
    }
}

impl GBatches {
    /// Bytes that the batches of so many paths take.
    pub(crate) fn bytes(path_count: usize) -> u64 {
        let ray = size_of::<Ray>() + size_of::<Option<VoxelHit>>();
        let entry = size_of::<(Option<u32>, Vec3)>() + ray;
        // Two batches, of vectors that grow by doubling.
        (4 * path_count * (ray + ASKED_MAX as usize * entry)) as u64
    }

    /// Answers what has been asked, so that it can be taken.
    pub(crate) fn trace(&mut self, voxels: &VoxelScene<'_>) {
        self.answered.clear();
        std::mem::swap(&mut self.asked, &mut self.answered);
        let GBatch { rays, answers, .. } = &mut self.answered;
        answers.resize(rays.len(), None);
        voxels.intersect_batch(rays, answers);
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        self.asked.clear();
        self.answered.clear();
    }
}
