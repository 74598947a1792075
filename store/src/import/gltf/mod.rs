//! glTF 2.0: `.gltf` with its buffers, and `.glb`. The JSON says where things are; the numbers stay in the files.
//!
//! ```text
//! Container -> JsonDocument -> walk of nodes -> placements  \
//!                         `-> Accessors -----> primitives    > GltfSource: for each primitive, placement, instance:
//!                         `-> materials                     /  indices (RowWindow), corners (VertexCache), transform
//! ```
//!
//! Meshes that stand in several places are delivered in each of them: a page file has no instances.
//!
//! Invariants: 1. the JSON is leased before it is read, and gone when the source is open: what is kept is placements
//! and primitives, leased one by one; 2. numbers are read where they lie, those that are encoded go through the
//! spool; 3. no offset, count or index is used before `accessors.rs` has checked it.

mod accessors;
mod affine;
mod buffers;
mod bytes;
mod container;
mod dense;
mod draco;
mod json;
mod json_look;
mod json_value;
mod materials;
mod meshopt;
mod nodes;
mod open_values;
mod packed;
mod primitives;
mod row_layout;
mod rows;
mod source;
#[cfg(test)]
pub(super) mod testing;
mod textures;
mod triangles;

use super::input::Input;
use super::{Encoding, Format, ImportOptions, warn};
use crate::error::{Code, Error, Result};
use crate::geom::Lattice;
use crate::source::SourceStats;
use crate::stated_lattice;
use accessors::Accessors;
use buffers::{Buffers, is_data};
use bytes::{Spool, SpoolUse};
use container::Container;
use dense::DenseStore;
use json::JsonDocument;
use materials::GltfMaterials;
use nodes::Walk;
use primitives::Primitives;
use source::GltfParts;
use std::path::Path;
use std::sync::Arc;
use textures::Textures;

pub(super) use source::GltfSource;

/// Extensions that may be required: they are read, or change nothing that is.
const KNOWN_EXTENSIONS: [&str; 8] = [
    "KHR_mesh_quantization",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_node_visibility",
    "KHR_accessor_float64",
    "KHR_animation_pointer",
];
/// Beginnings of those that are about looks alone.
const KNOWN_PREFIXES: [&str; 5] =
    ["KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_xmp"];

/// Opens the file that `input` has found to be of `format`.
pub(super) fn open(input: Input, format: Format, options: &ImportOptions) -> Result<GltfSource> {
    open_with(input, format, SpoolUse::Kept, options)
}

fn open_with(input: Input, format: Format, kept: SpoolUse, options: &ImportOptions) -> Result<GltfSource> {
    let (path, length): (Arc<Path>, u64) = (input.path().into(), input.length());
    let file = input.second_handle()?;
    // Its window is of no use here.
    drop(input);
    let container = Container::read(&file, &path, format, length, options)?;
    let (document, _lease) = container.parse(&path, options)?;
    check_document(&document, &path)?;
    let mut spool = Spool::new(kept, options);
    let mut buffers = Buffers::new(&path, &document, &container, options)?;
    buffers.file_bytes = length;
    let mut accessors =
        Accessors { path: &path, document: &document, buffers: &mut buffers, spool: &mut spool, draco: None };
    let walk = nodes::walk(&mut accessors, options)?;
    // Before they are read, as all that is named.
    for uri in document.images.iter().filter_map(|image| image.uri.as_deref()) {
        if let Some(path) = accessors.buffers.path_of(uri).filter(|_| !is_data(uri)) {
            accessors.buffers.name(&path)?;
        }
    }
    let textures = match kept {
        SpoolUse::Kept => Textures::read(&mut accessors, options)?,
        SpoolUse::Counted => Textures::none(&document, options)?,
    };
    let primitives = Primitives::read(&mut accessors, &walk.placements, &textures, options)?;
    let materials = GltfMaterials::read(&document, &textures, &path, options)?;
    let mut stats = stats(&document, &container, &buffers, &walk, &primitives, &materials);
    textures.told.iter().for_each(|told| warn(&mut stats, told.clone()));
    let named = buffers.into_named();
    let lattice = lattice(&document);
    let store = DenseStore::new(spool, &path)?;
    Ok(GltfSource::new(
        GltfParts { path, walk, primitives, materials, textures, store, stats, named, lattice },
        options,
    ))
}

/// The lattice that the file's generator states.
fn lattice(document: &JsonDocument<'_>) -> Option<Lattice> {
    let generator = document.asset.as_ref()?.generator.as_deref()?;
    stated_lattice::parse(&generator[generator.find(stated_lattice::WORDS)?..])
}

/// A source of what the file declares, without what is encoded in it.
pub(super) fn counted(input: Input, format: Format, options: &ImportOptions) -> Result<GltfSource> {
    open_with(input, format, SpoolUse::Counted, options)
}

/// What the file declares: encoding, vertices and triangles.
pub(super) fn declared(source: &GltfSource, format: Format) -> (Encoding, Option<u64>, Option<u64>) {
    let encoding = if format == Format::Glb { Encoding::BinaryLittleEndian } else { Encoding::Ascii };
    let (vertices, triangles) = source.declared();
    (encoding, Some(vertices), Some(triangles))
}

/// Refuses versions that are not read, and extensions that the file cannot be read without.
fn check_document(document: &JsonDocument<'_>, path: &Path) -> Result<()> {
    let version = document.asset.as_ref().and_then(|asset| asset.version.as_deref());
    let Some(version) = version else {
        return Err(Error::new(Code::InputFormat, "this is no glTF file: it names no version of glTF")
            .at(path)
            .numbers("asset.version is not there")
            .next("check the file's name and content"));
    };
    if !version.starts_with("2.") {
        let shown: String = version.chars().take(16).collect();
        return Err(Error::new(Code::InputFormat, "the glTF file has a version that is not read")
            .at(path)
            .numbers(format!("version {shown}, and 2.0 is read"))
            .next("convert it to glTF 2.0"));
    }
    let is_known = |name: &str| {
        KNOWN_EXTENSIONS.contains(&name) || KNOWN_PREFIXES.iter().any(|prefix| name.starts_with(prefix))
    };
    let is_read = |name: &str| is_known(name) || (name == draco::EXTENSION && draco::IS_READ);
    match document.extensions_required.iter().find(|name| !is_read(name)) {
        None => Ok(()),
        Some(name) if &**name == draco::EXTENSION => Err(draco::unread(path)),
        Some(name) => {
            let shown: String = name.chars().take(64).collect();
            Err(Error::new(Code::InputFormat, "the glTF file needs an extension that is not read")
                .at(path)
                .numbers(shown)
                .next("export it again without this extension"))
        }
    }
}

/// What is known before the stream, and what to tell of it.
fn stats(
    document: &JsonDocument<'_>,
    container: &Container,
    buffers: &Buffers<'_>,
    walk: &Walk,
    primitives: &Primitives,
    materials: &GltfMaterials,
) -> SourceStats {
    let mut stats = SourceStats {
        bytes_total: buffers.file_bytes,
        vertex_count: primitives.vertex_count,
        dropped_attribute_count: primitives.dropped_attribute_count,
        skipped_face_count: primitives.skipped_count + primitives.loose_corner_count,
        transparent_material_count: materials.transparent_count,
        material_name_bytes: materials.name_bytes,
        instance_count: primitives.instance_count,
        instanced_mesh_count: primitives.instanced_mesh_count,
        scene: walk.scene.clone(),
        ..SourceStats::default()
    };
    let counted = [
        (container.trailing_bytes, "bytes after the end of the GLB container are not read"),
        (primitives.unplaced_mesh_count, "meshes are in no node of the scene and are left out"),
        (primitives.skipped_count, "primitives of points or lines, or without positions, are left out"),
        (primitives.loose_corner_count, "corners after the last whole triangle of a list are left out"),
        (
            materials.unread_count,
            "materials have a picture that is not read: half of their colour's factor counts",
        ),
        (
            materials.textured_count,
            "materials have other textures than that of their colour (metal, normals, light), which are not read",
        ),
        (walk.other_camera_count, "cameras are left out: a scene has one, with a perspective"),
        (walk.other_light_count, "lights are left out: of an unknown kind, without a place, or too many"),
        (document.animations.len() as u64, "animations are left out: nodes stand as the file places them"),
    ];
    for (count, what) in counted.into_iter().filter(|(count, _)| *count > 0) {
        warn(&mut stats, format!("{count} {what}"));
    }
    for (is_there, what) in [
        (walk.has_skins, "skins are left out: meshes stand as their nodes place them"),
        (primitives.has_targets, "morph targets are left out: meshes have their base shape"),
        (document.scenes.is_empty(), "the file has no scene: all nodes are drawn"),
    ] {
        if is_there {
            warn(&mut stats, what.to_owned());
        }
    }
    stats
}
