//! Frames with a deadline: what a viewer shows while the user moves. Paper, section 5.2.
//!
//! ```text
//! event -> preview frames: C-rays through what is resident, in its light: every 4th pixel, every 2nd  whole picture
//!       -> frames: tiles, the stalest first, until a fetch block is done                              response
//!       -> frames: photons, where light has changed, and tiles, until a block is done, the picture is
//!                  complete or t_max has passed
//!       -> ...     every pixel has a sample                                                           complete picture
//! ```
//!
//! The first fetch block counts from the event. Its tiles are shown together.
//!
//! While samples are few the preview, which is smoothed, is mixed in, and counts less with each sample: no picture is
//! further from the truth than the one before. Where photons have come in, and samples are to be taken anew, what was
//! shown until then takes the preview's place.
//!
//! A *state* is what samples are of: it changes with each event, and each time that more photons are in. A tile shows
//! its samples until it has some of the present state, unless the preview is of a later one.
//!
//! Where the pages in demand approach the frames there are, no tile is begun while others wait for theirs. Tried and
//! taken out: a governor that raised the error of the footprint rule until every pixel had a sample. The preview is
//! there sooner, and a complete picture of the plant came twice as late (`docs/measurements.md`).
//!
//! Invariants: 1. no pixel shows nothing, or what was there before the event, after the first frame, unless that was
//! stopped; 2. nothing of a preview is ever on the film; 3. once the view stands still, the film goes to the same bytes
//! as [`super::Session::render`]'s.

use super::fetch_block::{Block, FetchBlock};
use super::ladder::Ladder;
use super::next_light::NextLight;
use super::next_tree::NextTree;
use super::{Change, Event, Pick, Session};
use crate::image::display::Display;
use crate::image::encode::Image;
use crate::image::film::Film;
use crate::image::saliency::ReducedPicture;
use crate::image::tile::{TILE_SIDE_PIXELS, Tile, TileOrder};
use crate::scene::method::Method;
use crate::schedule::Pass;
use crate::trace::PagedTracer;
use std::ops::Deref;
use std::time::{Duration, Instant};
use trex_store::{Code, Error, NextStep, Result, Setting};

/// Share of the frames that pages asked for may take before frames are scarce.
const DEMAND_MOST: f64 = 0.85;

/// Options of frames with a deadline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameOptions {
    /// Longest time of a frame.
    pub t_max: Duration,
    /// Tiles that are shown together.
    pub fetch_block: FetchBlock,
    /// The order of tiles.
    pub order: TileOrder,
    /// True when also pictures that are gone with the next event are filled in between their samples; else only the
    /// pixels of those are shown, until [`LiveSession::fill_preview`] is called or the hand rests.
    pub fills_while_moving: bool,
}

impl Default for FrameOptions {
    fn default() -> FrameOptions {
        FrameOptions {
            t_max: Duration::from_millis(100),
            fetch_block: FetchBlock::default(),
            order: TileOrder::default(),
            fills_while_moving: true,
        }
    }
}

/// See [`LiveSession::tile_stamp`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileStamp {
    /// State and count of the samples that are shown.
    samples: Option<(Option<u32>, u32)>,
    /// State and step of the preview that is.
    preview: Option<(u32, u32)>,
    smoothed: u32,
}

/// A session whose pictures are made in frames. `T` answers rays, one per worker thread.
///
/// All of [`Session`] can be asked of it, but a picture made at leisure.
#[derive(Debug)]
pub struct LiveSession<T> {
    pub(super) session: Session<T>,
    pub(super) live: Live,
}

/// The state between frames, beside the session.
pub(super) struct Live {
    pub(super) options: FrameOptions,
    pub(super) display: Display,
    pub(super) next: Option<NextLight>,
    /// Photons of `full-gi` on their way.
    pub(super) next_tree: Option<NextTree>,
    pub(super) pass: Option<Pass>,
    pub(super) block: Block,
    pub(super) ladder: Ladder,
    /// Time of the event.
    pub(super) event_at: Instant,
    /// Time that the tiles of the last frame took.
    pub(super) tiles_time: Duration,
    /// Tiles done since the event.
    pub(super) finished: u64,
    /// Tiles of the first block since the event, once it is done.
    pub(super) first_block: Option<u32>,
    /// State of the film at the event.
    pub(super) event_state: u32,
    /// The tiles of the present state are still to be put in order.
    pub(super) is_unordered: bool,
    /// Every pixel has all samples that were asked for: no preview is mixed in.
    pub(super) is_done: bool,
    /// Pages in demand since the event, a bit each.
    demand: Vec<u64>,
}

impl<T: PagedTracer + Send> Session<T> {
    /// The session from now on: its pictures are made in frames.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] for a model without voxels: nothing could stand in for what is missing;
    /// [`Code::MemoryLimit`] when the budget has no room for the picture on show and the second map of photons.
    pub fn go_live(self, options: FrameOptions) -> Result<LiveSession<T>> {
        if self.model.voxels.is_none() {
            return Err(Error::new(
                Code::SceneFormat,
                "this file has no voxels to stand in for missing pages",
            )
            .at_setting(Setting::FrameDeadline)
            .numbers("frames with a deadline need them")
            .next(NextStep::BuildVoxels { or: "render without a deadline" }));
        }
        let settings = self.view.settings;
        let leases = self.shares(&settings, self.film.layers(), true).lease_live(&self.budget)?;
        let next = match (&self.photon_map, self.voxel_photons()) {
            (Some(map), Some(photons)) => {
                let mut next = NextLight::in_leases(&photons, map.irradiance().len(), leases.next);
                if map.photons() == 0 && photons.is_lit() {
                    next.begin(&photons);
                }
                Some(next)
            }
            _ => None,
        };
        let grows =
            settings.integrator == Method::FullGi && self.photon_tree.is_none() && self.sends_photons();
        let next_tree = if grows { Some(NextTree::new(&self)?) } else { None };
        let live = Live {
            options,
            display: Display::in_lease(settings.resolution, leases.display),
            next,
            next_tree,
            pass: None,
            block: Block::new(options.fetch_block),
            ladder: Ladder::new(false),
            event_at: Instant::now(),
            tiles_time: Duration::ZERO,
            finished: 0,
            first_block: None,
            event_state: 0,
            is_unordered: true,
            is_done: false,
            demand: Vec::new(),
        };
        let mut session = LiveSession { session: self, live };
        session.begin_state(Change::View);
        Ok(session)
    }
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Changes camera, lights or a material; the next frames show it.
    ///
    /// # Errors
    /// Those of [`Session::apply`]; nothing has changed then.
    pub fn apply(&mut self, event: Event) -> Result<()> {
        let change = match event {
            Event::Settings(settings) => self.resettle_live(settings)?,
            event => self.session.change(event)?,
        };
        if change != Change::Nothing {
            self.begin_state(change);
        }
        Ok(())
    }

    /// Radiance on show at pixel (x, y): that of the preview where the film has no samples of its state or a later one;
    /// the mean of the samples, and while more are to come of the preview, where both are of one state; else the mean
    /// of the samples. Linear RGB.
    pub fn shown(&self, pixel: [u32; 2]) -> [f32; 3] {
        let mut shown = [[0.0; 3]];
        self.show(pixel, &mut shown);
        shown[0]
    }

    /// What the look of a tile depends on: another stamp when it may show something else.
    pub fn tile_stamp(&self, index: u32) -> TileStamp {
        let Live { display, is_done, .. } = &self.live;
        let state = display.tile_state(index);
        let preview = state.zip(display.step());
        let samples =
            self.shows_samples(index).then(|| (self.film.tile_state(index), self.film.tile_samples(index)));
        // Samples of a later state, and all of them, have no preview in them.
        let is_mixed = samples.is_none_or(|(of, _)| !is_done && of == state);
        TileStamp { samples, preview: preview.filter(|_| is_mixed), smoothed: self.film.smoothed_of() }
    }

    /// As [`LiveSession::shown`], of as many pixels as there are places, from (x, y) on in its row; all of one tile.
    pub fn show(&self, first: [u32; 2], radiances: &mut [[f32; 3]]) {
        let tile = first.map(|x| x / TILE_SIDE_PIXELS);
        let index = tile[1] * self.view.settings.resolution[0].div_ceil(TILE_SIDE_PIXELS) + tile[0];
        let display = &self.live.display;
        let preview = display.radiances(first);
        if !self.shows_samples(index) {
            return radiances.iter_mut().zip(preview).for_each(|(shown, preview)| *shown = preview);
        }
        self.film.radiances(first, radiances);
        let is_alike = self.view.settings.integrator.has_own_preview();
        if is_alike && !self.live.is_done && self.film.tile_state(index) == display.tile_state(index) {
            let worth = display.worth(index);
            let share = worth / (worth + self.film.tile_samples(index) as f32);
            for (shown, preview) in radiances.iter_mut().zip(preview) {
                *shown = std::array::from_fn(|c| shown[c] + share * (preview[c] - shown[c]));
            }
        }
    }

    /// True when tile `index` shows its samples, false when it shows the preview.
    pub(super) fn shows_samples(&self, index: u32) -> bool {
        self.film.tile_state(index).is_some_and(|state| Some(state) >= self.live.display.tile_state(index))
    }

    /// Fills in what the preview shows between its samples, where that is still to be done.
    pub fn fill_preview(&mut self) {
        self.live.display.fill(&self.session.pool);
    }

    /// What is seen at a pixel, as [`Session::pick_until`] says.
    pub fn pick_until(&mut self, pixel: [u32; 2], stop: &dyn Fn() -> bool) -> Option<Pick> {
        self.session.pick_until(pixel, stop)
    }

    /// The session from now on: its pictures are made at leisure again, the next from its first sample on. Photons of
    /// light that has changed and are not all there are to be sent again.
    pub fn into_session(self) -> Session<T> {
        let LiveSession { mut session, live } = self;
        if !live.is_lit() {
            session.forget_photons();
        }
        session.film.clear();
        session
    }

    /// Begins a new picture, after the world has become another.
    fn begin_state(&mut self, change: Change) {
        let LiveSession { session, live } = self;
        // An event that comes before any tile is done finds a hand that moves.
        live.ladder = Ladder::new(live.finished == 0 && live.display.state().is_some());
        (live.finished, live.first_block, live.is_done, live.is_unordered) = (0, None, false, true);
        live.event_at = Instant::now();
        if change == Change::Light
            && let (Some(next), Some(photons)) = (&mut live.next, session.voxel_photons())
        {
            next.begin(&photons);
        }
        if change == Change::Light && session.view.settings.integrator == Method::FullGi {
            live.next_tree = Some(NextTree::again(live.next_tree.take())).filter(|_| session.sends_photons());
            if live.next_tree.is_none() {
                session.photon_tree = None;
            }
        }
        for tracer in &mut session.tracers {
            tracer.forget_demand();
        }
        self.begin_samples();
        self.live.event_state = self.film.state();
    }

    /// Puts the tiles of the present state in order, the stalest first. Not before a preview of it is there: what
    /// catches the eye is asked of that, and while the hand moves no tile is begun.
    pub(super) fn put_in_order(&mut self) {
        if !std::mem::take(&mut self.live.is_unordered) {
            return;
        }
        let (order, resolution) = (self.live.options.order, self.view.settings.resolution);
        let eye = match order {
            TileOrder::Saliency(_) => {
                self.live.display.release_work(&self.session.pool);
                ReducedPicture::new(resolution, |first, radiances| self.show(first, radiances))
            }
            _ => ReducedPicture::default(),
        };
        let Session { tiles, film, .. } = &mut self.session;
        *tiles = tiles.ordered(order, &eye);
        tiles.sort_by_age(|tile| film.tile_state(tile));
    }

    /// Begins to take samples in other light than that of a moment ago: what is shown stays, and counts for some
    /// samples beside those to come.
    pub(super) fn begin_light(&mut self) {
        let state = self.film.state() + 1;
        for index in 0..self.tiles.count() {
            let of = self.live.display.tile_state(index);
            if of < Some(self.live.event_state) {
                continue;
            }
            let samples = if self.film.tile_state(index) == of { self.film.tile_samples(index) } else { 0 };
            if samples > 0 {
                let Tile { first: [x, y], size: [width, height], .. } = self.tiles.tile(index);
                for y in y..y + height {
                    let mut row = [[0.0; 3]; TILE_SIDE_PIXELS as usize];
                    let row = &mut row[..width as usize];
                    self.show([x, y], row);
                    self.live.display.keep([x, y], row);
                }
            }
            self.live.display.stand(index, state, samples);
        }
        self.begin_samples();
    }

    /// Begins to take samples of another state. Those there are stay on show until there are better: the stalest are
    /// taken anew first.
    pub(super) fn begin_samples(&mut self) {
        let LiveSession { session, live } = self;
        session.film.begin_state();
        session.tiles.sort_by_age(|tile| session.film.tile_state(tile));
        live.pass = None;
    }
}

impl Live {
    /// True when no photons of changed light are on their way.
    pub(super) fn is_lit(&self) -> bool {
        self.next.as_ref().is_none_or(NextLight::is_idle) && self.next_tree.is_none()
    }

    /// True when the pages asked for since the event approach the frames there are.
    pub(super) fn is_scarce<T: PagedTracer>(&mut self, tracers: &[T]) -> bool {
        self.demand.fill(0);
        let frames = tracers.iter().map(|tracer| tracer.demand(&mut self.demand)).max().unwrap_or(0);
        let pages: u32 = self.demand.iter().map(|bits| bits.count_ones()).sum();
        frames > 0 && f64::from(pages) > DEMAND_MOST * frames as f64
    }
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Live").field("options", &self.options).finish_non_exhaustive()
    }
}

impl<T> Deref for LiveSession<T> {
    type Target = Session<T>;

    fn deref(&self) -> &Session<T> {
        &self.session
    }
}

impl<T: PagedTracer + Send> Image for LiveSession<T> {
    fn film(&self) -> &Film {
        &self.session.film
    }

    fn radiance(&self, pixel: [u32; 2]) -> [f32; 3] {
        self.shown(pixel)
    }
}
