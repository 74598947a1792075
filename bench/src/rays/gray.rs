//! `Gray`: ours through the voxels, those of the upper octree or the finest; in batches, and one by one.
//!
//! Invariant: all units are in memory, so no ray is blocked.

use super::contender::{ALL_THERE, Contender, RayAnswer, exact, spread};
use super::sets::{Query, RaySet, Space};
use std::time::Duration;
use trex_render::{AllResident, Answer, LowerHit, LowerScene, Ray, VoxelHit, VoxelScene};

/// Ours, through the voxels: rays learn of a leaf, not of a triangle.
pub(super) struct Gray<'a> {
    pub(super) space: Space,
    pub(super) scene: GrayScene<'a>,
    calls: GrayCalls,
    workers: Vec<GrayWorker>,
}

/// The voxels.
#[derive(Clone, Copy)]
pub(super) enum GrayScene<'a> {
    /// Those of the upper octree.
    Upper(VoxelScene<'a>),
    /// The finest ones, in units that are all there.
    Finest(LowerScene<'a>, &'a AllResident),
}

impl GrayScene<'_> {
    /// Side of a leaf, model units.
    pub(super) fn leaf_side(&self) -> f64 {
        match self {
            GrayScene::Upper(scene) => scene.leaf_side(),
            GrayScene::Finest(scene, _) => scene.leaf_side(),
        }
    }

    /// Distance off any surface at which a ray is free of that surface's own voxels, model units.
    pub(super) fn clearance(&self) -> f64 {
        match self {
            GrayScene::Upper(scene) => scene.clearance([1.0, 0.0, 0.0]),
            GrayScene::Finest(scene, _) => scene.clearance([1.0, 0.0, 0.0]),
        }
    }
}

/// How rays are handed to the voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GrayCalls {
    /// A chunk in one call.
    Batch,
    /// One by one.
    Single,
}

/// A chunk of rays, and answers.
#[derive(Clone, Default)]
struct GrayWorker {
    rays: Vec<Ray>,
    hits: Vec<Option<VoxelHit>>,
    occluded: Vec<bool>,
    finest: Vec<Answer<Option<LowerHit>>>,
}

impl<'a> Gray<'a> {
    pub(super) fn new(space: Space, scene: GrayScene<'a>, calls: GrayCalls, threads: usize) -> Gray<'a> {
        Gray { space, scene, calls, workers: vec![GrayWorker::default(); threads] }
    }
}

impl Contender for Gray<'_> {
    fn label(&self) -> &str {
        "trex"
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let Gray { space, scene, calls, .. } = *self;
        spread(&mut self.workers, set, answers, |worker, rays, answers| {
            worker.rays.clear();
            worker.rays.extend(rays.iter().map(|ray| space.to_gray(ray)));
            worker.hits.resize(rays.len(), None);
            worker.occluded.resize(rays.len(), false);
            match scene {
                GrayScene::Upper(scene) => worker.answer(&scene, (set.query, calls)),
                GrayScene::Finest(scene, pages) => worker.answer_finest((&scene, pages), (set.query, calls)),
            }
            match set.query {
                Query::Any => {
                    let pairs = answers.iter_mut().zip(&worker.occluded);
                    pairs.for_each(|(answer, occluded)| *answer = RayAnswer::from_occlusion(*occluded));
                }
                Query::Closest => {
                    let pairs = answers.iter_mut().zip(&worker.hits);
                    pairs.for_each(|(answer, hit)| *answer = RayAnswer::from_voxel(*hit));
                }
            }
        })
    }
}

impl GrayWorker {
    fn answer(&mut self, scene: &VoxelScene<'_>, how: (Query, GrayCalls)) {
        let GrayWorker { rays, hits, occluded, .. } = self;
        match how {
            (Query::Any, GrayCalls::Batch) => {
                scene.intersect_batch(rays, hits);
                occluded.iter_mut().zip(hits).for_each(|(occluded, hit)| *occluded = hit.is_some());
            }
            (Query::Closest, GrayCalls::Batch) => scene.intersect_batch(rays, hits),
            (Query::Any, GrayCalls::Single) => {
                rays.iter()
                    .zip(occluded)
                    .for_each(|(ray, occluded)| *occluded = scene.intersect(ray).is_some());
            }
            (Query::Closest, GrayCalls::Single) => {
                rays.iter().zip(hits).for_each(|(ray, hit)| *hit = scene.intersect(ray));
            }
        }
    }

    /// As `answer`, through units.
    fn answer_finest(
        &mut self,
        (scene, mut pages): (&LowerScene<'_>, &AllResident),
        how: (Query, GrayCalls),
    ) {
        let GrayWorker { rays, hits, occluded, finest } = self;
        match how {
            (Query::Any, GrayCalls::Batch) => {
                finest.resize(rays.len(), Answer::Blocked);
                scene.intersect_batch(rays, &mut pages, finest);
                let pairs = finest.iter().zip(occluded);
                pairs.for_each(|(answer, occluded)| *occluded = exact(*answer).expect(ALL_THERE).is_some());
            }
            (Query::Closest, GrayCalls::Batch) => {
                finest.resize(rays.len(), Answer::Blocked);
                scene.intersect_batch(rays, &mut pages, finest);
                let pairs = finest.iter().zip(hits);
                pairs.for_each(|(answer, hit)| *hit = exact(*answer).expect(ALL_THERE).map(|hit| hit.upper));
            }
            (Query::Any, GrayCalls::Single) => {
                rays.iter().zip(occluded).for_each(|(ray, occluded)| {
                    *occluded = exact(scene.intersect(ray, &mut pages)).expect(ALL_THERE).is_some();
                });
            }
            (Query::Closest, GrayCalls::Single) => {
                rays.iter().zip(hits).for_each(|(ray, hit)| {
                    let found = exact(scene.intersect(ray, &mut pages)).expect(ALL_THERE);
                    *hit = found.map(|hit| hit.upper);
                });
            }
        }
    }
}
