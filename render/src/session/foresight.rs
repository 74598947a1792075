//! `Foresight`: which view is likely to come next.
//!
//! ```text
//! the hand moves            the camera goes on as it went from the event before to this one
//! the picture is complete   the view before it, as of who goes back and forth
//! ```
//!
//! Invariant: a hand that has rested may go anywhere: nothing is foreseen of it.

use crate::scene::camera::Camera;
use std::time::{Duration, Instant};

/// Steps of the hand, each as long as the last one, after which its view is looked at.
const STEPS_AHEAD: f64 = 4.0;
/// From event to event, the longest time after which the hand has not rested in between.
const STEP_LONGEST: Duration = Duration::from_millis(200);

/// What is known of views to come.
#[derive(Debug, Default)]
pub(super) struct Foresight {
    /// When the camera became another, and what it was before.
    last: Option<(Instant, Camera)>,
    /// The hand is on its way, and where it comes to has not been looked at since the last event.
    pub(super) is_on_its_way: bool,
    /// The camera of the last picture that was complete before this one.
    pub(super) before: Option<Camera>,
    /// All of the view before is there, as far as rays told.
    pub(super) is_done: bool,
    /// Views looked at.
    looked: u32,
}

impl Foresight {
    /// Learns that another camera has taken the place of `from`, whose picture was complete or not.
    pub(super) fn note_camera(&mut self, from: Camera, was_complete: bool) {
        let now = Instant::now();
        self.is_on_its_way = self.last.is_some_and(|(before, _)| now - before <= STEP_LONGEST);
        self.last = Some((now, from));
        self.is_done = false;
        if was_complete {
            self.before = Some(from);
        }
    }

    /// Where the camera `now` comes to, if the hand moves on; once an event.
    pub(super) fn moved_on(&mut self, now: &Camera) -> Option<Camera> {
        if !std::mem::take(&mut self.is_on_its_way) {
            return None;
        }
        let (_, last) = self.last?;
        let on =
            |from: [f64; 3], to: [f64; 3]| std::array::from_fn(|a| to[a] + STEPS_AHEAD * (to[a] - from[a]));
        Some(Camera {
            position: on(last.position, now.position),
            target: on(last.target, now.target),
            ..*now
        })
    }

    /// Where in its cell each ray of a look goes through, another place each time: the additive recurrence of the
    /// plastic number.
    pub(super) fn next_place(&mut self) -> [f64; 2] {
        self.looked = self.looked.wrapping_add(1);
        [0.754_877_666_246_692_7, 0.569_840_290_998_053_2].map(|step| (f64::from(self.looked) * step).fract())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Fov;

    fn camera(x: f64, target_x: f64) -> Camera {
        Camera {
            position: [x, 0.0, 5.0],
            target: [target_x, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
            fov: Fov::X(40.0),
        }
    }

    #[test]
    fn a_hand_goes_on_as_it_went() {
        let mut foresight = Foresight::default();
        assert_eq!(foresight.moved_on(&camera(0.0, 0.0)), None);
        foresight.note_camera(camera(0.5, -0.25), false);
        assert_eq!(foresight.moved_on(&camera(1.0, 0.0)), None, "one step may be a jump");
        foresight.note_camera(camera(1.0, 0.0), false);
        assert_eq!(foresight.moved_on(&camera(1.5, 0.25)), Some(camera(3.5, 1.25)));
        assert_eq!(foresight.moved_on(&camera(1.5, 0.25)), None, "it has been looked at");
        assert_eq!(foresight.before, None);
        foresight.note_camera(camera(2.0, 0.0), true);
        assert_eq!(foresight.before, Some(camera(2.0, 0.0)));
        // A hand that has rested may go anywhere.
        foresight.last.as_mut().unwrap().0 -= 2 * STEP_LONGEST;
        foresight.note_camera(camera(2.5, 0.0), true);
        assert_eq!(foresight.moved_on(&camera(3.0, 0.0)), None);
    }
}
