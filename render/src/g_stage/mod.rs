//! The G-stage: rays that ask the voxels, of many tiles, answered in large batches, apart from the C-rays. Paper,
//! section 5.1.
//!
//! ```text
//! C-ray workers -> hit points -> shadow, gather and far rays of a tile (`GRays`) -> bounded queue (`schedule`)
//!               -> as many tiles as make a large batch -> GStage::answer
//!               -> each tile goes on with its answers
//! ```
//!
//! Invariants: 1. an answer depends on its ray alone, not on those beside it, nor on which stage gave it, but for the
//! stated bound of a stage on another device; 2. a ray that waits for a page is answered with Blocked, and asked again.

mod cpu;

pub(crate) use cpu::{BATCH_SAMPLES, CpuStage};

use crate::stats::GStats;
use crate::trace::{Answer, Pages, Ray};
use crate::voxel::VoxelSurface;

/// What a ray asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GKind {
    /// Whether it meets anything.
    Shadow,
    /// The surface that it meets first, and the light there.
    Gather,
    /// The surface that it meets first: a C-ray behind the cut of the footprint rule.
    Far,
}

/// What a ray came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum GAnswer {
    /// A page is missing.
    Blocked,
    Nothing,
    /// Something is met; all that a shadow ray is told.
    Occluded,
    Surface(VoxelSurface),
}

impl GAnswer {
    /// True when a page is missing.
    pub(crate) fn is_blocked(&self) -> bool {
        *self == GAnswer::Blocked
    }

    /// True when the ray met nothing.
    pub(crate) fn is_nothing(&self) -> bool {
        *self == GAnswer::Nothing
    }

    /// The surface that is met, of a ray that asked for one.
    pub(crate) fn surface(&self) -> Answer<Option<VoxelSurface>> {
        match *self {
            GAnswer::Blocked => Answer::Blocked,
            GAnswer::Nothing => Answer::Exact(None),
            GAnswer::Surface(surface) => Answer::Exact(Some(surface)),
            GAnswer::Occluded => unreachable!("a shadow ray is told of no surface"),
        }
    }
}

/// The rays that the samples of a tile ask, and their answers.
#[derive(Debug, Default)]
pub(crate) struct GRays {
    rays: Vec<Ray>,
    /// What each asks.
    kinds: Vec<GKind>,
    answers: Vec<GAnswer>,
}

impl GRays {
    /// Bytes of a ray with its answer.
    pub(crate) const RAY_BYTES: usize = size_of::<Ray>() + size_of::<GKind>() + size_of::<GAnswer>();

    /// Makes room for so many rays.
    pub(crate) fn reserve_exact(&mut self, rays: usize) {
        self.rays.reserve_exact(rays);
        self.kinds.reserve_exact(rays);
    }

    /// Asks `ray`. Gives its place.
    pub(crate) fn push(&mut self, ray: Ray, kind: GKind) -> u32 {
        self.rays.push(ray);
        self.kinds.push(kind);
        self.rays.len() as u32 - 1
    }

    /// The rays that are asked.
    pub(crate) fn rays(&self) -> &[Ray] {
        &self.rays
    }

    /// What each of them asks.
    pub(crate) fn kinds(&self) -> &[GKind] {
        &self.kinds
    }

    /// A ray and what it came to.
    ///
    /// # Panics
    /// When it has not been answered.
    pub(crate) fn answered(&self, place: u32) -> (&Ray, &GAnswer) {
        (&self.rays[place as usize], &self.answers[place as usize])
    }

    /// Takes the answers, one a ray, in the order of asking.
    pub(crate) fn answer(&mut self, answers: impl Iterator<Item = GAnswer>) {
        self.answers.clear();
        self.answers.reserve_exact(self.rays.len());
        self.answers.extend(answers);
        assert_eq!(self.answers.len(), self.rays.len(), "an answer for each ray");
    }

    /// The rays, what they ask, and the places of their answers.
    pub(crate) fn parts_mut(&mut self) -> (&[Ray], &[GKind], &mut [GAnswer]) {
        self.answers.clear();
        self.answers.reserve_exact(self.rays.len());
        self.answers.resize(self.rays.len(), GAnswer::Blocked);
        (&self.rays, &self.kinds, &mut self.answers)
    }
}

/// A device that answers G-rays.
pub(crate) trait GStage: Send + Sync + std::fmt::Debug {
    /// Samples whose rays make a batch that is large enough for it.
    fn batch_samples(&self) -> usize;

    /// Answers all rays of `tiles`; `pages` hold the units of lower octrees. Gives what it counted.
    fn answer(&self, tiles: &mut [&mut GRays], pages: &mut dyn Pages) -> GStats;
}

/// Counts of a batch of such rays, but for its time.
fn counted(tiles: &[&mut GRays]) -> GStats {
    let mut stats = GStats { batches: 1, ..GStats::default() };
    for kind in tiles.iter().flat_map(|tile| tile.kinds()) {
        *match kind {
            GKind::Shadow => &mut stats.shadow,
            GKind::Gather => &mut stats.gather,
            GKind::Far => &mut stats.far,
        } += 1;
    }
    let rays = stats.shadow + stats.gather + stats.far;
    stats.bytes_in = rays * (size_of::<Ray>() + size_of::<GKind>()) as u64;
    stats.bytes_out = rays * size_of::<GAnswer>() as u64;
    stats
}
