//! Compressed views, written by a port of the reference's encoder: what comes out is what went in, and what the port's
//! own decoder says of damaged ones.

use super::super::{Fixture, check_error, same};
use super::glb::{F32, GlbWriter, I16, U16, U32, floats, grid, triangles};
use crate::error::Code;
use meshoptimizer_rs::codec;
use meshoptimizer_rs::codec::{ExpMode, IndexEncoding, VertexEncoding};
use serde_json::json;

fn workspace() -> meshoptimizer_rs::Workspace {
    meshoptimizer_rs::Workspace::default()
}

/// Adds a compressed view, and gives it.
fn packed(glb: &mut GlbWriter, bytes: &[u8], rows: (&str, usize, usize), filter: &str) -> usize {
    let (mode, stride, count) = rows;
    let place = glb.view(bytes);
    let meshopt = json!({
        "buffer": 0, "byteOffset": glb.json["bufferViews"][place]["byteOffset"], "byteLength": bytes.len(),
        "byteStride": stride, "count": count, "mode": mode, "filter": filter,
    });
    // What readers without the extension would read is not there.
    glb.push(
        "bufferViews",
        json!({
            "buffer": 1, "byteLength": stride * count, "extensions": { "EXT_meshopt_compression": meshopt }
        }),
    )
}

/// A grid of `n` by `n` with compressed positions and indices.
fn compressed(n: usize, vertices: VertexEncoding, mode: &str, component: u32) -> GlbWriter {
    let (positions, indices) = grid(n);
    let mut glb = GlbWriter::new();
    glb.push("buffers", json!({ "byteLength": 1 << 20 }));
    let bytes = floats(&positions);
    let bytes = codec::encode_vertex_buffer(&bytes, positions.len(), 12, vertices, &mut workspace()).unwrap();
    let view = packed(&mut glb, &bytes, ("ATTRIBUTES", 12, positions.len()), "NONE");
    let at = glb.push(
        "accessors",
        json!({ "bufferView": view, "componentType": F32, "type": "VEC3", "count": positions.len() }),
    );
    let bytes = match mode {
        "TRIANGLES" => codec::encode_index_buffer(&indices, IndexEncoding::DEFAULT, &mut workspace()),
        _ => codec::encode_index_sequence(&indices, IndexEncoding::DEFAULT, &mut workspace()),
    }
    .unwrap();
    let stride = if component == U16 { 2 } else { 4 };
    let view = packed(&mut glb, &bytes, (mode, stride, indices.len()), "NONE");
    let indices = glb.push(
        "accessors",
        json!({ "bufferView": view, "componentType": component, "type": "SCALAR", "count": indices.len() }),
    );
    glb.place(json!({ "attributes": { "POSITION": at }, "indices": indices }));
    glb
}

#[test]
fn grids_of_all_versions_and_modes() {
    for n in [1, 4, 15, 16, 50, 120] {
        for (version, level) in [(0, 2), (1, 0), (1, 2), (1, 3)] {
            let encoding = VertexEncoding::new(version, level).unwrap();
            for (mode, component) in
                [("TRIANGLES", U32), ("TRIANGLES", U16), ("INDICES", U16), ("INDICES", U32)]
            {
                let glb = compressed(n, encoding, mode, component);
                let mesh = Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{error}"));
                let (positions, indices) = grid(n);
                // The encoder turns triangles so that another corner comes first.
                let first_least = |triangle: &[[f64; 3]; 3]| {
                    let mut turned = *triangle;
                    let least = (0..3).min_by(|&a, &b| triangle[a].partial_cmp(&triangle[b]).unwrap());
                    turned.rotate_left(least.unwrap());
                    turned
                };
                let found: Vec<_> = mesh.triangles.iter().map(first_least).collect();
                let expected: Vec<_> = triangles(&positions, &indices).iter().map(first_least).collect();
                assert!(same(&found, &expected), "{n} {version} {level} {mode}");
            }
        }
    }
}

/// Rows of any bytes, of any size, in numbers around a block's: against the port's decoder.
#[test]
fn rows_of_noise_and_of_steps() {
    let mut random = 0x9e37_79b9_u32;
    let mut next = move || {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        random
    };
    for stride in [4, 8, 12, 16, 28, 32, 64, 128, 256] {
        for count in [1usize, 15, 16, 17, 31, 255, 256, 257, 700] {
            let mut bytes = Vec::new();
            for row in 0..count {
                for word in 0..stride / 4 {
                    let number = match word % 4 {
                        0 => next(),
                        1 => (row * 3) as u32,
                        2 => (row as f32 * 0.1).to_bits(),
                        _ => next() & 0x0101_0303,
                    };
                    bytes.extend(number.to_le_bytes());
                }
            }
            for (version, level) in [(0, 0), (1, 0), (1, 1), (1, 2), (1, 3)] {
                let encoding = VertexEncoding::new(version, level).unwrap();
                let packed =
                    codec::encode_vertex_buffer(&bytes, count, stride, encoding, &mut workspace()).unwrap();
                assert!(
                    unpack(&packed, stride, count).unwrap() == bytes,
                    "{stride} {count} {version} {level}"
                );
            }
        }
    }
}

/// Decodes rows with the reader's decoder, out of a file.
fn unpack(packed: &[u8], stride: usize, count: usize) -> Option<Vec<u8>> {
    use super::super::super::gltf::testing::unpack_rows;
    unpack_rows(packed, stride, count)
}

/// Where the port refuses a damaged view the reader does, and where it does not both give the same rows.
#[test]
fn damaged_rows_are_refused_as_the_reference_refuses_them() {
    let (positions, _) = grid(20);
    let bytes = floats(&positions);
    for version in [0, 1] {
        let encoding = VertexEncoding::new(version, 2).unwrap();
        let sound =
            codec::encode_vertex_buffer(&bytes, positions.len(), 12, encoding, &mut workspace()).unwrap();
        for at in 0..sound.len() {
            for change in [1, 0x40, 0xff] {
                let mut damaged = sound.clone();
                damaged[at] ^= change;
                let theirs =
                    codec::decode_vertex_buffer(positions.len(), 12, &damaged, &mut workspace()).ok();
                assert!(unpack(&damaged, 12, positions.len()) == theirs, "byte {at} of {version}");
            }
        }
        for length in 0..sound.len() {
            assert!(unpack(&sound[..length], 12, positions.len()).is_none(), "{length} bytes");
        }
    }
}

#[test]
fn filtered_rows() {
    // Positions as exponents and mantissas of 15 bits hold whole numbers to 127 exactly.
    let (positions, indices) = grid(40);
    let numbers: Vec<f32> = positions.iter().flatten().map(|&value| value as f32).collect();
    let filtered =
        codec::encode_filter_exp(positions.len(), 12, 15, &numbers, ExpMode::Separate, &mut workspace())
            .unwrap();
    let encoding = VertexEncoding::new(0, 2).unwrap();
    let bytes =
        codec::encode_vertex_buffer(&filtered, positions.len(), 12, encoding, &mut workspace()).unwrap();
    let mut glb = GlbWriter::new();
    glb.push("buffers", json!({ "byteLength": 1 << 20 }));
    let view = packed(&mut glb, &bytes, ("ATTRIBUTES", 12, positions.len()), "EXPONENTIAL");
    let at = glb.push(
        "accessors",
        json!({ "bufferView": view, "componentType": F32, "type": "VEC3", "count": positions.len() }),
    );
    let indices_at = glb.indices(&indices, U16);
    let node = glb.place(json!({ "attributes": { "POSITION": at }, "indices": indices_at }));
    let expected = triangles(&positions, &indices);
    assert!(same(&Fixture::new("a.glb", &glb.glb()).read().unwrap().triangles, &expected));

    // Rotations of instances, a quarter turn around z among them.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turns =
        [[0.0, 0.0, half, half], [1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.5, -0.5], [0.0, 0.6, 0.0, -0.8f32]];
    let mut rows = codec::encode_filter_quat(4, 8, 16, turns.as_flattened(), &mut workspace()).unwrap();
    let bytes = codec::encode_vertex_buffer(&rows, 4, 8, encoding, &mut workspace()).unwrap();
    let view = packed(&mut glb, &bytes, ("ATTRIBUTES", 8, 4), "QUATERNION");
    let turns_at = glb.push(
        "accessors",
        json!({ "bufferView": view, "componentType": I16, "normalized": true, "type": "VEC4", "count": 4 }),
    );
    glb.json["nodes"][node]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "ROTATION": turns_at } } });
    let mesh = Fixture::new("a.glb", &glb.glb()).read().unwrap();
    assert_eq!(mesh.triangles.len(), 4 * expected.len());
    codec::decode_filter_quat(&mut rows, 4, 8, &mut workspace()).unwrap();
    let parts: Vec<f64> = rows
        .chunks_exact(2)
        .map(|part| f64::from(i16::from_le_bytes([part[0], part[1]])) / 32_767.0)
        .collect();
    for (turn, quaternion) in parts.chunks_exact(4).enumerate() {
        let first = mesh.triangles[turn * expected.len()][2];
        let want = turned(quaternion, expected[0][2]);
        assert!((0..3).all(|axis| (first[axis] - want[axis]).abs() < 1e-9), "{turn}: {first:?}, {want:?}");
    }
}

/// q v q*, after Hamilton.
fn turned(q: &[f64], v: [f64; 3]) -> [f64; 3] {
    let norm = q.iter().map(|part| part * part).sum::<f64>().sqrt();
    let product = |a: [f64; 4], b: [f64; 4]| {
        [
            a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
            a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
            a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
            a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
        ]
    };
    let q = [q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm];
    let turned = product(product(q, [v[0], v[1], v[2], 0.0]), [-q[0], -q[1], -q[2], q[3]]);
    [turned[0], turned[1], turned[2]]
}

/// A view may say it by both names.
#[test]
fn a_view_has_one_codec_by_two_names() {
    let sound = compressed(4, VertexEncoding::new(0, 2).unwrap(), "TRIANGLES", U32);
    let mut both = GlbWriter { json: sound.json.clone(), bin: sound.bin.clone() };
    for view in both.json["bufferViews"].as_array_mut().unwrap() {
        if let Some(meshopt) = view["extensions"].get("EXT_meshopt_compression").cloned() {
            view["extensions"]["KHR_meshopt_compression"] = meshopt;
        }
    }
    let triangles = |glb: GlbWriter| Fixture::new("a.glb", &glb.glb()).read().unwrap().triangles;
    assert!(triangles(both) == triangles(sound));
}

#[test]
fn what_no_position_has_is_refused() {
    let sound = compressed(4, VertexEncoding::new(0, 2).unwrap(), "TRIANGLES", U32);
    for (key, value, words) in [
        ("filter", json!("OCTAHEDRAL"), "filter OCTAHEDRAL"),
        ("mode", json!("POINTS"), "mode POINTS"),
        ("byteStride", json!(13), "byteStride 13"),
        ("byteStride", json!(260), "byteStride 260"),
        ("count", json!(300), "ends early"),
        ("count", json!(1u64 << 40), "count 1099511627776"),
        ("buffer", json!(7), "buffers[7]"),
        ("byteLength", json!(1u64 << 50), "outside of its buffer"),
    ] {
        let mut glb = GlbWriter { json: sound.json.clone(), bin: sound.bin.clone() };
        glb.json["bufferViews"][1]["extensions"]["EXT_meshopt_compression"][key] = value.clone();
        let bytes = glb.glb();
        let fixture = Fixture::new("a.glb", &bytes);
        let error = fixture.read().map(|mesh| mesh.triangles.len()).unwrap_err();
        assert!(error.to_string().contains(words), "{key}: {error}");
    }
    let mut damaged = GlbWriter { json: sound.json.clone(), bin: sound.bin.clone() };
    damaged.bin[0] = 0xa7;
    check_error("a.glb", &damaged.glb(), Code::InputFormat, "does not begin as rows of vertices");
}
