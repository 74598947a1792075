//! `Clock`: what `--time-limit` says of a picture.
//!
//! Invariant: without a limit only an interrupt stops it.

use crate::context::Context;
use std::time::{Duration, Instant};
use trex_store::StopSignal;

/// When the work began, and when it is to stop.
pub struct Clock<'a> {
    pub start: Instant,
    deadline: Option<Instant>,
    /// Due when it is to stop.
    pub stop: StopSignal,
    pub ctx: &'a Context,
}

impl Clock<'_> {
    /// From now on, for so long.
    pub fn start(time_limit: Option<Duration>, ctx: &Context) -> Clock<'_> {
        let start = Instant::now();
        let deadline = time_limit.and_then(|limit| start.checked_add(limit));
        Clock { start, deadline, stop: StopSignal::new(&ctx.interrupt, deadline), ctx }
    }

    pub fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    pub fn stops(&self) -> bool {
        self.stop.is_due()
    }

    /// When a share of the time that is left has passed.
    pub fn after(&self, share: f64) -> Option<Instant> {
        let now = Instant::now();
        self.deadline.map(|deadline| now + deadline.saturating_duration_since(now).mul_f64(share))
    }
}
