//! glTF through the command: the same model as from PLY, its scene beside the output, nothing replaced that it names,
//! and the limit as the kernel counts.

use crate::cgroup::Cgroup;
use crate::command::{document_in, folder, listing, run_in, said};
use crate::support::{build_options, build_source, source};
use crate::view::ViewProcess;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use trex_store::import::{ImportOptions, open};
use trex_store::{Budget, TriangleBatch};

/// A container of a text and a binary chunk.
pub(crate) fn glb(text: &str, bin: &[u8]) -> Vec<u8> {
    let pad = |bytes: &[u8], fill: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), fill);
        bytes
    };
    let (text, bin) = (pad(text.as_bytes(), b' '), pad(bin, 0));
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, bytes) in [(b"JSON", text), (b"BIN\0", bin)] {
        file.extend((bytes.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(bytes);
    }
    file
}

/// A document of one mesh in one node: `views` are offset and bytes of each, with more keys; then accessors, the
/// primitive, and what else the node has.
pub(crate) fn document(
    views: &[(usize, usize, &str)],
    accessors: &str,
    primitive: &str,
    node: &str,
) -> String {
    let views: Vec<String> = views
        .iter()
        .map(|(at, bytes, more)| format!("{{\"buffer\":0,\"byteOffset\":{at},\"byteLength\":{bytes}{more}}}"))
        .collect();
    let bytes = "BYTES";
    format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\
         \"nodes\":[{{\"mesh\":0{node}}}],\
         \"meshes\":[{{\"primitives\":[{{{primitive}}}]}}],\"accessors\":[{accessors}],\"bufferViews\":[{}],\
         \"buffers\":[{{\"byteLength\":{bytes}}}]}}",
        views.join(",")
    )
}

/// The file of a document whose one buffer is the binary chunk.
pub(crate) fn file(document: &str, bin: &[u8]) -> Vec<u8> {
    glb(&document.replace("BYTES", &bin.len().to_string()), bin)
}

fn floats<'a>(numbers: impl IntoIterator<Item = &'a [f64; 3]>) -> Vec<u8> {
    numbers.into_iter().flatten().flat_map(|&number| (number as f32).to_le_bytes()).collect()
}

/// Triangles of a generator, moved to steps of 2^-8 from 0 on, so that 16 bits hold them; none without area.
fn generated(spec: &str) -> Vec<[[f64; 3]; 3]> {
    let (mut source, mut batch, mut all) = (source(spec), TriangleBatch::default(), Vec::new());
    while source.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch.corners);
    }
    let corners = || all.as_flattened().iter();
    let lo: [f64; 3] = std::array::from_fn(|axis| corners().map(|c| c[axis]).fold(f64::INFINITY, f64::min));
    let hi = corners().flatten().fold(f64::NEG_INFINITY, |most, &value| most.max(value));
    let scale = 200.0 / (hi - lo.iter().copied().fold(f64::INFINITY, f64::min));
    let step = |corner: [f64; 3]| {
        std::array::from_fn(|axis| ((corner[axis] - lo[axis]) * scale * 256.0).round() / 256.0)
    };
    let mut stepped: Vec<[[f64; 3]; 3]> = all.iter().map(|triangle| triangle.map(step)).collect();
    stepped.retain(|[a, b, c]| a != b && b != c && a != c);
    stepped
}

/// Vertices without repeats, and the triangles by index.
fn indexed(triangles: &[[[f64; 3]; 3]]) -> (Vec<[f64; 3]>, Vec<u32>) {
    let (mut vertices, mut index_of) = (Vec::new(), BTreeMap::new());
    let mut index = |corner: &[f64; 3]| {
        *index_of.entry(corner.map(f64::to_bits)).or_insert_with(|| {
            vertices.push(*corner);
            vertices.len() as u32 - 1
        })
    };
    let indices = triangles.as_flattened().iter().map(&mut index).collect();
    (vertices, indices)
}

fn ply(vertices: &[[f64; 3]], indices: &[u32]) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        vertices.len(),
        indices.len() / 3
    )
    .into_bytes();
    bytes.extend(floats(vertices));
    for triangle in indices.chunks_exact(3) {
        bytes.push(3);
        triangle.iter().for_each(|index| bytes.extend(index.to_le_bytes()));
    }
    bytes
}

/// The mesh in several encodings, by name.
fn encodings(vertices: &[[f64; 3]], indices: &[u32]) -> Vec<(&'static str, Vec<u8>)> {
    let (count, index_count) = (vertices.len(), indices.len());
    let index_bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
    let accessors = |kind: u32, more: &str| {
        format!(
            "{{\"bufferView\":0,\"componentType\":{kind},\"type\":\"VEC3\",\"count\":{count}{more}}},\
             {{\"bufferView\":1,\"componentType\":5125,\"type\":\"SCALAR\",\"count\":{index_count}}}"
        )
    };
    let primitive = "\"attributes\":{\"POSITION\":0},\"indices\":1";
    let with = |rows: &[u8], view: &str, accessors: String, node: &str| {
        let at = rows.len().next_multiple_of(4);
        let mut bin = rows.to_vec();
        bin.resize(at, 0);
        bin.extend_from_slice(&index_bytes);
        file(
            &document(&[(0, rows.len(), view), (at, index_bytes.len(), "")], &accessors, primitive, node),
            &bin,
        )
    };
    let plain = floats(vertices);
    // Between other things, with every row ending in what is not read.
    let interleaved: Vec<u8> =
        vertices.iter().flat_map(|vertex| [&[9; 8][..], &floats([vertex]), &[7; 4]].concat()).collect();
    // 16 bits at steps of 2^-8, which the node's scale makes positions of.
    let short: Vec<u8> = vertices
        .iter()
        .flat_map(|v| [v[0], v[1], v[2], 0.0].map(|value| (value * 256.0) as u16))
        .flat_map(u16::to_le_bytes)
        .collect();
    // Mirrored by the node, and turned round in the file.
    let mirrored: Vec<[f64; 3]> = vertices.iter().map(|v| [-v[0], v[1], v[2]]).collect();
    let turned: Vec<u8> =
        indices.chunks_exact(3).flat_map(|t| [t[0], t[2], t[1]]).flat_map(u32::to_le_bytes).collect();
    let mut back = floats(&mirrored);
    let views = [(0, back.len(), ""), (back.len(), turned.len(), "")];
    let mirrored = document(&views, &accessors(5126, ""), primitive, ",\"scale\":[-1,1,1]");
    back.extend(turned);
    let soup: Vec<u8> = floats(indices.iter().map(|&index| &vertices[index as usize]));
    let soup_accessor =
        format!("{{\"bufferView\":0,\"componentType\":5126,\"type\":\"VEC3\",\"count\":{index_count}}}");
    let soup_text = document(&[(0, soup.len(), "")], &soup_accessor, "\"attributes\":{\"POSITION\":0}", "");
    vec![
        ("plain", with(&plain, "", accessors(5126, ""), "")),
        ("interleaved", with(&interleaved, ",\"byteStride\":24", accessors(5126, ",\"byteOffset\":8"), "")),
        (
            "short",
            with(
                &short,
                ",\"byteStride\":8",
                accessors(5123, ""),
                ",\"scale\":[0.00390625,0.00390625,0.00390625]",
            ),
        ),
        ("mirrored", file(&mirrored, &back)),
        ("soup", file(&soup_text, &soup)),
    ]
}

#[test]
fn every_encoding_gives_the_triangles_of_the_ply() {
    let inside = folder();
    let triangles = generated("gen:isosurface:20k");
    let (vertices, indices) = indexed(&triangles);
    let built = |name: &str, bytes: &[u8]| {
        let path = inside.path().join(name);
        fs::write(&path, bytes).unwrap();
        let options = ImportOptions::new(Budget::new(256 << 20), inside.path());
        let built = build_source(&mut *open(&path, &options).unwrap(), &build_options());
        // As a set: corners turned so that the least comes first, which keeps the side that is seen.
        let mut set: Vec<_> = built
            .decode()
            .iter()
            .map(|triangle| {
                let mut corners =
                    triangle.map(|corner| corner.map(|value| (value * 65_536.0).round() as i64));
                let least = (0..3).min_by_key(|&at| corners[at]).unwrap();
                corners.rotate_left(least);
                corners
            })
            .collect();
        set.sort_unstable();
        set
    };
    let expected = built("m.ply", &ply(&vertices, &indices));
    assert!(expected.len() > 15_000, "{} triangles", expected.len());
    for (name, bytes) in encodings(&vertices, &indices) {
        assert!(built(&format!("{name}.glb"), &bytes) == expected, "{name}");
    }
}

/// A triangle in a `.gltf` with its buffer beside, a camera, and a light of each kind.
fn with_scene(inside: &Path, name: &str) {
    let bin = floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let accessor = "{\"bufferView\":0,\"componentType\":5126,\"type\":\"VEC3\",\"count\":3}";
    let lights = "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[\
                  {\"type\":\"point\",\"intensity\":40},{\"type\":\"directional\"},{\"type\":\"spot\"}]}}";
    let node = |light: usize| {
        format!(
            ",{{\"translation\":[0,0,5],\"extensions\":{{\"KHR_lights_punctual\":{{\"light\":{light}}}}}}}"
        )
    };
    let nodes = format!("}},{{\"camera\":0,\"translation\":[0.25,0.25,3]{}", "}")
        + &[node(0), node(1), node(2)].concat();
    let text = document(&[(0, 36, "")], accessor, "\"attributes\":{\"POSITION\":0}", "");
    let text = text
        .replace("BYTES", &format!("36,\"uri\":\"{name}.bin\""))
        .replace("[0]}]", "[0,1,2,3,4]}]")
        .replace("{\"mesh\":0}", &format!("{{\"mesh\":0{nodes}"))
        .replacen(
            '{',
            &format!(
                "{{{lights},\"cameras\":[{{\"type\":\"perspective\",\"perspective\":{{\"yfov\":0.8}}}}],"
            ),
            1,
        );
    fs::write(inside.join(format!("{name}.gltf")), text).unwrap();
    fs::write(inside.join(format!("{name}.bin")), bin).unwrap();
}

#[test]
fn camera_and_lights_go_beside_the_output_and_over_nothing() {
    let inside = folder();
    let at = |name: &str| inside.path().join(name);
    with_scene(inside.path(), "m");
    let ran = run_in(inside.path(), "build m.gltf -o m.trex");
    ran.expect(0);
    assert!(ran.stderr.contains("the camera and 3 lights of the input: m.toml"), "{}", ran.stderr);
    let text = fs::read_to_string(at("m.toml")).unwrap();
    let scene: toml::Table = text.parse().unwrap();
    assert_eq!(scene["model"].as_str(), Some("m.trex"));
    let lights = scene["light"].as_array().unwrap();
    let kinds: Vec<&str> = lights.iter().map(|light| light["type"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["point", "directional", "point"]);
    assert!(text.contains("a spot in the input"), "{text}");
    // It is a scene: the triangle fills the middle of its picture, lit from the front.
    run_in(inside.path(), "render m.toml -o m.png --resolution 16x16 --spp 1 --integrator direct").expect(0);
    let (width, _, pixels) = crate::command::pixels(&at("m.png"));
    let middle = (8 * width as usize + 8) * (pixels.len() / (width * width) as usize);
    assert!(pixels[middle] > 50, "the middle is dark: {}", pixels[middle]);
    // What stands there stays, whatever `--overwrite` says of the output.
    fs::write(at("m.toml"), "mine").unwrap();
    let again = run_in(inside.path(), "build m.gltf -o m.trex --overwrite");
    again.expect(0);
    assert!(again.stderr.contains("are not written: m.toml is there"), "{}", again.stderr);
    assert_eq!(fs::read_to_string(at("m.toml")).unwrap(), "mine");
    let odd = run_in(inside.path(), "build m.gltf -o k.toml");
    odd.expect(0);
    assert!(odd.stderr.contains("k.toml is there"), "{}", odd.stderr);
}

/// They were shown of a page file beside its mesh alone. What stands beside one that was named may be of another.
#[test]
fn a_viewer_shows_camera_and_lights_wherever_it_builds() {
    let inside = folder();
    with_scene(inside.path(), "m");
    document_in(inside.path(), "build m.gltf -o k.trex");
    fs::remove_file(inside.path().join("k.toml")).unwrap();
    let lights = |line: &str| {
        let viewing =
            ViewProcess::start(inside.path(), &format!("{line} --quiet --spp 1 --memory-limit 256MiB"));
        let (welcome, _) = viewing.told_after_waits(|text| text["type"] == "welcome");
        viewing.end().expect(0);
        welcome["lights"].as_array().unwrap().len()
    };
    let framed = lights("k.trex");
    assert_eq!([lights("m.gltf"), lights("m.gltf -o n.trex"), lights("m.gltf -o n.trex")], [3; 3]);
    assert_ne!(framed, 3);
    fs::write(
        inside.path().join("other.toml"),
        "model = 'n.trex'\n[[light]]\ntype = 'sky'\nradiance = [1, 1, 1]\n",
    )
    .unwrap();
    assert_eq!(lights("m.gltf -o other.trex"), framed);
}

/// The rule of OBJ's libraries holds for buffers: none is replaced by the model that is made of it.
#[test]
fn a_buffer_is_not_replaced() {
    let inside = folder();
    with_scene(inside.path(), "m");
    fs::hard_link(inside.path().join("m.bin"), inside.path().join("hard.trex")).unwrap();
    let before = listing(inside.path());
    for line in [
        "build m.gltf -o m.bin",
        "build m.gltf -o m.gltf",
        "build gen:soup:10k m.gltf -o m.bin --no-resume",
        "build m.gltf -o hard.trex",
    ] {
        let error = run_in(inside.path(), &format!("{line} --overwrite --json -q")).expect_error(2, "usage");
        assert!(error["what"].as_str().unwrap().contains("is an input"), "{line}: {error}");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
}

#[test]
fn instances_are_told_in_the_plan() {
    let inside = folder();
    let mut bin = floats(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    bin.extend(floats(&[[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [5.0, 5.0, 1.0]]));
    let rows = |view: usize, count: usize| {
        format!("{{\"bufferView\":{view},\"componentType\":5126,\"type\":\"VEC3\",\"count\":{count}}}")
    };
    let node = ",\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":1}}}";
    let accessors = format!("{},{}", rows(0, 3), rows(1, 4));
    let views = [(0, 36, ""), (36, 48, "")];
    let text = document(&views, &accessors, "\"attributes\":{\"POSITION\":0}", node);
    fs::write(inside.path().join("m.glb"), file(&text, &bin)).unwrap();
    let ran = run_in(inside.path(), "build m.glb -o m.trex --no-asvo --json");
    ran.expect(0);
    assert!(ran.stderr.contains("4 instances of 1 meshes"), "{}", ran.stderr);
    assert_eq!(ran.document()["instance_count"], 4);
    assert_eq!(ran.document()["triangle_count"], 4);
}

/// A limit that has no room for the JSON is named, and what is named works; in a group of exactly that size.
#[test]
fn limits_hold_for_json_and_for_numbers() {
    let inside = folder();
    let nodes: Vec<String> = (0..60_000)
        .map(|at| {
            format!("{{\"mesh\":0,\"translation\":[{},{},0],\"name\":\"node {at}\"}}", at % 245, at / 245)
        })
        .collect();
    let bin = floats(&[[0.0, 0.0, 0.0], [0.9, 0.0, 0.1], [0.0, 0.9, 0.0]]);
    let accessor = "{\"bufferView\":0,\"componentType\":5126,\"type\":\"VEC3\",\"count\":3}";
    let roots: Vec<String> = (0..nodes.len()).map(|at| at.to_string()).collect();
    let text = document(&[(0, 36, "")], accessor, "\"attributes\":{\"POSITION\":0}", "")
        .replace("[0]}]", &format!("[{}]}}]", roots.join(",")))
        .replace("{\"mesh\":0}", &nodes.join(","));
    fs::write(inside.path().join("many.glb"), file(&text, &bin)).unwrap();
    let line = "build many.glb -o many.trex --no-asvo --threads 2 --overwrite --json -q";
    let run_at = |bytes: u64| {
        let line = format!("{line} --memory-limit {bytes}B");
        match Cgroup::new("gltf", bytes) {
            None => run_in(inside.path(), &line),
            Some(group) => {
                let ran = group.run_in(inside.path(), &line);
                assert_eq!(group.oom_kill_count(), 0, "{bytes}: killed\n{}", ran.stderr);
                ran
            }
        }
    };
    let mut limit = 32 << 20;
    // What is named may be what one step of several takes: a few rounds find the one that does.
    for round in 0.. {
        let ran = run_at(limit);
        if ran.code == Some(0) {
            assert_eq!(ran.document()["triangle_count"], 60_000);
            said(&format!("60,000 nodes: {} MiB, after {round} refusals", limit >> 20));
            break;
        }
        let named = ran.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
        assert!(named > limit && round < 4, "{named} after {limit}\n{}", ran.stderr);
        limit = named;
    }
    assert!(limit < 128 << 20, "{limit}");
    // Numbers stay in the file: 12 million bytes of a mesh under a limit of 64 MiB and voxels.
    let (vertices, indices) = indexed(&generated("gen:isosurface:300k"));
    let (_, bytes) = encodings(&vertices, &indices).swap_remove(0);
    fs::write(inside.path().join("large.glb"), bytes).unwrap();
    document_in(inside.path(), "info large.glb");
    if let Some(group) = Cgroup::new("gltf", 64 << 20) {
        let line = "build large.glb -o large.trex --voxels 64 --threads 2 --memory-limit 64MiB --json -q";
        let ran = group.run_in(inside.path(), line);
        assert_eq!((group.oom_kill_count(), ran.code), (0, Some(0)), "{}", ran.stderr);
    }
}
