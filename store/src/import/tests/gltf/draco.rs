//! Streams of Draco. Two grids with all attributes, compressed by the C++ library, are what that library makes of them
//! again (`draco/*.glb`, written with glTF-Transform 4 and draco3dgltf 1.5); a real model is the one that was not
//! compressed; and what decoding takes is what is leased for it, whatever the stream.

use super::super::models::models;
use super::super::{Fixture, SourceMesh, check_error, read, same};
use super::glb::{F32, GlbWriter, U32, grid, triangles};
use crate::budget::{Budget, RESERVE_BYTES};
use crate::error::Code;
use crate::import::{ImportOptions, open};
use crate::source::TriangleBatch;
use draco_core::{
    AttributeValueIndex, DataType, EncoderBuffer, EncoderOptions, GeometryAttributeType, Mesh, MeshEncoder,
    PointAttribute, PointIndex,
};
use serde_json::{Value, json};

/// Each compressed, and decoded by the reference.
const FILES: [(&str, &[u8], &[u8]); 2] = [
    ("edgebreaker", include_bytes!("draco/edgebreaker.glb"), include_bytes!("draco/edgebreaker-plain.glb")),
    ("sequential", include_bytes!("draco/sequential.glb"), include_bytes!("draco/sequential-plain.glb")),
];

#[test]
fn streams_are_what_the_reference_makes_of_them() {
    for (name, packed, plain) in FILES {
        let [found, expected] = [packed, plain].map(|file| Fixture::new("a.glb", file).read().unwrap());
        assert_eq!(found.triangles.len(), 2 * 81 + 2 * 25, "{name}");
        assert!(same(&found.triangles, &expected.triangles), "{name}");
        assert_eq!(found.colours, expected.colours, "{name}");
        assert_eq!(found.normals, expected.normals, "{name}");
        assert_eq!(found.stats.vertex_count, expected.stats.vertex_count, "{name}");
    }
}

/// What triangles of a grid share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Share {
    /// Vertices, with their normals where they have any.
    Vertices,
    /// Places: each triangle has a normal of its own, so every edge is a seam.
    Places,
    /// Nothing.
    Nothing,
}

/// A bent grid, and its triangles.
fn mesh(n: usize, share: Share, has_normals: bool) -> (Mesh, Vec<[[f64; 3]; 3]>) {
    let (positions, indices) = grid(n);
    let expected = triangles(&positions, &indices);
    let corners = 3 * expected.len() as u32;
    let own: Vec<u32> = (0..corners).collect();
    let of_triangle: Vec<u32> = (0..corners).map(|corner| corner / 3).collect();
    // Values, which each vertex has, and the vertices of triangles.
    let (positions, places, normals, faces) = match share {
        Share::Vertices => (positions.clone(), None, (positions, None), &indices),
        Share::Places => {
            let firsts: Vec<_> = expected.iter().map(|triangle| triangle[0]).collect();
            (positions, Some(&indices), (firsts, Some(&of_triangle)), &own)
        }
        Share::Nothing => {
            (expected.as_flattened().to_vec(), None, (expected.as_flattened().to_vec(), None), &own)
        }
    };
    let vertices = if share == Share::Vertices { positions.len() } else { corners as usize };
    let mut mesh = Mesh::new();
    mesh.set_num_points(vertices);
    let position = (GeometryAttributeType::Position, &positions, places);
    let normal = (GeometryAttributeType::Normal, &normals.0, normals.1);
    for (kind, values, of_vertex) in [position, normal].into_iter().take(1 + usize::from(has_normals)) {
        let mut attribute = PointAttribute::new();
        attribute.init(kind, 3, DataType::Float32, false, values.len());
        let values: Vec<f32> = values.iter().flatten().map(|&value| value as f32 + 0.25).collect();
        attribute.buffer_mut().update_f32s_le(0, &values);
        if let Some(of_vertex) = of_vertex {
            attribute.set_explicit_mapping(vertices);
            for (vertex, value) in (0..).zip(of_vertex) {
                attribute.set_point_map_entry(PointIndex(vertex), AttributeValueIndex(*value));
            }
        }
        mesh.add_attribute(attribute);
    }
    mesh.set_num_faces(expected.len());
    mesh.set_faces_from_flat_indices(faces);
    let moved = |triangle: &[[f64; 3]; 3]| triangle.map(|corner| corner.map(|value| value + 0.25));
    (mesh, expected.iter().map(moved).collect())
}

/// As the encoder of the crate writes it: speed 10 without the neighbourhood of triangles, 0 with all predictions.
fn encoded(mesh: &Mesh, speed: i32) -> Vec<u8> {
    let mut options = EncoderOptions::new();
    options.set_global_int("encoding_speed", speed);
    options.set_global_int("decoding_speed", speed);
    for attribute in 0..mesh.num_attributes() {
        options.set_attribute_quantization(attribute, 14);
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh.clone());
    let mut bytes = EncoderBuffer::new();
    encoder.encode(&options, &mut bytes).unwrap();
    bytes.data().to_vec()
}

/// A primitive of a stream, with accessors of its own.
fn primitive(glb: &mut GlbWriter, stream: &[u8], mesh: &Mesh) -> Value {
    let view = glb.view(stream);
    let vertices = json!({ "componentType": F32, "type": "VEC3", "count": mesh.num_points() });
    let corners = json!({ "componentType": U32, "type": "SCALAR", "count": 3 * mesh.num_faces() });
    let (position, indices) = (glb.push("accessors", vertices.clone()), glb.push("accessors", corners));
    let (mut accessors, mut attributes) = (json!({ "POSITION": position }), json!({ "POSITION": 0 }));
    if mesh.num_attributes() > 1 {
        accessors["NORMAL"] = json!(glb.push("accessors", vertices));
        attributes["NORMAL"] = json!(1);
    }
    let draco = json!({ "bufferView": view, "attributes": attributes });
    json!({ "attributes": accessors, "indices": indices, "extensions": { "KHR_draco_mesh_compression": draco } })
}

/// Triangles in any order, each from its least corner on, within half a step of 14 bits.
fn assert_alike(found: &SourceMesh, expected: &[[[f64; 3]; 3]], name: &str) {
    let sorted = |triangles: &[[[f64; 3]; 3]]| {
        let mut triangles = triangles.to_vec();
        for triangle in &mut triangles {
            for value in triangle.as_flattened_mut() {
                *value = (*value * 16.0).round() / 16.0;
            }
            let least = (0..3).min_by(|&a, &b| triangle[a].partial_cmp(&triangle[b]).unwrap());
            triangle.rotate_left(least.unwrap());
        }
        triangles.sort_by(|a, b| a.partial_cmp(b).unwrap());
        triangles
    };
    assert!(sorted(&found.triangles) == sorted(expected), "{name}");
}

/// Speeds choose the way in which triangles and values are predicted.
#[test]
fn grids_and_soups_at_all_speeds() {
    for speed in 0..=10 {
        for (share, has_normals) in [
            (Share::Vertices, false),
            (Share::Vertices, true),
            (Share::Places, true),
            (Share::Nothing, false),
        ] {
            let (mesh, expected) = mesh(17, share, has_normals);
            let mut glb = GlbWriter::new();
            let primitive = primitive(&mut glb, &encoded(&mesh, speed), &mesh);
            glb.place(primitive);
            let name = format!("speed {speed}, sharing {share:?}, normals {has_normals}");
            let found =
                Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_alike(&found, &expected, &name);
        }
    }
}

/// Accessors without a view say how many rows there are, not which: two streams may have the same.
#[test]
fn two_streams_share_their_accessors() {
    let (mesh, mut expected) = mesh(6, Share::Vertices, false);
    let (mut moved, further) = (mesh.clone(), |value: f32| value + 512.0);
    let values: Vec<f32> =
        mesh.attribute(0).read_f32s(mesh.num_points(), 3).into_iter().map(further).collect();
    moved.attribute_mut(0).buffer_mut().update_f32s_le(0, &values);
    let mut glb = GlbWriter::new();
    let first = primitive(&mut glb, &encoded(&mesh, 5), &mesh);
    let mut second = first.clone();
    let view = glb.view(&encoded(&moved, 5));
    second["extensions"]["KHR_draco_mesh_compression"]["bufferView"] = json!(view);
    let mesh = glb.push("meshes", json!({ "primitives": [first, second] }));
    glb.node(json!({ "mesh": mesh }));
    let found = Fixture::new("a.glb", &glb.glb()).read().unwrap();
    expected.extend(
        expected.clone().iter().map(|triangle| triangle.map(|corner| corner.map(|value| value + 512.0))),
    );
    assert_alike(&found, &expected, "both");
}

/// What has bytes of its own is read from them.
#[test]
fn a_form_without_compression_is_preferred() {
    let (positions, indices) = grid(3);
    let mut glb = GlbWriter::new();
    let view = glb.view(b"no stream");
    let accessors = [glb.positions(&positions), glb.indices(&indices, U32)];
    let draco = json!({ "bufferView": view, "attributes": { "POSITION": 0 } });
    glb.place(json!({
        "attributes": { "POSITION": accessors[0] }, "indices": accessors[1],
        "extensions": { "KHR_draco_mesh_compression": draco },
    }));
    let found = Fixture::new("a.glb", &glb.glb()).read().unwrap();
    assert!(same(&found.triangles, &triangles(&positions, &indices)));
}

#[test]
fn streams_that_lie_are_refused() {
    let (mesh, _) = mesh(9, Share::Vertices, true);
    let stream = encoded(&mesh, 5);
    let refused = |code: Code, words: &str, change: &dyn Fn(&mut GlbWriter, &mut Value)| {
        let mut glb = GlbWriter::new();
        let mut primitive = primitive(&mut glb, &stream, &mesh);
        change(&mut glb, &mut primitive);
        glb.place(primitive);
        check_error("a.glb", &glb.glb(), code, words);
    };
    let draco = "KHR_draco_mesh_compression";
    refused(Code::InputFormat, "cannot be decoded", &|glb, _| glb.bin[20] ^= 0x55);
    refused(Code::InputFormat, "cannot be decoded", &|glb, _| {
        glb.json["bufferViews"][0]["byteLength"] = json!(stream.len() / 2);
    });
    refused(Code::InputFormat, "bufferViews[0]", &|glb, _| glb.json["accessors"][1]["count"] = json!(3));
    refused(Code::InputFormat, "100 vertices and 162 triangles", &|glb, _| {
        glb.json["accessors"][0]["count"] = json!(101);
        glb.json["accessors"][2]["count"] = json!(101);
    });
    refused(Code::InputFormat, "no attribute 7", &|_, primitive| {
        primitive["extensions"][draco]["attributes"]["NORMAL"] = json!(7);
    });
    refused(Code::InputFormat, "3 numbers of Float32", &|glb, _| {
        glb.json["accessors"][2]["componentType"] = json!(5130);
    });
    refused(Code::InputFormat, "no list of triangles", &|_, primitive| primitive["mode"] = json!(5));
    refused(Code::InputFormat, "no list of triangles", &|_, primitive| {
        primitive.as_object_mut().unwrap().remove("indices");
    });
    refused(Code::InputFormat, "no list of triangles", &|_, primitive| {
        primitive["extensions"][draco].as_object_mut().unwrap().remove("bufferView");
    });
    refused(Code::InputFormat, "bufferViews[9]", &|_, primitive| {
        primitive["extensions"][draco]["bufferView"] = json!(9);
    });
    refused(Code::InputFormat, "4294967295", &|glb, _| {
        for accessor in 0..3 {
            glb.json["accessors"][accessor]["count"] = json!(u32::MAX);
        }
    });
}

/// What a primitive takes is leased before, and one that is too large is refused by its name.
#[test]
fn decoding_takes_what_is_leased() {
    let kinds =
        [(Share::Vertices, false), (Share::Vertices, true), (Share::Places, true), (Share::Nothing, true)];
    for (speed, (share, has_normals)) in
        [0, 3, 5, 10].into_iter().flat_map(|speed| kinds.map(|kind| (speed, kind)))
    {
        let (mesh, expected) = mesh(127, share, has_normals);
        let mut glb = GlbWriter::new();
        let primitive = primitive(&mut glb, &encoded(&mesh, speed), &mesh);
        glb.place(primitive);
        let fixture = Fixture::new("a.glb", &glb.glb());
        let within = |limit: u64| ImportOptions {
            budget: Budget::new(RESERVE_BYTES + limit),
            vertex_cache_bytes: 1 << 16,
            ..fixture.options()
        };
        let options = within(1 << 30);
        let mut batch = TriangleBatch::default();
        let taken = allocation_counter::measure(|| {
            let mut source = open(&fixture.path, &options).unwrap();
            assert!(source.next_batch(&mut batch).unwrap());
        });
        let leased = options.budget.peak_bytes();
        // The batch, and the text of the file: 72 bytes for corners, beside materials, colours and normals.
        let beside = 256 * TriangleBatch::TARGET_TRIANGLES as u64;
        assert!(
            taken.bytes_max <= leased + beside,
            "speed {speed}, sharing {share:?}: {} of {leased} leased for {} triangles and {} vertices",
            taken.bytes_max,
            expected.len(),
            mesh.num_points(),
        );
        let error = open(&fixture.path, &within(1 << 20)).unwrap().next_batch(&mut batch).unwrap_err();
        assert_eq!(error.code(), Code::MemoryLimit);
        assert!(error.place().contains("bufferViews[0]"), "{error}");
    }
}

/// An engine of 29 meshes, as it was before it was compressed, but for triangles without area, which the encoder left
/// out.
#[test]
fn a_compressed_engine_is_an_engine() {
    let Some(folder) = models() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let options = ImportOptions::unlimited(scratch.path());
    let [(count, area), (plain_count, plain_area)] =
        ["2CylinderEngine_draco/2CylinderEngine.gltf", "2CylinderEngine.glb"].map(|name| {
            let triangles = read(&folder.join("gltf").join(name), &options).unwrap().triangles;
            (triangles.len(), triangles.iter().map(super::real::area).sum::<f64>())
        });
    // As the accessors say, each as often as its mesh stands in a node.
    assert_eq!((count, plain_count), (110_336, 121_496));
    assert!((area / plain_area - 1.0).abs() < 1e-3, "{area} {plain_area}");
}
