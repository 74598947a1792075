//! The light of a session that is at leisure: photons through the voxels, or through the exact mesh: the tree of
//! `full-gi`, and the facets of `photon` where they are baked.
//!
//! Invariants: 1. a pass of photons counts whole or not at all; 2. the light depends on world and photon count alone.

use super::Session;
use crate::photon::bake::BakeJob;
use crate::photon::kd_tree::PhotonStore;
use crate::photon::mesh::{BATCH, Deposit, MeshPhotons, flight_bytes};
use crate::photon::trace::{PASS_PHOTONS, send_in_passes};
use crate::photon::voxel::{PassInWork, VoxelPhotons};
use crate::scene::method::Method;
use crate::scene::settings::RenderKeys;
use crate::shading::light::PhotonSources;
use crate::stats::PhotonStats;
use crate::trace::PagedTracer;
use std::ops::{ControlFlow, Range};
use std::sync::Mutex;
use trex_store::Result;

// Passes are whole batches: what landed of the last whole pass is what counts.
const _: () = assert!(PASS_PHOTONS.is_multiple_of(BATCH));

impl<T: PagedTracer + Send> Session<T> {
    /// Sends the photons that are still to be sent, of those the view asks for; does nothing for methods without.
    /// `stop` is asked in between; `tell` hears how many are done, and of how many.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for a pass of photons, or for all of `full-gi`.
    pub fn illuminate(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        if self.view.settings.integrator == Method::FullGi && self.photon_tree.is_none() {
            return self.grow_tree(stop, tell);
        }
        if self.view.settings.bake {
            return self.bake(stop, tell);
        }
        let Some(mut map) = self.photon_map.take() else { return Ok(PhotonStats::default()) };
        let target = self.view.settings.photons;
        let stats = self.voxel_photons().map(|all| {
            let mut work: PassInWork = all.begin()?;
            Ok(all.trace((&mut work, &mut map), target, stop, &mut |done| tell(done, target)))
        });
        self.photon_map = Some(map);
        stats.unwrap_or(Ok(PhotonStats::default()))
    }

    /// The voxels that photons go through, with the world; `None` for a model without voxels.
    pub(super) fn voxel_photons(&self) -> Option<VoxelPhotons<'_>> {
        let voxels = self.model.voxels.as_ref()?;
        Some(VoxelPhotons {
            world: &self.world,
            bounds: &self.model.bounds,
            voxels: voxels.scene(self.view.settings.occluders),
            g_stage: &*self.g_stage,
            pool: &self.pool,
            budget: &self.budget,
        })
    }

    /// Sends the photons that the facets of the voxels still lack through the mesh.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for those under way, or for the sums of a pass.
    fn bake(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        let Session { world, model, view, tracers, budget, photon_map, pool, .. } = self;
        let (Some(map), Some(voxels)) = (photon_map, &model.voxels) else {
            return Ok(PhotonStats::default());
        };
        let _flights = budget.lease("the photons under way", flight_bytes(tracers.len()))?;
        let RenderKeys { photons: target, occluders, .. } = *view.settings;
        let voxels = voxels.scene(occluders);
        let baking = BakeJob { world, bounds: &model.bounds, voxels, budget, stop, pool };
        baking.trace(map, tracers, target, &mut |done| tell(done, target))
    }

    /// Sends all photons through the mesh, into a tree; there is none where there is no light.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the photons, or for those under way.
    fn grow_tree(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        if !self.sends_photons() {
            return Ok(PhotonStats::default());
        }
        let mut store = self.photon_store()?;
        let target = self.view.settings.photons;
        let send = |indices| match self.send_to_store(&mut store, indices, stop) {
            Some(pass) => ControlFlow::Continue(pass),
            None => ControlFlow::Break(PhotonStats::default()),
        };
        let stats = send_in_passes(0..target, send, &mut |done| tell(done, target));
        self.photon_tree = Some(store.into_tree(stats.photons));
        Ok(stats)
    }

    /// True when anything sends photons.
    pub(super) fn sends_photons(&self) -> bool {
        PhotonSources::new(&self.world.lights, &self.model.bounds).is_some()
    }

    /// Room for the photons of `full-gi`.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for them, and for those under way.
    pub(super) fn photon_store(&self) -> Result<PhotonStore> {
        let flights = flight_bytes(self.tracers.len());
        PhotonStore::new(self.view.settings.photons, self.model.bounds.center().into(), flights, &self.budget)
    }

    /// Sends the photons with these indices, from a whole batch on, through the mesh. `None` when it was stopped: some
    /// batches have landed then, and are to be sent again with the others.
    pub(super) fn send_to_store(
        &mut self,
        store: &mut PhotonStore,
        indices: Range<u64>,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<PhotonStats> {
        let Session { world, model, tracers, pool, .. } = self;
        let sources = PhotonSources::new(&world.lights, &model.bounds)?;
        let store = Mutex::new(store);
        let land = |batch, deposits: &[Deposit]| {
            store.lock().expect("a worker panicked").land(batch, deposits);
            deposits.len() as u64
        };
        MeshPhotons { world, sources: &sources, land: &land, stop, pool }.trace(tracers, indices)
    }
}
