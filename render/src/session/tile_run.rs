//! `TileRun`: tiles taken in frames: the pass in work, and how many of its tiles a frame takes.
//!
//! ```text
//! times: deadline, tiles wanted -> pieces of passes -> the block learns how much a frame can do
//! ```
//!
//! Invariant: a pass is of one state of the film; where that changes, [`TileRun::restart`] ends it.

use super::Session;
use super::event_state::EventState;
use super::fetch_block::{
    BLOCK_PART, BLOCK_PART_LEAST, BLOCK_TILES_MIN, Block, FetchBlock, Nth, RESPONSE_SHARE,
};
use crate::integrate::RenderContext;
use crate::schedule::{Canvas, Pass, SampleWork, TileWork, Until, WhenFull, Workers};
use crate::stats::PassStats;
use crate::trace::PagedTracer;
use std::time::{Duration, Instant};
use trex_film::Display;

/// Share of the frames that pages asked for may take before frames are scarce.
const DEMAND_MOST: f64 = 0.85;

/// The tiles of a live session.
pub(super) struct TileRun {
    pass: Option<Pass>,
    block: Block,
    /// Time that the tiles of the last frame took.
    time: Duration,
    /// Pages in demand since the event, a bit each.
    demand: Vec<u64>,
}

/// A frame that takes tiles.
#[derive(Clone, Copy)]
pub(super) struct TileFrame<'a> {
    /// Samples of a pixel that are enough.
    pub(super) spp: u32,
    /// When the frame began.
    pub(super) begin: Instant,
    /// Longest time of a frame.
    pub(super) t_max: Duration,
    /// Asked between tiles.
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

/// The time that the tiles of a frame may take, and how many are wanted.
struct FrameTimes {
    nth: Nth,
    deadline: Instant,
    /// Time that a block should take.
    allowed: Duration,
    /// Tiles of the block.
    whole: u32,
}

impl TileRun {
    /// No tile yet; those of a block are shown together.
    pub(super) fn new(block: FetchBlock) -> TileRun {
        TileRun { pass: None, block: Block::new(block), time: Duration::ZERO, demand: Vec::new() }
    }

    /// Time that the tiles of the last frame took.
    pub(super) fn time(&self) -> Duration {
        self.time
    }

    /// Learns the time that the tiles of a frame took, with what is done for them and with them.
    pub(super) fn learn_time(&mut self, time: Duration) {
        self.time = time;
    }

    /// Tiles of the first block after an event.
    pub(super) fn first_block(&self) -> u32 {
        self.block.tiles(Nth::First)
    }

    /// Ends the pass in work: the next samples are of another state.
    pub(super) fn restart(&mut self) {
        self.pass = None;
    }

    /// True when the pages asked for since the event approach those that find room.
    pub(super) fn is_scarce<T: PagedTracer>(&mut self, tracers: &[T]) -> bool {
        self.demand.fill(0);
        let room = tracers.iter().map(|tracer| tracer.demand(&mut self.demand)).max().unwrap_or(0);
        let pages: u32 = self.demand.iter().map(|bits| bits.count_ones()).sum();
        room > 0 && f64::from(pages) > DEMAND_MOST * room as f64
    }

    /// Takes tiles until a block is done, the picture becomes complete, or the time of the frame is over.
    pub(super) fn run<T: PagedTracer + Send>(
        &mut self,
        session: &mut Session<T>,
        display: &mut Display,
        event: &mut EventState,
        frame: &TileFrame<'_>,
    ) -> PassStats {
        let FrameTimes { nth, deadline, allowed, whole } = self.times(event, frame);
        // Where the pages of all tiles find no room together, each tile that is begun costs those that wait theirs.
        let full = if self.is_scarce(&session.tracers) { WhenFull::Wait } else { WhenFull::Defer };
        let Session { world, model, light, film, tiles, tracers, pool, g_stage, .. } = session;
        let ctx = RenderContext::new(world, model, light.irradiance())
            .with_layers(film.layers())
            .beside_preview()
            .with_photon_tree(light.photon_tree());
        let work = TileWork { samples: SampleWork::new(ctx, &**g_stage), tiles };
        let (begin, was_complete) = (Instant::now(), film.samples() > 0);
        let mut total = PassStats::default();
        let mut has_become_complete = false;
        let mut wanted = u64::from(whole);
        if nth == Nth::First {
            wanted = wanted.saturating_sub(event.finished()).max(1);
        }
        while wanted > 0 && Instant::now() < deadline && !(frame.stop)() {
            let samples = film.samples();
            if self.pass.as_ref().is_none_or(|pass| pass.is_done(tiles)) {
                // A picture that has become complete is shown at once.
                has_become_complete = samples > 0 && !was_complete;
                if samples >= frame.spp || has_become_complete {
                    break;
                }
                self.pass = None;
            }
            let pass = self.pass.get_or_insert_with(|| Pass::new(samples + 1, tracers.len(), full));
            pass.set_full(full);
            let until = Until { stop: frame.stop, deadline: Some(deadline), tiles: wanted as u32 };
            let canvas = Canvas { film, display: Some(display) };
            let stats = pass.run(&work, canvas, Workers { tracers, pool }, &until);
            total.add(&stats);
            wanted = wanted.saturating_sub(stats.tiles_finished);
            event.note_tiles(stats.tiles_finished);
        }
        // What was left of the picture says nothing of how much a frame can do.
        if !has_become_complete {
            self.block.learn(nth, total.tiles_finished, begin.elapsed(), allowed);
        }
        // A block that follows the speed of late is past its time what there is.
        let least = if self.block.is_adaptive() { BLOCK_TILES_MIN.min(whole) } else { whole };
        if event.finished() >= u64::from(least.min(tiles.count())) {
            event.note_block(event.finished().min(whole.into()) as u32);
        }
        total
    }

    /// The plan of a frame.
    fn times(&self, event: &EventState, frame: &TileFrame<'_>) -> FrameTimes {
        let TileFrame { begin, t_max, .. } = *frame;
        let nth = event.nth();
        let whole = self.block.tiles(nth);
        if !self.block.is_adaptive() {
            let deadline = (begin + t_max).max(Instant::now() + t_max / BLOCK_PART_LEAST);
            return FrameTimes { nth, deadline, allowed: t_max, whole };
        }
        // The first block counts from the event.
        let (passed, longest) = match nth {
            Nth::First => (event.at.elapsed(), t_max.mul_f64(RESPONSE_SHARE)),
            Nth::Later => (begin.elapsed(), t_max),
        };
        let least = t_max / BLOCK_PART_LEAST;
        let deadline = Instant::now() + longest.saturating_sub(passed).max(least);
        let allowed = (t_max / BLOCK_PART).saturating_sub(passed).max(least);
        FrameTimes { nth, deadline, allowed, whole }
    }
}
