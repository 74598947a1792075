//! Other settings for a session at work: what they make anew, and what stays.
//!
//! ```text
//! film, tiles, picture on show      another resolution, a filter switched on or off
//! room of the passes                other counts of rays that are asked together
//! photons                           another integrator, other photons, seed, bitmaps or way through the model
//! all else                          stays, and with another exposure or count of samples all samples do
//! ```
//!
//! Invariants: 1. settings that are refused, or for which there is no room, change nothing; 2. what goes makes room for
//! what comes: its bytes are taken over in one step of the ledger, and its memory is gone before the other is taken.

use super::light::{LightKind, LightRoom};
use super::live::Live;
use super::shares::SessionShares;
use super::{Change, LiveSession, Session};
use crate::scene::exposure::Exposure;
use crate::scene::method::Filter;
use crate::scene::settings::{RenderKeys, RenderSettings};
use crate::scene::world::{View, World};
use crate::trace::PagedTracer;
use trex_film::{Display, Film, Layers, Portion, Tiles};
use trex_store::{Code, Error, Lease, Result};

/// True when photons sent under one of the settings are those of the other.
fn are_lit_alike(a: &RenderSettings, b: &RenderSettings) -> bool {
    let light =
        |of: &RenderSettings| (of.integrator, of.light, of.up, of.photons, of.seed, of.occluders, of.bake);
    light(a) == light(b)
}

/// True when samples under one of the settings are those under the other: these only say how many, and how they are
/// shown.
fn are_sampled_alike(a: &RenderSettings, b: &RenderSettings) -> bool {
    let sampled = |of: &RenderSettings| RenderKeys { spp: 1, exposure: Exposure::Auto, ..**of };
    sampled(a) == sampled(b)
}

/// The shares before and after other settings.
#[derive(Clone, Copy)]
struct Exchange {
    before: SessionShares,
    after: SessionShares,
}

impl Exchange {
    fn has_other_film(&self) -> bool {
        self.after.has_other_film(&self.before)
    }

    fn has_other_light(&self) -> bool {
        self.after.has_other_light(&self.before)
    }
}

impl<T: PagedTracer + Send> Session<T> {
    /// Takes other settings, with what is `live` of it. The film is empty, or still that of the state before.
    pub(super) fn resettle(
        &mut self,
        mut live: Option<&mut Live>,
        settings: RenderSettings,
    ) -> Result<Change> {
        self.check_whole()?;
        let before = self.view.settings;
        let view = View { settings, ..self.view.clone() };
        let world = World::new(&self.model, &view)?;
        let exchange = self.exchange(live.is_some(), &settings);
        let budget = self.budget.clone();
        // What is there if there is room makes way.
        if let Some(live) = live.as_deref_mut().filter(|_| exchange.has_other_film()) {
            live.display.keep_no_light();
        }
        let mut old = self.leases_that_go(&exchange, live.as_deref_mut());
        let bytes = exchange.after.bytes_after(&exchange.before);
        let exchanged = budget.exchange("a picture by these settings", bytes, &mut old);
        if let Some(live) = live.as_deref_mut().filter(|_| exchanged.is_err() && exchange.has_other_film()) {
            live.display.keep_light(&live.options.kept_light(), &budget);
        }
        let mut room = exchanged?;
        self.let_go(&exchange, live.as_deref_mut(), &mut room);
        (self.view, self.world) = (view, world);
        self.make(&exchange, live, &mut room);
        let is_lit_alike = !exchange.has_other_light() && are_lit_alike(&before, &settings);
        Ok(match (is_lit_alike, are_sampled_alike(&before, &settings)) {
            (true, true) => Change::Nothing,
            (true, false) => Change::View,
            (false, _) => Change::Light,
        })
    }

    /// True when the film is of a part of the picture alone.
    pub(super) fn is_portion(&self) -> bool {
        self.film.portion() != Portion::whole(self.view.settings.resolution, 0)
    }

    /// Refuses what a session of a part of a picture does not do.
    pub(super) fn check_whole(&self) -> Result<()> {
        if !self.is_portion() {
            return Ok(());
        }
        let Portion { tiles: [first, end], .. } = self.film.portion();
        Err(Error::new(Code::Usage, "a part of a picture takes no other settings, and has no deadline")
            .at_place("the session")
            .numbers(format!("its film is of tiles {first}..{end}"))
            .next("make the picture as a whole, or another session"))
    }

    fn exchange(&self, is_live: bool, settings: &RenderSettings) -> Exchange {
        let layers = Layers { filter: settings.filter == Filter::On, ..self.film.layers() };
        Exchange {
            before: self.shares(&self.view.settings, self.film.layers(), is_live),
            after: self.shares(settings, layers, is_live),
        }
    }

    fn leases_that_go<'a>(
        &'a mut self,
        exchange: &Exchange,
        live: Option<&'a mut Live>,
    ) -> Vec<&'a mut Lease> {
        let mut leases = vec![&mut self.lease];
        if exchange.has_other_light() {
            leases.extend(self.light.leases_mut());
        }
        if exchange.has_other_film() {
            leases.push(self.film.lease_mut());
            leases.extend(live.map(|live| live.display.lease_mut()));
        }
        leases
    }

    /// Lets go what is made anew.
    fn let_go(&mut self, exchange: &Exchange, live: Option<&mut Live>, room: &mut Lease) {
        let nothing = [0, 0];
        if exchange.has_other_light() {
            self.light = LightKind::None.light(LightRoom { lasting: room.split(0), in_frames: None });
        }
        if exchange.has_other_film() {
            self.film = Film::in_lease(nothing, Layers::default(), room.split(0));
        }
        if let Some(live) = live {
            live.tiles.restart();
            if exchange.has_other_film() {
                live.display = Display::in_lease(nothing, room.split(0));
            }
        }
    }

    /// Makes it, in its `room`.
    fn make(&mut self, exchange: &Exchange, live: Option<&mut Live>, room: &mut Lease) {
        let (after, resolution) = (&exchange.after, self.view.settings.resolution);
        self.lease = room.split(after.pass_bytes);
        if exchange.has_other_film() {
            self.film = Film::in_lease(resolution, after.layers, room.split(after.film_bytes));
            self.tiles = Tiles::z_curve(resolution);
        }
        if exchange.has_other_light() {
            let lasting = room.split(after.light_bytes.lasting);
            let in_frames = live.is_some().then(|| room.split(after.light_bytes.in_frames));
            self.light = after.light.light(LightRoom { lasting, in_frames });
        }
        let Some(live) = live else { return };
        if exchange.has_other_film() {
            live.display = Display::in_lease(resolution, room.split(after.display_bytes));
            live.display.keep_light(&live.options.kept_light(), &self.budget);
        }
    }
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Takes other settings; the picture on show goes with a film that goes.
    pub(super) fn resettle_live(&mut self, settings: RenderSettings) -> Result<Change> {
        self.session.resettle(Some(&mut self.live), settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::method::Method;
    use crate::session::tests::{floor, sun};
    use crate::session::{Event, FetchBlock, FrameOptions, FrameProgress};
    use std::ops::ControlFlow;
    use std::time::Duration;
    use trex_store::RESERVE_BYTES;

    const SPP: u32 = 2;

    fn keys() -> RenderKeys {
        let (integrator, resolution) = (Method::Photon, [32, 24]);
        RenderKeys { integrator, resolution, photons: 30_000, n_shadow: 1, ..RenderKeys::default() }
    }

    /// Settings far from each other: each differs from the one before in something else.
    fn tour() -> Vec<RenderKeys> {
        let keys = keys();
        let small = RenderKeys { resolution: [9, 40], ..keys };
        let smooth = RenderKeys { filter: Filter::On, ..small };
        let many = RenderKeys { n_shadow: 3, n_gather: 5, photons: 50_000, ..smooth };
        let other = RenderKeys { integrator: Method::Ao, filter: Filter::Off, ..many };
        let near = RenderKeys { lod_error: 2.0, seed: 7, ..keys };
        let full = RenderKeys { integrator: Method::FullGi, k_nearest: 9, photons: 5_000, ..keys };
        vec![keys, small, smooth, many, other, near, full, keys, RenderKeys { caustics: true, ..keys }]
    }

    fn settings(keys: RenderKeys) -> RenderSettings {
        RenderSettings::new(keys).unwrap()
    }

    fn pixels(film: &Film) -> Vec<[u32; 3]> {
        let [width, height] = film.resolution();
        let places = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        places.map(|pixel| film.radiance(pixel).map(f32::to_bits)).collect()
    }

    /// The picture of a session that had `keys` from the beginning.
    fn fresh(keys: RenderKeys) -> Vec<[u32; 3]> {
        finished(&mut floor(keys))
    }

    fn finished<T: PagedTracer + Send>(session: &mut Session<T>) -> Vec<[u32; 3]> {
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(SPP, &|| false, &mut |_, _| ControlFlow::Continue(()));
        session.smooth().unwrap();
        pixels(session.film())
    }

    fn done<T: PagedTracer + Send>(live: &mut LiveSession<T>) -> Vec<[u32; 3]> {
        (0..10_000).find(|_| live.frame(SPP, &|| false).progress == FrameProgress::Done).unwrap();
        pixels(live.film())
    }

    fn options() -> FrameOptions {
        let t_max = Duration::from_millis(50);
        FrameOptions { t_max, fetch_block: FetchBlock::Tiles(4), ..FrameOptions::default() }
    }

    #[test]
    fn a_session_with_other_settings_is_as_one_that_had_them_from_the_beginning() {
        let (mut session, mut live) = (floor(keys()), floor(keys()).go_live(options()).unwrap());
        for keys in tour() {
            session.apply(Event::Settings(settings(keys))).unwrap();
            live.apply(Event::Settings(settings(keys))).unwrap();
            let expected = fresh(keys);
            assert!(finished(&mut session) == expected, "at leisure: {keys:?}");
            assert!(done(&mut live) == expected, "in frames: {keys:?}");
            // A second event while the first is under way.
            live.apply(Event::Settings(settings(RenderKeys { seed: 3, ..keys }))).unwrap();
            live.frame(SPP, &|| false);
        }
        live.apply(Event::Lights(sun(1.0))).unwrap();
        live.frame(SPP, &|| false);
        let mut session = live.into_session();
        session.apply(Event::Settings(settings(keys()))).unwrap();
        assert!(finished(&mut session) == fresh(keys()), "at leisure after frames");
    }

    #[test]
    fn photons_stay_where_they_are_the_same() {
        let mut session = floor(keys());
        let sent = |session: &mut Session<_>| session.illuminate(&|| false, &mut |_, _| {}).unwrap().photons;
        assert_eq!(sent(&mut session), 30_000);
        for (keys, photons) in [
            (RenderKeys { resolution: [50, 50], ..keys() }, 0),
            (RenderKeys { lod_error: 1.0, n_gather: 7, exposure: Exposure::Factor(2.0), ..keys() }, 0),
            (RenderKeys { seed: 2, ..keys() }, 30_000),
            (RenderKeys { photons: 20_000, seed: 2, ..keys() }, 20_000),
        ] {
            session.apply(Event::Settings(settings(keys))).unwrap();
            assert_eq!(sent(&mut session), photons, "{keys:?}");
        }
    }

    /// Under a limit that has room for the picture before or for the one after, but not for both.
    #[test]
    fn what_goes_makes_room_for_what_comes_and_what_has_no_room_changes_nothing() {
        for keys in tour().into_iter().skip(1) {
            let mut live = floor(self::keys()).go_live(options()).unwrap();
            let before = done(&mut live);
            let budget = live.session.budget.clone();
            let mut expected = floor(keys).go_live(options()).unwrap();
            done(&mut expected);
            // What is there only if there is room is not counted.
            expected.live.display.keep_no_light();
            live.live.display.keep_no_light();
            let needed = expected.session.budget.used_bytes();
            let held = budget.used_bytes();
            // Full-gi takes what it needs when its photons are sent.
            let asked = if keys.integrator == Method::FullGi { held } else { needed };
            if asked > held {
                budget.set_limit(RESERVE_BYTES + asked - 1);
                let error = live.apply(Event::Settings(settings(keys))).unwrap_err();
                assert_eq!(error.code(), Code::MemoryLimit, "{keys:?}");
                assert_eq!(error.smallest_limit_bytes(), Some(RESERVE_BYTES + asked), "{keys:?}");
                assert!(done(&mut live) == before && live.view().settings == settings(self::keys()));
                live.live.display.keep_no_light();
                assert_eq!(budget.used_bytes(), held, "{keys:?}");
            }
            budget.set_limit(RESERVE_BYTES + held.max(asked));
            live.apply(Event::Settings(settings(keys))).unwrap_or_else(|error| panic!("{keys:?}: {error}"));
            budget.set_limit(u64::MAX);
            assert!(done(&mut live) == done(&mut expected), "{keys:?}");
            live.live.display.keep_no_light();
            assert_eq!(budget.used_bytes(), needed, "{keys:?}");
        }
    }

    /// Photons of `full-gi` on their way, and the thread that makes their tree, once kept their room while other
    /// settings asked for it: under a limit that has room for either light they were refused.
    #[test]
    fn photons_on_their_way_make_room_for_another_light() {
        const PHOTONS: u64 = 200_000;
        let full = RenderKeys { integrator: Method::FullGi, photons: PHOTONS, ..keys() };
        let other = RenderKeys { resolution: [200, 200], ..keys() };
        let mut expected = floor(other).go_live(options()).unwrap();
        let expected_film = done(&mut expected);
        expected.live.display.keep_no_light();
        let whole = PHOTONS as f64 / (PHOTONS + 1) as f64;
        for (share, event) in [(1e-9, None), (whole, None), (whole, Some(Event::Lights(sun(2.0))))] {
            let t_max = Duration::from_millis(1);
            let mut live = floor(full).go_live(FrameOptions { t_max, ..options() }).unwrap();
            (0..10_000).find(|_| live.frame(SPP, &|| false).light_share >= share).unwrap();
            assert!(live.light.share() < 1.0);
            let is_lit_anew = event.is_some();
            event.into_iter().for_each(|event| live.apply(event).unwrap());
            let budget = live.session.budget.clone();
            let (held, needed) = (budget.used_bytes(), expected.session.budget.used_bytes());
            assert!(needed < held, "{needed} {held}");
            budget.set_limit(RESERVE_BYTES + held);
            live.apply(Event::Settings(settings(other))).unwrap();
            budget.set_limit(u64::MAX);
            live.apply(Event::Lights(sun(1.0))).unwrap();
            assert!(done(&mut live) == expected_film, "{share} {is_lit_anew}");
            live.live.display.keep_no_light();
            assert_eq!(budget.used_bytes(), needed);
        }
    }

    #[test]
    fn samples_stay_where_they_are_the_same() {
        let (mut session, mut live) = (floor(keys()), floor(keys()).go_live(options()).unwrap());
        let (film, shown) = (finished(&mut session), done(&mut live));
        let other =
            Event::Settings(settings(RenderKeys { exposure: Exposure::Factor(3.0), spp: 99, ..keys() }));
        session.apply(other.clone()).unwrap();
        live.apply(other).unwrap();
        assert!(pixels(session.film()) == film && pixels(live.film()) == shown);
        assert_eq!(live.frame(SPP, &|| false).progress, FrameProgress::Done);
        assert!(live.frame(SPP + 1, &|| false).pass.samples > 0 && live.film().samples() == SPP);
        session.apply(Event::Settings(settings(RenderKeys { seed: 5, ..keys() }))).unwrap();
        assert_eq!(session.film().samples(), 0);
    }

    /// The stamps of tiles tell of each change of what is shown, and of none where there is none.
    #[test]
    fn stamps_change_where_the_picture_does() {
        let mut live = floor(keys()).go_live(options()).unwrap();
        let shown = |live: &LiveSession<_>| {
            let tile = |index: u32| {
                let [x, y] = [index % 4 * 8, index / 4 * 8];
                let row = |y| (x..x + 8).map(move |x| [x, y]);
                let pixels: Vec<_> =
                    (y..y + 8).flat_map(row).map(|pixel| live.shown(pixel).map(f32::to_bits)).collect();
                (pixels, live.tile_stamp(index))
            };
            (0..12).map(tile).collect::<Vec<_>>()
        };
        let mut events =
            vec![Event::Lights(sun(3.0)), Event::Settings(settings(RenderKeys { lod_error: 9.0, ..keys() }))];
        let (mut before, mut changes) = (shown(&live), 0);
        loop {
            let progress = live.frame(5, &|| false).progress;
            let now = shown(&live);
            for (tile, (before, now)) in before.iter().zip(&now).enumerate() {
                assert!(before.0 == now.0 || before.1 != now.1, "tile {tile}: {:?}", now.1);
                changes += u32::from(before.1 != now.1);
            }
            before = now;
            if progress == FrameProgress::Done {
                let Some(event) = events.pop() else { break };
                live.frame(5, &|| false);
                assert!(shown(&live) == before, "nothing changes once it is done");
                live.apply(event).unwrap();
            }
        }
        // Two previews, five samples and five times anew for each tile, thrice, and little more.
        assert!((3 * 12 * 5..3 * 12 * 15).contains(&changes), "{changes}");
    }

    #[test]
    fn a_pick_is_what_the_pixel_shows() {
        let mut session = floor(keys());
        let camera = session.view().camera;
        let pick = session.pick([16, 12]).unwrap();
        assert!(pick.position[2].abs() < 1e-9 && (pick.shaded.hit.t - 3.0).abs() < 0.1, "{pick:?}");
        let away = crate::scene::camera::Camera { target: [0.0, 0.0, 9.0], ..camera };
        session.apply(Event::Camera(away)).unwrap();
        assert_eq!(session.pick([16, 12]), None);
    }
}
