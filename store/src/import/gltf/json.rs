//! The JSON of a glTF file: the parts of it that a mesh is made of, as they stand there. Nothing is checked here.
//!
//! Invariants: 1. strings are borrowed from the text, but for those with escapes; 2. what is parsed takes at most
//! [`parsed_bytes`], whatever the text says: an object is read from an object alone, never from an array, and none of
//! the structs is larger than [`OBJECT_BYTES_MAX`].

use super::json_look::{JsonCamera, JsonExtensions, JsonLight, JsonMaterial, JsonMaterialExtensions};
use super::json_look::{JsonSampler, JsonTexture, JsonTextureInfo, JsonTextureTransform};
use super::json_value::{JsonText, Object};
use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, MapAccess, Visitor};
use std::fmt;

/// Most bytes of a struct here.
const OBJECT_BYTES_MAX: usize = 128;
/// Sets of coordinates in pictures that a vertex can have, of those that are read.
pub(super) const COORDINATE_SETS: usize = 4;
/// Bytes charged per object: a vector that grows holds up to twice its content, and half of that again while it moves.
const BYTES_PER_OBJECT: u64 = 3 * OBJECT_BYTES_MAX as u64;
/// Bytes charged per array: its allocation.
const BYTES_PER_ARRAY: u64 = 64;
/// Bytes charged per comma: an index in a vector that grows, or a number of a transform.
const BYTES_PER_COMMA: u64 = 12;

/// Most bytes that [`JsonDocument`] takes when it is parsed from `text`.
pub(super) fn parsed_bytes(text: &[u8]) -> u64 {
    let (mut bytes, mut has_escapes) = (OBJECT_BYTES_MAX as u64 * 4, false);
    for byte in text {
        match byte {
            b'{' => bytes += BYTES_PER_OBJECT,
            b'[' => bytes += BYTES_PER_ARRAY,
            b',' => bytes += BYTES_PER_COMMA,
            b'\\' => has_escapes = true,
            _ => {}
        }
    }
    bytes + if has_escapes { 2 * text.len() as u64 } else { 0 }
}

/// The whole document.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonDocument<'a> {
    #[serde(borrow)]
    pub(super) asset: Option<Object<JsonAsset<'a>>>,
    pub(super) scene: Option<u32>,
    pub(super) scenes: Vec<Object<JsonScene>>,
    pub(super) nodes: Vec<Object<JsonNode>>,
    pub(super) meshes: Vec<Object<JsonMesh>>,
    #[serde(borrow)]
    pub(super) accessors: Vec<Object<JsonAccessor<'a>>>,
    #[serde(borrow)]
    pub(super) buffer_views: Vec<Object<JsonView<'a>>>,
    #[serde(borrow)]
    pub(super) buffers: Vec<Object<JsonBuffer<'a>>>,
    #[serde(borrow)]
    pub(super) materials: Vec<Object<JsonMaterial<'a>>>,
    #[serde(borrow)]
    pub(super) cameras: Vec<Object<JsonCamera<'a>>>,
    #[serde(borrow)]
    pub(super) images: Vec<Object<JsonImage<'a>>>,
    pub(super) textures: Vec<Object<JsonTexture>>,
    pub(super) samplers: Vec<Object<JsonSampler>>,
    pub(super) animations: Vec<IgnoredAny>,
    #[serde(borrow)]
    pub(super) extensions_required: Vec<JsonText<'a>>,
    #[serde(borrow)]
    pub(super) extensions: Option<Object<JsonExtensions<'a>>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonAsset<'a> {
    #[serde(borrow)]
    pub(super) version: Option<JsonText<'a>>,
    #[serde(borrow)]
    pub(super) generator: Option<JsonText<'a>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonScene {
    #[serde(default)]
    pub(super) nodes: Vec<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonNode {
    pub(super) mesh: Option<u32>,
    pub(super) camera: Option<u32>,
    pub(super) skin: Option<u32>,
    #[serde(default)]
    pub(super) children: Vec<u32>,
    pub(super) matrix: Option<Box<[f64; 16]>>,
    pub(super) translation: Option<Box<[f64; 3]>>,
    pub(super) rotation: Option<Box<[f64; 4]>>,
    pub(super) scale: Option<Box<[f64; 3]>>,
    pub(super) extensions: Option<Box<Object<JsonNodeExtensions>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonNodeExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub(super) light: Option<Object<JsonLightIndex>>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Object<JsonInstances>>,
    #[serde(rename = "KHR_node_visibility")]
    pub(super) visibility: Option<Object<JsonVisibility>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonLightIndex {
    pub(super) light: u32,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonVisibility {
    #[serde(default = "yes")]
    pub(super) visible: bool,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonInstances {
    pub(super) attributes: Object<JsonInstanceAttributes>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE", default)]
pub(super) struct JsonInstanceAttributes {
    pub(super) translation: Option<u32>,
    pub(super) rotation: Option<u32>,
    pub(super) scale: Option<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonMesh {
    pub(super) primitives: Vec<Object<JsonPrimitive>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonPrimitive {
    pub(super) attributes: JsonAttributes,
    pub(super) indices: Option<u32>,
    pub(super) material: Option<u32>,
    #[serde(default = "triangles")]
    pub(super) mode: u32,
    pub(super) targets: Option<IgnoredAny>,
    pub(super) extensions: Option<Object<JsonPrimitiveExtensions>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonPrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(super) draco: Option<Box<Object<JsonDraco>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonDraco {
    pub(super) buffer_view: Option<u32>,
    /// Numbers of attributes in the stream, not accessors.
    pub(super) attributes: JsonAttributes,
}

/// The attributes that are read, and how many others there are.
#[derive(Debug, Default)]
pub(super) struct JsonAttributes {
    pub(super) position: Option<u32>,
    pub(super) colour: Option<u32>,
    pub(super) normal: Option<u32>,
    /// Coordinates in pictures.
    pub(super) places: [Option<u32>; COORDINATE_SETS],
    pub(super) other_count: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonAccessor<'a> {
    pub(super) buffer_view: Option<u32>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(borrow, rename = "type")]
    pub(super) kind: JsonText<'a>,
    pub(super) sparse: Option<Box<Object<JsonSparse>>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonSparse {
    pub(super) count: u64,
    pub(super) indices: Object<JsonSparsePart>,
    pub(super) values: Object<JsonSparsePart>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonSparsePart {
    pub(super) buffer_view: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    /// Of indices only.
    pub(super) component_type: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonView<'a> {
    pub(super) buffer: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    #[serde(borrow)]
    pub(super) extensions: Option<Box<Object<JsonViewExtensions<'a>>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonViewExtensions<'a> {
    #[serde(borrow, rename = "KHR_meshopt_compression")]
    khr_meshopt: Option<Box<Object<JsonMeshopt<'a>>>>,
    #[serde(borrow, rename = "EXT_meshopt_compression")]
    ext_meshopt: Option<Box<Object<JsonMeshopt<'a>>>>,
}

impl<'a> JsonViewExtensions<'a> {
    /// The view as it is compressed; where both names stand, by the younger.
    pub(super) fn meshopt(&self) -> Option<&JsonMeshopt<'a>> {
        Some(self.khr_meshopt.as_deref().or(self.ext_meshopt.as_deref())?)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonMeshopt<'a> {
    pub(super) buffer: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: u64,
    pub(super) count: u64,
    #[serde(borrow)]
    pub(super) mode: JsonText<'a>,
    #[serde(borrow)]
    pub(super) filter: Option<JsonText<'a>>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonBuffer<'a> {
    #[serde(borrow)]
    pub(super) uri: Option<JsonText<'a>>,
    pub(super) byte_length: u64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonImage<'a> {
    #[serde(borrow)]
    pub(super) uri: Option<JsonText<'a>>,
    pub(super) buffer_view: Option<u32>,
}

const _: () = assert!(
    size_of::<JsonNode>() <= OBJECT_BYTES_MAX
        && size_of::<JsonNodeExtensions>() <= OBJECT_BYTES_MAX
        && size_of::<JsonPrimitive>() <= OBJECT_BYTES_MAX
        && size_of::<JsonDraco>() <= OBJECT_BYTES_MAX
        && size_of::<JsonAccessor<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonSparse>() <= OBJECT_BYTES_MAX
        && size_of::<JsonView<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonMeshopt<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonBuffer<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonMaterial<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonMaterialExtensions>() <= OBJECT_BYTES_MAX
        && size_of::<JsonCamera<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonLight<'_>>() <= OBJECT_BYTES_MAX
        && size_of::<JsonTexture>() <= OBJECT_BYTES_MAX
        && size_of::<JsonTextureInfo>() <= OBJECT_BYTES_MAX
        && size_of::<JsonTextureTransform>() <= OBJECT_BYTES_MAX
        && size_of::<JsonSampler>() <= OBJECT_BYTES_MAX
);

fn yes() -> bool {
    true
}

/// The mode of a primitive that names none.
fn triangles() -> u32 {
    4
}

impl<'de> Deserialize<'de> for JsonAttributes {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<JsonAttributes, D::Error> {
        from.deserialize_map(AttributeNames)
    }
}

/// Reads the names of attributes, and keeps those that are read.
struct AttributeNames;

impl<'de> Visitor<'de> for AttributeNames {
    type Value = JsonAttributes;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of attributes")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut names: A) -> Result<JsonAttributes, A::Error> {
        let mut all = JsonAttributes::default();
        while let Some(name) = names.next_key::<JsonText<'de>>()? {
            let accessor: u32 = names.next_value()?;
            match &*name {
                "POSITION" => all.position = Some(accessor),
                "NORMAL" => all.normal = Some(accessor),
                "COLOR_0" => all.colour = Some(accessor),
                "TEXCOORD_0" => all.places[0] = Some(accessor),
                "TEXCOORD_1" => all.places[1] = Some(accessor),
                "TEXCOORD_2" => all.places[2] = Some(accessor),
                "TEXCOORD_3" => all.places[3] = Some(accessor),
                _ => all.other_count = all.other_count.saturating_add(1),
            }
        }
        Ok(all)
    }
}
