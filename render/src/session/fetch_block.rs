//! `FetchBlock`: how many tiles are shown together. What the user asks for, or as many as take half of `t_max` at the
//! speed of late, whichever is less: it shrinks at once, also when `t_max` has passed, and grows by a quarter.

use std::time::Duration;

/// Fewest tiles of a fetch block: what a picture needs to be seen to change.
pub const BLOCK_TILES_MIN: u32 = 16;
/// A block is made to take this part of `t_max`: the rest is for what varies.
pub(super) const BLOCK_PART: u32 = 2;
/// Part of `t_max` after which the first block is what there is: a tile and the end of the frame come on top.
pub(super) const RESPONSE_SHARE: f64 = 0.75;
/// Part of `t_max` that the first block gets at least, whatever the event and the preview took.
pub(super) const BLOCK_PART_LEAST: u32 = 8;
/// A block grows by this much a frame.
const BLOCK_GROWTH: f64 = 1.25;

/// The size of the fetch block: of the first block after an event, and of those that follow. They differ, since an
/// order by saliency begins with what is hard.
#[derive(Clone, Copy, Debug)]
pub(super) struct FetchBlock {
    most: u32,
    tiles: [f64; 2],
}

/// A block after an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Nth {
    First,
    Later,
}

impl FetchBlock {
    /// Blocks of `most` tiles at most, and of that many until speeds are known.
    pub(super) fn new(most: u32) -> FetchBlock {
        let most = most.max(BLOCK_TILES_MIN);
        FetchBlock { most, tiles: [f64::from(most); 2] }
    }

    /// Count of tiles of a block.
    pub(super) fn tiles(&self, nth: Nth) -> u32 {
        (self.tiles[nth as usize] as u32).clamp(BLOCK_TILES_MIN, self.most)
    }

    /// Learns that `finished` tiles took `time`, which should be `allowed`: shrinks at once, grows slowly.
    pub(super) fn learn(&mut self, nth: Nth, finished: u64, time: Duration, allowed: Duration) {
        let tiles = &mut self.tiles[nth as usize];
        let fit = finished as f64 * allowed.as_secs_f64() / time.as_secs_f64().max(1e-9);
        *tiles = fit.min(*tiles * BLOCK_GROWTH).clamp(f64::from(BLOCK_TILES_MIN), f64::from(self.most));
    }
}
