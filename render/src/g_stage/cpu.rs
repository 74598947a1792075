//! `CpuStage`: the G-stage on the processor: the rays of many tiles as one batch through the lanes of `voxel/simd`.
//!
//! Tried and lost: sorting the rays of a batch by kind, cell of the origin and octant of the direction (1,024 samples,
//! 4,096 rays, octree of 512): the walk takes as long as before, since neighbours of a tile read the same nodes
//! anyway, and the sort takes 5 % of a picture.

use super::{GAnswer, GKind, GRays, GStage, counted};
use crate::stats::GStats;
use crate::trace::{Pages, Ray};
use crate::voxel::VoxelScene;
use std::time::Instant;

/// Samples of a batch: with two shadow and two gather rays each, 32 times as many rays as lanes have under way. Twice
/// as many are no faster, and take memory from pages.
pub(crate) const BATCH_SAMPLES: usize = 512;

/// The processor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CpuStage<'a> {
    voxels: VoxelScene<'a>,
}

impl<'a> CpuStage<'a> {
    /// The stage that asks `voxels`.
    pub(crate) fn new(voxels: VoxelScene<'a>) -> CpuStage<'a> {
        CpuStage { voxels }
    }

    /// Bytes of a batch in work with so many rays, beside those of the tiles.
    pub(crate) const fn bytes(rays: usize) -> usize {
        rays * (size_of::<Ray>() + size_of::<GKind>() + size_of::<GAnswer>())
    }
}

impl GStage for CpuStage<'_> {
    fn batch_samples(&self) -> usize {
        BATCH_SAMPLES
    }

    fn answer(&self, tiles: &mut [&mut GRays], _pages: &mut dyn Pages) -> GStats {
        let begin = Instant::now();
        let asked = || tiles.iter().flat_map(|tile| tile.rays());
        let rays: Vec<Ray> = asked().map(|ray| ray.ray).collect();
        let kinds: Vec<GKind> = asked().map(|ray| ray.kind).collect();
        let mut answers = vec![GAnswer::Nothing; rays.len()];
        self.voxels.each_in_batch(&rays, |place, hit| {
            answers[place] = match (hit, kinds[place]) {
                (None, _) => GAnswer::Nothing,
                (Some(_), GKind::Shadow) => GAnswer::Occluded,
                (Some(hit), GKind::Gather | GKind::Far) => GAnswer::Surface(self.voxels.surface(&hit)),
            };
        });
        let mut stats = counted(&kinds);
        let mut answers = answers.into_iter();
        for tile in tiles {
            let count = tile.rays().len();
            tile.answer(answers.by_ref().take(count));
        }
        stats.time_ns = begin.elapsed().as_nanos() as u64;
        stats
    }
}
