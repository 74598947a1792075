//! `PagedTracer`: a tracer whose pages come and go, as the loops over tiles and photons see it.

use super::Tracer;
use std::time::Duration;

/// A way to guess which pages will be wanted. Each has its own counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predictor {
    /// Pages beside those in use.
    Neighbours,
    /// Pages that the camera will see, should it go on as it went.
    Camera,
    /// Pages that the next tiles need.
    Tiles,
}

/// A tracer whose pages come and go, as work that waits for pages needs it.
pub trait PagedTracer: Tracer {
    /// Called when a tile starts or resumes: pins of the previous tile may be dropped. Until the next call, pages
    /// that were resident when a ray asked for them should stay, as far as there is room.
    fn begin_tile(&mut self);

    /// Hands the pages recorded since the last call to the loader. Returns how many are awaited.
    fn request_missing(&mut self) -> usize;

    /// Sleeps until something has arrived, or for `longest`.
    fn wait(&mut self, longest: Duration);

    /// Hands the pages recorded since the last call to the loader as guesses, in place of this predictor's earlier
    /// ones; for [`Predictor::Neighbours`], those beside the pages in use.
    fn prefetch(&mut self, _predictor: Predictor) {}

    /// Adds the pages asked for since [`PagedTracer::forget_demand`] to `pages`, a bit each; gives the count of frames,
    /// 0 where all pages have one.
    fn demand(&self, _pages: &mut Vec<u64>) -> usize {
        0
    }

    /// Begins to count the pages asked for anew; what has been asked for and not yet begun to be read is not wanted any
    /// more.
    fn forget_demand(&mut self) {}
}
