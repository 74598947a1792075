//! `TriangleSource`: where triangles come from, one batch at a time. Readers and generators implement it.
//!
//! Invariants: 1. a source holds a bounded amount of memory whatever the input's size, all of it leased from
//! the budget; 2. after `rewind` the same triangles come in the same order, at any thread count; 3. corner
//! order is the input's (counter-clockwise = front); 4. non-finite and degenerate triangles are delivered as
//! they are: the build counts and rejects them.

use crate::attributes::{AttributeColumns, AttributeSet, CornerAttributes};
use crate::cluster::Colour;
use crate::error::Result;
use crate::geom::{Aabb, Lattice};
use crate::material_list::MaterialList;
use crate::source_scene::SourceScene;

/// Triangles in flight between a source and its consumer. A source replaces the content; buffers are reused.
#[derive(Clone, Debug, Default)]
pub struct TriangleBatch {
    /// Corner positions in model space, `[corner][axis]`.
    pub corners: Vec<[[f64; 3]; 3]>,
    /// Index into [`TriangleSource::materials`] per triangle; as long as `corners`.
    pub material: Vec<u32>,
    /// What their corners have beside their places.
    pub attributes: AttributeColumns,
}

impl TriangleBatch {
    /// What a source aims to deliver per batch; a batch may hold up to twice as many.
    pub const TARGET_TRIANGLES: usize = 16 * 1024;

    /// Bytes that a batch of [`Self::TARGET_TRIANGLES`], twice filled, takes.
    pub const fn bytes(attributes: AttributeSet) -> u64 {
        2 * Self::TARGET_TRIANGLES as u64 * (72 + 4 + attributes.row_bytes())
    }

    /// Removes all triangles, keeps the memory.
    pub fn clear(&mut self) {
        self.corners.clear();
        self.material.clear();
        self.attributes.clear();
    }

    /// Adds one triangle whose corners have no attributes.
    pub fn push(&mut self, corners: [[f64; 3]; 3], material: u32) {
        self.push_with(corners, material, &CornerAttributes::NONE);
    }

    /// Adds one triangle whose corners have these attributes.
    pub fn push_with(&mut self, corners: [[f64; 3]; 3], material: u32, attributes: &CornerAttributes) {
        self.attributes.push(attributes, (self.corners.len(), self.corners.capacity()));
        self.corners.push(corners);
        self.material.push(material);
    }

    /// Gives each corner the colour of its place.
    pub fn paint(&mut self, colour: impl Fn([f64; 3]) -> Colour) {
        let AttributeColumns { colours, .. } = &mut self.attributes;
        colours.clear();
        colours.reserve_exact(self.corners.capacity());
        colours.extend(self.corners.iter().map(|corners| corners.map(&colour)));
    }

    /// Count of triangles.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// True when there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.corners.is_empty()
    }
}

/// What a source knows before its stream runs, good enough to choose the lattice without a scan pass.
#[derive(Clone, Copy, Debug)]
pub struct ScanHint {
    /// Holds every vertex of the stream.
    pub bounds: Aabb,
    /// At most the true median edge length of the stream, in model units.
    pub median_edge: f64,
    /// Count of triangles to come, within 1 %.
    pub triangle_count: u64,
    /// What their corners have beside their places.
    pub attributes: AttributeSet,
}

/// What a source has met so far, for progress and for the report.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct SourceStats {
    /// Input bytes consumed since the last rewind.
    pub bytes_read: u64,
    /// Total input bytes; 0 for generators.
    pub bytes_total: u64,
    /// Triangles delivered since the last rewind.
    pub triangle_count: u64,
    /// Polygons of more than three sides that were cut into fans.
    pub polygon_count: u64,
    /// Faces with fewer than three corners, points and lines: skipped.
    pub skipped_face_count: u64,
    /// Vertex attributes dropped (values of texture coordinates, of normals and colours that cannot be read), counted
    /// per vertex.
    pub dropped_attribute_count: u64,
    /// Vertices declared by the input (0 for formats without an index).
    pub vertex_count: u64,
    /// Vertex look-ups, and those that missed the block cache and read the disk.
    pub vertex_lookups: u64,
    /// See `vertex_lookups`.
    pub vertex_cache_misses: u64,
    /// Materials with `d` < 1, drawn opaque.
    pub transparent_material_count: u64,
    /// Bytes of the names of all materials, as files hold them; 0 for inputs without names.
    #[serde(default)]
    pub material_name_bytes: u64,
    /// Meshes that stand in more than one place, and in how many places all of these stand: each is delivered in each.
    #[serde(default)]
    pub instanced_mesh_count: u64,
    /// See `instanced_mesh_count`.
    #[serde(default)]
    pub instance_count: u64,
    /// Slabs of a volume, which are read one after the other; 0 for meshes.
    #[serde(default)]
    pub slab_count: u64,
    /// Bytes of samples that are held at a time.
    #[serde(default)]
    pub slab_bytes: u64,
    /// Cameras and lights of the input.
    #[serde(default)]
    pub scene: SourceScene,
    /// Things worth telling the user, in plain words (a missing MTL, trailing bytes), bounded in number.
    pub warnings: Vec<String>,
    /// Files that the input names and the source looked for (MTL, buffers), as the system writes their paths, each
    /// with its [`crate::stamp`] at that time.
    pub named_files: Vec<(Vec<u8>, String)>,
}

/// A stream of triangles. See the module's invariants.
pub trait TriangleSource: Send {
    /// Name for messages: the path, or `gen:KIND:COUNT:SEED`.
    fn name(&self) -> String;

    /// Replaces the content of `batch` with the next triangles. `false`: the stream has ended, the batch is
    /// empty. A batch may be empty while `true` is returned.
    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool>;

    /// Starts again from the first triangle.
    fn rewind(&mut self) -> Result<()>;

    /// Generators know bounds and edges before the stream; files answer `None` and are scanned first.
    fn hint(&self) -> Option<ScanHint>;

    /// The lattice that all vertices lie on, where the input says so with its first triangle or before. Nobody has
    /// checked it.
    fn lattice(&self) -> Option<Lattice> {
        None
    }

    /// What the corners of its triangles have, where it knows before its stream; else who reads it finds out.
    fn attributes(&self) -> AttributeSet {
        AttributeSet::default()
    }

    /// All materials met so far; complete once the stream has ended. Never empty: index 0 always exists.
    fn materials(&self) -> &MaterialList;

    /// Counters so far.
    fn stats(&self) -> SourceStats;
}
