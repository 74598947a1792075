//! `ModelInfo`: what the tables of a model's file say, no page read.

use serde::Serialize;
use trex_store::{Aabb, PageFile, Result};

/// Counts and sizes of a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModelInfo {
    /// Box around all triangles, model units.
    pub bounds: Aabb,
    /// Triangles that rays can hit.
    pub triangle_count: u64,
    /// Vertices, those shared by clusters counted once a cluster.
    pub vertex_count: u64,
    /// Clusters.
    pub cluster_count: u64,
    /// Pages, those of units included.
    pub page_count: u64,
    /// Materials.
    pub material_count: u64,
    /// Triangles that give light.
    pub emitter_count: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes of the page file a triangle.
    pub bytes_per_triangle: f64,
    /// Most that a vertex is away from the input's, model units.
    pub error_bound: f64,
    /// Model position of point 0 of the lattice, on which all corners lie.
    pub lattice_origin: [f64; 3],
    /// Step of the lattice, model units: a power of two.
    pub lattice_step: f64,
    /// Leaves along a side of the resident octree; `None` for a file without voxels.
    pub voxel_resolution: Option<u32>,
}

impl ModelInfo {
    /// What the tables of `file` say.
    ///
    /// # Errors
    /// Those of [`PageFile::upper_size`].
    pub(crate) fn new(file: &PageFile) -> Result<ModelInfo> {
        let block = file.superblock();
        Ok(ModelInfo {
            bounds: block.bounds,
            triangle_count: block.triangle_count,
            vertex_count: block.vertex_count,
            cluster_count: block.cluster_count,
            page_count: file.pages().len() as u64,
            material_count: file.materials().len() as u64,
            emitter_count: file.emitters().len() as u64,
            file_bytes: block.file_bytes,
            bytes_per_triangle: block.file_bytes as f64 / block.triangle_count.max(1) as f64,
            error_bound: block.error_bound,
            lattice_origin: block.lattice.origin,
            lattice_step: block.lattice.step(),
            voxel_resolution: file.upper_size()?.map(|size| size.resolution),
        })
    }
}
