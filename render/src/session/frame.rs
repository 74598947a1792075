//! The frames of a live session: see [`super::live`] for what they show, and when.
//!
//! ```text
//! rungs of the preview
//! photons -> tiles -> block learned
//! ```
//!
//! Invariant: nothing here waits past the deadline but for what is begun: a rung of the preview, a batch of the
//! G-stage, a batch of photons a worker, the filter of a picture whose samples have doubled.

use super::Session;
use super::fetch_block::{BLOCK_PART, BLOCK_PART_LEAST, BLOCK_TILES_MIN, Nth, RESPONSE_SHARE};
use super::frame_report::{FrameProgress, FrameReport};
use super::ladder::{ROUGH_STEP, Turn};
use super::light::Arrival;
use super::live::{Live, LiveSession};
use crate::image::filter;
use crate::integrate::RenderContext;
use crate::schedule::{Grid, Pass, SampleWork, TileWork, Until, WhenFull, Workers};
use crate::stats::{PassStats, RayCounts};
use crate::trace::PagedTracer;
use std::time::{Duration, Instant};

/// Photons take as long as tiles do while light changes; so many times as long when every tile has been taken anew,
/// since what these show goes out of date with each photon.
const PHOTON_SHARE_LATE: u32 = 3;
/// Parts of a frame that photons take at most, and at least.
const PHOTON_PART: u32 = 2;
const PHOTON_PART_LEAST: u32 = 50;

/// The time that the tiles of a frame may take, and how many are wanted.
struct FrameTimes {
    nth: Nth,
    deadline: Instant,
    /// Time that a block should take.
    allowed: Duration,
    /// Tiles of the block.
    whole: u32,
}

/// Rays of a frame that are on no film.
#[derive(Clone, Copy, Default)]
struct OtherRays {
    preview: RayCounts,
    photon: u64,
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Goes on with the picture: with the preview that comes first; then until a fetch block is done, the picture is
    /// complete or `t_max` has passed. `spp`: samples that are enough. `stop` is asked between tiles. Light that has
    /// changed comes by itself: by voxels, whether it was baked or not; for `full-gi` through the mesh.
    pub fn frame(&mut self, spp: u32, stop: &(dyn Fn() -> bool + Sync)) -> FrameReport {
        let begin = Instant::now();
        let mut other = OtherRays::default();
        let t_max = self.live.options.t_max;
        if let Some(step) = self.live.ladder.next(Turn::First, t_max) {
            other.preview = self.show_preview(step, stop);
            return self.report(FrameProgress::Preview, PassStats::default(), other);
        }
        self.fill_preview();
        let has_responded = self.live.first_block.is_some();
        // The response comes first, unless there is no light at all.
        if has_responded || self.light.precedes_response() {
            let share = if self.is_complete() { PHOTON_SHARE_LATE } else { 1 };
            let photons_time = share * self.live.tiles_time;
            let photons_time = photons_time.clamp(t_max / PHOTON_PART_LEAST, t_max / PHOTON_PART);
            other.photon = self.illuminate_until(begin + photons_time, stop);
        }
        let tiles_begin = Instant::now();
        let pass = self.run_tiles(spp, begin, stop);
        self.smooth(spp, stop);
        self.live.tiles_time = tiles_begin.elapsed();
        let progress = match self.live.first_block {
            _ if self.film.samples() >= spp && self.light.is_whole() => FrameProgress::Done,
            _ if self.is_complete() => FrameProgress::Complete,
            Some(_) => FrameProgress::Block,
            None => FrameProgress::Part,
        };
        self.live.is_done = progress == FrameProgress::Done;
        self.report(progress, pass, other)
    }

    /// Shows what is resident by a sample at every `step`-th pixel, and at finer grids while the ladder has a rung for
    /// this frame.
    fn show_preview(&mut self, step: u32, stop: &(dyn Fn() -> bool + Sync)) -> RayCounts {
        let Session { world, model, light, film, tracers, pool, g_stage, .. } = &mut self.session;
        let Live { display, ladder, options, .. } = &mut self.live;
        let ctx = RenderContext::new(world, model, light.irradiance()).for_preview();
        let work = SampleWork::new(ctx, &**g_stage);
        let (mut rays, mut rung, mut taken) = (RayCounts::default(), Some(step), None);
        while let Some(step) = rung {
            let begin = Instant::now();
            let grid = Grid { resolution: film.resolution(), step };
            let (sent, is_whole) = grid.take(&work, display, Workers { tracers, pool }, stop);
            rays.add(&sent);
            if !is_whole {
                break;
            }
            ladder.learn(begin.elapsed());
            taken = rung;
            rung = ladder.next(Turn::Later, options.t_max);
        }
        if let Some(step) = taken {
            let is_sparse = ladder.is_moving() && !options.fills_while_moving;
            display.show(film.state(), step, is_sparse, pool);
        }
        // Where there is no time for a rough picture there is none for pages.
        let is_rough = taken.is_some_and(|step| step <= ROUGH_STEP);
        if ladder.is_moving() && is_rough || ladder.next(Turn::First, options.t_max).is_none() {
            for tracer in tracers.iter_mut() {
                tracer.request_missing();
            }
        }
        rays
    }

    /// Sends photons of changed light. Gives the count of their rays.
    fn illuminate_until(&mut self, deadline: Instant, stop: &(dyn Fn() -> bool + Sync)) -> u64 {
        let (light, mut work) = self.session.light_parts(stop);
        let (rays, arrival) = light.advance(&mut work, deadline);
        match arrival {
            Arrival::Nothing => {}
            Arrival::Blended => self.begin_light(),
            Arrival::Replaced => self.begin_samples(),
        }
        rays
    }

    /// The plan of a frame that began at `begin`.
    fn times(&self, begin: Instant) -> FrameTimes {
        let live = &self.live;
        let t_max = live.options.t_max;
        let nth = if live.first_block.is_some() { Nth::Later } else { Nth::First };
        let whole = live.block.tiles(nth);
        if !live.block.is_adaptive() {
            let deadline = (begin + t_max).max(Instant::now() + t_max / BLOCK_PART_LEAST);
            return FrameTimes { nth, deadline, allowed: t_max, whole };
        }
        // The first block counts from the event.
        let (passed, longest) = match nth {
            Nth::First => (live.event_at.elapsed(), t_max.mul_f64(RESPONSE_SHARE)),
            Nth::Later => (begin.elapsed(), t_max),
        };
        let least = t_max / BLOCK_PART_LEAST;
        let deadline = Instant::now() + longest.saturating_sub(passed).max(least);
        let allowed = (t_max / BLOCK_PART).saturating_sub(passed).max(least);
        FrameTimes { nth, deadline, allowed, whole }
    }

    fn run_tiles(&mut self, spp: u32, begin: Instant, stop: &(dyn Fn() -> bool + Sync)) -> PassStats {
        self.put_in_order();
        let FrameTimes { nth, deadline, allowed, whole } = self.times(begin);
        let is_scarce = self.live.is_scarce(&self.session.tracers);
        // Where the pages of all tiles find no room together, each tile that is begun costs those that wait theirs.
        let full = if is_scarce { WhenFull::Wait } else { WhenFull::Defer };
        let Session { world, model, light, film, tiles, tracers, pool, g_stage, .. } = &mut self.session;
        let Live { pass, block, finished, first_block, .. } = &mut self.live;
        let ctx = RenderContext::new(world, model, light.irradiance())
            .with_layers(film.layers())
            .with_photon_tree(light.photon_tree());
        let work = TileWork { samples: SampleWork::new(ctx, &**g_stage), tiles };
        let (begin, was_complete) = (Instant::now(), film.samples() > 0);
        let mut total = PassStats::default();
        let mut has_become_complete = false;
        let mut wanted = u64::from(whole);
        if nth == Nth::First {
            wanted = wanted.saturating_sub(*finished).max(1);
        }
        while wanted > 0 && Instant::now() < deadline && !stop() {
            let samples = film.samples();
            if pass.as_ref().is_none_or(|pass| pass.is_done(tiles)) {
                // A picture that has become complete is shown at once.
                has_become_complete = samples > 0 && !was_complete;
                if samples >= spp || has_become_complete {
                    break;
                }
                *pass = None;
            }
            let pass = pass.get_or_insert_with(|| Pass::new(samples + 1, tracers.len(), full));
            pass.set_full(full);
            let until = Until { stop, deadline: Some(deadline), tiles: wanted as u32 };
            let stats = pass.run(&work, film, Workers { tracers, pool }, &until);
            total.add(&stats);
            wanted = wanted.saturating_sub(stats.tiles_finished);
            *finished += stats.tiles_finished;
        }
        // What was left of the picture says nothing of how much a frame can do.
        if !has_become_complete {
            block.learn(nth, total.tiles_finished, begin.elapsed(), allowed);
        }
        // A block that follows the speed of late is past its time what there is.
        let least = if block.is_adaptive() { BLOCK_TILES_MIN.min(whole) } else { whole };
        if *finished >= u64::from(least.min(tiles.count())) {
            let shown = (*finished).min(whole.into()) as u32;
            first_block.get_or_insert(shown);
        }
        total
    }

    /// Smooths the indirect light of a film that keeps it apart, each time that its samples have doubled, and when all
    /// `spp` are there.
    fn smooth(&mut self, spp: u32, stop: &(dyn Fn() -> bool + Sync)) {
        let Session { film, world, pool, .. } = &mut self.session;
        let samples = film.samples();
        if film.layers().filter
            && samples > film.smoothed_of()
            && (samples.is_power_of_two() || samples >= spp)
        {
            // In the room that the display leaves it.
            self.live.display.release_work(pool);
            filter::smooth(film, &world.projection, pool, stop);
        }
    }

    /// True when every tile has samples from after the event.
    fn is_complete(&self) -> bool {
        (0..self.tiles.count()).all(|tile| self.film.tile_state(tile) >= Some(self.live.event_state))
    }

    fn report(&self, progress: FrameProgress, pass: PassStats, other: OtherRays) -> FrameReport {
        let live = &self.live;
        let tiles = self.tiles.count();
        let (mut preview_tiles, mut stale_tiles) = (0, 0);
        for tile in 0..tiles {
            let is_stale = self.film.tile_state(tile) < Some(live.event_state);
            preview_tiles += u32::from(is_stale && !self.shows_samples(tile));
            stale_tiles += u32::from(is_stale);
        }
        let preview = live.display.step().filter(|_| live.display.state() >= Some(live.event_state));
        FrameReport {
            progress,
            block_tiles: live.first_block.unwrap_or(live.block.tiles(Nth::First)),
            block_share: f64::from(live.first_block.unwrap_or(0)) / f64::from(tiles),
            sample_step: if stale_tiles == 0 { Some(1) } else { preview },
            preview_tiles,
            hole_tiles: if live.display.state().is_none() { preview_tiles } else { 0 },
            light_share: self.light.share(),
            lod_error: self.view.settings.lod_error,
            pass,
            preview_rays: other.preview,
            photon_rays: other.photon,
        }
    }
}
