//! The G-stage: rays that ask the voxels, of many tiles, answered in large batches, apart from the C-rays. Paper,
//! section 5.1. This is the seam for a second device.
//!
//! ```text
//! C-ray workers -> hit points -> shadow, gather and far rays of a tile (`GRays`) -> bounded queue (`schedule`)
//!   photons ------------------+  -> as many tiles as make a large batch (`GCall`) -> GStage::submit
//!   a sample alone -----------+       -> Answered: at once, by the worker itself
//!                                     -> UnderWay: the worker goes on with other tiles, and asks again (`GTurn`)
//! ```
//!
//! Invariants: 1. an answer depends on its ray, the octree and the [`GView`] alone, not on the rays beside it, nor on
//! which stage gave it, but for the stated bound of a stage on another device; 2. each call comes back, once, with
//! all of its rays answered, in any order among calls; 3. a ray that needs a page which is missing is answered with
//! [`GAnswer::BLOCKED`], and asked again.

mod cpu;

pub use cpu::CpuStage;

use crate::stats::GStats;
use crate::trace::Pages;
use crate::voxel::{GAnswer, GKind, GRay, MissingUnits, Occluders, Voxels};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};
use trex_store::Result;

/// What is wrong with a stage that breaks invariant 2.
const DROPPED: &str = "the G-stage dropped a call without its answers";

/// A device that answers G-rays. A session has one for its whole life: see [`crate::SessionSetup`].
pub trait GStage: Send + Sync + std::fmt::Debug {
    /// Takes the octree that all rays are asked of from now on; the one before, if any, is not asked again. A session
    /// gives it once, when it begins; light and materials are no part of it. The units below it come and go: they are
    /// looked up in the pages that are lent with each call.
    ///
    /// # Errors
    /// Those of the device, such as [`trex_store::Code::MemoryLimit`] when it has no room for the octree.
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()>;

    /// What it asks of who calls it.
    fn needs(&self) -> GNeeds;

    /// Answers the rays of `call`, now or later. Called by many threads at a time; it may block for as long as a batch
    /// takes. `pages` are those of the worker that calls, lent until this returns: units are looked up there, and
    /// [`Pages::want`] is told of each ray that one of them blocks.
    ///
    /// A ray that comes alone is to be answered with room for one page: workers wait for pages so when room is scarce.
    ///
    /// # Panics
    /// Before the octree was set.
    fn submit(&self, call: GCall, pages: &mut dyn Pages) -> GTurn;
}

/// What a stage asks of who calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GNeeds {
    /// Rays of a batch that is large enough; fewer come where there are no more.
    pub batch_rays: usize,
    /// Bytes of memory that it takes for each ray of a call, beside the arrays of the call.
    pub ray_bytes: usize,
    /// Calls that a worker should have under way, at least 1; more than 1 only for a stage that answers later.
    pub calls: usize,
    /// Photons that a worker sends side by side, a ray of each in a call, at least 1: as many as it answers within some
    /// milliseconds, the most that a deadline is passed by.
    pub photons: usize,
}

/// What rays below the upper octree find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GUnits {
    /// Nothing is below: leaves of the upper octree answer all rays.
    None,
    /// Units, where the file has any; this becomes of rays that meet one which is missing.
    On(MissingUnits),
}

/// How the rays of a call see the octree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GView {
    /// The form of leaves.
    pub occluders: Occluders,
    /// What is below the upper octree.
    pub units: GUnits,
}

/// The rays that were asked together, such as those of a tile, and their answers.
#[derive(Debug, Default)]
pub struct GRays {
    rays: Vec<GRay>,
    answers: Vec<GAnswer>,
}

/// Rays of several tiles, handed to a stage and back.
#[derive(Debug)]
pub struct GCall {
    /// How all of them see the octree.
    pub view: GView,
    /// The rays, a part for each tile.
    pub parts: Vec<GRays>,
}

/// What is left to do for a call that a stage has answered, in the thread that waits for it: it gives the call.
pub type GEnd = Box<dyn FnOnce() -> GCall + Send>;

/// The reply of a stage to a call.
#[derive(Debug)]
pub enum GTurn {
    /// All rays are answered.
    Answered(GCall),
    /// The stage is at work; the end of the call arrives here once all of its rays are answered.
    UnderWay(Receiver<GEnd>),
}

impl GRays {
    /// Bytes of a ray with its answer.
    pub(crate) const RAY_BYTES: usize = size_of::<GRay>() + size_of::<GAnswer>();

    /// Makes room for so many rays.
    pub fn reserve_exact(&mut self, rays: usize) {
        self.rays.reserve_exact(rays);
    }

    /// Asks `ray`. Gives its place.
    pub fn push(&mut self, ray: GRay) -> u32 {
        self.rays.push(ray);
        self.rays.len() as u32 - 1
    }

    /// The rays that are asked.
    pub fn rays(&self) -> &[GRay] {
        &self.rays
    }

    /// The answers, one a ray; none before a stage has answered.
    pub fn answers(&self) -> &[GAnswer] {
        &self.answers
    }

    /// The rays, and the places of their answers, all of them blocked: what a stage writes to.
    pub fn parts_mut(&mut self) -> (&[GRay], &mut [GAnswer]) {
        self.answers.clear();
        self.answers.reserve_exact(self.rays.len());
        self.answers.resize(self.rays.len(), GAnswer::bare(GAnswer::BLOCKED));
        (&self.rays, &mut self.answers)
    }

    /// Puts `answer` in the place of ray `place`, whose answer [`GRays::parts_mut`] has made room for.
    ///
    /// # Panics
    /// Where there is no such ray, or no room was made.
    pub fn set_answer(&mut self, place: usize, answer: GAnswer) {
        self.answers[place] = answer;
    }

    /// Has the ray in `place` pass the octree by: nobody needs its answer any more.
    pub(crate) fn pass_by(&mut self, place: u32) {
        self.rays[place as usize].t_max = -1.0;
    }

    /// Forgets the rays from place `count` on, which were not answered yet.
    pub(crate) fn truncate(&mut self, count: usize) {
        self.rays.truncate(count);
    }

    /// Forgets rays and answers, and keeps their room.
    pub(crate) fn clear(&mut self) {
        self.rays.clear();
        self.answers.clear();
    }
}

impl GCall {
    /// Counts of the call, but for its time.
    pub(crate) fn counted(&self) -> GStats {
        let mut stats = GStats { batches: 1, ..GStats::default() };
        for ray in self.parts.iter().flat_map(|part| part.rays()) {
            *match ray.kind() {
                GKind::Shadow => &mut stats.shadow,
                GKind::Gather => &mut stats.gather,
                GKind::Far => &mut stats.far,
                // Who sends photons counts their rays.
                GKind::Photon => continue,
            } += 1;
        }
        let rays = stats.shadow + stats.gather + stats.far;
        stats.bytes_in = rays * size_of::<GRay>() as u64;
        stats.bytes_out = rays * size_of::<GAnswer>() as u64;
        stats
    }
}

impl GTurn {
    /// True once the call is answered.
    ///
    /// # Panics
    /// When the stage has dropped the call.
    pub(crate) fn is_answered(&mut self) -> bool {
        let GTurn::UnderWay(answers) = self else { return true };
        match answers.try_recv() {
            Ok(end) => *self = GTurn::Answered(end()),
            Err(TryRecvError::Empty) => return false,
            Err(TryRecvError::Disconnected) => panic!("{DROPPED}"),
        }
        true
    }

    /// The answered call, waited for.
    ///
    /// # Panics
    /// When the stage has dropped the call.
    pub fn wait(self) -> GCall {
        match self {
            GTurn::Answered(call) => call,
            GTurn::UnderWay(answers) => answers.recv().expect(DROPPED)(),
        }
    }
}
