//! `Motion`: how the camera moves from event to event, and where it will be.

use crate::scene::camera::Projection;
use std::time::{Duration, Instant};

/// Responses ahead that the camera is guessed.
const RESPONSES_AHEAD: f64 = 2.0;

/// The motion of the camera from event to event.
#[derive(Debug)]
pub(super) struct Motion {
    /// The last event.
    at: Instant,
    /// Time from the last event to its response.
    response: Option<Duration>,
    /// The cameras before and after the last event, and the time between the last two.
    step: Option<([Projection; 2], Duration)>,
}

impl Motion {
    /// A camera that stands.
    pub(super) fn new() -> Motion {
        Motion { at: Instant::now(), response: None, step: None }
    }

    /// Learns that an event has come, with the cameras before and after it.
    pub(super) fn learn_event(&mut self, before: &Projection, after: &Projection) {
        let now = Instant::now();
        self.step = Some(([*before, *after], now - self.at));
        (self.at, self.response) = (now, None);
    }

    /// Learns that the picture holds a fetch block.
    pub(super) fn learn_response(&mut self) {
        self.response.get_or_insert(self.at.elapsed());
    }

    /// Time since the last event.
    pub(super) fn since_event(&self) -> Duration {
        self.at.elapsed()
    }

    /// The camera two responses after the last event, should it go on as it went; `None` where it stands or jumps. A
    /// response that has not come is taken for `t_max`.
    pub(super) fn guessed_camera(&self, t_max: Duration) -> Option<Projection> {
        let ([before, after], time) = self.step?;
        let response = self.response.unwrap_or(t_max);
        let steps = RESPONSES_AHEAD * response.as_secs_f64() / time.as_secs_f64().max(1e-9);
        before.is_near(&after).then(|| before.towards(&after, 1.0 + steps.min(RESPONSES_AHEAD)))
    }
}
