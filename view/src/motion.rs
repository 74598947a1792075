//! `Motion`: whether the hand moves, and how often a picture that gets better is worth sending.
//!
//! Invariants: 1. the hand moves from the second event on that comes within [`REST`] of the one before, until [`REST`] has
//! passed without any, or the page says so; 2. between an event and the end of its picture, refreshes of what is complete
//! grow in number as the logarithm of the time.

use crate::picture::SCALE_MAX;
use std::time::{Duration, Instant};

/// So long without an event is rest.
pub(crate) const REST: Duration = Duration::from_millis(150);
/// A picture that is complete is sent again when so much of the time since its event has passed.
const REFRESH_PART: u32 = 3;

/// See the module's description.
#[derive(Debug)]
pub(crate) struct Motion {
    event_at: Option<Instant>,
    /// When the picture was begun: by an event, or at all.
    begun_at: Instant,
    is_moving: bool,
    /// Pixels from one to the next while it moves; 0: as many as the picture has samples for.
    scale: u32,
    refreshed_at: Instant,
}

impl Motion {
    /// At rest.
    pub(crate) fn new() -> Motion {
        let now = Instant::now();
        Motion { event_at: None, begun_at: now, is_moving: false, scale: 0, refreshed_at: now }
    }

    /// An event came.
    pub(crate) fn event(&mut self) {
        let now = Instant::now();
        self.is_moving = self.event_at.is_some_and(|before| now - before < REST);
        (self.event_at, self.begun_at) = (Some(now), now);
    }

    /// The hand has let go.
    pub(crate) fn rest(&mut self) {
        self.is_moving = false;
    }

    /// Sets the scale while moving: 0, 1, 2, 4 or 8; others are as the next smaller one.
    pub(crate) fn set_scale(&mut self, scale: u32) {
        self.scale = if scale == 0 { 0 } else { 1 << scale.min(SCALE_MAX).ilog2() };
    }

    /// How long the hand will go on to move without another event; `None` at rest.
    pub(crate) fn moves_for(&self) -> Option<Duration> {
        let left = REST.checked_sub(self.event_at?.elapsed())?;
        (self.is_moving && !left.is_zero()).then_some(left)
    }

    /// The scale of a picture with a sample at every `step`-th pixel.
    pub(crate) fn scale(&self, step: u32) -> u32 {
        match self.scale {
            0 => 1 << step.clamp(1, SCALE_MAX).ilog2(),
            scale => scale,
        }
    }

    /// True when it is time to send what is complete again.
    pub(crate) fn is_due(&self) -> bool {
        self.refreshed_at.elapsed() >= self.begun_at.elapsed() / REFRESH_PART
    }

    /// Notes that the picture was sent.
    pub(crate) fn refreshed(&mut self) {
        self.refreshed_at = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_event_is_a_jump_and_two_are_a_motion() {
        let mut motion = Motion::new();
        motion.event();
        assert!(motion.moves_for().is_none());
        motion.event();
        assert!(motion.moves_for().is_some_and(|left| left <= REST));
        motion.rest();
        assert!(motion.moves_for().is_none());
        motion.event();
        motion.event_at = Instant::now().checked_sub(REST);
        assert!(motion.moves_for().is_none());
    }

    #[test]
    fn scales_are_powers_of_two_up_to_eight() {
        let mut motion = Motion::new();
        assert_eq!([1, 2, 3, 4, 8, 100].map(|step| motion.scale(step)), [1, 2, 2, 4, 8, 8]);
        for (asked, scale) in [(1, 1), (3, 2), (8, 8), (u32::MAX, 8)] {
            motion.set_scale(asked);
            assert_eq!(motion.scale(4), scale);
        }
        motion.set_scale(0);
        assert_eq!(motion.scale(4), 4);
    }

    #[test]
    fn what_is_complete_is_sent_less_and_less() {
        let mut motion = Motion::new();
        let ago = |ms| Instant::now().checked_sub(Duration::from_millis(ms)).unwrap();
        (motion.begun_at, motion.refreshed_at) = (ago(30_000), ago(9_000));
        assert!(!motion.is_due());
        motion.refreshed_at = ago(10_100);
        assert!(motion.is_due());
    }
}
