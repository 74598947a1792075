//! `GlbWriter`: glTF documents for tests, part by part; and a mesh whose coordinates every encoding holds exactly.

use super::super::SourceTriangle;
use base64::Engine;
use serde_json::{Value, json};

/// Component types.
pub(super) const I8: u32 = 5120;
pub(super) const U8: u32 = 5121;
pub(super) const I16: u32 = 5122;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
pub(super) const F32: u32 = 5126;

/// A document and its binary chunk.
pub(super) struct GlbWriter {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
}

impl GlbWriter {
    /// A scene without nodes.
    pub(super) fn new() -> GlbWriter {
        let json = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [] }], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [], "buffers": [{ "byteLength": 0 }], "materials": [],
        });
        GlbWriter { json, bin: Vec::new() }
    }

    /// Appends an item to a list, and gives its index.
    pub(super) fn push(&mut self, list: &str, item: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    /// A view of `bytes`, at a multiple of four.
    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0xee);
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }

    /// An accessor of all rows of a view of its own.
    pub(super) fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }),
        )
    }

    /// Positions as floats.
    pub(super) fn positions(&mut self, positions: &[[f64; 3]]) -> usize {
        self.accessor(&floats(positions), F32, "VEC3", positions.len())
    }

    /// Indices of a type.
    pub(super) fn indices(&mut self, indices: &[u32], component: u32) -> usize {
        self.accessor(&integers(indices, component), component, "SCALAR", indices.len())
    }

    /// A mesh of one primitive, in a node of the scene. Gives the node.
    pub(super) fn place(&mut self, primitive: Value) -> usize {
        let mesh = self.push("meshes", json!({ "primitives": [primitive] }));
        self.node(json!({ "mesh": mesh }))
    }

    /// A node of the scene.
    pub(super) fn node(&mut self, node: Value) -> usize {
        let node = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    /// The document with the length of its buffer.
    pub(super) fn document(&self) -> Value {
        let mut json = self.json.clone();
        if json["buffers"][0]["byteLength"] == 0 {
            json["buffers"][0]["byteLength"] = json!(self.bin.len());
        }
        json
    }

    /// As a GLB file.
    pub(super) fn glb(&self) -> Vec<u8> {
        glb(self.document().to_string().as_bytes(), &self.bin)
    }

    /// As a glTF file with the buffer at this URI.
    pub(super) fn gltf(&self, uri: &str) -> Vec<u8> {
        let mut json = self.document();
        json["buffers"][0]["uri"] = json!(uri);
        json.to_string().into_bytes()
    }

    /// The buffer as a data URI.
    pub(super) fn data_uri(&self) -> String {
        let text = base64::engine::general_purpose::STANDARD.encode(&self.bin);
        format!("data:application/octet-stream;base64,{text}")
    }
}

/// A container of a text and a binary chunk.
pub(super) fn glb(text: &[u8], bin: &[u8]) -> Vec<u8> {
    let mut text = text.to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let total = 12 + 8 + text.len() + 8 + bin.len().next_multiple_of(4);
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((total as u32).to_le_bytes());
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(&text);
    bytes.extend((bin.len().next_multiple_of(4) as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(bin);
    bytes.resize(total, 0);
    bytes
}

pub(super) fn floats(positions: &[[f64; 3]]) -> Vec<u8> {
    positions.iter().flatten().flat_map(|&value| (value as f32).to_le_bytes()).collect()
}

pub(super) fn integers(values: &[u32], component: u32) -> Vec<u8> {
    let bytes = match component {
        I8 | U8 => 1,
        I16 | U16 => 2,
        _ => 4,
    };
    values.iter().flat_map(|value| value.to_le_bytes()[..bytes].to_vec()).collect()
}

/// A bent grid of `n` by `n` squares: positions of whole numbers from 0 to 127, and triangles.
pub(super) fn grid(n: usize) -> (Vec<[f64; 3]>, Vec<u32>) {
    assert!(n < 128);
    let mut positions = Vec::new();
    for (y, x) in (0..=n).flat_map(|y| (0..=n).map(move |x| (y, x))) {
        positions.push([x as f64, y as f64, ((x * 7 + y * y * 3) % 128) as f64]);
    }
    let mut indices = Vec::new();
    for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
        let at = (y * (n + 1) + x) as u32;
        let above = at + n as u32 + 1;
        indices.extend([at, at + 1, above + 1, at, above + 1, above]);
    }
    (positions, indices)
}

/// The triangles that positions and indices make.
pub(super) fn triangles(positions: &[[f64; 3]], indices: &[u32]) -> Vec<SourceTriangle> {
    let corner = |index: u32| positions[index as usize];
    indices.chunks_exact(3).map(|t| [corner(t[0]), corner(t[1]), corner(t[2])]).collect()
}

/// A GLB file of two triangles that uses much of the format, for changes at random: a matrix, a strip, a replaced row,
/// instances, a light, a camera, a material and its picture.
pub(in super::super) fn small_glb() -> Vec<u8> {
    let mut glb = GlbWriter::new();
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
    let positions = glb.positions(&corners);
    let (which, values) = (glb.view(&[2, 0]), glb.view(&floats(&[[0.0, 2.0, 0.0]])));
    glb.json["accessors"][positions]["sparse"] = json!({
        "count": 1, "indices": { "bufferView": which, "componentType": U16 }, "values": { "bufferView": values }
    });
    let indices = glb.indices(&[0, 1, 2, 3], U8);
    let places = glb.positions(&[[1.0, 2.0, 3.0]]);
    let mut picture = Vec::new();
    let mut encoder = png::Encoder::new(&mut picture, 2, 2);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().unwrap().write_image_data(&[9, 99, 199, 255]).unwrap();
    let view = glb.view(&picture);
    glb.json["images"] = json!([{ "bufferView": view }]);
    glb.json["textures"] = json!([{ "source": 0 }]);
    let shares = integers(&[0, 0, 255, 0, 0, 255, 255, 255], U8);
    let coordinates = glb.accessor(&shares, U8, "VEC2", 4);
    glb.json["accessors"][coordinates]["normalized"] = json!(true);
    let look = json!({ "baseColorTexture": { "index": 0 } });
    let material = glb
        .push("materials", json!({ "name": "a", "emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": look }));
    let attributes = json!({ "POSITION": positions, "TEXCOORD_0": coordinates });
    let node = glb.place(json!({
        "attributes": attributes, "indices": indices, "mode": 5, "material": material
    }));
    glb.json["nodes"][node]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": places } } });
    glb.json["nodes"][node]["scale"] = json!([-1, 2, 1]);
    glb.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } }]);
    glb.json["extensions"] =
        json!({ "KHR_lights_punctual": { "lights": [{ "type": "spot", "intensity": 5 }] } });
    glb.node(json!({ "camera": 0, "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
    glb.glb()
}

/// A quad with normals under a node that scales it.
pub(in super::super) struct NormalsGlb<'a> {
    pub(in super::super) corners: &'a [[f64; 3]; 4],
    pub(in super::super) normals: &'a [[f64; 3]; 4],
    pub(in super::super) scale: [f64; 3],
}

impl NormalsGlb<'_> {
    /// The file.
    pub(in super::super) fn bytes(&self) -> Vec<u8> {
        let mut glb = GlbWriter::new();
        let normals = glb.accessor(&floats(self.normals), F32, "VEC3", 4);
        let attributes = json!({ "POSITION": glb.positions(self.corners), "NORMAL": normals });
        let primitive = json!({ "attributes": attributes, "indices": glb.indices(&[0, 1, 2, 0, 2, 3], U16) });
        glb.place(primitive);
        glb.json["nodes"][0]["scale"] = json!(self.scale);
        glb.glb()
    }
}
