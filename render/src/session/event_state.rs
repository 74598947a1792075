//! `EventState`: how far the picture of a live session has come since the last event.
//!
//! ```text
//! event -> rungs of the ladder -> tiles in order -> tiles finish -> the first block is done -> progress: Done
//! ```
//!
//! Invariants: 1. an event begins another of these: nothing of it outlives the next event; 2. the first block is noted
//! once.

use super::fetch_block::Nth;
use super::frame_report::FrameProgress;
use super::ladder::Ladder;
use std::time::Instant;

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
    progress: FrameProgress,
}

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

    /// Notes that the picture on show is made anew, if it is time for that: the picture has so many `tiles`.
    pub(super) fn note_refresh(&mut self, tiles: u32) -> bool {
        let tiles = u64::from(tiles);
        let next = (2 * self.refreshed).max(tiles.div_ceil(REFRESH_PART));
        let is_time = self.finished >= next && self.refreshed < REFRESH_PASSES * tiles;
        if is_time {
            self.refreshed = self.finished;
        }
        is_time
    }

    /// Notes that so many more tiles are done.
    pub(super) fn note_tiles(&mut self, count: u64) {
        self.finished += count;
    }

    /// Notes that a block of so many tiles is done, where it is the first.
    pub(super) fn note_block(&mut self, tiles: u32) {
        self.first_block.get_or_insert(tiles);
    }

    /// Notes the state of the picture at the end of a frame.
    pub(super) fn note_progress(&mut self, progress: FrameProgress) {
        self.progress = progress;
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
            if event.note_refresh(160) {
                times.push(finished);
            }
        }
        assert_eq!(times, [40, 80, 160, 320, 640, 1280, 2560]);
    }
}
