//! One mesh in each encoding of its numbers: the triangles are those that the numbers stand for, bit for bit.

use super::super::{Fixture, SourceMesh, SourceTriangle, same};
use super::glb::{F32, GlbWriter, I8, I16, U8, U16, U32, floats, grid, integers, triangles};
use crate::cluster::Normal;
use serde_json::{Value, json};
use std::os::unix::ffi::OsStrExt;

/// Reads a writer's file as GLB, and compares.
fn check(glb: &GlbWriter, expected: &[SourceTriangle]) -> SourceMesh {
    let mesh = Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{error}"));
    assert!(same(&mesh.triangles, expected), "{}", glb.json["accessors"]);
    mesh
}

fn primitive(positions: usize, indices: usize) -> Value {
    json!({ "attributes": { "POSITION": positions }, "indices": indices })
}

#[test]
fn indices_of_all_types() {
    let (positions, indices) = grid(14);
    for component in [U8, U16, U32] {
        let mut glb = GlbWriter::new();
        let primitive = primitive(glb.positions(&positions), glb.indices(&indices, component));
        glb.place(primitive);
        let mesh = check(&glb, &triangles(&positions, &indices));
        assert_eq!((mesh.stats.vertex_count, mesh.stats.instance_count), (225, 0));
        assert_eq!(mesh.stats.bytes_read, mesh.stats.bytes_total);
    }
    let mut glb = GlbWriter::new();
    let corners = triangles(&positions, &indices);
    let positions = glb.positions(corners.as_flattened());
    glb.place(json!({ "attributes": { "POSITION": positions } }));
    check(&glb, &corners);
}

#[test]
fn positions_of_all_types() {
    let (positions, indices) = grid(100);
    let expected = triangles(&positions, &indices);
    let whole: Vec<u32> = positions.iter().flatten().map(|&value| value as u32).collect();
    for (component, greatest) in [(I8, 127.0), (U8, 255.0), (I16, 32_767.0), (U16, 65_535.0)] {
        for is_normalized in [false, true] {
            let mut glb = GlbWriter::new();
            // Vertices begin at multiples of four bytes, as the extension asks: the rest of each is filled up.
            let bytes = integers(&whole, component);
            let row = bytes.len() / positions.len();
            let stride = row.next_multiple_of(4);
            let mut padded = Vec::new();
            for vertex in bytes.chunks_exact(row) {
                padded.extend_from_slice(vertex);
                padded.resize(padded.len().next_multiple_of(4), 0xee);
            }
            // The last row ends with its position: the view is no longer than it has to be.
            padded.truncate(padded.len() - (stride - row));
            let accessor = glb.accessor(&padded, component, "VEC3", positions.len());
            glb.json["accessors"][accessor]["normalized"] = json!(is_normalized);
            glb.json["bufferViews"][0]["byteStride"] = json!(stride);
            let primitive = primitive(accessor, glb.indices(&indices, U32));
            glb.place(primitive);
            let shares = |t: &SourceTriangle| t.map(|corner| corner.map(|value| value / greatest));
            let shares: Vec<_> = expected.iter().map(shares).collect();
            check(&glb, if is_normalized { &shares } else { &expected });
        }
    }
}

#[test]
fn least_integers_are_shares_of_minus_one() {
    let mut glb = GlbWriter::new();
    let accessor = glb.accessor(&[0x80, 0x81, 0x7f, 0, 0, 0, 1, 2, 3], I8, "VEC3", 3);
    glb.json["accessors"][accessor]["normalized"] = json!(true);
    glb.place(json!({ "attributes": { "POSITION": accessor } }));
    let small = [1.0, 2.0, 3.0].map(|value| value / 127.0);
    check(&glb, &[[[-1.0, -1.0, 1.0], [0.0; 3], small]]);
}

/// The last vertex of an interleaved view ends with the view, though a whole stride from its position on does not.
#[test]
fn interleaved_vertices() {
    let (positions, indices) = grid(30);
    let mut glb = GlbWriter::new();
    let indices_at = glb.indices(&indices, U16);
    let mut rows = Vec::new();
    for (at, position) in positions.iter().enumerate() {
        rows.extend(floats(&[[at as f64, -1.0, 0.5]]));
        rows.extend([7; 8]);
        rows.extend(floats(&[*position]));
    }
    let accessor = glb.accessor(&rows, F32, "VEC3", positions.len());
    glb.json["accessors"][accessor]["byteOffset"] = json!(20);
    let view = glb.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    glb.json["bufferViews"][view]["byteStride"] = json!(32);
    let mut normals = glb.json["accessors"][accessor].clone();
    normals["byteOffset"] = json!(0);
    let normals = glb.push("accessors", normals);
    let attributes = json!({ "POSITION": accessor, "NORMAL": normals, "TEXCOORD_0": 0 });
    let primitive = json!({ "attributes": attributes, "indices": indices_at });
    glb.place(primitive);
    let mesh = check(&glb, &triangles(&positions, &indices));
    assert_eq!(mesh.stats.dropped_attribute_count, positions.len() as u64);
    let normal = |vertex: &u32| Normal::from_vector([f64::from(*vertex), -1.0, 0.5]);
    assert!(mesh.normals.as_flattened().iter().copied().eq(indices.iter().map(normal)));
}

#[test]
fn strips_and_fans() {
    let corners: Vec<[f64; 3]> = (0..7).map(|i| [f64::from(i), f64::from(i % 2), f64::from(i * i)]).collect();
    let [a, b, c, d, e, f, g] = corners[..] else { unreachable!() };
    // As chapter 3.7.2.1 of the specification lists them.
    let strip = [[a, b, c], [b, d, c], [c, d, e], [d, f, e], [e, f, g]];
    let fan = [[b, c, a], [c, d, a], [d, e, a], [e, f, a], [f, g, a]];
    for (mode, expected) in [(5, &strip), (6, &fan)] {
        let mut glb = GlbWriter::new();
        let positions = glb.positions(&corners);
        glb.place(json!({ "attributes": { "POSITION": positions }, "mode": mode }));
        check(&glb, expected);
        let indices = glb.indices(&[0, 1, 2, 3, 4, 5, 6], U8);
        glb.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        check(&glb, expected);
    }
}

/// A fan whose indices do not fit a window asks for its first one all the time.
#[test]
fn a_fan_that_is_longer_than_a_window() {
    let corners: Vec<[f64; 3]> = (0..40_000).map(|i| [f64::from(i), f64::from(i % 7), 1.0]).collect();
    let mut glb = GlbWriter::new();
    let positions = glb.positions(&corners);
    let indices = glb.indices(&(0..40_000).collect::<Vec<_>>(), U32);
    glb.place(json!({ "attributes": { "POSITION": positions }, "indices": indices, "mode": 6 }));
    let expected: Vec<_> = (1..39_999).map(|at| [corners[at], corners[at + 1], corners[0]]).collect();
    check(&glb, &expected);
}

#[test]
fn replaced_rows() {
    let (mut positions, indices) = grid(20);
    for has_view in [true, false] {
        let mut glb = GlbWriter::new();
        let accessor = if has_view {
            glb.positions(&positions)
        } else {
            positions.fill([0.0; 3]);
            glb.push("accessors", json!({ "componentType": F32, "type": "VEC3", "count": positions.len() }))
        };
        let replaced = [0usize, 3, 200, 440];
        let values: Vec<[f64; 3]> = (0..4).map(|i| [f64::from(i), -5.0, 0.25]).collect();
        let which: Vec<u32> = replaced.iter().map(|&at| at as u32).collect();
        let (which, values_at) = (glb.view(&integers(&which, U16)), glb.view(&floats(&values)));
        glb.json["accessors"][accessor]["sparse"] = json!({
            "count": 4, "indices": { "bufferView": which, "componentType": U16 },
            "values": { "bufferView": values_at },
        });
        replaced.iter().zip(&values).for_each(|(&at, value)| positions[at] = *value);
        let primitive = primitive(accessor, glb.indices(&indices, U16));
        glb.place(primitive);
        check(&glb, &triangles(&positions, &indices));
    }
}

/// Indices that are replaced go through the same gate.
#[test]
fn replaced_indices() {
    let (positions, indices) = grid(3);
    let mut glb = GlbWriter::new();
    let at = glb.positions(&positions);
    let mut wrong = indices.clone();
    (wrong[4], wrong[17]) = (0, 0);
    let accessor = glb.indices(&wrong, U8);
    let values = glb.view(&[indices[4] as u8, indices[17] as u8]);
    let which = glb.view(&[4, 17]);
    glb.json["accessors"][accessor]["sparse"] = json!({
        "count": 2, "indices": { "bufferView": which, "componentType": U8 }, "values": { "bufferView": values },
    });
    glb.place(primitive(at, accessor));
    check(&glb, &triangles(&positions, &indices));
}

#[test]
fn buffers_beside_and_within() {
    let (positions, indices) = grid(90);
    let mut glb = GlbWriter::new();
    let primitive = primitive(glb.positions(&positions), glb.indices(&indices, U16));
    glb.place(primitive);
    let expected = triangles(&positions, &indices);
    let data = glb.gltf(&glb.data_uri());
    for (name, content) in [("a.gltf", &data[..]), ("a", &data), ("a.GLTF", &data)] {
        let mesh = Fixture::new(name, content).read().unwrap();
        assert!(same(&mesh.triangles, &expected));
    }
    let marked = [b"\xef\xbb\xbf", &data[..]].concat();
    assert!(same(&Fixture::new("a.gltf", &marked).read().unwrap().triangles, &expected));
    // Escapes as the specification has them, and a name as careless writers leave it; also one folder up.
    for (uri, file) in
        [("a%20b.bin", "a b.bin"), ("a b.bin", "a b.bin"), ("50%.bin", "50%.bin"), ("x/../c", "c")]
    {
        let fixture = Fixture::new("a.gltf", &glb.gltf(uri));
        std::fs::create_dir(fixture.folder.path().join("x")).unwrap();
        std::fs::write(fixture.folder.path().join(file), &glb.bin).unwrap();
        let mesh = fixture.read().unwrap_or_else(|error| panic!("{error}"));
        assert!(same(&mesh.triangles, &expected), "{uri}");
        let named = &mesh.stats.named_files;
        assert_eq!(named.len(), 1);
        assert!(named[0].0.ends_with(file.as_bytes()) && named[0].1.contains("bytes"), "{named:?}");
        let told = crate::import::info(&fixture.path, &fixture.options()).unwrap();
        assert_eq!(
            told.named_files.iter().map(|path| path.as_os_str().as_bytes()).collect::<Vec<_>>(),
            [&named[0].0]
        );
    }
}

/// Two primitives of one mesh that share their positions, as exporters write parts of several materials.
#[test]
fn primitives_share_positions_and_keep_their_materials() {
    let (positions, indices) = grid(10);
    let (one, other) = indices.split_at(300);
    let mut glb = GlbWriter::new();
    let at = glb.positions(&positions);
    let parts = [glb.indices(one, U8), glb.indices(other, U8)];
    for name in ["red", "blue"] {
        glb.push("materials", json!({ "name": name }));
    }
    let primitives = parts.map(|part| {
        json!({
            "attributes": { "POSITION": at }, "indices": part, "material": usize::from(part == parts[0])
        })
    });
    glb.push("meshes", json!({ "primitives": primitives }));
    glb.node(json!({ "mesh": 0 }));
    let mesh = check(&glb, &triangles(&positions, &indices));
    assert_eq!((&*mesh.material_names[0], &*mesh.material_names[199]), ("blue", "red"));
    assert_eq!(mesh.stats.vertex_count, 121);
}
