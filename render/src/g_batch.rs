//! Rays of many samples through the voxels, traced together: what one sample asks for after a hit is too little to keep a processor busy.
//!
//! ```text
//! path at a surface -> asks: its shadow and gather rays go to the batch, the path waits
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

/// Rays that ask the voxels, and their answers. All kinds in one: the more rays side by side, the fewer lanes stand empty.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// Shadow and gather rays in the order of asking: which ray, if anything is left of it, and the weight of what it brings.
    entries: Vec<(Option<u32>, [f32; 3])>,
    /// These, and C-rays behind the cut of the footprint rule.
    rays: Vec<GRay>,
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
    surface: Surface,
    shadow: Part,
    gather: Part,
}

/// Entries of one kind.
#[derive(Clone, Debug)]
struct Part {
    entries: Range<u32>,
    /// The first ray that is still to be asked.
    next: u32,
}

impl GBatch {
    /// Asks for the rest of a C-ray. Its place.
    pub(crate) fn push_far(&mut self, far: &FarRay) -> u32 {
        self.rays.push(far.ray);
        self.rays.len() as u32 - 1
    }

    fn push(&mut self, ray: Option<GRay>, weight: [f32; 3]) {
        let place = ray.map(|ray| {
            self.rays.push(ray);
            self.rays.len() as u32 - 1
        });
        self.entries.push((place, weight));
    }

    fn entries(&self, part: &Part) -> &[(Option<u32>, [f32; 3])] {
        &self.entries[part.entries.start as usize..part.entries.end as usize]
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
        let ray = size_of::<GRay>() + size_of::<Option<VoxelHit>>();
        let entry = size_of::<(Option<u32>, [f32; 3])>() + ray;
        // Two batches, of vectors that grow by doubling.
        (4 * path_count * (ray + ASKED_MAX as usize * entry)) as u64
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
        far.hit(voxels, batch.answers[place as usize])
    }

    /// Answers what has been asked, so that it can be taken.
    pub(crate) fn answer(&self, batches: &mut GBatches) {
        let scene = self.stand_in.expect("batches have voxels");
        batches.answered.clear();
        std::mem::swap(&mut batches.asked, &mut batches.answered);
        let GBatch { rays, answers, .. } = &mut batches.answered;
        answers.resize(rays.len(), None);
        scene.voxels.intersect_batch(rays, answers);
    }

    /// Asks for the shadow rays of a surface, from number `shadow` on, and with the last of them for the gather rays, from
    /// number `gather` on.
    pub(crate) fn ask(
        &self,
        path: &mut Path,
        surface: &Surface,
        [shadow, gather]: [u32; 2],
        batch: &mut GBatch,
    ) -> Stage {
        let scene = self.voxels.expect("batches have voxels");
        let (from, next) = (batch.entries.len() as u32, self.world.n_shadow.min(shadow + ASKED_MAX));
        let left = if next == self.world.n_shadow { ASKED_MAX - (next - shadow) } else { 0 };
        for index in shadow..next {
            if let Some(query) = self.shadow_query(path, surface, index) {
                self.count_shadow_ray(path);
                let ray = scene.leave(surface, query.direction, query.distance, query.front);
                batch.push(ray, query.light);
            }
        }
        let shadow = Part { entries: from..batch.entries.len() as u32, next };
        let next = self.n_gather().min(gather + left);
        for index in gather..next {
            if let Some((direction, weight)) = self.gather_query(path, surface, index) {
                batch.push(scene.leave(surface, direction, f64::INFINITY, None), weight);
            }
        }
        let gather = Part { entries: shadow.entries.end..batch.entries.len() as u32, next };
        Stage::TakeGRays(Place { surface: *surface, shadow, gather })
    }

    /// Takes what these rays brought.
    pub(crate) fn take(&self, path: &mut Path, place: &Place, batch: &GBatch) -> Stage {
        let Place { surface, shadow, gather } = place;
        for &(ray, light) in batch.entries(shadow) {
            if ray.is_none_or(|ray| batch.answers[ray as usize].is_none()) {
                path.gain(light);
            }
        }
        if shadow.next < self.world.n_shadow {
            return Stage::Shadow { surface: *surface, index: shadow.next };
        }
        let scene = self.voxels.expect("batches have voxels");
        for &(ray, weight) in batch.entries(gather) {
            let Some(ray) = ray.map(|ray| ray as usize) else { continue };
            let found = (batch.rays[ray], batch.answers[ray]);
            let found = scene.gather_from(found, &self.world.materials, self.world.lights.sky());
            path.sample.rays.gather += found.rays;
            path.gain_indirect(mul_rgb(weight, found.radiance));
        }
        self.after_gather_ray(*surface, gather.next)
    }
}
