//! `GBatch`: what the samples of a tile ask of the G-stage, and what they are to do with the answers.
//!
//! Invariant: what a path asked for is there, answered, until its tile is handed on again.

use super::c_ray::FarRay;
use crate::g_stage::{GAnswer, GKind, GRays};
use crate::scene::method::Near;
use crate::scene::settings::RenderKeys;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Answer, Ray};
use crate::voxel::VoxelSurface;
use glam::Vec3;
use std::ops::Range;

/// Rays of one path in a batch: bounds what a batch holds, whatever `n_shadow` and `n_gather`.
pub(super) const RAYS_ASKED_MAX: usize = 8;

/// Most rays that a path asks for at a time, by what the view asks for at a surface.
pub(crate) fn rays_asked(keys: &RenderKeys) -> usize {
    let RenderKeys { integrator, near, n_shadow, n_gather, .. } = *keys;
    // Others ask for the rest of a C-ray behind the cut.
    let batches_g_rays = integrator.asks_voxels() && near == Near::Voxel;
    let rays = if batches_g_rays { n_shadow.saturating_add(n_gather) as usize } else { 1 };
    rays.clamp(1, RAYS_ASKED_MAX)
}

/// A shadow or gather ray: which of the rays asked, if anything is left of it, and the weight of what it brings.
type Entry = (Option<u32>, Vec3);

/// Rays that ask the voxels, and their answers.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// Shadow and gather rays in the order of asking.
    entries: Vec<Entry>,
    rays: GRays,
    /// Rays that may come, for vectors that do not grow past them.
    room: usize,
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
        self.make_room();
        self.rays.push(far.ray, GKind::Far)
    }

    /// Asks for a shadow or gather ray, if anything is left of it; `weight` is what it brings.
    pub(super) fn push(&mut self, ray: Option<Ray>, kind: GKind, weight: Vec3) {
        self.make_room();
        let place = ray.map(|ray| self.rays.push(ray, kind));
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

    fn make_room(&mut self) {
        if self.entries.capacity() == 0 {
            self.entries.reserve_exact(self.room);
            self.rays.reserve_exact(self.room);
        }
    }
}

impl GBatches {
    /// Batches of paths that ask for `room` rays at most, all together.
    pub(crate) fn with_room(room: usize) -> GBatches {
        let batch = || GBatch { room, ..GBatch::default() };
        GBatches { asked: batch(), answered: batch() }
    }

    /// Bytes that the batches of paths take which ask for so many rays, all together.
    pub(crate) const fn bytes(rays: usize) -> usize {
        rays * (GRays::RAY_BYTES + size_of::<Entry>())
    }

    /// The rays that are to be answered before the paths go on: those asked for since the last call.
    pub(crate) fn turn(&mut self) -> &mut GRays {
        let room = self.asked.room;
        self.answered = std::mem::replace(&mut self.asked, GBatch { room, ..GBatch::default() });
        &mut self.answered.rays
    }

    /// Forgets what has been taken.
    pub(crate) fn forget_answered(&mut self) {
        self.answered = GBatch::default();
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        *self = GBatches::with_room(self.asked.room);
    }
}
