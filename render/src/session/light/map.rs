//! `MapLight`: the light of `photon`, irradiance by the sides of the octree's facets. Photons go through the voxels;
//! where light is baked, those of a session at leisure through the exact mesh.
//!
//! ```text
//! at leisure   photons of a pass -> sums -> map on show
//! in frames    an edit -> second map, empty; its passes come in while the first one is on show
//!              gather rays find  first + share * (second - first)
//!              all are in -> the maps are swapped
//! ```
//!
//! The first light of all has nothing to be blended with, and is found as it comes.

use super::indirect::{Arrival, IndirectLight, LightBytes, LightRoom, LightWork};
use crate::g_stage::GNeeds;
use crate::photon::bake::BakeJob;
use crate::photon::irradiance::{Irradiance, MapForm, PhotonMap};
use crate::photon::mesh::flight_bytes;
use crate::photon::voxel::{PassInWork, VoxelPhotons, flock_bytes};
use crate::scene::settings::{RenderKeys, RenderSettings};
use crate::stats::PhotonStats;
use std::time::Instant;
use trex_store::{Lease, Result};

/// Irradiance by side, and in frames what comes after it.
#[derive(Debug)]
pub(super) struct MapLight {
    shown: PhotonMap,
    /// `None` at leisure.
    next: Option<NextMap>,
}

/// The light that comes after a change, in a map of its own.
#[derive(Debug)]
struct NextMap {
    map: PhotonMap,
    work: PassInWork,
    /// Share of its photons that are there, 0 to 1; `None` when nothing comes.
    share: Option<f32>,
}

impl MapLight {
    /// What light of this form takes: the map on show; in frames a second one, and the sums of a pass, which come
    /// and go at leisure.
    pub(super) fn bytes(
        form: MapForm,
        settings: &RenderSettings,
        (workers, g_needs): (usize, &GNeeds),
    ) -> LightBytes {
        let (map, pass) = (form.bytes(), form.pass_bytes());
        let photons = if settings.bake { flight_bytes(workers) } else { 0 };
        LightBytes {
            lasting: map,
            in_frames: map + pass,
            pass,
            flocks: flock_bytes(workers, g_needs),
            photons,
            photons_in_frames: photons,
        }
    }

    /// Dark light of this form, in its `room`.
    pub(super) fn new(form: MapForm, room: LightRoom) -> MapLight {
        let next = room.in_frames.map(|room| NextMap::new(form, room));
        MapLight { shown: PhotonMap::in_lease(form, room.lasting), next }
    }

    /// Sends the photons that the sides of facets still lack through the mesh.
    fn bake(&mut self, work: &mut LightWork<'_>, tell: &mut dyn FnMut(u64, u64)) -> Result<PhotonStats> {
        let LightWork { world, model, budget, pool, stop, .. } = *work;
        let Some(voxels) = &model.voxels else { return Ok(PhotonStats::default()) };
        let _flights = budget.lease("the photons under way", flight_bytes(work.tracers.count()))?;
        let RenderKeys { photons: target, occluders, .. } = *world.settings;
        let voxels = voxels.scene(occluders);
        let baking = BakeJob { world, bounds: &model.bounds, voxels, budget, stop, pool };
        baking.trace(&mut self.shown, work.tracers, target, &mut |done| tell(done, target))
    }
}

impl IndirectLight for MapLight {
    fn leases_mut(&mut self) -> Vec<&mut Lease> {
        let next = self.next.iter_mut().flat_map(|next| [next.map.lease_mut(), next.work.lease_mut()]);
        [self.shown.lease_mut()].into_iter().chain(next).collect()
    }

    fn forget(&mut self) {
        self.shown.clear();
    }

    fn illuminate(
        &mut self,
        work: &mut LightWork<'_>,
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        if work.world.settings.bake {
            return self.bake(work, tell);
        }
        let target = work.world.settings.photons;
        let Some(photons) = work.voxel_photons() else { return Ok(PhotonStats::default()) };
        let mut pass = photons.begin(self.shown.form())?;
        let stats =
            photons.trace((&mut pass, &mut self.shown), target, work.stop, &mut |done| tell(done, target));
        // A pass that was stopped is light, too.
        photons.fold(&mut pass, &mut self.shown);
        Ok(stats)
    }

    fn go_live(&mut self, work: &LightWork<'_>, room: Lease) -> Result<()> {
        let next = self.next.insert(NextMap::new(self.shown.form(), room));
        if self.shown.photons() < work.world.settings.photons
            && let Some(photons) = work.voxel_photons().filter(VoxelPhotons::is_lit)
        {
            next.restart(&photons);
        }
        Ok(())
    }

    fn leave_frames(&mut self) {
        if !self.is_whole() {
            self.forget();
        }
        self.next = None;
    }

    fn restart(&mut self, work: &LightWork<'_>) {
        if let (Some(next), Some(photons)) = (&mut self.next, work.voxel_photons()) {
            next.restart(&photons);
        }
    }

    fn advance(&mut self, work: &mut LightWork<'_>, deadline: Instant) -> (u64, Arrival) {
        let (Some(next), Some(photons)) = (&mut self.next, work.voxel_photons()) else {
            return (0, Arrival::Nothing);
        };
        let stop = || Instant::now() >= deadline || (work.stop)();
        next.advance(&photons, &mut self.shown, work.world.settings.photons, &stop)
    }

    fn share(&self) -> f64 {
        self.next.as_ref().and_then(|next| next.share).map_or(1.0, f64::from)
    }

    fn is_whole(&self) -> bool {
        self.next.as_ref().is_none_or(|next| next.share.is_none())
    }

    fn precedes_response(&self) -> bool {
        self.shown.photons() == 0
    }

    fn irradiance(&self) -> Irradiance<'_> {
        let next = self.next.as_ref().and_then(|next| {
            let is_first = self.shown.photons() == 0 && next.map.photons() > 0;
            let share = next.share?;
            Some((&next.map, if is_first { 1.0 } else { share }))
        });
        Irradiance::new(&self.shown, next)
    }

    fn photon_map(&self) -> Option<&PhotonMap> {
        Some(&self.shown)
    }
}

impl NextMap {
    /// The second map of this form and the sums of a pass, in a lease of both; nothing is on its way.
    fn new(form: MapForm, mut room: Lease) -> NextMap {
        let map = PhotonMap::in_lease(form, room.split(form.bytes()));
        NextMap { map, work: PassInWork::in_lease(form, room), share: None }
    }

    /// Begins anew: what was on its way is out of date.
    fn restart(&mut self, photons: &VoxelPhotons<'_>) {
        self.map.clear();
        photons.restart(&mut self.work);
        self.share = Some(0.0);
    }

    /// Sends photons until `stop` says so, and swaps the maps when the `target` is reached.
    fn advance(
        &mut self,
        photons: &VoxelPhotons<'_>,
        shown: &mut PhotonMap,
        target: u64,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (u64, Arrival) {
        if self.share.is_none() {
            return (0, Arrival::Nothing);
        }
        let before = self.map.photons();
        let stats = photons.trace((&mut self.work, &mut self.map), target, stop, &mut |_| {});
        self.share = Some((self.map.photons() as f64 / target as f64) as f32);
        // Without any light there is nothing to wait for.
        let is_done = self.map.photons() >= target || !photons.is_lit();
        if is_done {
            std::mem::swap(&mut self.map, shown);
            self.share = None;
        }
        (stats.rays, if is_done || self.map.photons() > before { Arrival::Blended } else { Arrival::Nothing })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon::trace::PASS_PHOTONS;
    use crate::scene::method::Method;
    use crate::scene::settings::RenderKeys;
    use crate::session::tests::{floor, sun};
    use crate::session::{Event, Session};
    use crate::trace::PagedTracer;
    use glam::Vec3;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::Duration;

    const TARGET: u64 = 3 * PASS_PHOTONS;
    /// Batches that end within the second pass of three.
    const BATCHES: u64 = 700;

    fn session() -> Session<impl PagedTracer + Send> {
        let integrator = Method::Photon;
        floor(RenderKeys { integrator, resolution: [8, 8], photons: TARGET, ..RenderKeys::default() })
    }

    fn form<T>(session: &Session<T>) -> MapForm {
        MapForm { facets: session.model.voxels.as_ref().unwrap().facet_count(), caustics: false }
    }

    /// The light of `session`, sent in one go.
    fn whole<T: PagedTracer + Send>(session: &mut Session<T>, photons: u64) -> PhotonMap {
        let mut map = PhotonMap::new(form(session), &session.budget).unwrap();
        let (_, work) = session.light_parts(&|| false);
        let world = work.voxel_photons().unwrap();
        world.trace((&mut world.begin(map.form()).unwrap(), &mut map), photons, &|| false, &mut |_| {});
        assert_eq!(map.photons(), photons);
        map
    }

    /// Light in frames of which `shown` is on show, and nothing on its way.
    fn in_frames<T: PagedTracer + Send>(session: &Session<T>, shown: PhotonMap) -> MapLight {
        let form = form(session);
        let lease = |bytes| session.budget.lease("light", bytes).unwrap();
        let (map, pass) = (form.bytes(), form.pass_bytes());
        let room = LightRoom { lasting: lease(map), in_frames: Some(lease(map + pass)) };
        MapLight { shown, ..MapLight::new(form, room) }
    }

    fn restart<T: PagedTracer + Send>(session: &mut Session<T>, light: &mut MapLight) {
        light.restart(&session.light_parts(&|| false).1);
        assert_eq!((light.is_whole(), light.share()), (false, 0.0));
    }

    /// Sends photons until `stop` says so. The count of rays, and true when the light on show has changed.
    fn advance<T: PagedTracer + Send>(
        session: &mut Session<T>,
        light: &mut MapLight,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (u64, bool) {
        let deadline = Instant::now() + Duration::from_secs(3600);
        let (rays, arrival) = light.advance(&mut session.light_parts(stop).1, deadline);
        assert_ne!(arrival, Arrival::Replaced);
        (rays, arrival == Arrival::Blended)
    }

    /// Sends the photons of some batches. True when the light on show has changed.
    fn some<T: PagedTracer + Send>(session: &mut Session<T>, light: &mut MapLight) -> bool {
        let asked = AtomicU64::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= BATCHES;
        let (rays, has_changed) = advance(session, light, &stop);
        assert!(rays > 0);
        has_changed
    }

    /// Sends what is left.
    fn rest<T: PagedTracer + Send>(session: &mut Session<T>, light: &mut MapLight) -> bool {
        advance(session, light, &|| false).1
    }

    /// The light that gather rays find is `of` each side, but for what packing rounds.
    fn check(light: &MapLight, of: impl Fn(usize) -> Vec3) {
        let found = light.irradiance();
        for side in 0..light.shown.irradiance().len() {
            let (found, expected) = (found.at(side as u32), of(side));
            let is_near = found.abs_diff_eq(expected, 4e-4 * expected.max_element());
            assert!(is_near, "{side}: {found} {expected}");
        }
    }

    fn at(map: &PhotonMap) -> impl Fn(usize) -> Vec3 + '_ {
        let light: Vec<_> = map.irradiance().collect();
        move |side| light[side].into()
    }

    fn mean(map: &PhotonMap) -> f32 {
        map.irradiance().map(|rgb| rgb[0]).sum::<f32>() / map.irradiance().len() as f32
    }

    #[test]
    fn the_first_light_of_all_is_there_in_full_with_its_first_pass() {
        let mut session = session();
        let dark = PhotonMap::new(form(&session), &session.budget).unwrap();
        let mut light = in_frames(&session, dark);
        assert!(light.precedes_response());
        restart(&mut session, &mut light);
        check(&light, |_| Vec3::ZERO);
        assert!(some(&mut session, &mut light));
        assert_eq!(light.share() as f32, 1.0 / 3.0);
        check(&light, at(&whole(&mut session, PASS_PHOTONS)));
    }

    #[test]
    fn other_light_is_blended_in_by_its_share_and_swapped_when_it_is_whole() {
        let mut session = session();
        let before = whole(&mut session, PASS_PHOTONS);
        let shown = whole(&mut session, PASS_PHOTONS);
        let mut light = in_frames(&session, shown);
        assert_eq!((light.is_whole(), light.share(), light.precedes_response()), (true, 1.0, false));
        assert!(!rest(&mut session, &mut light));

        session.change(Event::Lights(sun(5.0))).unwrap();
        restart(&mut session, &mut light);
        check(&light, at(&before));
        assert!(some(&mut session, &mut light));
        assert_eq!(light.share() as f32, 1.0 / 3.0);
        let part = whole(&mut session, PASS_PHOTONS);
        assert!(mean(&before) > 0.1 && (mean(&part) / mean(&before) - 5.0).abs() < 0.1);
        check(&light, |facet| (2.0 * at(&before)(facet) + at(&part)(facet)) / 3.0);

        assert!(rest(&mut session, &mut light));
        assert_eq!((light.is_whole(), light.share()), (true, 1.0));
        let all = whole(&mut session, TARGET);
        assert!(light.shown.irradiance().eq(all.irradiance()));
        check(&light, at(&all));
        assert!(!rest(&mut session, &mut light));
    }

    /// What was on its way is half a pass of another sun: none of it may come in.
    #[test]
    fn an_edit_forgets_what_was_on_its_way() {
        let mut session = session();
        let before = whole(&mut session, PASS_PHOTONS);
        let shown = whole(&mut session, PASS_PHOTONS);
        let mut light = in_frames(&session, shown);
        session.change(Event::Lights(sun(5.0))).unwrap();
        restart(&mut session, &mut light);
        some(&mut session, &mut light);

        session.change(Event::Lights(sun(2.0))).unwrap();
        restart(&mut session, &mut light);
        assert_eq!(light.next.as_ref().unwrap().map.photons(), 0);
        check(&light, at(&before));
        rest(&mut session, &mut light);
        assert!(light.shown.irradiance().eq(whole(&mut session, TARGET).irradiance()));

        session.change(Event::Lights(sun(0.0))).unwrap();
        restart(&mut session, &mut light);
        assert!(rest(&mut session, &mut light) && light.is_whole());
        check(&light, |_| Vec3::ZERO);
    }

    /// What has been sent when it is stopped is light, also in the middle of a pass; later photons come on top of it.
    #[test]
    fn photons_of_a_pass_that_is_stopped_count() {
        let mut session = session();
        let mut light =
            MapLight { shown: PhotonMap::new(form(&session), &session.budget).unwrap(), next: None };
        let mut send = |session: &mut Session<_>, batches| {
            let (asked, mut told) = (AtomicU64::new(0), vec![]);
            let stop = || asked.fetch_add(1, Ordering::Relaxed) >= batches;
            let mut work = session.light_parts(&stop).1;
            light.illuminate(&mut work, &mut |done, _| told.push(done)).unwrap();
            (light.shown.irradiance().collect::<Vec<_>>(), light.shown.photons(), told)
        };
        let (none, photons, _) = send(&mut session, 0);
        assert_eq!((photons, none.iter().flatten().sum::<f32>()), (0, 0.0));
        let (part, photons, told) = send(&mut session, 20);
        assert!((1..PASS_PHOTONS).contains(&photons) && told.is_empty(), "{photons} {told:?}");
        assert!(part.into_iter().eq(whole(&mut session, photons).irradiance()));
        let (_, photons, told) = send(&mut session, u64::MAX);
        assert_eq!((photons, told.len()), (TARGET, 3));
        let (found, expected) = (mean(&light.shown), mean(&whole(&mut session, TARGET)));
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }

    /// Light that is not whole when frames end is not that of the world: it is to be sent again.
    #[test]
    fn light_that_is_not_whole_goes_with_the_frames() {
        let mut session = session();
        for (is_whole, photons) in [(true, PASS_PHOTONS), (false, 0)] {
            let shown = whole(&mut session, PASS_PHOTONS);
            let mut light = in_frames(&session, shown);
            if !is_whole {
                restart(&mut session, &mut light);
                some(&mut session, &mut light);
            }
            light.leave_frames();
            assert_eq!((light.shown.photons(), light.is_whole()), (photons, true));
            assert_eq!(light.leases_mut().len(), 1);
        }
    }
}
