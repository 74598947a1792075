//! Light that photons bring through the exact mesh: the tree of `full-gi`, and the facets of `photon` where they are baked.
//!
//! Invariants: 1. a pass of photons counts whole or not at all; 2. the light depends on world and photon count alone.

use crate::frame::PagedTracer;
use crate::integrator::Method;
use crate::light::PhotonSources;
use crate::photon_flight::{BATCH, Deposit, MeshPhotons, PhotonStats, flight_bytes};
use crate::photon_tree::{PhotonStore, PhotonTree};
use crate::session::Session;
use crate::voxel::{Baking, PASS_PHOTONS};
use crate::world::GRays;
use std::sync::Mutex;
use trex_store::Result;

// Passes are whole batches: what landed of the last whole pass is what counts.
const _: () = assert!(PASS_PHOTONS.is_multiple_of(BATCH));

/// Bytes that photons on the mesh take at most for `method`, with those under way on `worker_count` workers.
pub fn mesh_photons_bytes(method: Method, g_rays: &GRays, worker_count: usize) -> u64 {
    match method {
        Method::FullGi => PhotonTree::bytes(g_rays.photons) + flight_bytes(worker_count),
        Method::Photon if g_rays.bake => flight_bytes(worker_count),
        _ => 0,
    }
}

impl<T: PagedTracer + Send> Session<T> {
    /// Sends the photons that the facets of the voxels still lack through the mesh.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for those under way, or for the sums of a pass.
    pub(crate) fn bake(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        let Session { world, model, view, tracers, budget, photons, .. } = self;
        let (Some(map), Some(voxels)) = (photons, &model.voxels) else { return Ok(PhotonStats::default()) };
        let _flights = budget.lease("the photons under way", flight_bytes(tracers.len()))?;
        let GRays { photons: target, occluders, .. } = view.g_rays;
        let voxels = voxels.scene(occluders);
        let baking = Baking { world, bounds: &model.bounds, voxels, budget, stop };
        baking.trace(map, tracers, target, &mut |done| tell(done, target))
    }

    /// Sends all photons through the mesh, into a tree; there is none where there is no light.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for [`mesh_photons_bytes`].
    pub(crate) fn grow_tree(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        let Session { world, model, view, tracers, budget, .. } = self;
        let (mut stats, target) = (PhotonStats::default(), view.g_rays.photons);
        let Some(sources) = PhotonSources::new(&world.lights, &model.bounds) else { return Ok(stats) };
        let _flights = budget.lease("the photons under way", flight_bytes(tracers.len()))?;
        let store = Mutex::new(PhotonStore::new(target, model.bounds.center(), budget)?);
        let land = |batch, deposits: &[Deposit]| {
            store.lock().expect("a worker panicked").land(batch, deposits);
            deposits.len() as u64
        };
        let photons = MeshPhotons { world, sources: &sources, land: &land, stop };
        while stats.photons < target {
            let end = target.min(stats.photons + PASS_PHOTONS);
            let Some(pass) = photons.trace(tracers, stats.photons..end) else { break };
            stats.add(&pass);
            tell(stats.photons, target);
        }
        let store = store.into_inner().expect("a worker panicked");
        self.tree = Some(store.into_tree(stats.photons));
        Ok(stats)
    }
}
