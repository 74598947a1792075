//! The id of a file: what was read, and what was asked.

use super::voxels::OctreeShape;
use crate::build::model_materials::ModelMaterials;
use crate::build::partition::summary::PartitionSummary;
use crate::layout::VERSION;
use crate::octree::Refinement;
use xxhash_rust::xxh3::Xxh3;

/// The id of a file of these.
pub(crate) fn file_id(
    summary: &PartitionSummary,
    shape: Option<OctreeShape>,
    materials: &ModelMaterials,
) -> u64 {
    let mut hasher = Xxh3::new();
    materials.hash(&mut hasher);
    let mut bytes = Vec::new();
    bytes.extend(summary.content_hash.to_le_bytes());
    bytes.extend(summary.grid.lattice.exponent.to_le_bytes());
    summary.grid.lattice.origin.iter().for_each(|v| bytes.extend(v.to_bits().to_le_bytes()));
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(shape.map_or(0, |shape| shape.grid.resolution).to_le_bytes());
    if let Some(shape) = shape.filter(|shape| shape.refinement != Refinement::None) {
        bytes.extend(shape.refinement.factor().to_le_bytes());
    }
    hasher.update(&bytes);
    hasher.digest()
}
