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
mod lower;
mod map;
mod packet;
mod photons;
mod traverse;

pub use crate::photon_flight::PhotonStats;
pub(crate) use bake::Baking;
pub use gather::Near;
pub(crate) use gather::{GScene, Gathered, MIRRORS_MAX};
pub use lower::{LowerHit, LowerLeaf, LowerScene};
pub(crate) use map::Irradiance;
pub use map::{PASS_PHOTONS, PhotonMap};
pub use packet::Width;
pub(crate) use photons::{PhotonWork, PhotonWorld};
pub use traverse::{GRay, Occluders, VoxelHit, VoxelScene};

use trex_store::octree::{LowerLinks, UpperOctree};
use trex_store::{Budget, Lattice, Lease, PageFile, Result};

/// The resident octree of a model, where it stands, and where the units below it are.
#[derive(Debug)]
pub struct Voxels {
    octree: UpperOctree,
    links: Option<(LowerLinks, Lease)>,
    lattice: Lattice,
    _lease: Lease,
}

impl Voxels {
    /// Reads those of `file`; `None` for a file without. Their memory is leased from `budget`.
    ///
    /// # Errors
    /// As [`PageFile::upper`] and [`PageFile::lower`].
    pub fn of(file: &PageFile, budget: &Budget) -> Result<Option<Voxels>> {
        let lattice = file.superblock().lattice;
        let Some((octree, lease)) = file.upper(budget)? else { return Ok(None) };
        let links = file.lower(&octree, budget)?;
        Ok(Some(Voxels { octree, links, lattice, _lease: lease }))
    }

    /// The resident octree, for rays.
    pub fn scene(&self, occluders: Occluders) -> VoxelScene<'_> {
        VoxelScene::on(&self.octree, &self.lattice, occluders)
    }

    /// The same with the units below it; `None` for a file whose upper leaves are the finest.
    pub fn lower_scene(&self, occluders: Occluders) -> Option<LowerScene<'_>> {
        self.links.as_ref().map(|(links, _)| LowerScene::new(self.scene(occluders), links))
    }

    /// Count of facets, which light is kept by.
    pub fn facet_count(&self) -> usize {
        self.octree.facets().count()
    }
}
