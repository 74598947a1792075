//! Frames with a deadline: what a viewer shows while the user moves. Paper, section 5.2.
//!
//! ```text
//! event -> preview frames: C-rays through what is resident, in its light: every 8th, 4th, 2nd pixel    whole picture
//!       -> frames: tiles, the stalest first, until a fetch block is done                              response
//!       -> frames: photons, where light has changed, and tiles, until a block is done, the picture is
//!                  complete or t_max has passed
//!       -> ...     every pixel has a sample                                                           complete picture
//! ```
//!
//! The first fetch block counts from the event. Its tiles are shown together.
//!
//! While samples are few the preview, which is smoothed, is mixed in, and counts less with each sample: no picture is
//! further from the truth than the one before. The light of the samples comes into it from time to time, until they are
//! some (`Display::refresh`). Where photons have come in, and samples are to be taken anew, what was
//! shown until then takes the preview's place.
//!
//! A *state* is what samples are of: it changes with each event, and each time that more photons are in. A tile shows
//! its samples until it has some of the present state, unless the preview is of a later one.
//!
//! Without voxels nothing stands in for pages that are missing: the background is seen there, and no shadow falls,
//! until exact tiles come.
//!
//! Where the pages in demand approach the frames there are, no tile is begun while others wait for theirs. Tried and
//! taken out: a governor that raised the error of the footprint rule until every pixel had a sample. The preview is
//! there sooner, and a complete picture of the plant came twice as late (`docs/measurements.md`).
//!
//! Invariants: 1. no pixel shows nothing, or what was there before the event, after the first frame, unless that was
//! stopped; 2. nothing of a preview is ever on the film; 3. once the view stands still, the film goes to the same bytes
//! as [`super::Session::render`]'s.

#[cfg(test)]
mod tests;

use super::carried_light::CarriedLight;
use super::event_state::EventState;
use super::fetch_block::FetchBlock;
use super::foresight::Foresight;
use super::ladder::Ladder;
use super::tile_run::TileRun;
use super::{Change, Event, Pick, Session};
use crate::trace::PagedTracer;
use std::ops::Deref;
use std::time::{Duration, Instant};
use trex_film::{Display, Film, Image, KeptLight, ReducedPicture, TILE_SIDE_PIXELS, Tile, TileOrder};
use trex_store::Result;

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
    /// True when pages of the view that is likely to come next are read ahead, where there is room for them.
    pub looks_ahead: bool,
    /// True when the light of the picture before is carried to where its surfaces are seen after the camera has moved.
    pub carries_light: bool,
    /// True when that of earlier pictures is kept where it is in the world, too.
    pub caches_light: bool,
    /// Most bytes for both: what memory was planned for them. They are kept where there is room.
    pub kept_light_bytes: u64,
}

impl Default for FrameOptions {
    fn default() -> FrameOptions {
        FrameOptions {
            t_max: Duration::from_millis(100),
            fetch_block: FetchBlock::default(),
            order: TileOrder::default(),
            fills_while_moving: true,
            looks_ahead: false,
            carries_light: true,
            caches_light: true,
            kept_light_bytes: u64::MAX,
        }
    }
}

impl FrameOptions {
    pub(super) fn kept_light(&self) -> KeptLight {
        KeptLight {
            in_picture: self.carries_light,
            in_world: self.caches_light,
            most_bytes: self.kept_light_bytes,
        }
    }
}

/// See [`LiveSession::tile_stamp`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileStamp {
    /// State and count of the samples that are shown.
    samples: Option<(Option<u32>, u32)>,
    /// State and step of the preview that is, and how often it was made anew.
    preview: Option<(u32, u32, u32)>,
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

/// The state between frames, beside the session. What changes within a part is written by that part's file alone; the
/// display as a whole is exchanged by `resettle.rs`, and an event begins another [`EventState`].
pub(super) struct Live {
    pub(super) options: FrameOptions,
    pub(super) display: Display,
    pub(super) event: EventState,
    pub(super) tiles: TileRun,
    pub(super) foresight: Foresight,
    pub(super) carried: CarriedLight,
}

impl<T: PagedTracer + Send> Session<T> {
    /// The session from now on: its pictures are made in frames.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the picture on show and the second map of
    /// photons; [`trex_store::Code::Usage`] for a session of a part of a picture.
    pub fn go_live(mut self, options: FrameOptions) -> Result<LiveSession<T>> {
        self.check_whole()?;
        let settings = self.view.settings;
        let leases = self.shares(&settings, self.film.layers(), true).lease_live(&self.budget)?;
        let (light, work) = self.light_parts(&|| false);
        light.go_live(&work, leases.light)?;
        let mut display = Display::in_lease(settings.resolution, leases.display);
        display.keep_light(&options.kept_light(), &self.budget);
        let live = Live {
            options,
            display,
            event: EventState::new(Instant::now(), 0, Ladder::new(false)),
            tiles: TileRun::new(options.fetch_block),
            foresight: Foresight::default(),
            carried: CarriedLight::default(),
        };
        let mut session = LiveSession { session: self, live };
        session.begin_state(Change::View);
        Ok(session)
    }
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// How frames are made.
    pub fn frame_options(&self) -> &FrameOptions {
        &self.live.options
    }

    /// Keeps light of before in at most so many bytes from now on.
    pub fn keep_light_within(&mut self, bytes: u64) {
        let Live { options, display, .. } = &mut self.live;
        options.kept_light_bytes = bytes;
        display.keep_light(&options.kept_light(), &self.session.budget);
    }

    /// Changes camera, lights or a material; the next frames show it.
    ///
    /// # Errors
    /// Those of [`Session::apply`]; nothing has changed then.
    pub fn apply(&mut self, event: Event) -> Result<()> {
        let (from, view) = (self.view.camera, self.world.projection);
        let (moves, lights) =
            (matches!(event, Event::Camera(_)), matches!(event, Event::Lights(_) | Event::Material { .. }));
        let change = match event {
            Event::Settings(settings) => self.resettle_live(settings)?,
            event => self.session.change(event)?,
        };
        if self.view.camera != from {
            self.note_camera(from);
        }
        if change != Change::Nothing {
            let Live { options, display, carried, .. } = &mut self.live;
            if (moves || lights) && options.carries_light {
                carried.note_change(display, view, lights);
            } else {
                carried.forget(display);
            }
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
        let Live { display, event, .. } = &self.live;
        let state = display.tile_state(index);
        let preview = state.zip(display.step()).map(|(state, step)| (state, step, display.refreshes()));
        let samples =
            self.shows_samples(index).then(|| (self.film.tile_state(index), self.film.tile_samples(index)));
        // Samples of a later state, and all of them, have no preview in them.
        let is_mixed = samples.is_none_or(|(of, _)| !event.is_done() && of == state);
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
        let samples = self.film.tile_worth(index);
        // Of samples from before an event nothing says how many they are: they are shown as they are.
        if is_alike
            && samples > 0
            && !self.live.event.is_done()
            && self.film.tile_state(index) == display.tile_state(index)
        {
            for (x, (shown, preview)) in (first[0]..).zip(radiances.iter_mut().zip(preview)) {
                *shown = display.mixed((index, [x, first[1]]), (samples, *shown), preview);
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
        let LiveSession { mut session, .. } = self;
        session.light.leave_frames();
        session.film.clear();
        session
    }

    /// Begins a new picture, after the world has become another.
    fn begin_state(&mut self, change: Change) {
        let LiveSession { session, live } = self;
        // An event that comes before any tile is done finds a hand that moves.
        let ladder = Ladder::new(live.event.finished() == 0 && live.display.state().is_some());
        let event_at = Instant::now();
        if change == Change::Light {
            let (light, work) = session.light_parts(&|| false);
            light.restart(&work);
        }
        for tracer in &mut session.tracers {
            tracer.forget_demand();
        }
        self.begin_samples();
        self.live.event = EventState::new(event_at, self.film.state(), ladder);
    }

    /// Puts the tiles of the present state in order, the stalest first. Not before a preview of it is there: what is
    /// likely to be wrong, and what catches the eye, is asked of that, and while the hand moves no tile is begun.
    pub(super) fn put_in_order(&mut self) {
        if !self.live.event.note_order() {
            return;
        }
        let (order, resolution) = (self.live.options.order, self.view.settings.resolution);
        let eye = match order {
            TileOrder::Saliency(_) | TileOrder::Error(_) => {
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
            if of < Some(self.live.event.film_state) {
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
        live.tiles.restart();
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
