//! `Voxels`: the resident octree of a file, with what leads to its units.

use super::lower::LowerScene;
use super::traverse::{Occluders, VoxelScene};
use crate::trace::Parts;
use std::sync::Arc;
use trex_store::octree::{LowerLinks, UpperOctree};
use trex_store::{Budget, Lattice, Lease, PageFile, Result};

/// The resident octree of a model, where it stands, and where the units below it are.
#[derive(Debug)]
pub struct Voxels {
    octree: UpperOctree,
    links: Option<(LowerLinks, Lease)>,
    lattice: Lattice,
    page_count: u32,
    lease: Lease,
    /// The octree with all materials, where this one leaves some out.
    whole: Option<Arc<Voxels>>,
}

impl Voxels {
    /// Reads the octree of `file`; `None` for a file without. Their memory is leased from `budget`.
    ///
    /// # Errors
    /// As [`PageFile::upper`] and [`PageFile::lower`].
    pub fn open(file: &PageFile, budget: &Budget) -> Result<Option<Voxels>> {
        let lattice = file.superblock().lattice;
        let Some((octree, lease)) = file.upper(budget)? else { return Ok(None) };
        let links = file.lower(&octree, budget)?;
        Ok(Some(Voxels { octree, links, lattice, page_count: file.pages().len() as u32, lease, whole: None }))
    }

    /// These voxels without those of hidden materials, which a bit each names: rays pass through leaves of which such
    /// a material covers the most. Their memory is leased from `budget`.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn without(this: &Arc<Voxels>, parts: &Parts, budget: &Budget) -> Result<Voxels> {
        let bytes = UpperOctree::without_bytes(this.octree.leaf_count());
        let lease = budget.lease("the voxels of what is shown", bytes)?;
        Ok(Voxels {
            octree: this.octree.without(|material| parts.hides(material.into())),
            links: None,
            whole: Some(this.clone()),
            lease,
            ..**this
        })
    }

    /// Bytes that are leased for it.
    pub fn leased_bytes(&self) -> u64 {
        self.lease.bytes() + self.links.as_ref().map_or(0, |(_, lease)| lease.bytes())
    }

    /// The resident octree, as a device takes it: nodes, bitmaps, leaves and facets.
    pub fn octree(&self) -> &UpperOctree {
        &self.octree
    }

    /// The words that lead from its last nodes to units; `None` for a file whose upper leaves are the finest.
    pub fn links(&self) -> Option<&LowerLinks> {
        let of = self.whole.as_deref().unwrap_or(self);
        of.links.as_ref().map(|(links, _)| links)
    }

    /// Count of the file's pages, of which some hold units.
    pub fn page_count(&self) -> u32 {
        self.page_count
    }

    /// The resident octree, for rays.
    pub fn scene(&self, occluders: Occluders) -> VoxelScene<'_> {
        VoxelScene::new(&self.octree, &self.lattice, occluders)
    }

    /// The octree with the units below it; `None` for a file whose upper leaves are the finest.
    pub fn lower_scene(&self, occluders: Occluders) -> Option<LowerScene<'_>> {
        self.links().map(|links| LowerScene::new(self.scene(occluders), links))
    }

    /// Count of facets. Light is kept by their sides, of which each has two.
    pub fn facet_count(&self) -> usize {
        self.octree.facets().count()
    }
}
