//! `Ladder`: how fine the picture is that a frame shows at once, rung by rung.
//!
//! ```text
//! the hand rests: frame 1   every 8th pixel, every 4th
//!                 frame 2   every 2nd: the picture is whole
//! the hand moves: frame 1   as fine as fits into it
//! ```
//!
//! A rung takes three times as many samples as those before it together, and so three times their time. It is taken as
//! a whole: the first of a frame whatever it takes.

use std::time::Duration;
use trex_film::STEPS;

/// Pixels from sample to sample at which a picture is first shown.
pub(super) const ROUGH_STEP: u32 = 4;
/// Part of `t_max` that all rungs may take while the hand moves.
const MOVING_PART: u32 = 2;
/// Time of a rung over that of those before it.
const RUNG_GROWTH: u32 = 3;

/// The rungs that are taken of a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ladder {
    taken: usize,
    /// Time that they took.
    spent: Duration,
    /// True while events follow each other so fast that a frame is all that a picture gets.
    is_moving: bool,
}

/// Where a rung would stand in its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    First,
    Later,
}

impl Ladder {
    /// A ladder of which nothing is taken.
    pub(super) fn new(is_moving: bool) -> Ladder {
        Ladder { taken: 0, spent: Duration::ZERO, is_moving }
    }

    /// Step of the rung that comes next in a frame of `t_max`; `None` when the picture is as fine as it gets there.
    pub(super) fn next(&self, turn: Turn, t_max: Duration) -> Option<u32> {
        let step = *STEPS.get(self.taken)?;
        let time = RUNG_GROWTH * self.spent;
        let comes = match turn {
            Turn::First => true,
            Turn::Later if self.is_moving => self.spent + time <= t_max / MOVING_PART,
            Turn::Later => step >= ROUGH_STEP && self.spent + time <= t_max,
        };
        comes.then_some(step)
    }

    /// True while a frame is all that a picture gets.
    pub(super) fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// Learns that the next rung has been taken, in `time`.
    pub(super) fn learn(&mut self, time: Duration) {
        self.taken += 1;
        self.spent += time;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The steps of the frames of a picture whose every sample of the coarsest grid takes `time` in all.
    fn frames(time: Duration, t_max: Duration, is_moving: bool) -> Vec<Vec<u32>> {
        let mut ladder = Ladder::new(is_moving);
        let mut frames = vec![];
        while let Some(step) = ladder.next(Turn::First, t_max) {
            let mut frame = vec![];
            let mut next = Some(step);
            while let Some(step) = next {
                frame.push(step);
                let samples = (STEPS[0] / step).pow(2);
                ladder.learn(time * if step == STEPS[0] { 1 } else { samples - samples / 4 });
                next = ladder.next(Turn::Later, t_max);
            }
            frames.push(frame);
        }
        frames
    }

    #[test]
    fn a_picture_is_as_fine_as_its_time_allows() {
        let ms = Duration::from_millis;
        let rest = |time, t_max| frames(ms(time), ms(t_max), false);
        // 1, 4 and 16 ms for all samples up to a rung.
        assert_eq!(rest(1, 100), [vec![8, 4], vec![2]]);
        // A large picture: 30 ms, 120 ms, 480 ms.
        assert_eq!(rest(30, 119), [vec![8], vec![4], vec![2]]);
        assert_eq!(rest(30, 120), [vec![8, 4], vec![2]]);
        let moving = |time, t_max| frames(ms(time), ms(t_max), true);
        assert_eq!(moving(1, 100)[0], [8, 4, 2]);
        assert_eq!(moving(5, 100)[0], [8, 4]);
        assert_eq!(moving(30, 100)[0], [8]);
    }
}
