//! `PagedTracer`: a tracer whose pages come and go, as the loops over tiles and photons see it.

use super::{OpenParts, Parts, Tracer};
use std::sync::Arc;
use std::time::Duration;
use trex_store::StopSignal;

/// A tracer whose pages come and go, as work that waits for pages needs it.
pub trait PagedTracer: Tracer {
    /// Called when a tile starts or resumes: pins of the previous tile may be dropped. Until the next call, pages
    /// that were resident when a ray asked for them should stay, as far as there is room.
    fn begin_tile(&mut self);

    /// Hands the worker's want-list to the loader: see [`Pages::want`](super::Pages::want). Returns how many are
    /// awaited.
    fn request_missing(&mut self) -> usize;

    /// The frames of this worker where pages come from afar: most of the time is the way, so that as many are to be
    /// asked for at once as there is room for. `None` where pages are near.
    fn frames_from_afar(&self) -> Option<usize> {
        None
    }

    /// From now on, or no more, a page that is missing is waited for while the ray that asks is on its way, for a
    /// second at most.
    fn set_patient(&mut self, _is_patient: bool) {}

    /// From now on, or no more, rays are of a view to come: pages that they miss are asked for behind all others, by
    /// [`PagedTracer::request_missing`], and count for nothing.
    fn look_ahead(&mut self, _looks_ahead: bool) {}

    /// No page is asked for ahead any more, with the next request.
    fn forget_ahead(&mut self) {}

    /// True while a page that rays of a view to come have missed may still come.
    fn awaits_ahead(&self) -> bool {
        false
    }

    /// From now on, rays that look up a page once `stop` is due are Blocked: a single ray may cross millions of
    /// triangles. Whoever asks is to end on the same signal, or asks for ever.
    fn stop_by(&mut self, _stop: &StopSignal) {}

    /// From now on, rays meet these parts of the model alone. A tracer that knows no parts shows all.
    fn show(&mut self, _parts: &Arc<Parts>) {}

    /// The open parts that rays have met on sections since [`PagedTracer::show`].
    fn open_parts(&self) -> OpenParts {
        OpenParts::default()
    }

    /// Sleeps until something has arrived, or for `longest`.
    fn wait(&mut self, longest: Duration);

    /// Adds the pages asked for since [`PagedTracer::forget_demand`] to `pages`, a bit each; gives how many find room
    /// together, 0 where all do.
    fn demand(&self, _pages: &mut Vec<u64>) -> usize {
        0
    }

    /// Begins to count the pages asked for anew; what has been asked for and not yet begun to be read is not wanted any
    /// more, but what is asked for ahead.
    fn forget_demand(&mut self) {}
}
