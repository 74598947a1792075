//! `EventState`: how far the picture of a live session has come since the last event.
//!
//! ```text
//! event -> rungs of the ladder -> tiles in order -> tiles finish -> the first block is done -> progress: Done
//!                      ^                      |
//!                      +-- the finest rung, where voxels stood in for the mesh --+
//! ```
//!
//! Invariants: 1. an event begins another of these: nothing of it outlives the next event; 2. the first block is noted
//! once.

use super::fetch_block::Nth;
use super::frame_report::FrameProgress;
use super::ladder::{Ladder, Turn};
use crate::schedule::PreviewStats;
use std::time::{Duration, Instant};

/// The state of a picture since the event that it follows.
#[derive(Clone, Copy, Debug)]
pub(super) struct EventState {
    /// How fine the preview is.
    pub(super) ladder: Ladder,
    /// Time of the event.
    pub(super) at: Instant,
    /// State of the film at the event.
    pub(super) film_state: u32,
    /// Tiles done.
    finished: u64,
    /// Tiles of the first block, once it is done.
    first_block: Option<u32>,
    /// The tiles are in order.
    is_ordered: bool,
    /// Tiles done when the picture on show was made anew.
    refreshed: u64,
    /// What the preview saw.
    pub(super) preview: PreviewStats,
    /// A frame has taken tiles.
    has_waited: bool,
    /// How far the picture on show is made anew; `None` while it is not time for that.
    pub(super) renewal: Option<Renewal>,
    progress: FrameProgress,
}

/// How far the picture on show is made anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Renewal {
    /// Stand-ins are looked at again, from this part of the grid on: pages have come since.
    Look(u32),
    /// All that was looked at is to be shown.
    Show,
}

/// Part of the samples of a rough picture that have to see stand-ins, or its finest grid follows at once.
const STAND_INS_PART: u64 = 4;
/// Part of the first pass after which the picture on show is made anew; then it is each time that samples have doubled.
const REFRESH_PART: u64 = 4;
/// Passes after which it no longer is: by then the samples count for more.
const REFRESH_PASSES: u64 = 16;

impl EventState {
    /// An event at a time, from which on the film is in `film_state`; its preview is as fine as `ladder` says.
    pub(super) fn new(at: Instant, film_state: u32, ladder: Ladder) -> EventState {
        EventState {
            ladder,
            at,
            film_state,
            finished: 0,
            first_block: None,
            is_ordered: false,
            refreshed: 0,
            preview: PreviewStats::default(),
            has_waited: false,
            renewal: None,
            progress: FrameProgress::Preview,
        }
    }

    /// Tiles done since the event.
    pub(super) fn finished(&self) -> u64 {
        self.finished
    }

    /// Tiles of the first block, once it is done.
    pub(super) fn first_block(&self) -> Option<u32> {
        self.first_block
    }

    /// The block that is made.
    pub(super) fn nth(&self) -> Nth {
        if self.first_block.is_some() { Nth::Later } else { Nth::First }
    }

    /// True when every pixel has all samples that were asked for: no preview is mixed in.
    pub(super) fn is_done(&self) -> bool {
        self.progress == FrameProgress::Done
    }

    /// True when every pixel has a sample that was taken after the event.
    pub(super) fn is_complete(&self) -> bool {
        self.progress >= FrameProgress::Complete
    }

    /// Notes that the tiles are put in order. True the first time.
    pub(super) fn note_order(&mut self) -> bool {
        !std::mem::replace(&mut self.is_ordered, true)
    }

    /// Begins to make the picture on show anew, if it is time for that: the picture has so many `tiles`.
    pub(super) fn begin_renewal(&mut self, tiles: u32) {
        let tiles = u64::from(tiles);
        let next = (2 * self.refreshed).max(tiles.div_ceil(REFRESH_PART));
        let is_time = self.finished >= next && self.refreshed < REFRESH_PASSES * tiles;
        if is_time {
            (self.refreshed, self.renewal) = (self.finished, Some(Renewal::Look(0)));
        }
    }

    /// True while pages of what a rough picture shows are on their way, for one frame of tiles: until then a finer grid
    /// would show the same voxels.
    fn awaits_mesh(&self) -> bool {
        self.sees_voxels() && !self.has_waited && !self.ladder.is_moving() && self.ladder.is_rough()
    }

    /// True when much of what the preview saw stood in for mesh.
    pub(super) fn sees_voxels(&self) -> bool {
        STAND_INS_PART * self.preview.stand_ins > self.preview.samples
    }

    /// Step of the rung of the preview that comes next in a frame of `t_max`.
    pub(super) fn next_rung(&self, t_max: Duration) -> Option<u32> {
        self.ladder.next(Turn::First, t_max).filter(|_| !self.awaits_mesh() && !self.is_complete())
    }

    /// Notes that so many more tiles are done.
    pub(super) fn note_tiles(&mut self, count: u64) {
        self.finished += count;
    }

    /// Notes that a block of so many tiles is done, where it is the first.
    pub(super) fn note_block(&mut self, tiles: u32) {
        self.first_block.get_or_insert(tiles);
    }

    /// Notes the state of the picture at the end of a frame of tiles.
    pub(super) fn note_progress(&mut self, progress: FrameProgress) {
        (self.progress, self.has_waited) = (progress, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At a quarter of the first pass, then at twice as many samples each time, to sixteen passes.
    #[test]
    fn the_picture_on_show_is_made_anew_ever_more_seldom() {
        let mut event = EventState::new(Instant::now(), 0, Ladder::new(false));
        let mut times = vec![];
        for finished in 1..=160 * 40 {
            event.note_tiles(1);
            event.begin_renewal(160);
            if event.renewal.take().is_some() {
                times.push(finished);
            }
        }
        assert_eq!(times, [40, 80, 160, 320, 640, 1280, 2560]);
    }

    /// A rough picture of stand-ins has its finest rung after a frame of tiles, any other at once; a hand that moves
    /// waits for nothing.
    #[test]
    fn the_finest_rung_waits_a_frame_for_mesh_that_is_missing() {
        let ms = Duration::from_millis;
        let rung_after = |stand_ins: u64, is_moving: bool| {
            let mut event = EventState::new(Instant::now(), 0, Ladder::new(is_moving));
            for step in [8, 4] {
                assert_eq!(event.next_rung(ms(100)), Some(step));
                event.ladder.learn(None, ms(1));
                let (samples, stand_ins) = (50, stand_ins / 2);
                event.preview.add(&PreviewStats { samples, stand_ins, ..PreviewStats::default() });
            }
            event
        };
        assert_eq!(rung_after(24, false).next_rung(ms(100)), Some(2));
        assert_eq!(rung_after(26, true).next_rung(ms(100)), Some(2));
        let mut event = rung_after(26, false);
        assert_eq!(event.next_rung(ms(100)), None);
        event.note_progress(FrameProgress::Part);
        assert_eq!(event.next_rung(ms(100)), Some(2));
        event.note_progress(FrameProgress::Complete);
        assert_eq!(event.next_rung(ms(100)), None, "there are exact samples everywhere");
    }
}
