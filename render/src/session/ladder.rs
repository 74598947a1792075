//! `Ladder`: how fine the picture is that a frame shows at once, rung by rung.
//!
//! ```text
//! the hand rests: frame 1   every 8th pixel, and every 4th where both fit into a third of it
//!                 frame 2.. the others, up to every 2nd: the picture is whole
//! the hand moves: frame 1   as fine as fits into half of it
//! ```
//!
//! A rung takes three times as many samples as those before it together, and so three times their time. The first is
//! taken whole, whatever that takes: until then the picture is of before the event. One that its frame has no time for
//! goes on in the next.

use std::time::Duration;
use trex_film::STEPS;

/// Pixels from sample to sample at which a picture is first shown.
pub(super) const ROUGH_STEP: u32 = 4;
/// Pixels from sample to sample at which it is whole.
pub(super) const WHOLE_STEP: u32 = STEPS[STEPS.len() - 1];
/// Part of `t_max` that the rungs may take while the hand moves: a picture gets no more than its first frame.
const MOVING_PART: u32 = 2;
/// The same while it rests: a rough picture at once is more than a better one later, which comes in any case.
const RESTING_PART: u32 = 3;
/// Time of a rung over that of those before it.
const RUNG_GROWTH: u32 = 3;

/// The rungs that are taken of a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ladder {
    taken: usize,
    /// Parts of the next that are taken.
    parts: u32,
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
        Ladder { taken: 0, parts: 0, spent: Duration::ZERO, is_moving }
    }

    /// Step of the rung that comes next in a frame of `t_max`; `None` when the picture is as fine as it gets there.
    pub(super) fn next(&self, turn: Turn, t_max: Duration) -> Option<u32> {
        let step = *STEPS.get(self.taken)?;
        let time = RUNG_GROWTH * self.spent;
        let comes = match turn {
            Turn::First => true,
            Turn::Later if self.is_moving => self.spent + time <= t_max / MOVING_PART,
            Turn::Later => step >= ROUGH_STEP && self.spent + time <= t_max / RESTING_PART,
        };
        comes.then_some(step)
    }

    /// True while a frame is all that a picture gets.
    pub(super) fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// Parts of the next rung that are taken already.
    pub(super) fn parts(&self) -> u32 {
        self.parts
    }

    /// True before the first rung has been taken.
    pub(super) fn is_empty(&self) -> bool {
        self.taken == 0
    }

    /// True when the finest rung comes next.
    pub(super) fn is_rough(&self) -> bool {
        STEPS.get(self.taken) == Some(&WHOLE_STEP)
    }

    /// Learns that the next rung has been taken up to so many `parts`, `None` to its end, in `time` since it was asked
    /// for last.
    pub(super) fn learn(&mut self, parts: Option<u32>, time: Duration) {
        self.taken += usize::from(parts.is_none());
        self.parts = parts.unwrap_or(0);
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
                ladder.learn(None, time * if step == STEPS[0] { 1 } else { samples - samples / 4 });
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
        assert_eq!(rest(30, 359), [vec![8], vec![4], vec![2]]);
        assert_eq!(rest(30, 360), [vec![8, 4], vec![2]]);
        let moving = |time, t_max| frames(ms(time), ms(t_max), true);
        assert_eq!(moving(1, 100)[0], [8, 4, 2]);
        assert_eq!(moving(5, 100)[0], [8, 4]);
        assert_eq!(moving(30, 100)[0], [8]);
    }
}
