//! `NextLight`: photons of light that has changed, in a map of their own: blended in while it grows, then swapped.

use crate::photon::irradiance::{Irradiance, PhotonMap};
use crate::photon::voxel::{PassInWork, VoxelPhotons};
use trex_store::{Budget, Result};

/// The light that comes after a change, in a map of its own: blended in while it grows, then swapped.
#[derive(Debug)]
pub(super) struct NextLight {
    map: PhotonMap,
    work: PassInWork,
    /// Share of its photons that are there, 0 to 1; `None` when nothing comes.
    share: Option<f32>,
}

impl NextLight {
    /// The second buffer of `shown`; on its way at once where that is dark and anything gives light.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for a second map.
    pub(super) fn new(world: &VoxelPhotons<'_>, shown: &PhotonMap, budget: &Budget) -> Result<NextLight> {
        let work = world.begin()?;
        let map = PhotonMap::new(shown.irradiance().len(), budget)?;
        let share = (shown.photons() == 0 && world.is_lit()).then_some(0.0);
        Ok(NextLight { map, work, share })
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
