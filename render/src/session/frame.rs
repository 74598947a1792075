//! The frames of a live session: see [`super::live`] for what they show, and when.
//!
//! ```text
//! rungs of the preview; the finest after a frame of tiles, where voxels stand in for what is seen
//! stand-ins looked at again -> picture on show made anew -> photons -> tiles -> block learned
//! ```
//!
//! Invariant: nothing here waits past the deadline but for what is begun: the first rung of a preview, a batch of the
//! G-stage, a batch of photons a worker, the picture on show made anew, the filter of a picture whose samples have
//! doubled.

use super::Session;
use super::carried_light::CarriedLight;
use super::event_state::Renewal;
use super::frame_report::{FrameProgress, FrameReport};
use super::ladder::{ROUGH_STEP, Turn, WHOLE_STEP};
use super::light::Arrival;
use super::live::{Live, LiveSession};
use super::tile_run::TileFrame;
use crate::integrate::RenderContext;
use crate::schedule::{Grid, PreviewStats, SampleWork, Workers};
use crate::stats::PassStats;
use crate::trace::PagedTracer;
use std::time::Instant;
use trex_film::{Display, GridPart, Reprojection, smooth};

/// Quarters of a frame after which its samples of a preview end: a picture is still to be made of them.
const SAMPLES_PART: u32 = 3;
/// Photons take as long as tiles do while light changes; so many times as long when every tile has been taken anew,
/// since what these show goes out of date with each photon.
const PHOTON_SHARE_LATE: u32 = 3;
/// Parts of a frame that photons take at most, and at least.
const PHOTON_PART: u32 = 2;
const PHOTON_PART_LEAST: u32 = 50;

/// Work of a frame that is on no film.
#[derive(Clone, Copy, Default)]
struct OtherRays {
    preview: PreviewStats,
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
        if let Some(step) = self.live.event.next_rung(t_max) {
            let (preview, progress) = self.show_preview(step, begin + t_max / 4 * SAMPLES_PART, stop);
            other.preview = preview;
            return self.report(progress, PassStats::default(), other);
        }
        self.fill_preview();
        if let Some(preview) = self.refresh_display(begin + t_max / 4 * SAMPLES_PART, stop) {
            other.preview = preview;
            let has_responded = self.live.event.first_block().is_some();
            let progress = if has_responded { FrameProgress::Block } else { FrameProgress::Part };
            return self.report(progress, PassStats::default(), other);
        }
        let has_responded = self.live.event.first_block().is_some();
        // The response comes first, unless there is no light at all.
        if has_responded || self.light.precedes_response() {
            let share = if self.is_complete() { PHOTON_SHARE_LATE } else { 1 };
            let photons_time = share * self.live.tiles.time();
            let photons_time = photons_time.clamp(t_max / PHOTON_PART_LEAST, t_max / PHOTON_PART);
            other.photon = self.illuminate_until(begin + photons_time, stop);
        }
        let tiles_begin = Instant::now();
        self.put_in_order();
        let LiveSession { session, live } = self;
        let pass = live.tiles.run(
            session,
            &mut live.display,
            &mut live.event,
            &TileFrame { spp, begin, t_max, stop },
        );
        self.smooth_shown(spp, stop);
        self.live.tiles.learn_time(tiles_begin.elapsed());
        let progress = match self.live.event.first_block() {
            _ if self.film.samples() >= spp && self.light.is_whole() => FrameProgress::Done,
            _ if self.is_complete() => FrameProgress::Complete,
            Some(_) => FrameProgress::Block,
            None => FrameProgress::Part,
        };
        self.live.event.note_progress(progress);
        if progress >= FrameProgress::Complete {
            self.look_back();
        }
        self.report(progress, pass, other)
    }

    /// Shows what is resident by a sample at every `step`-th pixel, and at finer grids while the ladder has a rung for
    /// this frame. The first picture comes whatever it takes, the others by the `deadline` or later.
    fn show_preview(
        &mut self,
        step: u32,
        deadline: Instant,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (PreviewStats, FrameProgress) {
        let LiveSession { session, live: Live { display, event, options, carried, .. } } = self;
        // Tiles of other light than now are taken anew.
        let is_beside = event.finished() > 0 && session.film.state() == event.film_state;
        // Pages may have come since the first picture: its voxels would be dots among mesh.
        let looks_again = is_beside || event.finished() == 0 && !event.ladder.is_empty();
        let part = if looks_again { GridPart::NewAndStandIns } else { GridPart::New };
        let (mut total, mut rung, mut taken) = (PreviewStats::default(), Some(step), None);
        while let Some(step) = rung {
            let begin = Instant::now();
            let waits = event.ladder.is_empty();
            // A frame goes on by a part at least.
            let stop = |begun| stop() || !waits && begun > 0 && Instant::now() > deadline;
            let parts = event.ladder.parts();
            let (stats, next_part) = take_grid(session, (display, carried), (step, part), (parts, &stop));
            total.add(&stats);
            event.preview.add(&stats);
            event.ladder.learn(next_part, begin.elapsed());
            if next_part.is_some() {
                break;
            }
            taken = rung;
            rung = event.ladder.next(Turn::Later, options.t_max);
        }
        if let Some(step) = taken {
            let is_sparse = event.ladder.is_moving() && !options.fills_while_moving;
            let Session { world, film, pool, .. } = session;
            let change = carried.change(&world.projection);
            let change = change.as_ref().map(|change| change as &dyn Reprojection);
            if is_beside {
                display.show_beside(film, change, pool);
            } else {
                display.show((film.state(), step), is_sparse, change, pool);
            }
        }
        let progress = match taken {
            _ if event.first_block().is_some() => FrameProgress::Block,
            Some(_) => FrameProgress::Preview,
            None => FrameProgress::PreviewPart,
        };
        // Where there is no time for a rough picture there is none for pages, unless it is of coarse voxels.
        let asks = event.sees_voxels() || taken.is_some_and(|step| step <= ROUGH_STEP);
        let is_last = event.ladder.is_moving() && asks || event.next_rung(options.t_max).is_none();
        if self.look_where_it_moves() || is_last {
            for tracer in &mut self.session.tracers {
                tracer.request_missing();
            }
        }
        (total, progress)
    }

    /// Sends photons of changed light. Gives the count of their rays.
    fn illuminate_until(&mut self, deadline: Instant, stop: &(dyn Fn() -> bool + Sync)) -> u64 {
        let (light, mut work) = self.session.light_parts(stop);
        let (rays, arrival) = light.advance(&mut work, deadline);
        if arrival != Arrival::Nothing {
            self.live.carried.forget(&mut self.live.display);
        }
        match arrival {
            Arrival::Nothing => {}
            Arrival::Blended => self.begin_light(),
            Arrival::Replaced => self.begin_samples(),
        }
        rays
    }

    /// Makes the picture on show anew with the light of the samples, where it is time for that, and looks again before
    /// that where voxels stood in. Gives the counts of its rays where that took the frame.
    fn refresh_display(
        &mut self,
        deadline: Instant,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<PreviewStats> {
        let LiveSession { session, live: Live { display, event, carried, .. } } = self;
        if session.view.settings.integrator.has_own_preview() {
            event.begin_renewal(session.tiles.count());
        }
        let shown = (session.film.state(), WHOLE_STEP);
        let may_look = !event.is_complete() && display.state().zip(display.step()) == Some(shown);
        if let Renewal::Look(first) = event.renewal?
            && may_look
        {
            let stop = |begun| stop() || begun > 0 && Instant::now() > deadline;
            let grid = (WHOLE_STEP, GridPart::StandIns);
            let (stats, next) = take_grid(session, (display, carried), grid, (first, &stop));
            // Where voxels are seen still it is left at that.
            let next = next.filter(|_| 4 * stats.stand_ins <= 3 * stats.samples);
            event.renewal = Some(next.map_or(Renewal::Show, Renewal::Look));
            if next.is_some() || stats.samples > 0 {
                return Some(stats);
            }
        }
        event.renewal = None;
        display.refresh(&session.film, &session.pool);
        None
    }

    /// Smooths the indirect light of a film that keeps it apart, each time that its samples have doubled, and when all
    /// `spp` are there. Frames do so by themselves; for 0 it is done of what samples there are, until `stop`.
    pub fn smooth_shown(&mut self, spp: u32, stop: &(dyn Fn() -> bool + Sync)) {
        let Session { film, world, pool, .. } = &mut self.session;
        let samples = film.samples();
        if film.layers().filter
            && samples > film.smoothed_of()
            && (samples.is_power_of_two() || samples >= spp)
        {
            // In the room that the display leaves it.
            self.live.display.release_work(pool);
            smooth(film, &world.projection, pool, stop);
        }
    }

    /// True when every tile has samples from after the event.
    fn is_complete(&self) -> bool {
        (0..self.tiles.count()).all(|tile| self.film.tile_state(tile) >= Some(self.live.event.film_state))
    }

    fn report(&self, progress: FrameProgress, pass: PassStats, other: OtherRays) -> FrameReport {
        let live = &self.live;
        let (tiles, event_state) = (self.tiles.count(), live.event.film_state);
        let first_block = live.event.first_block();
        let (mut preview_tiles, mut stale_tiles) = (0, 0);
        for tile in 0..tiles {
            let is_stale = self.film.tile_state(tile) < Some(event_state);
            preview_tiles += u32::from(is_stale && !self.shows_samples(tile));
            stale_tiles += u32::from(is_stale);
        }
        let preview = live.display.step().filter(|_| live.display.state() >= Some(event_state));
        FrameReport {
            progress,
            block_tiles: first_block.unwrap_or(live.tiles.first_block()),
            block_share: f64::from(first_block.unwrap_or(0)) / f64::from(tiles),
            sample_step: if stale_tiles == 0 { Some(1) } else { preview },
            preview_tiles,
            hole_tiles: if live.display.state().is_none() { preview_tiles } else { 0 },
            light_share: self.light.share(),
            lod_error: self.view.settings.lod_error,
            pass,
            preview_rays: other.preview.rays,
            preview_samples: other.preview.samples,
            preview_covered: other.preview.covered,
            photon_rays: other.photon,
        }
    }
}

/// Takes samples of a grid for the display, from part `first` on, as [`Grid::take`] says.
fn take_grid<T: PagedTracer + Send>(
    session: &mut Session<T>,
    (display, carried): (&mut Display, &CarriedLight),
    (step, part): (u32, GridPart),
    (first, stop): (u32, &(dyn Fn(u32) -> bool + Sync)),
) -> (PreviewStats, Option<u32>) {
    let Session { world, model, light, film, tracers, pool, g_stage, .. } = session;
    let ctx = RenderContext::new(world, model, light.irradiance()).for_preview(carried.pictures());
    let (resolution, stand_ins_to) = (film.resolution(), world.stand_ins_to(model, ROUGH_STEP));
    let grid = Grid { resolution, step, part, stand_ins_to };
    grid.take(first, &SampleWork::new(ctx, &**g_stage), display, Workers { tracers, pool }, stop)
}
