//! `Block`: how many tiles are shown together: as many as were asked for, or, where that is asked for by name, as many
//! as take half of `t_max` at the speed of late. That one shrinks at once, also when `t_max` has passed, and grows by a
//! quarter; what it says of a response is what it was made to say.

use std::time::Duration;

/// Fewest tiles of a block that follows the speed of late: what a picture needs to be seen to change.
pub const BLOCK_TILES_MIN: u32 = 16;
/// Most tiles of a block that follows the speed of late.
const BLOCK_TILES_MAX: f64 = 512.0;
/// A block that follows the speed of late is made to take this part of `t_max`: the rest is for what varies.
pub(super) const BLOCK_PART: u32 = 2;
/// Part of `t_max` after which the first such block is what there is: a tile and the end of the frame come on top.
pub(super) const RESPONSE_SHARE: f64 = 0.75;
/// Part of `t_max` that the first such block gets at least, whatever the event and the preview took.
pub(super) const BLOCK_PART_LEAST: u32 = 8;
/// A block grows by this much a frame.
const BLOCK_GROWTH: f64 = 1.25;

/// How many tiles are shown together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FetchBlock {
    /// So many.
    Tiles(u32),
    /// As many as take half of the frame at the speed of late.
    Adaptive,
}

impl Default for FetchBlock {
    /// 64 tiles: 4,096 pixels, 1.6 % of a picture of 512x512.
    fn default() -> FetchBlock {
        FetchBlock::Tiles(64)
    }
}

/// The size of the fetch block: of the first block after an event, and of those that follow. They differ where they
/// follow the speed of late, since an order by saliency begins with what is hard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    kind: FetchBlock,
    tiles: [f64; 2],
}

/// A block after an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Nth {
    First,
    Later,
}

impl Block {
    /// Blocks of the size that is asked for; of the most tiles until speeds are known.
    pub(super) fn new(kind: FetchBlock) -> Block {
        let tiles = match kind {
            FetchBlock::Tiles(tiles) => f64::from(tiles.max(1)),
            FetchBlock::Adaptive => BLOCK_TILES_MAX,
        };
        Block { kind, tiles: [tiles; 2] }
    }

    /// True for blocks that follow the speed of late.
    pub(super) fn is_adaptive(&self) -> bool {
        self.kind == FetchBlock::Adaptive
    }

    /// Count of tiles of a block.
    pub(super) fn tiles(&self, nth: Nth) -> u32 {
        self.tiles[nth as usize] as u32
    }

    /// Learns that `finished` tiles took `time`, which should be `allowed`: shrinks at once, grows slowly.
    pub(super) fn learn(&mut self, nth: Nth, finished: u64, time: Duration, allowed: Duration) {
        if self.is_adaptive() {
            let tiles = &mut self.tiles[nth as usize];
            let fit = finished as f64 * allowed.as_secs_f64() / time.as_secs_f64().max(1e-9);
            *tiles = fit.min(*tiles * BLOCK_GROWTH).clamp(f64::from(BLOCK_TILES_MIN), BLOCK_TILES_MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_that_was_asked_for_stays() {
        let mut block = Block::new(FetchBlock::Tiles(100));
        block.learn(Nth::First, 1, Duration::from_secs(9), Duration::from_millis(1));
        assert_eq!([Nth::First, Nth::Later].map(|nth| block.tiles(nth)), [100; 2]);
    }

    #[test]
    fn one_that_adapts_shrinks_at_once_and_grows_slowly() {
        let ms = Duration::from_millis;
        let mut block = Block::new(FetchBlock::Adaptive);
        assert_eq!(block.tiles(Nth::First), 512);
        block.learn(Nth::First, 100, ms(100), ms(50));
        assert_eq!((block.tiles(Nth::First), block.tiles(Nth::Later)), (50, 512));
        block.learn(Nth::First, 1000, ms(50), ms(50));
        assert_eq!(block.tiles(Nth::First), 62);
        block.learn(Nth::First, 1, ms(50), ms(50));
        assert_eq!(block.tiles(Nth::First), BLOCK_TILES_MIN);
        for _ in 0..99 {
            block.learn(Nth::First, 9999, ms(1), ms(50));
        }
        assert_eq!(block.tiles(Nth::First), 512);
    }
}
