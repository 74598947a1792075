//! The frames of a session that is live: see [`crate::live`] for what they show, and when.
//!
//! ```text
//! preview | photons -> tiles -> block learned -> governor -> predictors
//! ```
//!
//! Invariant: nothing here waits past the deadline but for what is begun: a tile, a batch of photons.

use crate::camera::Projection;
use crate::frame::{PagedTracer, Pass, PassStats, Predictor, Until};
use crate::live::{
    BLOCK_PART, BLOCK_PART_LEAST, BLOCK_TILES_MIN, DEMAND, FrameOptions, FrameReport, Live, NextLight, Nth,
    Prefetch, Progress, RESPONSE_SHARE, irradiance, middle,
};
use crate::saliency::{Reduced, SAMPLES_PER_SIDE};
use crate::session::{Session, integrator};
use crate::tile::{TILE_SIDE_PIXELS, TileOrder};
use crate::trace::Ray;
use crate::world::World;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;
use trex_store::{Code, Error, Result};

/// Most tiles that a worker previews at a time.
const PREVIEW_TILES_MOST: u32 = 256;
/// Photons take this part of a frame while light changes.
const PHOTON_PART: u32 = 2;
/// Tiles ahead whose pages are guessed.
const TILES_AHEAD: u32 = 64;
/// Rays along each side of the picture through the camera that is guessed.
const CAMERA_RAYS: u32 = 12;

/// What an event changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Changes {
    Camera,
    /// Lights or a material.
    Light,
}

impl<T: PagedTracer + Send> Session<T> {
    /// From now on [`Session::frame`] makes pictures.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] for a model without voxels: nothing could stand in for what is missing;
    /// [`Code::MemoryLimit`] when the budget has no room for the picture on show and the second map of photons.
    pub fn go_live(&mut self, options: FrameOptions) -> Result<()> {
        if self.model.voxels.is_none() {
            return Err(Error::new(
                Code::SceneFormat,
                "this file has no voxels to stand in for missing pages",
            )
            .at_place("--t-max")
            .numbers("frames with a deadline need them")
            .next("build the file without --no-asvo, or render without a deadline"));
        }
        let next = match (&self.photons, self.photon_world()) {
            (Some(map), Some(world)) => NextLight::new(&world, map, &self.budget)?,
            _ => None,
        };
        let error = self.view.lod_error_pixels;
        self.live = Some(Live::new((options, error), self.view.resolution, next, &self.budget)?);
        self.begin_state(&self.world.projection.clone(), Changes::Camera);
        Ok(())
    }

    /// Goes on with the picture until a fetch block is done, the picture is complete or `t_max` has passed. `spp`: samples that
    /// are enough. `stop` is asked between tiles. Light that has changed comes by voxels, whether it was baked or not; for
    /// `full-gi` it comes when [`Session::illuminate`] is called again.
    ///
    /// # Panics
    /// When the session is not live.
    pub fn frame(&mut self, spp: u32, stop: &(dyn Fn() -> bool + Sync)) -> FrameReport {
        let begin = Instant::now();
        let live = self.live.as_mut().expect("go_live comes before frames");
        if std::mem::take(&mut live.is_new) {
            self.show_preview();
            return self.report(Progress::Preview, (PassStats::default(), 0));
        }
        let t_max = live.options.t_max;
        let mut photon_rays = 0;
        let has_responded = live.first_block.is_some();
        // The response comes first, unless there is no light at all.
        if has_responded || self.photons.as_ref().is_some_and(|map| map.photons() == 0) {
            photon_rays = self.illuminate_until(begin + t_max / PHOTON_PART, stop);
        }
        let pass = self.run_tiles(spp, begin, stop);
        let samples = self.film.samples();
        self.govern(samples);
        if has_responded {
            self.predict();
        }
        let live = self.live.as_ref().expect("it is live");
        let is_lit = live.next.as_ref().is_none_or(NextLight::is_idle);
        let progress = match live.first_block {
            _ if self.film.samples() >= spp && is_lit => Progress::Done,
            _ if samples > 0 => Progress::Complete,
            Some(_) => Progress::Block,
            None => Progress::Part,
        };
        self.report(progress, (pass, photon_rays))
    }

    /// What the pixel (x, y) shows: the mean of its samples, else what stands in for it. Linear RGB.
    pub fn shown(&self, pixel: [u32; 2]) -> [f32; 3] {
        let tile = pixel.map(|x| x / TILE_SIDE_PIXELS);
        let index = tile[1] * self.view.resolution[0].div_ceil(TILE_SIDE_PIXELS) + tile[0];
        match &self.live {
            Some(live) if self.film.tile_samples(index) == 0 => live.shown.radiance(pixel, index),
            _ => self.film.radiance(pixel),
        }
    }

    /// Begins a new picture, after the world has become another and before the film is cleared.
    pub(crate) fn begin_state(&mut self, before: &Projection, changes: Changes) {
        let [width, height] = self.view.resolution;
        let tiles = [width, height].map(|side| side.div_ceil(TILE_SIDE_PIXELS));
        let step = TILE_SIDE_PIXELS / SAMPLES_PER_SIDE;
        let at = |[x, y]: [u32; 2]| self.shown([(x * step).min(width - 1), (y * step).min(height - 1)]);
        let order = self.live.as_ref().map_or(TileOrder::ZCurve, |live| live.options.order);
        let eye = match order {
            TileOrder::Saliency(_) => Reduced::new(tiles, at),
            _ => Reduced::new([0, 0], at),
        };
        self.tiles = self.tiles.ordered(order, &eye);
        let Some(live) = &mut self.live else { return };
        let demand = live.demand(&self.tracers);
        live.governor.lower(demand);
        live.last_demand = demand;
        live.pass = None;
        (live.finished, live.first_block) = (0, None);
        live.learn_event(before, &self.world.projection);
        let next = match changes {
            Changes::Camera => {
                live.is_new = true;
                None
            }
            Changes::Light => {
                // The old picture stays until the new one comes.
                live.shown.keep(&self.film, &self.tiles);
                live.next.take()
            }
        };
        if let (Some(mut next), Some(world)) = (next, self.photon_world()) {
            next.begin(&world);
            self.live.as_mut().expect("it is live").next = Some(next);
        }
        self.set_error();
    }

    /// Puts the governor's error into force, and begins to count demand anew.
    fn set_error(&mut self) {
        let Some(live) = &self.live else { return };
        let error = live.governor.error();
        self.world.voxels_from = World::voxels_from(&self.model, &self.world.projection, error);
        for tracer in &mut self.tracers {
            tracer.forget_demand();
        }
    }

    /// One voxel ray a tile.
    fn show_preview(&mut self) {
        let Live { next, shown, .. } = self.live.as_mut().expect("it is live");
        let irradiance = irradiance(self.photons.as_ref(), next.as_ref());
        let integrator = integrator(&self.world, (&self.model, &self.view), self.film.layers(), irradiance);
        let (tiles, turn) = (&self.tiles, AtomicU32::new(0));
        let share = tiles.count().div_ceil(4 * self.tracers.len() as u32);
        let at_a_time = share.clamp(1, PREVIEW_TILES_MOST);
        let work = || {
            let mut mine = Vec::new();
            loop {
                let from = turn.fetch_add(at_a_time, Ordering::Relaxed);
                if from >= tiles.count() {
                    return mine;
                }
                let end = tiles.count().min(from + at_a_time);
                // In rows: neighbours meet the same nodes.
                let some: Vec<_> = (from..end).map(|index| tiles.tile(index)).collect();
                let paths: Vec<_> = some.iter().map(|tile| integrator.start(middle(tile), 0)).collect();
                mine.extend(some.into_iter().zip(integrator.previews(paths.iter()).unwrap_or_default()));
            }
        };
        let previews: Vec<_> = std::thread::scope(|scope| {
            let workers: Vec<_> = self.tracers.iter().map(|_| scope.spawn(work)).collect();
            workers.into_iter().flat_map(|worker| worker.join().expect("a worker panicked")).collect()
        });
        for (tile, radiance) in previews {
            shown.set_preview(&tile, radiance);
        }
    }

    /// Photons of changed light. Gives the count of their rays.
    fn illuminate_until(&mut self, deadline: Instant, stop: &(dyn Fn() -> bool + Sync)) -> u64 {
        let Some(mut next) = self.live.as_mut().and_then(|live| live.next.take()) else { return 0 };
        let Some(mut map) = self.photons.take() else { return 0 };
        let target = self.view.g_rays.photons;
        let stop = || Instant::now() >= deadline || stop();
        let done = self.photon_world().map(|world| next.go_on(&world, (&mut map, target), &stop));
        let (rays, has_changed) = done.unwrap_or_default();
        self.photons = Some(map);
        self.live.as_mut().expect("it is live").next = Some(next);
        if has_changed {
            self.begin_again();
        }
        rays
    }

    /// What is on the film is of another state: it stays on show until there is better.
    fn begin_again(&mut self) {
        let live = self.live.as_mut().expect("it is live");
        live.shown.keep(&self.film, &self.tiles);
        live.pass = None;
        self.film.clear();
    }

    fn run_tiles(&mut self, spp: u32, begin: Instant, stop: &(dyn Fn() -> bool + Sync)) -> PassStats {
        let live = self.live.as_ref().expect("it is live");
        let t_max = live.options.t_max;
        let nth = if live.first_block.is_some() { Nth::Later } else { Nth::First };
        // The first block counts from the event.
        let (passed, longest) = match nth {
            Nth::First => (live.since_event(), t_max.mul_f64(RESPONSE_SHARE)),
            Nth::Later => (begin.elapsed(), t_max),
        };
        let least = t_max / BLOCK_PART_LEAST;
        let deadline = Instant::now() + longest.saturating_sub(passed).max(least);
        let allowed = (t_max / BLOCK_PART).saturating_sub(passed).max(least);
        let whole = live.block.tiles(nth);

        let Live { next, shown, pass, block, finished, .. } = self.live.as_mut().expect("it is live");
        let irradiance = irradiance(self.photons.as_ref(), next.as_ref());
        let integrator = integrator(&self.world, (&self.model, &self.view), self.film.layers(), irradiance)
            .with_photons(self.tree.as_ref());
        let (begin, was_complete) = (Instant::now(), self.film.samples() > 0);
        let mut total = PassStats::default();
        let mut has_become_complete = false;
        let mut wanted = u64::from(whole);
        if nth == Nth::First {
            wanted = wanted.saturating_sub(*finished).max(1);
        }
        while wanted > 0 && Instant::now() < deadline && !stop() {
            let samples = self.film.samples();
            if pass.as_ref().is_none_or(|pass| pass.is_done(&self.tiles)) {
                // A picture that has become complete is shown at once.
                has_become_complete = samples > 0 && !was_complete;
                if samples >= spp || has_become_complete {
                    break;
                }
                *pass = None;
            }
            let pass = pass.get_or_insert_with(|| Pass::new(samples + 1, self.tracers.len()));
            let until = Until { stop, deadline: Some(deadline), tiles: wanted as u32 };
            let film = (&mut self.film, Some(&mut *shown));
            let stats = pass.run((&integrator, &self.tiles), film, &mut self.tracers, &until);
            total.add(&stats);
            wanted = wanted.saturating_sub(stats.tiles_finished);
            *finished += stats.tiles_finished;
        }
        // What was left of the picture says nothing of how much a frame can do.
        if !has_become_complete {
            block.learn(nth, total.tiles_finished, begin.elapsed(), allowed);
        }
        // Past the deadline the block is what there is.
        let shrunk = u64::from(BLOCK_TILES_MIN).min(self.tiles.count().into());
        if wanted == 0 || *finished >= shrunk {
            let tiles = (*finished).min(whole.into()) as u32;
            self.live.as_mut().expect("it is live").learn_response(tiles);
        }
        total
    }

    fn govern(&mut self, samples: u32) {
        let live = self.live.as_mut().expect("it is live");
        let demand = live.demand(&self.tracers);
        let changes = if samples > 0 { live.governor.let_go() } else { live.governor.raise(demand) };
        if changes {
            self.begin_again();
            self.set_error();
        }
    }

    /// Asks for the pages that will be wanted.
    fn predict(&mut self) {
        let live = self.live.as_mut().expect("it is live");
        // Its pages are of the ray that a worker narrows down to.
        let is_narrow = live.pass.as_ref().is_some_and(Pass::is_narrow);
        // Where frames are scarce a guess takes the place of what is in use. A state that begins is taken to be as the last.
        let is_scarce = live.demand(&self.tracers).max(live.last_demand) > DEMAND.start;
        if live.options.prefetch == Prefetch::Off || is_narrow || is_scarce {
            return;
        }
        let live = self.live.as_ref().expect("it is live");
        let tracer = &mut self.tracers[0];
        tracer.begin_tile(0);
        let cut = self.world.voxels_from;
        let probe = |tracer: &mut T, mut ray: Ray| {
            ray.t_max = ray.t_max.min(cut);
            if cut > 0.0 {
                let _ = tracer.intersect(&ray);
            }
        };
        if let Some(pass) = &live.pass {
            let turn = pass.turn().min(self.tiles.count());
            for turn in turn..self.tiles.count().min(turn + TILES_AHEAD) {
                let [x, y] = middle(&self.tiles.nth(turn)).map(f64::from);
                probe(tracer, self.world.projection.ray(x, y));
            }
        }
        tracer.prefetch(Predictor::Tiles);
        if let Some(projection) = live.guessed_camera() {
            for index in 0..CAMERA_RAYS * CAMERA_RAYS {
                let place = [index % CAMERA_RAYS, index / CAMERA_RAYS];
                let at = |a: usize| {
                    (f64::from(place[a]) + 0.5) / f64::from(CAMERA_RAYS) * f64::from(self.view.resolution[a])
                };
                probe(tracer, projection.ray(at(0), at(1)));
            }
        }
        tracer.prefetch(Predictor::Camera);
        tracer.prefetch(Predictor::Neighbours);
        tracer.begin_tile(0);
    }

    fn report(&self, progress: Progress, (pass, photon_rays): (PassStats, u64)) -> FrameReport {
        let live = self.live.as_ref().expect("it is live");
        let [stand_in_tiles, hole_tiles] = live.shown.count(&self.film);
        FrameReport {
            progress,
            block_tiles: live.first_block.unwrap_or(live.block.tiles(Nth::First)),
            stand_in_tiles,
            hole_tiles,
            error_pixels: live.governor.error(),
            pass,
            photon_rays,
        }
    }
}
