//! `GBatch`: what the samples of a tile ask of the G-stage, and what they are to do with the answers.
//!
//! Invariant: what a path asked for is there, answered, until its tile is handed on again.

use super::c_ray::FarRay;
use crate::g_stage::{GAnswer, GKind, GRay, GRays};
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Answer, Ray};
use crate::voxel::VoxelSurface;
use glam::Vec3;
use std::ops::Range;

/// Rays of one path in a batch: bounds what a batch holds, whatever `n_shadow` and `n_gather`.
pub(crate) const RAYS_ASKED_MAX: usize = 8;

/// A shadow or gather ray: which of the rays asked, if anything is left of it, and the weight of what it brings.
type Entry = (Option<u32>, Vec3);

/// Rays that ask the voxels, and their answers.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// Shadow and gather rays in the order of asking.
    entries: Vec<Entry>,
    rays: GRays,
}

/// The batch that is asked, and the one before, whose answers are taken meanwhile.
#[derive(Debug, Default)]
pub(crate) struct GBatches {
    pub(super) asked: GBatch,
    pub(super) answered: GBatch,
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
    /// The rays that were asked, by number at the surface; the end is the first that is still to be asked.
    pub(super) rays: Range<u32>,
}

impl GBatch {
    /// Asks for the rest of a C-ray. Its place.
    pub(super) fn push_far(&mut self, far: &FarRay) -> u32 {
        self.rays.push(GRay { ray: far.ray, kind: GKind::Far })
    }

    /// Asks for a shadow or gather ray, if anything is left of it; `weight` is what it brings.
    pub(super) fn push(&mut self, ray: Option<Ray>, kind: GKind, weight: Vec3) {
        let place = ray.map(|ray| self.rays.push(GRay { ray, kind }));
        self.entries.push((place, weight));
    }

    /// The rays of a part, with their weights.
    pub(super) fn entries(&self, part: &Part) -> &[Entry] {
        &self.entries[part.entries.start as usize..part.entries.end as usize]
    }

    /// Entries up to now.
    pub(super) fn entry_count(&self) -> u32 {
        self.entries.len() as u32
    }

    /// The surface that a C-ray behind the cut has met: in the resident octree, so it is never blocked.
    pub(super) fn far_answer(&self, place: u32) -> Option<VoxelSurface> {
        match self.answer(place).1.surface() {
            Answer::Exact(found) => found,
            Answer::Blocked => unreachable!("the upper octree is resident"),
        }
    }

    /// A ray that was asked, and what it met.
    pub(super) fn answer(&self, place: u32) -> (&Ray, &GAnswer) {
        self.rays.answered(place)
    }

    fn clear(&mut self) {
        self.entries.clear();
        self.rays.clear();
    }
}

impl GBatches {
    /// Bytes that the batches of so many paths take.
    pub(crate) const fn bytes(path_count: usize) -> usize {
        let asked = path_count * RAYS_ASKED_MAX;
        // Of a vector that grows by doubling. While answers are taken, hardly anything is asked again.
        GRays::bytes(asked) + 2 * asked * size_of::<Entry>()
    }

    /// The rays that are to be answered before the paths go on: those asked for since the last call.
    pub(crate) fn turn(&mut self) -> &mut GRays {
        self.answered.clear();
        std::mem::swap(&mut self.asked, &mut self.answered);
        &mut self.answered.rays
    }

    /// True when anything has been asked since the last turn.
    pub(crate) fn asks(&self) -> bool {
        !self.asked.rays.rays().is_empty() || !self.asked.entries.is_empty()
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        self.asked.clear();
        self.answered.clear();
    }
}
