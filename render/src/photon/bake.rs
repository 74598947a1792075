//! `bake`: photons through the exact mesh, their light to the sides of the facets of the voxels. Paper, section 5.1:
//! where lights and materials stay, the mesh tells more exactly than the voxels where photons go.
//!
//! Invariant: as of photons through voxels: the same photons give the same map, and a pass counts whole or not at all.

use super::irradiance::{PhotonMap, PhotonPass};
use super::mesh::{Deposit, MeshPhotons};
use super::trace::send_in_passes;
use super::tracers::PhotonTracers;
use crate::scene::world::World;
use crate::shading::light::PhotonSources;
use crate::stats::PhotonStats;
use crate::voxel::VoxelScene;
use rayon::ThreadPool;
use std::ops::{ControlFlow, Range};
use trex_store::{Aabb, Budget, Result};

/// The mesh's light, and the voxels that take it.
#[derive(Clone, Copy)]
pub(crate) struct BakeJob<'a> {
    pub(crate) world: &'a World,
    pub(crate) bounds: &'a Aabb,
    pub(crate) voxels: VoxelScene<'a>,
    pub(crate) budget: &'a Budget,
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
    /// One thread a tracer.
    pub(crate) pool: &'a ThreadPool,
}

impl BakeJob<'_> {
    /// Sends photons until `map` has those of `target`, pass by pass; `tell` hears how many are done.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when there is no room for the sums of a pass.
    pub(crate) fn trace(
        &self,
        map: &mut PhotonMap,
        tracers: &mut dyn PhotonTracers,
        target: u64,
        tell: &mut dyn FnMut(u64),
    ) -> Result<PhotonStats> {
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else {
            return Ok(PhotonStats::default());
        };
        let facets = self.voxels.octree().facets();
        let mut pass = PhotonPass::new(map.form(), sources.flux(), self.budget)?;
        let first = map.photons();
        let send = |indices: Range<u64>| {
            let land = |_, deposits: &[Deposit]| self.deposit(&pass, deposits);
            let BakeJob { world, stop, pool, .. } = *self;
            let photons = MeshPhotons { world, sources: &sources, land: &land, stop, pool };
            let Some(sent) = tracers.trace(&photons, indices.clone()) else {
                return ControlFlow::Break(PhotonStats::default());
            };
            map.fold(&mut pass, indices.end - indices.start, facets, self.voxels.leaf_side());
            ControlFlow::Continue(sent)
        };
        Ok(send_in_passes(first..target, send, tell))
    }

    /// Adds what arrived on the mesh to the facets there. How many had one.
    fn deposit(&self, pass: &PhotonPass, deposits: &[Deposit]) -> u64 {
        let add = |deposit: &&Deposit| {
            let side = self.voxels.side_at(deposit.point, deposit.normal);
            side.inspect(|&side| pass.add(side, &deposit.cargo)).is_some()
        };
        deposits.iter().filter(add).count() as u64
    }
}
