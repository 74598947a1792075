//! The primitives of the meshes that are placed, in the order in which they are delivered, all of them checked.
//!
//! Invariants: 1. primitives that share their positions follow each other, so that a cache of these serves all of them;
//! 2. the count of triangles to come is known before the first.

use super::accessors::{AccessorUse, Accessors};
use super::buffers::wrong;
use super::draco::{self, DracoStream, StreamPart};
use super::json::{COORDINATE_SETS, JsonAttributes, JsonDocument, JsonPrimitive};
use super::materials;
use super::nodes::Placement;
use super::row_layout::RowLayout;
use super::rows::{ElementRows, ViewPlace};
use super::textures::Textures;
use crate::budget::Lease;
use crate::error::Result;
use crate::import::ImportOptions;
use crate::import::scalar::Scalar;
use std::ops::Range;
use std::sync::Arc;

/// Bytes that a compressed view, rows of a stream, and rows that are replaced, take beside the primitive.
const PACKED_BYTES: u64 = 256;
const SPARSE_BYTES: u64 = 512;

/// Bytes of a vertex in an attribute that is in a stream and is not read: four floats.
const UNREAD_BYTES: u64 = 16;
/// What attributes are used for, as [`listed`] has them.
const USES: [AccessorUse; 3 + COORDINATE_SETS] = [
    AccessorUse::Vectors,
    AccessorUse::Vectors,
    AccessorUse::Colours,
    AccessorUse::Coordinates,
    AccessorUse::Coordinates,
    AccessorUse::Coordinates,
    AccessorUse::Coordinates,
];

/// How corners become triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PrimitiveShape {
    /// Three corners each.
    Triangles,
    /// A corner each, with the two before it.
    Strip,
    /// A corner each, with the one before it and the first.
    Fan,
}

/// Triangles of a mesh that share a material.
#[derive(Clone, Debug)]
pub(super) struct GltfPrimitive {
    pub(super) positions: ElementRows,
    pub(super) indices: Option<ElementRows>,
    /// Of the vertices, as many as positions.
    pub(super) colours: Option<Box<ElementRows>>,
    pub(super) normals: Option<Box<ElementRows>>,
    /// Coordinates in the picture of the material.
    pub(super) coordinates: Option<Box<ElementRows>>,
    pub(super) topology: PrimitiveShape,
    pub(super) material: u32,
    /// Where the mesh stands, in the list of placements.
    pub(super) placements: Range<u32>,
}

impl GltfPrimitive {
    /// Triangles of one instance.
    pub(super) fn triangle_count(&self) -> u64 {
        let corners = self.indices.as_ref().unwrap_or(&self.positions).layout.count;
        match self.topology {
            PrimitiveShape::Triangles => corners / 3,
            PrimitiveShape::Strip | PrimitiveShape::Fan => corners.saturating_sub(2),
        }
    }

    fn beside_bytes(&self) -> u64 {
        let boxes = [self.colours.as_deref(), self.normals.as_deref(), self.coordinates.as_deref()];
        let rows = [Some(&self.positions), self.indices.as_ref()].into_iter().chain(boxes);
        let boxed = boxes.iter().flatten().count() as u64 * size_of::<ElementRows>() as u64;
        let beside = rows.flatten().map(|rows| {
            let packed = matches!(rows.view, Some(ViewPlace::Packed(_) | ViewPlace::Draco(..)));
            u64::from(packed) * PACKED_BYTES + u64::from(rows.sparse.is_some()) * SPARSE_BYTES
        });
        boxed + beside.sum::<u64>()
    }
}

/// All primitives, and what they come to.
pub(super) struct Primitives {
    pub(super) list: Vec<GltfPrimitive>,
    pub(super) triangle_count: u64,
    pub(super) vertex_count: u64,
    pub(super) dropped_attribute_count: u64,
    /// Primitives of points and lines.
    pub(super) skipped_count: u64,
    pub(super) unplaced_mesh_count: u64,
    pub(super) has_targets: bool,
    /// Corners behind the last triangle of a list.
    pub(super) loose_corner_count: u64,
    /// Meshes that stand in more than one place, and how often all of them stand anywhere.
    pub(super) instanced_mesh_count: u64,
    pub(super) instance_count: u64,
    /// The file's material that is called as the default is.
    default_at: Option<u32>,
    pub(super) lease: Lease,
}

impl Primitives {
    /// Reads the primitives of all placed meshes; placements come by mesh.
    pub(super) fn read(
        accessors: &mut Accessors<'_, '_>,
        placements: &[Placement],
        textures: &Textures,
        options: &ImportOptions,
    ) -> Result<Primitives> {
        let document = accessors.document;
        let groups = || placements.chunk_by(|a, b| a.mesh == b.mesh);
        let count: usize =
            groups().map(|of_mesh| document.meshes[of_mesh[0].mesh as usize].primitives.len()).sum();
        let bytes = count as u64 * size_of::<GltfPrimitive>() as u64;
        let mut all = Primitives {
            list: Vec::new(),
            triangle_count: 0,
            vertex_count: 0,
            dropped_attribute_count: 0,
            skipped_count: 0,
            unplaced_mesh_count: (document.meshes.len() - groups().count()) as u64,
            has_targets: false,
            loose_corner_count: 0,
            instanced_mesh_count: 0,
            instance_count: 0,
            default_at: materials::default_at(document),
            lease: options.budget.lease("the primitives of a glTF file", bytes)?,
        };
        all.list.reserve_exact(count);
        let mut at = 0;
        for of_mesh in groups() {
            let range = at..at + of_mesh.len() as u32;
            at = range.end;
            let times = of_mesh.iter().map(Placement::instance_count).fold(0u64, u64::saturating_add);
            if times > 1 {
                all.instanced_mesh_count += 1;
                all.instance_count = all.instance_count.saturating_add(times);
            }
            let mesh = of_mesh[0].mesh;
            for json in &document.meshes[mesh as usize].primitives {
                all.add(json, (mesh, range.clone(), times), textures, accessors)?;
            }
        }
        all.list.sort_by_key(|primitive| primitive.positions.identity());
        let mut last = None;
        for primitive in &all.list {
            if last.replace(primitive.positions.identity()) != Some(primitive.positions.identity()) {
                all.vertex_count = all.vertex_count.saturating_add(primitive.positions.layout.count);
            }
        }
        Ok(all)
    }

    fn add(
        &mut self,
        json: &JsonPrimitive,
        (mesh, placements, times): (u32, Range<u32>, u64),
        textures: &Textures,
        accessors: &mut Accessors<'_, '_>,
    ) -> Result<()> {
        let topology = match json.mode {
            4 => PrimitiveShape::Triangles,
            5 => PrimitiveShape::Strip,
            6 => PrimitiveShape::Fan,
            0..=3 => {
                self.skipped_count += 1;
                return Ok(());
            }
            mode => {
                let what = "a primitive of the glTF file is of an unknown kind";
                return Err(wrong(accessors.path, "meshes", mesh, what).numbers(format!("mode {mode}")));
            }
        };
        let document = accessors.document;
        let material_count = document.materials.len();
        if json.material.is_some_and(|material| material as usize >= material_count) {
            return Err(wrong(
                accessors.path,
                "meshes",
                mesh,
                "a primitive refers to a material that is not there",
            )
            .numbers(format!("materials[{}] of {material_count}", json.material.unwrap_or_default())));
        }
        let Some(position) = json.attributes.position else {
            self.skipped_count += 1;
            return Ok(());
        };
        accessors.draco = draco_stream(json, mesh, accessors)?.map(Arc::new);
        let positions = accessors.rows(position, AccessorUse::Vectors)?;
        let colours = (json.attributes.colour, AccessorUse::Colours, "colour");
        let (colours, dropped_colour) = values(colours, &positions, accessors)?;
        let normals = (json.attributes.normal, AccessorUse::Vectors, "normal");
        let (normals, dropped_normal) = values(normals, &positions, accessors)?;
        let (coordinates, dropped_coordinates) = coordinates(json, &positions, textures, accessors)?;
        let primitive = GltfPrimitive {
            positions,
            colours: colours.map(Box::new),
            normals: normals.map(Box::new),
            coordinates: coordinates.map(Box::new),
            indices: json.indices.map(|indices| accessors.rows(indices, AccessorUse::Indices)).transpose()?,
            topology,
            material: json.material.map_or(0, |index| materials::entry_of(index, self.default_at)),
            placements,
        };
        self.lease.grow("the primitives of a glTF file", primitive.beside_bytes())?;
        let corners = primitive.indices.as_ref().unwrap_or(&primitive.positions).layout.count;
        if topology == PrimitiveShape::Triangles {
            self.loose_corner_count += corners % 3;
        }
        let vertices = primitive.positions.layout.count;
        let dropped = dropped_colour + dropped_normal + dropped_coordinates;
        let dropped_count = json.attributes.other_count.saturating_add(dropped);
        let dropped = u64::from(dropped_count).saturating_mul(vertices);
        self.dropped_attribute_count = self.dropped_attribute_count.saturating_add(dropped);
        self.has_targets |= json.targets.is_some();
        let triangles = primitive.triangle_count().saturating_mul(times);
        self.triangle_count = self.triangle_count.saturating_add(triangles);
        self.list.push(primitive);
        Ok(())
    }
}

/// The coordinates of the vertices of a primitive in the picture of its material, and how many others are dropped.
fn coordinates(
    json: &JsonPrimitive,
    positions: &ElementRows,
    textures: &Textures,
    accessors: &mut Accessors<'_, '_>,
) -> Result<(Option<ElementRows>, u32)> {
    let set = textures.sampled(json.material).map(|texture| texture.set);
    let named = set.and_then(|set| json.attributes.places[set]);
    let read = (named, AccessorUse::Coordinates, "place in a picture");
    let (coordinates, _) = values(read, positions, accessors)?;
    let count = json.attributes.places.iter().flatten().count() as u32;
    let dropped_count = count - u32::from(coordinates.is_some());
    Ok((coordinates, dropped_count))
}

/// The values of an attribute of the vertices of a primitive, given with its use and its name, and how many attributes
/// are dropped since none can be had.
fn values(
    (accessor, used, name): (Option<u32>, AccessorUse, &str),
    positions: &ElementRows,
    accessors: &mut Accessors<'_, '_>,
) -> Result<(Option<ElementRows>, u32)> {
    let Some(accessor) = accessor else { return Ok((None, 0)) };
    if !has_plain_bytes(accessors.document, accessor) {
        return Ok((None, 1));
    }
    let rows = accessors.rows(accessor, used)?;
    let (count, position_count) = (rows.layout.count, positions.layout.count);
    if count != position_count {
        let what = format!("the vertices of a primitive do not all have a {name}");
        return Err(wrong(accessors.path, "accessors", accessor, &what)
            .numbers(format!("{count} {name}s, {position_count} positions")));
    }
    Ok((Some(rows), 0))
}

/// Whether the rows of an accessor are compressed, if at all, without a filter that is made for colours or normals.
fn has_plain_bytes(document: &JsonDocument<'_>, accessor: u32) -> bool {
    let accessor = document.accessors.get(accessor as usize);
    let view = accessor.and_then(|accessor| document.buffer_views.get(accessor.buffer_view? as usize));
    let meshopt = view.and_then(|view| view.extensions.as_deref()?.meshopt());
    let filter = meshopt.and_then(|meshopt| meshopt.filter.as_deref());
    !matches!(filter, Some("COLOR" | "OCTAHEDRAL"))
}

/// The stream of a primitive of a mesh that is compressed with Draco; `None` where it has none, or has all in another
/// form as well.
fn draco_stream(
    json: &JsonPrimitive,
    mesh: u32,
    accessors: &mut Accessors<'_, '_>,
) -> Result<Option<DracoStream>> {
    let Some(draco) = json.extensions.as_ref().and_then(|extensions| extensions.draco.as_deref()) else {
        return Ok(None);
    };
    let document = accessors.document;
    let has_bytes = |index: u32| {
        let accessor = document.accessors.get(index as usize);
        accessor.is_none_or(|accessor| accessor.buffer_view.is_some() || accessor.sparse.is_some())
    };
    if [json.attributes.position, json.indices].into_iter().flatten().all(has_bytes) {
        return Ok(None);
    }
    if !draco::IS_READ {
        return Err(draco::unread(accessors.path));
    }
    let (Some(view), Some(indices), Some(_), 4) =
        (draco.buffer_view, json.indices, draco.attributes.position, json.mode)
    else {
        let what = "a primitive that is compressed with Draco is no list of triangles with indices";
        return Err(wrong(accessors.path, "meshes", mesh, what).numbers(format!(
            "mode {}, bufferView {:?}, indices {:?}, POSITION {:?}",
            json.mode, draco.buffer_view, json.indices, draco.attributes.position
        )));
    };
    let corners = accessors.layout(indices, AccessorUse::Indices)?;
    let layout = RowLayout { scalar: Scalar::U32, ..corners }.packed();
    let mut stream = DracoStream {
        view,
        path: accessors.path.clone(),
        place: accessors.plain_view(view, "primitive")?,
        triangle_count: corners.count / 3,
        vertex_count: 0,
        vertex_bytes: u64::from(draco.attributes.other_count) * UNREAD_BYTES,
        parts: vec![StreamPart { accessor: indices, layout, attribute: None }],
    };
    let pairs = listed(&json.attributes).into_iter().zip(listed(&draco.attributes));
    for ((accessor, attribute), used) in pairs.zip(USES) {
        match (accessor, attribute) {
            (Some(accessor), Some(_)) => {
                let layout = accessors.layout(accessor, used)?.packed();
                stream.vertex_count = stream.vertex_count.max(layout.count);
                stream.vertex_bytes += layout.row_bytes() as u64;
                stream.parts.push(StreamPart { accessor, layout, attribute });
            }
            (None, Some(_)) => stream.vertex_bytes += UNREAD_BYTES,
            (_, None) => {}
        }
    }
    Ok(Some(stream))
}

/// Numbers of attributes that are read.
fn listed(attributes: &JsonAttributes) -> [Option<u32>; 3 + COORDINATE_SETS] {
    let JsonAttributes { position, normal, colour, places: [a, b, c, d], .. } = *attributes;
    [position, normal, colour, a, b, c, d]
}
