//! `Samples`: samples of neighbouring pixels on their way, taken together as far as the answers go.
//!
//! ```text
//! begin: rays from the camera as one
//! go on: each sample on until it asks for G-rays, ends or is blocked; the G-stage answers; and again
//! ```
//!
//! Invariant: a sample comes to the same bytes as alone.

use crate::g_stage::GStage;
use crate::integrate::{GBatches, Path, RenderContext, Sample, SampleIntegrator, Step, Together};
use crate::trace::Tracer;
use std::sync::Arc;

/// What takes samples: the integrator, and what answers its G-rays.
#[derive(Clone)]
pub(crate) struct SampleWork<'a> {
    pub(crate) integrator: SampleIntegrator<'a>,
    /// `None` where no ray asks voxels.
    pub(crate) g_stage: Option<Arc<dyn GStage + 'a>>,
}

impl<'a> SampleWork<'a> {
    /// The integrator that the world of `ctx` asks for, its G-rays answered on the processor.
    pub(crate) fn on_cpu(ctx: RenderContext<'a>) -> SampleWork<'a> {
        let integrator = SampleIntegrator::new(ctx);
        SampleWork { integrator, g_stage: integrator.cpu_stage().map(|stage| Arc::new(stage) as _) }
    }
}

/// A sample on its way.
pub(super) struct Pending {
    /// Its place among those of its tile.
    pub(super) slot: u32,
    pub(super) path: Path,
    /// True when it waits for pages, in the attempt at hand.
    pub(super) is_blocked: bool,
}

impl Pending {
    /// A sample that begins.
    pub(super) fn new(slot: u32, path: Path) -> Pending {
        Pending { slot, path, is_blocked: false }
    }
}

/// Samples on their way, and what they ask of the G-stage.
#[derive(Default)]
pub(super) struct Samples {
    pub(super) pending: Vec<Pending>,
    pub(super) batches: GBatches,
    /// True when any of them waits for the G-stage.
    pub(super) asks: bool,
}

impl Samples {
    /// Samples that ask for `rays` at most, all together.
    pub(super) fn new(pending: Vec<Pending>, rays: usize) -> Samples {
        Samples { pending, batches: GBatches::with_room(rays), asks: false }
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
            let Some(g_stage) = work.g_stage.as_ref().filter(|_| self.asks) else { break };
            g_stage.answer(&mut [self.batches.turn()], tracer.lend_pages());
        }
        self.batches.clear();
        assert!(self.pending.is_empty(), "a preview waits for nothing");
    }

    /// Takes all samples as far as the answers go; those that are done go to `finish` with their slots. True when any
    /// ray was answered.
    pub(super) fn go_on<T: Tracer>(
        &mut self,
        integrator: &SampleIntegrator<'_>,
        tracer: &mut T,
        mut finish: impl FnMut(u32, &Sample),
    ) -> bool {
        let Samples { pending, batches, asks } = self;
        *asks = false;
        let mut has_advanced = false;
        pending.retain_mut(|Pending { slot, path, is_blocked }| {
            if *is_blocked {
                return true;
            }
            let before = path.answered();
            let step = integrator.step(path, tracer, integrator.has_batches().then_some(&mut *batches));
            has_advanced |= path.answered() > before;
            match step {
                Step::Blocked => *is_blocked = true,
                Step::Asks => *asks = true,
                Step::Done(sample) => {
                    has_advanced = true;
                    finish(*slot, &sample);
                    return false;
                }
            }
            true
        });
        batches.forget_answered();
        has_advanced
    }
}
