//! `CpuStage`: the G-stage on the processor: the rays of many tiles as one batch through the lanes of `voxel/simd`.
//!
//! Tried and lost: sorting the rays of a batch by kind, cell of the origin and octant of the direction (1,024 samples,
//! 4,096 rays, octree of 512): the walk takes as long as before, since neighbours of a tile read the same nodes
//! anyway, and the sort takes 5 % of a picture.

use super::{GAnswer, GKind, GRays, GStage, counted};
use crate::stats::GStats;
use crate::trace::{Answer, Pages, Ray};
use crate::voxel::{LowerHit, LowerScene, VoxelHit, VoxelScene};
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
        // Through units: what is asked and where it is, its hit, and the lists of those that wait, of missing pages.
        let lists = 3 * size_of::<usize>() + size_of::<GKind>() + 4 * size_of::<u32>();
        rays * (size_of::<Ray>() + size_of::<GAnswer>() + size_of::<Answer<Option<LowerHit>>>() + lists)
    }

    /// Answers the rays of a tile from the resident octree.
    fn ask_upper(&self, tile: &mut GRays) {
        let (rays, kinds, answers) = tile.parts_mut();
        self.voxels.each_in_batch(rays, |place, hit| answers[place] = self.upper_answer(kinds[place], hit));
    }

    fn upper_answer(&self, kind: GKind, hit: Option<VoxelHit>) -> GAnswer {
        match (hit, kind) {
            (None, _) => GAnswer::Nothing,
            (Some(_), GKind::Shadow) => GAnswer::Occluded,
            (Some(hit), GKind::Gather) => GAnswer::Surface(self.voxels.surface(&hit)),
            (Some(hit), GKind::Far) => GAnswer::Surface(self.voxels.unlit_surface(&hit)),
        }
    }

    /// Answers the rays of all tiles: shadow and gather rays through `lower`, the others from the resident octree.
    fn ask_both(&self, lower: &LowerScene<'_>, tiles: &mut [&mut GRays], mut pages: &mut dyn Pages) {
        let kinds: Vec<GKind> = tiles.iter().flat_map(|tile| tile.kinds()).copied().collect();
        let all: Vec<&Ray> = tiles.iter().flat_map(|tile| tile.rays()).collect();
        let is_far = |place: &usize| kinds[*place] == GKind::Far;
        let (far, finest): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(is_far);
        let rays = |places: &[usize]| places.iter().map(|&place| *all[place]).collect::<Vec<Ray>>();
        let mut answers = vec![GAnswer::Blocked; all.len()];
        self.voxels.each_in_batch(&rays(&far), |at, hit| {
            answers[far[at]] = self.upper_answer(GKind::Far, hit);
        });
        let mut hits = vec![Answer::Blocked; finest.len()];
        lower.intersect_batch(&rays(&finest), &mut pages, &mut hits);
        for (&place, hit) in finest.iter().zip(hits) {
            answers[place] = match (hit, kinds[place]) {
                (Answer::Blocked, _) => GAnswer::Blocked,
                (Answer::Exact(None), _) => GAnswer::Nothing,
                (Answer::Exact(Some(_)), GKind::Shadow) => GAnswer::Occluded,
                (Answer::Exact(Some(hit)), _) => match lower.surface(&hit, &mut pages) {
                    Answer::Exact(surface) => GAnswer::Surface(surface),
                    Answer::Blocked => GAnswer::Blocked,
                },
            };
        }
        let mut answers = answers.into_iter();
        for tile in tiles {
            let count = tile.rays().len();
            tile.answer(answers.by_ref().take(count));
        }
    }
}

impl GStage for CpuStage<'_> {
    fn batch_samples(&self) -> usize {
        BATCH_SAMPLES
    }

    fn answer(&self, tiles: &mut [&mut GRays], pages: &mut dyn Pages) -> GStats {
        let begin = Instant::now();
        match &self.lower {
            // A tile at a time, where it lies: larger batches are no faster.
            None => tiles.iter_mut().for_each(|tile| self.ask_upper(tile)),
            Some(lower) => self.ask_both(lower, tiles, pages),
        }
        GStats { time_ns: begin.elapsed().as_nanos() as u64, ..counted(tiles) }
    }
}
