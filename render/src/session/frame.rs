//! The frames of a live session: see [`super::live`] for what they show, and when.
//!
//! ```text
//! preview | photons -> tiles -> block learned -> governor -> predictors
//! ```
//!
//! Invariant: nothing here waits past the deadline but for what is begun: a tile, a batch of photons.

use super::Session;
use super::fetch_block::{BLOCK_PART, BLOCK_PART_LEAST, BLOCK_TILES_MIN, Nth, RESPONSE_SHARE};
use super::live::{FrameProgress, FrameReport, Live, LiveSession};
use super::next_light::{NextLight, irradiance};
use crate::image::tile::Tile;
use crate::integrate::{RenderContext, SampleIntegrator};
use crate::schedule::{Canvas, Pass, TileWork, Until, Workers};
use crate::stats::PassStats;
use crate::trace::PagedTracer;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Most tiles that a worker previews at a time.
const PREVIEW_TILES_MOST: u32 = 256;
/// Photons take this part of a frame while light changes.
const PHOTON_PART: u32 = 2;

/// The time that the tiles of a frame may take, and how many are wanted.
struct FrameTimes {
    nth: Nth,
    deadline: Instant,
    /// Time that a block should take.
    allowed: Duration,
    /// Tiles of the block.
    whole: u32,
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Goes on with the picture until a fetch block is done, the picture is complete or `t_max` has passed. `spp`:
    /// samples that are enough. `stop` is asked between tiles. Light that has changed comes by voxels, whether it was
    /// baked or not; for `full-gi` it comes when [`LiveSession::illuminate`] is called again.
    pub fn frame(&mut self, spp: u32, stop: &(dyn Fn() -> bool + Sync)) -> FrameReport {
        let begin = Instant::now();
        if std::mem::take(&mut self.live.is_new) {
            self.show_preview();
            return self.report(FrameProgress::Preview, PassStats::default(), 0);
        }
        let t_max = self.live.options.t_max;
        let mut photon_rays = 0;
        let has_responded = self.live.first_block.is_some();
        // The response comes first, unless there is no light at all.
        if has_responded || self.photon_map.as_ref().is_some_and(|map| map.photons() == 0) {
            photon_rays = self.illuminate_until(begin + t_max / PHOTON_PART, stop);
        }
        let pass = self.run_tiles(spp, begin, stop);
        let samples = self.film.samples();
        self.govern(samples);
        if has_responded {
            self.predict();
        }
        let is_lit = self.live.next.as_ref().is_none_or(NextLight::is_idle);
        let progress = match self.live.first_block {
            _ if self.film.samples() >= spp && is_lit => FrameProgress::Done,
            _ if samples > 0 => FrameProgress::Complete,
            Some(_) => FrameProgress::Block,
            None => FrameProgress::Part,
        };
        self.report(progress, pass, photon_rays)
    }

    /// Shows what one voxel ray a tile sees.
    fn show_preview(&mut self) {
        let Session { world, model, photon_map, film, tiles, tracers, pool, .. } = &self.session;
        let Live { next, display, .. } = &mut self.live;
        let irradiance = irradiance(photon_map.as_ref(), next.as_ref());
        let ctx = RenderContext::new(world, model, irradiance).with_layers(film.layers());
        let integrator = SampleIntegrator::new(ctx);
        let share = tiles.count().div_ceil(4 * tracers.len() as u32);
        let at_a_time = share.clamp(1, PREVIEW_TILES_MOST) as usize;
        let preview = |indices: &[u32]| {
            // In rows: neighbours meet the same nodes.
            let some: Vec<Tile> = indices.iter().map(|&index| tiles.tile(index)).collect();
            let paths: Vec<_> = some.iter().map(|tile| integrator.start(tile.middle(), 0)).collect();
            let radiances = integrator.previews(paths.iter()).unwrap_or_default();
            some.into_iter().zip(radiances).collect::<Vec<_>>()
        };
        let indices: Vec<u32> = (0..tiles.count()).collect();
        let previews: Vec<_> =
            pool.install(|| indices.par_chunks(at_a_time).flat_map_iter(preview).collect());
        for (tile, radiance) in previews {
            display.set_preview(&tile, radiance);
        }
    }

    /// Sends photons of changed light. Gives the count of their rays.
    fn illuminate_until(&mut self, deadline: Instant, stop: &(dyn Fn() -> bool + Sync)) -> u64 {
        let Some(next) = &mut self.live.next else { return 0 };
        let Some(mut map) = self.session.photon_map.take() else { return 0 };
        let target = self.session.view.settings.photons;
        let stop = || Instant::now() >= deadline || stop();
        let done = self.session.voxel_photons().map(|photons| next.go_on(&photons, &mut map, target, &stop));
        let (rays, has_changed) = done.unwrap_or_default();
        self.session.photon_map = Some(map);
        if has_changed {
            self.begin_again();
        }
        rays
    }

    /// The plan of a frame that began at `begin`.
    fn times(&self, begin: Instant) -> FrameTimes {
        let live = &self.live;
        let t_max = live.options.t_max;
        let nth = if live.first_block.is_some() { Nth::Later } else { Nth::First };
        // The first block counts from the event.
        let (passed, longest) = match nth {
            Nth::First => (live.motion.since_event(), t_max.mul_f64(RESPONSE_SHARE)),
            Nth::Later => (begin.elapsed(), t_max),
        };
        let least = t_max / BLOCK_PART_LEAST;
        let deadline = Instant::now() + longest.saturating_sub(passed).max(least);
        let allowed = (t_max / BLOCK_PART).saturating_sub(passed).max(least);
        FrameTimes { nth, deadline, allowed, whole: live.block.tiles(nth) }
    }

    fn run_tiles(&mut self, spp: u32, begin: Instant, stop: &(dyn Fn() -> bool + Sync)) -> PassStats {
        let FrameTimes { nth, deadline, allowed, whole } = self.times(begin);
        let Session { world, model, photon_map, photon_tree, film, tiles, tracers, pool, .. } =
            &mut self.session;
        let Live { next, display, pass, block, finished, .. } = &mut self.live;
        let ctx = RenderContext::new(world, model, irradiance(photon_map.as_ref(), next.as_ref()))
            .with_layers(film.layers())
            .with_photon_tree(photon_tree.as_ref());
        let work = TileWork { integrator: SampleIntegrator::new(ctx), tiles };
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
            let pass = pass.get_or_insert_with(|| Pass::new(samples + 1, tracers.len()));
            let until = Until { stop, deadline: Some(deadline), tiles: wanted as u32 };
            let canvas = Canvas { film, display: Some(display) };
            let stats = pass.run(&work, canvas, Workers { tracers, pool }, &until);
            total.add(&stats);
            wanted = wanted.saturating_sub(stats.tiles_finished);
            *finished += stats.tiles_finished;
        }
        // What was left of the picture says nothing of how much a frame can do.
        if !has_become_complete {
            block.learn(nth, total.tiles_finished, begin.elapsed(), allowed);
        }
        // Past the deadline the block is what there is.
        let shrunk = u64::from(BLOCK_TILES_MIN).min(tiles.count().into());
        if wanted == 0 || *finished >= shrunk {
            let shown = (*finished).min(whole.into()) as u32;
            self.live.learn_response(shown);
        }
        total
    }

    fn govern(&mut self, samples: u32) {
        let LiveSession { session, live } = self;
        let demand = live.demand(&session.tracers);
        let changes = if samples > 0 { live.governor.let_go() } else { live.governor.raise(demand) };
        if changes {
            self.begin_again();
            self.set_error();
        }
    }

    fn report(&self, progress: FrameProgress, pass: PassStats, photon_rays: u64) -> FrameReport {
        let live = &self.live;
        let [stand_in_tiles, hole_tiles] = live.display.count(&self.film);
        FrameReport {
            progress,
            block_tiles: live.first_block.unwrap_or(live.block.tiles(Nth::First)),
            stand_in_tiles,
            hole_tiles,
            lod_error: live.governor.error(),
            pass,
            photon_rays,
        }
    }
}
