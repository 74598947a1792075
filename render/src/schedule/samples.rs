//! `Samples`: samples of neighbouring pixels, taken together as far as the answers go.
//!
//! ```text
//! rays from the camera as one -> each sample on until it asks for G-rays, ends or is blocked
//!                             -> the G-rays of all in one batch -> each sample on ...
//! ```
//!
//! Invariant: a sample comes to the same bytes as alone.

use crate::integrate::{GBatches, Path, Sample, SampleIntegrator, Step, Together};
use crate::trace::Tracer;

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

/// Room of a worker for what samples ask together.
#[derive(Default)]
pub(super) struct Samples {
    together: Together,
    batches: GBatches,
}

impl Samples {
    /// Bytes that so many samples take at most.
    pub(super) fn bytes(count: usize) -> u64 {
        GBatches::bytes(count) + Together::bytes(count)
    }

    /// Takes all of `pending` as far as the answers go; those that are done go to `finish` with their slots. True when
    /// any ray was answered.
    pub(super) fn ask<T: Tracer>(
        &mut self,
        integrator: &SampleIntegrator<'_>,
        pending: &mut Vec<Pending>,
        tracer: &mut T,
        mut finish: impl FnMut(u32, &Sample),
    ) -> bool {
        let Samples { together, batches } = self;
        let paths = pending.iter_mut().map(|waiting| (&mut waiting.path, &mut waiting.is_blocked));
        integrator.meet_together(paths, tracer, together);
        let mut has_advanced = false;
        loop {
            let mut asks = false;
            pending.retain_mut(|Pending { slot, path, is_blocked }| {
                if *is_blocked {
                    return true;
                }
                let before = path.answered();
                let step = integrator.step(path, tracer, integrator.has_batches().then_some(&mut *batches));
                has_advanced |= path.answered() > before;
                match step {
                    Step::Blocked => *is_blocked = true,
                    Step::Asks => asks = true,
                    Step::Done(sample) => {
                        finish(*slot, &sample);
                        return false;
                    }
                }
                true
            });
            if !asks {
                break;
            }
            integrator.answer(batches);
        }
        batches.clear();
        for waiting in pending {
            waiting.is_blocked = false;
        }
        has_advanced
    }
}
