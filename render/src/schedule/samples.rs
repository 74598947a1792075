//! `Samples`: samples of neighbouring pixels on their way, taken together as far as the answers go.
//!
//! ```text
//! begin: rays from the camera as one
//! go on: each sample on until it asks for shadow or gather rays, ends or is blocked; the mesh answers what is asked of
//!        it, the G-stage the rest; and again
//! ```
//!
//! Invariant: a sample comes to the same bytes as alone.

use crate::g_stage::GStage;
use crate::integrate::{GBatches, Path, RayNeeds, RenderContext, Sample, SampleIntegrator, Step, Together};
use crate::trace::Tracer;

/// What takes samples: the integrator, and what answers its G-rays.
#[derive(Clone, Copy)]
pub(crate) struct SampleWork<'a> {
    pub(crate) integrator: SampleIntegrator<'a>,
    pub(crate) g_stage: &'a dyn GStage,
}

impl<'a> SampleWork<'a> {
    /// The integrator that the world of `ctx` asks for; `g_stage` has the octree, where there is one.
    pub(crate) fn new(ctx: RenderContext<'a>, g_stage: &'a dyn GStage) -> SampleWork<'a> {
        SampleWork { integrator: SampleIntegrator::new(ctx), g_stage }
    }
}

/// A sample on its way.
pub(super) struct OpenSample {
    /// Its place among those of its tile.
    pub(super) slot: u32,
    pub(super) path: Path,
    /// True when it waits for pages, in the attempt at hand.
    pub(super) is_blocked: bool,
}

impl OpenSample {
    /// A sample that begins.
    pub(super) fn new(slot: u32, path: Path) -> OpenSample {
        OpenSample { slot, path, is_blocked: false }
    }
}

/// Samples on their way, and what they ask of the G-stage.
#[derive(Default)]
pub(super) struct Samples {
    pub(super) pending: Vec<OpenSample>,
    pub(super) batches: GBatches,
    /// True when any of them waits for the G-stage.
    pub(super) asks: bool,
}

impl Samples {
    /// Samples that ask for `rays` at most each.
    pub(super) fn new(pending: Vec<OpenSample>, rays: RayNeeds) -> Samples {
        let batches = GBatches::with_room(rays.times(pending.len()));
        Samples { pending, batches, asks: false }
    }

    /// Begins an attempt: traces the rays from the camera of all samples together.
    pub(super) fn begin<T: Tracer>(
        &mut self,
        integrator: &SampleIntegrator<'_>,
        tracer: &mut T,
        together: &mut Together,
    ) {
        self.pending.iter_mut().for_each(|waiting| waiting.is_blocked = false);
        let paths = self.pending.iter_mut().map(|waiting| (&mut waiting.path, &mut waiting.is_blocked));
        integrator.meet_together(paths, tracer, together);
    }

    /// Takes samples that wait for nothing to their ends.
    pub(super) fn finish<T: Tracer>(
        &mut self,
        work: &SampleWork<'_>,
        tracer: &mut T,
        together: &mut Together,
        mut finish: impl FnMut(u32, &Sample),
    ) {
        self.begin(&work.integrator, tracer, together);
        loop {
            self.go_on(&work.integrator, tracer, &mut finish);
            if !self.asks {
                break;
            }
            self.batches.ask_stage((work.g_stage, work.integrator.g_view()), tracer);
        }
        self.batches.clear();
        assert!(self.pending.is_empty(), "a preview waits for nothing");
    }

    /// Takes all samples as far as the answers go, those of the mesh included; those that are done go to `finish` with
    /// their slots. True when any ray was answered.
    pub(super) fn go_on<T: Tracer>(
        &mut self,
        integrator: &SampleIntegrator<'_>,
        tracer: &mut T,
        mut finish: impl FnMut(u32, &Sample),
    ) -> bool {
        let mut has_advanced = false;
        loop {
            has_advanced |= self.step(integrator, tracer, &mut finish);
            if !self.asks {
                return has_advanced;
            }
            self.batches.turn(tracer);
            if self.batches.waits_for_stage() {
                return has_advanced;
            }
        }
    }

    /// Takes all samples to what they ask next.
    fn step<T: Tracer>(
        &mut self,
        integrator: &SampleIntegrator<'_>,
        tracer: &mut T,
        finish: &mut impl FnMut(u32, &Sample),
    ) -> bool {
        let Samples { pending, batches, asks } = self;
        *asks = false;
        let mut has_advanced = false;
        pending.retain_mut(|OpenSample { slot, path, is_blocked }| {
            if *is_blocked {
                return true;
            }
            let before = path.answered();
            let step = integrator.step(path, tracer, batches);
            has_advanced |= path.answered() > before;
            match step {
                Step::Blocked => *is_blocked = true,
                Step::Asks => *asks = true,
                Step::Done => {
                    has_advanced = true;
                    finish(*slot, &path.sample);
                    return false;
                }
            }
            true
        });
        batches.forget_answered();
        has_advanced
    }
}
