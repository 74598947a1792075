//! `CpuStage`: the G-stage on the processor: the rays of many tiles as one batch through the lanes of `voxel/simd`.
//!
//! Tried and lost: sorting the rays of a batch by kind, cell of the origin and octant of the direction (1,024 samples,
//! 4,096 rays, octree of 512): the walk takes as long as before, since neighbours of a tile read the same nodes
//! anyway, and the sort takes 5 % of a picture.

use super::{GAnswer, GKind, GRay, GRays, GStage, counted};
use crate::stats::GStats;
use crate::trace::{Answer, Pages, Ray};
use crate::voxel::{LowerHit, LowerScene, VoxelScene};
use std::time::Instant;

/// Samples of a batch: with two shadow and two gather rays each, 32 times as many rays as lanes have under way. Twice
/// as many are no faster, and take memory from pages.
pub(crate) const BATCH_SAMPLES: usize = 512;

/// The processor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CpuStage<'a> {
    voxels: VoxelScene<'a>,
    /// The octree with its units, for shadow and gather rays.
    lower: Option<LowerScene<'a>>,
}

impl<'a> CpuStage<'a> {
    /// The stage that asks `voxels`, and where there are units `lower`.
    pub(crate) fn new(voxels: VoxelScene<'a>, lower: Option<LowerScene<'a>>) -> CpuStage<'a> {
        CpuStage { voxels, lower }
    }

    /// Bytes of a batch in work with so many rays, beside those of the tiles.
    pub(crate) const fn bytes(rays: usize) -> usize {
        let walk = size_of::<Answer<Option<LowerHit>>>() + 2 * size_of::<u32>();
        rays * (size_of::<Ray>() + size_of::<u32>() + size_of::<GAnswer>() + walk)
    }

    /// Answers rays that the resident octree answers.
    fn ask_upper(&self, (all, places): (&[&GRay], &[u32]), answers: &mut [GAnswer]) {
        let rays: Vec<Ray> = places.iter().map(|&place| all[place as usize].ray).collect();
        self.voxels.each_in_batch(&rays, |index, hit| {
            let place = places[index] as usize;
            answers[place] = match (hit, all[place].kind) {
                (None, _) => GAnswer::Nothing,
                (Some(_), GKind::Shadow) => GAnswer::Occluded,
                (Some(hit), GKind::Gather | GKind::Far) => GAnswer::Surface(self.voxels.surface(&hit)),
            };
        });
    }

    /// Answers rays that go through units.
    fn ask_units(
        &self,
        lower: &LowerScene<'_>,
        (all, places): (&[&GRay], &[u32]),
        mut pages: &mut dyn Pages,
        answers: &mut [GAnswer],
    ) {
        let rays: Vec<Ray> = places.iter().map(|&place| all[place as usize].ray).collect();
        let mut hits = vec![Answer::Blocked; rays.len()];
        lower.intersect_batch(&rays, &mut pages, &mut hits);
        for (&place, hit) in places.iter().zip(hits) {
            answers[place as usize] = match (hit, all[place as usize].kind) {
                (Answer::Blocked, _) => GAnswer::Blocked,
                (Answer::Exact(None), _) => GAnswer::Nothing,
                (Answer::Exact(Some(_)), GKind::Shadow) => GAnswer::Occluded,
                (Answer::Exact(Some(hit)), _) => match lower.surface(&hit, &mut pages) {
                    Answer::Exact(surface) => GAnswer::Surface(surface),
                    Answer::Blocked => GAnswer::Blocked,
                },
            };
        }
    }
}

impl GStage for CpuStage<'_> {
    fn batch_samples(&self) -> usize {
        BATCH_SAMPLES
    }

    fn answer(&self, tiles: &mut [&mut GRays], pages: &mut dyn Pages) -> GStats {
        let begin = Instant::now();
        let all: Vec<&GRay> = tiles.iter().flat_map(|tile| tile.rays()).collect();
        let mut answers = vec![GAnswer::Nothing; all.len()];
        let is_upper = |place: &u32| self.lower.is_none() || all[*place as usize].kind == GKind::Far;
        let (upper, finest): (Vec<u32>, Vec<u32>) = (0..all.len() as u32).partition(is_upper);
        self.ask_upper((&all, &upper), &mut answers);
        if let Some(lower) = &self.lower {
            self.ask_units(lower, (&all, &finest), pages, &mut answers);
        }
        let mut stats = counted(&all);
        let mut answers = answers.into_iter();
        for tile in tiles {
            let count = tile.rays().len();
            tile.answer(answers.by_ref().take(count));
        }
        stats.time_ns = begin.elapsed().as_nanos() as u64;
        stats
    }
}
