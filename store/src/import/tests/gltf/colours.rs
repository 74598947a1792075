//! COLOR_0 in each encoding: linear numbers in the file, sRGB bytes of the corners.

use super::super::{Fixture, check_error};
use super::glb::{F32, GlbWriter, U8, U16, U32, grid, integers};
use crate::error::Code;
use serde_json::{Value, json};

/// The byte whose sRGB curve passes nearest to `linear`, by search of the curve's own definition.
fn nearest_byte(linear: f64) -> u8 {
    let distance = |byte: &u8| {
        let coded = f64::from(*byte) / 255.0;
        let curve = if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) };
        // Nearest as coded, where steps are alike.
        (curve.powf(1.0 / 2.4) - linear.powf(1.0 / 2.4)).abs()
    };
    (0..=255).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// Linear shares of a vertex.
fn shares(vertex: usize) -> [f64; 4] {
    [(vertex * 5 % 256) as f64 / 255.0, (vertex % 256) as f64 / 255.0, 1.0, 0.5]
}

/// A grid with such colours, and their accessor.
fn coloured(component: u32, kind: &str) -> (GlbWriter, Vec<u32>, usize) {
    let (positions, indices) = grid(15);
    let mut glb = GlbWriter::new();
    let channels = if kind == "VEC3" { 3 } else { 4 };
    let mut bytes = Vec::new();
    for vertex in 0..positions.len() {
        for share in &shares(vertex)[..channels] {
            match component {
                F32 => bytes.extend((*share as f32).to_le_bytes()),
                U16 => bytes.extend(integers(&[(share * 65_535.0).round() as u32], U16)),
                _ => bytes.extend(integers(&[(share * 255.0).round() as u32], U8)),
            }
        }
        bytes.resize(bytes.len().next_multiple_of(4), 0xee);
    }
    let stride = bytes.len() / positions.len();
    let accessor = glb.accessor(&bytes, component, kind, positions.len());
    glb.json["accessors"][accessor]["normalized"] = json!(component != F32);
    glb.json["bufferViews"][0]["byteStride"] = json!(stride);
    let attributes = json!({ "POSITION": glb.positions(&positions), "COLOR_0": accessor });
    let primitive = json!({ "attributes": attributes, "indices": glb.indices(&indices, U32) });
    glb.place(primitive);
    (glb, indices, accessor)
}

fn read(glb: &GlbWriter) -> super::super::SourceMesh {
    Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn linear_numbers_of_all_types_become_bytes() {
    for component in [U8, U16, F32] {
        for kind in ["VEC3", "VEC4"] {
            let (glb, indices, _) = coloured(component, kind);
            let mesh = read(&glb);
            let byte =
                |vertex: &u32| [0, 1, 2].map(|channel| nearest_byte(shares(*vertex as usize)[channel]));
            let expected: Vec<[[u8; 3]; 3]> =
                indices.chunks(3).map(|t| [0, 1, 2].map(|i| byte(&t[i]))).collect();
            assert_eq!(mesh.colours.len(), expected.len());
            for (found, expected) in mesh.colours.as_flattened().iter().zip(expected.as_flattened()) {
                let is_near = found.iter().zip(expected).all(|(found, wanted)| found.abs_diff(*wanted) <= 1);
                assert!(is_near, "{component} {kind}: {found:?}, not {expected:?}");
            }
            assert_eq!(mesh.stats.dropped_attribute_count, 0);
        }
    }
}

/// A mirrored node turns its triangles about, and their colours with them; what has no colours stays white.
#[test]
fn colours_stay_at_their_corners() {
    let (mut glb, _, _) = coloured(U8, "VEC4");
    let (positions, indices) = grid(3);
    let plain = json!({ "attributes": { "POSITION": glb.positions(&positions) },
        "indices": glb.indices(&indices, U32) });
    glb.place(plain);
    let mesh = read(&glb);
    glb.json["nodes"][0]["scale"] = json!([-1.0, 1.0, 1.0]);
    let mirrored = read(&glb);
    let place = |corner: &[f64; 3], sign: f64| [sign * corner[0], corner[1], corner[2]].map(f64::to_bits);
    let at_corners = |mesh: &super::super::SourceMesh, sign: f64| {
        let mut all: Vec<_> =
            mesh.triangles[..450].as_flattened().iter().zip(mesh.colours.as_flattened()).collect::<Vec<_>>();
        all.sort_by_key(|(corner, _)| place(corner, sign));
        all.iter().map(|(corner, colour)| (place(corner, sign), **colour)).collect::<Vec<_>>()
    };
    assert_ne!(mesh.triangles, mirrored.triangles);
    // Vertices at x = 0 have a sign of zero, and stand at both ends.
    let key = |all: Vec<([u64; 3], [u8; 3])>| {
        let mut all: Vec<_> = all
            .into_iter()
            .map(|(at, c)| (at.map(|bits| (f64::from_bits(bits) + 0.0).to_bits()), c))
            .collect();
        all.sort_unstable();
        all
    };
    assert_eq!(key(at_corners(&mesh, 1.0)), key(at_corners(&mirrored, -1.0)));
    assert!(mesh.colours[450..].iter().all(|corners| *corners == [[255; 3]; 3]) && mesh.colours.len() == 468);
}

#[test]
fn colours_that_cannot_be_are_refused() {
    let edit = |key: &str, value: Value| {
        let (mut glb, _, accessor) = coloured(U8, "VEC4");
        glb.json["accessors"][accessor][key] = value;
        glb.glb()
    };
    check_error("a.glb", &edit("count", json!(9)), Code::InputFormat, "9 colours, 256 positions");
    check_error("a.glb", &edit("type", json!("VEC2")), Code::InputFormat, "Colours wanted, found type VEC2");
    check_error("a.glb", &edit("componentType", json!(5125)), Code::InputFormat, "Colours wanted");
}

/// A filter that is not decoded costs the colours, not the model.
#[test]
fn colours_behind_a_filter_of_their_own_are_dropped() {
    let (mut glb, _, accessor) = coloured(U8, "VEC4");
    let view = glb.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    glb.json["bufferViews"][view]["extensions"] = json!({ "KHR_meshopt_compression": {
        "buffer": 0, "byteLength": 9, "byteStride": 4, "count": 256, "mode": "ATTRIBUTES", "filter": "COLOR" } });
    let mesh = read(&glb);
    assert_eq!((mesh.stats.dropped_attribute_count, mesh.triangles.len()), (256, 450));
    assert!(mesh.colours.iter().all(|corners| *corners == [[255; 3]; 3]));
}
