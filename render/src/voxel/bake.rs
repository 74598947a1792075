//! `--bake`: photons through the exact mesh, their light into the facets of the voxels. Paper, section 5.1: where lights and
//! materials stay, the mesh tells more exactly than the voxels where photons go.
//!
//! Invariant: as of photons through voxels: the same photons give the same map, and a pass counts whole or not at all.

use super::map::{PASS_PHOTONS, PhotonMap, PhotonPass};
use super::traverse::VoxelScene;
use crate::frame::PagedTracer;
use crate::light::PhotonSources;
use crate::math::along;
use crate::photon_flight::{Deposit, MeshPhotons, PhotonStats};
use crate::world::World;
use trex_store::{Aabb, Budget, Result};

/// The mesh's light, and the voxels that take it.
#[derive(Clone, Copy)]
pub(crate) struct Baking<'a> {
    pub(crate) world: &'a World,
    pub(crate) bounds: &'a Aabb,
    pub(crate) voxels: VoxelScene<'a>,
    pub(crate) budget: &'a Budget,
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
}

impl VoxelScene<'_> {
    /// The facet of the leaf at a place on the exact mesh with unit `normal`; `None` where no leaf is near.
    pub(super) fn facet_at(&self, point: [f64; 3], normal: [f64; 3]) -> Option<u32> {
        let step = 0.5 * self.clearance(normal);
        let (node, leaf) =
            [0.0, -step, step].into_iter().find_map(|offset| self.leaf_at(along(point, offset, normal)))?;
        Some(self.octree().facet(node, leaf))
    }
}

impl Baking<'_> {
    /// Sends photons until `map` has those of `target`, pass by pass; `tell` hears how many are done.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when there is no room for the sums of a pass.
    pub(crate) fn trace<T: PagedTracer + Send>(
        &self,
        map: &mut PhotonMap,
        tracers: &mut [T],
        target: u64,
        tell: &mut dyn FnMut(u64),
    ) -> Result<PhotonStats> {
        let mut stats = PhotonStats::default();
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else { return Ok(stats) };
        let facets = self.voxels.octree().facets();
        let mut pass = PhotonPass::new(facets.count(), sources.flux(), self.budget)?;
        while map.photons() < target {
            let first = map.photons();
            let end = target.min(first + PASS_PHOTONS);
            let land = |_, deposits: &[Deposit]| {
                let add = |deposit: &&Deposit| match self.voxels.facet_at(deposit.point, deposit.normal) {
                    Some(facet) => {
                        pass.add(facet, deposit.flux);
                        true
                    }
                    None => false,
                };
                deposits.iter().filter(add).count() as u64
            };
            let photons = MeshPhotons { world: self.world, sources: &sources, land: &land, stop: self.stop };
            let Some(sent) = photons.trace(tracers, first..end) else { break };
            stats.add(&sent);
            map.fold(&mut pass, end - first, facets, self.voxels.leaf_side());
            tell(map.photons());
        }
        Ok(stats)
    }
}
