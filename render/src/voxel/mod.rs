//! The voxel octree at work: G-rays on it, and photons. What the CPU does, and the twin of each shader to come. Paper,
//! section 5.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bake;
mod gather;
#[cfg(target_arch = "x86_64")]
mod lanes;
mod map;
mod packet;
mod photons;
mod traverse;

pub use crate::photon_flight::PhotonStats;
pub(crate) use bake::Baking;
pub use gather::Near;
pub(crate) use gather::{GScene, Gathered, MIRRORS_MAX};
pub(crate) use map::Irradiance;
pub use map::{PASS_PHOTONS, PhotonMap};
pub use packet::Width;
pub(crate) use photons::{PhotonWork, PhotonWorld};
pub use traverse::{GRay, Occluders, VoxelHit, VoxelScene};

use trex_store::octree::UpperOctree;
use trex_store::{Budget, Lattice, Lease, PageFile, Result};

/// The resident octree of a model, and where it stands.
#[derive(Debug)]
pub struct Voxels {
    octree: UpperOctree,
    lattice: Lattice,
    _lease: Lease,
}

impl Voxels {
    /// Reads those of `file`; `None` for a file without. Their memory is leased from `budget`.
    ///
    /// # Errors
    /// As [`PageFile::upper`].
    pub fn of(file: &PageFile, budget: &Budget) -> Result<Option<Voxels>> {
        let lattice = file.superblock().lattice;
        Ok(file.upper(budget)?.map(|(octree, lease)| Voxels { octree, lattice, _lease: lease }))
    }

    /// For rays.
    pub fn scene(&self, occluders: Occluders) -> VoxelScene<'_> {
        VoxelScene::on(&self.octree, &self.lattice, occluders)
    }

    /// Count of facets, which light is kept by.
    pub fn facet_count(&self) -> usize {
        self.octree.facets().count()
    }
}
