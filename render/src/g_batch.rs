//! Rays of many samples through the voxels, traced together: what one sample asks for after a hit is too little to keep a processor busy.
//!
//! ```text
//! path at a surface -> asks: its shadow (or gather) rays go to the batch, the path waits
//!                      all paths of a tile have asked or ended -> the batch is traced -> each takes its answers, in order
//! ```
//!
//! Only rays that the resident octree answers go here: with `near = exact`, or with units, a ray may be blocked, and is asked
//! alone.
//!
//! Invariants: 1. a sample gets the same bytes as from rays asked one by one: the same numbers, added in the same order;
//! 2. a path that has asked takes its answers before the batch is cleared; 3. a path asks for at most [`ASKED_MAX`] at a time.

use crate::footprint::FarRay;
use crate::integrator::{Integrator, Path, Stage};
use crate::math::mul_rgb;
use crate::surface::Surface;
use crate::trace::Hit;
use crate::voxel::{GRay, Near, VoxelHit};
use std::ops::Range;

/// Rays of one path in a batch: bounds what a batch holds, whatever `n_shadow` and `n_gather`.
const ASKED_MAX: u32 = 16;

/// Rays that ask the voxels, and their answers.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// C-rays behind the cut of the footprint rule; without entries.
    far: Asked<Option<VoxelHit>>,
    shadow: Asked<bool>,
    gather: Asked<Option<VoxelHit>>,
}

/// Rays of one kind.
#[derive(Debug, Default)]
struct Asked<A> {
    /// In the order of asking: which ray, if anything is left of it, and the weight of what it brings.
    entries: Vec<(Option<u32>, [f32; 3])>,
    rays: Vec<GRay>,
    answers: Vec<A>,
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
    surface: Surface,
    /// The first ray that is still to be asked.
    next: u32,
    entries: Range<u32>,
}

impl<A> Asked<A> {
    fn push(&mut self, ray: Option<GRay>, weight: [f32; 3]) {
        let place = ray.map(|ray| {
            self.rays.push(ray);
            self.rays.len() as u32 - 1
        });
        self.entries.push((place, weight));
    }

    fn clear(&mut self) {
        self.entries.clear();
        self.rays.clear();
        self.answers.clear();
    }
}

impl GBatch {
    /// Asks for the rest of a C-ray. Its place.
    pub(crate) fn push_far(&mut self, far: &FarRay) -> u32 {
        self.far.rays.push(far.ray);
        self.far.rays.len() as u32 - 1
    }

    fn clear(&mut self) {
        self.far.clear();
        self.shadow.clear();
        self.gather.clear();
    }
}

impl GBatches {
    /// Bytes that the batches of so many paths take.
    pub(crate) fn bytes(path_count: usize) -> u64 {
        let entry = size_of::<(Option<u32>, [f32; 3])>() + size_of::<GRay>();
        let both = 2 * entry + size_of::<bool>() + size_of::<Option<VoxelHit>>();
        let far = size_of::<GRay>() + size_of::<Option<VoxelHit>>();
        // Two batches, of vectors that grow by doubling.
        (4 * path_count * (far + ASKED_MAX as usize * both)) as u64
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        self.asked.clear();
        self.answered.clear();
    }
}

impl Integrator<'_> {
    /// Whether any rays are asked in batches.
    pub(crate) fn has_batches(&self) -> bool {
        self.stand_in.is_some()
    }

    /// Whether shadow and gather rays are.
    pub(crate) fn batches_g_rays(&self) -> bool {
        self.voxels.is_some_and(|scene| scene.near == Near::Voxel && scene.lower.is_none())
    }

    /// Takes what a ray behind the cut has met.
    pub(crate) fn take_far(&self, far: &FarRay, place: u32, batch: &GBatch) -> Option<Hit> {
        let voxels = &self.stand_in.expect("batches have voxels").voxels;
        far.hit(voxels, batch.far.answers[place as usize])
    }

    /// Answers what has been asked, so that it can be taken.
    pub(crate) fn answer(&self, batches: &mut GBatches) {
        let scene = self.stand_in.expect("batches have voxels");
        batches.answered.clear();
        std::mem::swap(&mut batches.asked, &mut batches.answered);
        let GBatch { far, shadow, gather } = &mut batches.answered;
        far.answers.resize(far.rays.len(), None);
        scene.voxels.intersect_batch(&far.rays, &mut far.answers);
        shadow.answers.resize(shadow.rays.len(), false);
        scene.voxels.occluded_batch(&shadow.rays, &mut shadow.answers);
        gather.answers.resize(gather.rays.len(), None);
        scene.voxels.intersect_batch(&gather.rays, &mut gather.answers);
    }

    /// Asks for the shadow rays of a surface, from number `index` on.
    pub(crate) fn ask_shadow(
        &self,
        path: &mut Path,
        (surface, index): (&Surface, u32),
        batch: &mut GBatch,
    ) -> Stage {
        let scene = self.voxels.expect("batches have voxels");
        let next = self.world.n_shadow.min(index + ASKED_MAX);
        let from = batch.shadow.entries.len() as u32;
        for index in index..next {
            if let Some(query) = self.shadow_query(path, surface, index) {
                self.count_shadow_ray(path);
                let ray = scene.leave(surface, query.direction, query.distance, query.front);
                batch.shadow.push(ray, query.light);
            }
        }
        let entries = from..batch.shadow.entries.len() as u32;
        Stage::TakeShadow(Place { surface: *surface, next, entries })
    }

    /// Takes what these rays brought.
    pub(crate) fn take_shadow(&self, path: &mut Path, place: &Place, batch: &GBatch) -> Stage {
        let Asked { entries, answers, .. } = &batch.shadow;
        for &(ray, light) in &entries[place.entries.start as usize..place.entries.end as usize] {
            if ray.is_none_or(|ray| !answers[ray as usize]) {
                path.gain(light);
            }
        }
        self.after_shadow_ray(place.surface, place.next)
    }

    /// Asks for the gather rays of a surface, from number `index` on.
    pub(crate) fn ask_gather(
        &self,
        path: &mut Path,
        (surface, index): (&Surface, u32),
        batch: &mut GBatch,
    ) -> Stage {
        let scene = self.voxels.expect("batches have voxels");
        let next = self.world.n_gather.min(index + ASKED_MAX);
        let from = batch.gather.entries.len() as u32;
        for index in index..next {
            if let Some((direction, weight)) = self.gather_query(path, surface, index) {
                batch.gather.push(scene.leave(surface, direction, f64::INFINITY, None), weight);
            }
        }
        let entries = from..batch.gather.entries.len() as u32;
        Stage::TakeGather(Place { surface: *surface, next, entries })
    }

    /// Takes what these rays brought.
    pub(crate) fn take_gather(&self, path: &mut Path, place: &Place, batch: &GBatch) -> Stage {
        let scene = self.voxels.expect("batches have voxels");
        let Asked { entries, rays, answers } = &batch.gather;
        for &(ray, weight) in &entries[place.entries.start as usize..place.entries.end as usize] {
            let Some(ray) = ray.map(|ray| ray as usize) else { continue };
            let found =
                scene.gather_from((rays[ray], answers[ray]), &self.world.materials, self.world.lights.sky());
            path.sample.rays.gather += found.rays;
            path.gain_indirect(mul_rgb(weight, found.radiance));
        }
        self.after_gather_ray(place.surface, place.next)
    }
}
