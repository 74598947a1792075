//! `NextLight`: photons of light that has changed, in a map of their own: blended in while it grows, then swapped.

use crate::photon::irradiance::{Irradiance, PhotonMap};
use crate::photon::voxel::{PassInWork, VoxelPhotons};
use trex_store::Lease;

/// The light that comes after a change, in a map of its own: blended in while it grows, then swapped.
#[derive(Debug)]
pub(super) struct NextLight {
    map: PhotonMap,
    work: PassInWork,
    /// Share of its photons that are there, 0 to 1; `None` when nothing comes.
    share: Option<f32>,
}

impl NextLight {
    /// The second buffer of a map of so many facets, in two leases of [`PhotonMap::bytes`]; nothing is on its way.
    pub(super) fn in_leases(world: &VoxelPhotons<'_>, facets: usize, leases: [Lease; 2]) -> NextLight {
        let [map, work] = leases;
        NextLight { work: world.begin_in_lease(work), map: PhotonMap::in_lease(facets, map), share: None }
    }

    /// The leases of its memory.
    pub(super) fn leases_mut(&mut self) -> [&mut Lease; 2] {
        [self.map.lease_mut(), self.work.lease_mut()]
    }

    /// Begins anew, since light has changed: what was on its way is out of date.
    pub(super) fn begin(&mut self, world: &VoxelPhotons<'_>) {
        self.map.clear();
        world.restart(&mut self.work);
        self.share = Some(0.0);
    }

    /// True when nothing is on its way.
    pub(super) fn is_idle(&self) -> bool {
        self.share.is_none()
    }

    /// Share of its photons that are there, 0 to 1; 1 when nothing is on its way.
    pub(super) fn share(&self) -> f64 {
        self.share.map_or(1.0, f64::from)
    }

    /// Sends photons until `stop` says so, and swaps the maps when the `target` is reached. Gives the count of rays,
    /// and whether the light that gather rays find has changed.
    pub(super) fn go_on(
        &mut self,
        world: &VoxelPhotons<'_>,
        shown: &mut PhotonMap,
        target: u64,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (u64, bool) {
        if self.is_idle() {
            return (0, false);
        }
        let before = self.map.photons();
        let stats = world.trace((&mut self.work, &mut self.map), target, stop, &mut |_| {});
        self.share = Some((self.map.photons() as f64 / target as f64) as f32);
        // Without any light there is nothing to wait for.
        let is_done = self.map.photons() >= target || !world.is_lit();
        if is_done {
            std::mem::swap(&mut self.map, shown);
            self.share = None;
        }
        (stats.rays, is_done || self.map.photons() > before)
    }

    /// The light that gather rays find.
    pub(super) fn irradiance<'a>(&'a self, shown: &'a PhotonMap) -> Irradiance<'a> {
        // The first light of all has nothing to be blended with.
        let is_first = shown.photons() == 0 && self.map.photons() > 0;
        let share = self.share.map(|share| if is_first { 1.0 } else { share });
        Irradiance::new(shown, share.map(|share| (&self.map, share)))
    }
}

/// The light that gather rays find: the session's map `shown`, and what comes after it.
pub(super) fn irradiance<'a>(shown: Option<&'a PhotonMap>, next: Option<&'a NextLight>) -> Irradiance<'a> {
    match (shown, next) {
        (None, _) => Irradiance::NONE,
        (Some(shown), None) => Irradiance::new(shown, None),
        (Some(shown), Some(next)) => next.irradiance(shown),
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

    const TARGET: u64 = 3 * PASS_PHOTONS;
    /// Batches that end within the second pass of three.
    const BATCHES: u64 = 700;

    fn session() -> Session<impl PagedTracer + Send> {
        let integrator = Method::Photon;
        floor(RenderKeys { integrator, resolution: [8, 8], photons: TARGET, ..RenderKeys::default() })
    }

    /// The light of `session`, sent in one go.
    fn whole<T: PagedTracer + Send>(session: &Session<T>, photons: u64) -> PhotonMap {
        let world = session.voxel_photons().unwrap();
        let mut map =
            PhotonMap::new(session.model().voxels.as_ref().unwrap().facet_count(), &session.budget).unwrap();
        world.trace((&mut world.begin().unwrap(), &mut map), photons, &|| false, &mut |_| {});
        assert_eq!(map.photons(), photons);
        map
    }

    /// A map of which nothing is on its way.
    fn idle<T: PagedTracer + Send>(session: &Session<T>) -> NextLight {
        let facets = session.model().voxels.as_ref().unwrap().facet_count();
        let leases = [(); 2].map(|()| session.budget.lease("a map", PhotonMap::bytes(facets)).unwrap());
        NextLight::in_leases(&session.voxel_photons().unwrap(), facets, leases)
    }

    /// Sends the photons of some batches. Whether the light on show has changed.
    fn some<T: PagedTracer + Send>(
        session: &Session<T>,
        next: &mut NextLight,
        shown: &mut PhotonMap,
    ) -> bool {
        let asked = AtomicU64::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= BATCHES;
        let (rays, has_changed) = next.go_on(&session.voxel_photons().unwrap(), shown, TARGET, &stop);
        assert!(rays > 0);
        has_changed
    }

    /// Sends what is left.
    fn rest<T: PagedTracer + Send>(
        session: &Session<T>,
        next: &mut NextLight,
        shown: &mut PhotonMap,
    ) -> bool {
        next.go_on(&session.voxel_photons().unwrap(), shown, TARGET, &|| false).1
    }

    /// The light that gather rays find is `of` each facet.
    fn check(next: &NextLight, shown: &PhotonMap, of: impl Fn(usize) -> Vec3) {
        let found = next.irradiance(shown);
        for facet in 0..shown.irradiance().len() {
            let (found, expected) = (found.at(facet as u32), of(facet));
            assert!(
                found.abs_diff_eq(expected, 1e-5 * expected.max_element()),
                "{facet}: {found} {expected}"
            );
        }
    }

    fn at(map: &PhotonMap) -> impl Fn(usize) -> Vec3 + '_ {
        |facet| map.irradiance()[facet].into()
    }

    fn mean(map: &PhotonMap) -> f32 {
        map.irradiance().iter().map(|rgb| rgb[0]).sum::<f32>() / map.irradiance().len() as f32
    }

    #[test]
    fn the_first_light_of_all_is_there_in_full_with_its_first_pass() {
        let session = session();
        let mut shown =
            PhotonMap::new(whole(&session, PASS_PHOTONS).irradiance().len(), &session.budget).unwrap();
        let mut next = idle(&session);
        next.begin(&session.voxel_photons().unwrap());
        assert_eq!((next.is_idle(), next.share()), (false, 0.0));
        check(&next, &shown, |_| Vec3::ZERO);
        assert!(some(&session, &mut next, &mut shown));
        assert_eq!(next.share() as f32, 1.0 / 3.0);
        check(&next, &shown, at(&whole(&session, PASS_PHOTONS)));
    }

    #[test]
    fn other_light_is_blended_in_by_its_share_and_swapped_when_it_is_whole() {
        let mut session = session();
        let mut shown = whole(&session, PASS_PHOTONS);
        let before = whole(&session, PASS_PHOTONS);
        let mut next = idle(&session);
        assert_eq!((next.is_idle(), next.share()), (true, 1.0));
        assert!(!rest(&session, &mut next, &mut shown));

        session.change(Event::Lights(sun(5.0))).unwrap();
        next.begin(&session.voxel_photons().unwrap());
        assert_eq!((next.is_idle(), next.share()), (false, 0.0));
        check(&next, &shown, at(&before));
        assert!(some(&session, &mut next, &mut shown));
        assert_eq!(next.share() as f32, 1.0 / 3.0);
        let part = whole(&session, PASS_PHOTONS);
        assert!(mean(&before) > 0.1 && (mean(&part) / mean(&before) - 5.0).abs() < 0.1);
        check(&next, &shown, |facet| (2.0 * at(&before)(facet) + at(&part)(facet)) / 3.0);

        assert!(rest(&session, &mut next, &mut shown));
        assert_eq!((next.is_idle(), next.share()), (true, 1.0));
        assert_eq!(shown.irradiance(), whole(&session, TARGET).irradiance());
        check(&next, &shown, at(&shown));
        assert!(!rest(&session, &mut next, &mut shown));
    }

    /// What was on its way is half a pass of another sun: none of it may come in.
    #[test]
    fn an_edit_forgets_what_was_on_its_way() {
        let mut session = session();
        let mut shown = whole(&session, PASS_PHOTONS);
        let before = whole(&session, PASS_PHOTONS);
        let mut next = idle(&session);
        session.change(Event::Lights(sun(5.0))).unwrap();
        next.begin(&session.voxel_photons().unwrap());
        some(&session, &mut next, &mut shown);

        session.change(Event::Lights(sun(2.0))).unwrap();
        next.begin(&session.voxel_photons().unwrap());
        assert_eq!((next.share(), next.map.photons()), (0.0, 0));
        check(&next, &shown, at(&before));
        rest(&session, &mut next, &mut shown);
        assert_eq!(shown.irradiance(), whole(&session, TARGET).irradiance());

        session.change(Event::Lights(sun(0.0))).unwrap();
        next.begin(&session.voxel_photons().unwrap());
        assert!(rest(&session, &mut next, &mut shown) && next.is_idle());
        check(&next, &shown, |_| Vec3::ZERO);
    }
}
