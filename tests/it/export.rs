//! The mesh back out: what `export` writes is what the page file holds, as another reader sees it, and a build of it
//! gives the same triangles of the lattice.

use crate::command::{document_in, folder, listing, run_in};
use crate::fixtures::built_in;
use crate::support::{Mesh, build_options, build_source};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use trex_store::cluster::FrameView;
use trex_store::layout::FRAME_BYTES;
use trex_store::{Budget, Lattice, Material, PageFile};

/// Corners by their bits, the least first, in the order that they go round.
type TriangleKey = [[u64; 3]; 3];

/// How often each triangle is there, whatever their order.
type TriangleCounts = BTreeMap<TriangleKey, usize>;

fn key(corners: [[f64; 3]; 3]) -> TriangleKey {
    let mut corners = corners.map(|corner| corner.map(f64::to_bits));
    let first = (0..3).min_by_key(|&i| corners[i]).unwrap();
    corners.rotate_left(first);
    corners
}

fn counts(triangles: impl IntoIterator<Item = [[f64; 3]; 3]>) -> TriangleCounts {
    let mut counts = TriangleCounts::new();
    triangles.into_iter().for_each(|corners| *counts.entry(key(corners)).or_default() += 1);
    counts
}

/// Corners, and the name of the material.
type NamedTriangle = ([[f64; 3]; 3], String);

/// What a page file holds: its lattice, and positions of corners with names of materials.
fn content(path: &Path) -> (Lattice, Vec<NamedTriangle>) {
    let file = PageFile::open(path, &Budget::unlimited()).unwrap();
    let lattice = file.superblock().lattice;
    let (mut frame, mut buffers, mut all) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()], Vec::new());
    for page in (0..file.pages().len() as u32).filter(|&page| !file.has_units(page)) {
        file.read_page(page, &mut frame, &mut buffers).unwrap();
        FrameView::new(&frame).for_each_cluster(|cluster| {
            let mesh = cluster.decode();
            for (corners, &material) in mesh.triangles.iter().zip(&mesh.materials) {
                // Not `Lattice::position`, which is what the export computes.
                let corner = |i: u8| {
                    let q = mesh.vertices[usize::from(i)];
                    [0, 1, 2].map(|a| lattice.origin[a] + q[a] as f64 * f64::powi(2.0, lattice.exponent))
                };
                all.push((corners.map(corner), file.material_names().get(material.into()).unwrap().into()));
            }
        });
    }
    (lattice, all)
}

/// The triangles of a page file.
fn triangles(path: &Path) -> Vec<[[f64; 3]; 3]> {
    content(path).1.into_iter().map(|(corners, _)| corners).collect()
}

/// The triangles of a PLY file, as `ply-rs-bw` reads them.
fn ply_triangles(path: &Path) -> Vec<[[f64; 3]; 3]> {
    let ply =
        Parser::<DefaultElement>::new().read_ply(&mut BufReader::new(File::open(path).unwrap())).unwrap();
    let real = |property: &Property| match *property {
        Property::Float(value) => f64::from(value),
        Property::Double(value) => value,
        _ => panic!("no real number"),
    };
    let vertices: Vec<_> =
        ply.payload["vertex"].iter().map(|v| ["x", "y", "z"].map(|a| real(&v[a]))).collect();
    let face = |face: &DefaultElement| match &face["vertex_indices"] {
        Property::ListUInt(list) => [0, 1, 2].map(|corner| vertices[list[corner] as usize]),
        _ => panic!("no list of uint"),
    };
    ply.payload["face"].iter().map(face).collect()
}

/// A value of a GLB's document.
type Json = serde_json::Value;

/// The document of a GLB file and its binary chunk. The crate `gltf` finds nothing wrong with the file.
fn glb(path: &Path) -> (Json, Vec<u8>) {
    let bytes = std::fs::read(path).unwrap();
    gltf::Gltf::from_slice(&bytes).unwrap();
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], number(4), number(8)), (&b"glTF"[..], 2, bytes.len()));
    let json_end = 20 + number(12);
    assert_eq!((&bytes[16..20], &bytes[json_end + 4..json_end + 8]), (&b"JSON"[..], &b"BIN\0"[..]));
    let document: Json = serde_json::from_slice(&bytes[20..json_end]).unwrap();
    let binary = bytes[json_end + 8..].to_vec();
    assert_eq!(binary.len(), number(json_end));
    assert_eq!(document["buffers"][0]["byteLength"], binary.len());
    (document, binary)
}

/// The elements of an accessor of a GLB file, its numbers as they stand.
fn elements((document, binary): &(Json, Vec<u8>), accessor: &Json) -> Vec<Vec<f64>> {
    let count = |value: &Json| value.as_u64().unwrap_or(0) as usize;
    let accessor = &document["accessors"][count(accessor)];
    let view = &document["bufferViews"][count(&accessor["bufferView"])];
    let parts = match accessor["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC3" => 3,
        _ => 4,
    };
    let read: fn(&[u8]) -> f64 = match count(&accessor["componentType"]) {
        5126 => |bytes| f32::from_le_bytes(bytes.try_into().unwrap()).into(),
        5125 => |bytes| u32::from_le_bytes(bytes.try_into().unwrap()).into(),
        _ => |bytes| u16::from_le_bytes(bytes.try_into().unwrap()).into(),
    };
    let size = if count(&accessor["componentType"]) == 5123 { 2 } else { 4 };
    let stride = view["byteStride"].as_u64().map_or(parts * size, |stride| stride as usize);
    let begin = count(&view["byteOffset"]) + count(&accessor["byteOffset"]);
    assert!(count(&view["byteLength"]) >= stride * (count(&accessor["count"]) - 1) + parts * size);
    let element = |at: usize| binary[begin + stride * at..].chunks(size).take(parts).map(read).collect();
    (0..count(&accessor["count"])).map(element).collect()
}

/// The triangles of a GLB file whose nodes are moved only, with the names of their materials.
fn glb_triangles(path: &Path) -> Vec<NamedTriangle> {
    let file = glb(path);
    let document = &file.0;
    let mut all = Vec::new();
    for node in document["scenes"][0]["nodes"].as_array().unwrap() {
        let node = &document["nodes"][node.as_u64().unwrap() as usize];
        let moved: Vec<f64> =
            node["translation"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let part = &document["meshes"][node["mesh"].as_u64().unwrap() as usize]["primitives"][0];
        let positions = elements(&file, &part["attributes"]["POSITION"]);
        let name = &document["materials"][part["material"].as_u64().unwrap() as usize]["name"];
        let name = name.as_str().unwrap();
        for corners in elements(&file, &part["indices"]).chunks(3) {
            let corner = |at: usize| [0, 1, 2].map(|a| moved[a] + positions[corners[at][0] as usize][a]);
            all.push(([0, 1, 2].map(corner), name.to_string()));
        }
    }
    all
}

/// Exports `m.trex` as PLY and GLB, compares these, builds that, and compares again.
#[track_caller]
fn check_round_trip(inside: &Path) {
    let at = |name: &str| inside.join(name);
    let (lattice, _) = content(&at("m.trex"));
    let expected = counts(triangles(&at("m.trex")));
    let told = document_in(inside, "export m.trex -o back.ply --overwrite");
    assert_eq!(told["triangle_count"], expected.values().sum::<usize>());
    assert_eq!(told["output_bytes"], at("back.ply").metadata().unwrap().len());
    assert_eq!(counts(ply_triangles(&at("back.ply"))), expected);
    let told = document_in(inside, "export m.trex -o back.glb --overwrite");
    assert_eq!(told["triangle_count"], expected.values().sum::<usize>());
    assert_eq!(counts(glb_triangles(&at("back.glb")).into_iter().map(|(corners, _)| corners)), expected);
    for back in ["back.ply", "back.glb"] {
        let built = document_in(inside, &format!("build {back} -o back.trex --no-asvo --overwrite"));
        assert_eq!((&built["error_bound"], &built["triangle_count"]), (&0.0.into(), &told["triangle_count"]));
        assert_eq!(content(&at("back.trex")).0, lattice, "{back}");
        assert_eq!(counts(triangles(&at("back.trex"))), expected, "{back}");
    }
}

#[test]
fn what_is_exported_and_built_again_is_the_same() {
    for spec in ["gen:isosurface:40k", "gen:pipes:20k", "gen:soup:10k"] {
        let inside = folder();
        // With voxels: their pages stand behind those of the mesh.
        built_in(inside.path(), &format!("{spec} --voxels 64/256"), "m.trex");
        check_round_trip(inside.path());
    }
}

/// Far from the origin, with a step that no edge of the part suggests, and an origin that single precision has not.
#[test]
fn a_part_of_a_model_keeps_the_lattice_of_the_whole() {
    let inside = folder();
    let corner = |x: f64, y: f64| [1e7 + x, 2.0f64.powi(-9) * y, -3.0e6 + 0.1 * x * y];
    let patch = |i: usize| {
        let (x, y) = ((i % 40) as f64, (i / 40) as f64);
        [corner(x, y), corner(x + 1.0, y), corner(x, y + 1.0)]
    };
    let mut source = Mesh::new("patches", (0..1600).map(patch).collect());
    let built = build_source(&mut source, &build_options());
    std::fs::copy(built.file.path(), inside.path().join("m.trex")).unwrap();
    check_round_trip(inside.path());
    let (lattice, _) = content(&inside.path().join("m.trex"));
    document_in(inside.path(), "export m.trex -o few.obj --box 10000000,-1,-4000000,10000002,1,-2000000");
    document_in(inside.path(), "build few.obj -o few.trex --no-asvo");
    let (of_few, few) = content(&inside.path().join("few.trex"));
    assert_eq!(of_few, lattice);
    let all = counts(triangles(&inside.path().join("m.trex")));
    assert!(
        few.len() == 80 && few.iter().all(|(corners, _)| all.contains_key(&key(*corners))),
        "{}",
        few.len()
    );
}

#[test]
fn boxes_that_fill_space_part_the_model() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:40k --no-asvo", "m.trex");
    let all = triangles(&inside.path().join("m.trex"));
    let bounds = PageFile::superblock_of(&inside.path().join("m.trex")).unwrap().bounds;
    let cut = 0.4 * bounds.lo[0] + 0.6 * bounds.hi[0];
    let mut together = Vec::new();
    for (name, lo, hi) in [("left", -1e9, cut), ("right", cut, 1e9)] {
        document_in(inside.path(), &format!("export m.trex -o {name}.ply --box {lo},-1e9,-1e9,{hi},1e9,1e9"));
        let part = ply_triangles(&inside.path().join(format!("{name}.ply")));
        assert!(part.len() > all.len() / 5);
        let middle = |corners: &[[f64; 3]; 3]| corners.iter().map(|corner| corner[0]).sum::<f64>() / 3.0;
        assert!(part.iter().map(middle).all(|x| x >= lo - 1e-9 && x <= hi + 1e-9), "{name}");
        together.extend(part);
    }
    assert_eq!(counts(together), counts(all.iter().copied()));
    // Both parts are one model again, on the same lattice.
    document_in(inside.path(), "build left.ply right.ply -o both.trex --no-asvo");
    assert_eq!(counts(triangles(&inside.path().join("both.trex"))), counts(all));
}

#[test]
fn materials_go_to_obj_and_glb_and_choose() {
    let inside = folder();
    // A step that nobody would choose for it, so that it is the one that comes back.
    built_in(inside.path(), "gen:pipes:20k --no-asvo --error 0.01", "m.trex");
    let (lattice, all) = content(&inside.path().join("m.trex"));
    let named = |triangles: &[([[f64; 3]; 3], String)], name: &str| {
        counts(triangles.iter().filter(|(_, material)| material == name).map(|(corners, _)| *corners))
    };
    let names: std::collections::BTreeSet<&String> = all.iter().map(|(_, name)| name).collect();
    assert!(names.len() > 2);
    for format in ["obj", "glb"] {
        document_in(inside.path(), &format!("export m.trex -o all.{format}"));
        document_in(inside.path(), &format!("build all.{format} -o all.trex --no-asvo --overwrite"));
        let (of_back, back) = content(&inside.path().join("all.trex"));
        assert_eq!(of_back, lattice);
        names.iter().for_each(|name| assert_eq!(named(&back, name), named(&all, name), "{name}"));
        check_materials(&inside.path().join("m.trex"), &inside.path().join("all.trex"));
    }
    let [one, other] = [names.first().unwrap(), names.last().unwrap()];
    document_in(inside.path(), &format!("export m.trex -o two.ply --material {one} --material {other}"));
    let mut expected = named(&all, one);
    named(&all, other).into_iter().for_each(|(key, count)| *expected.entry(key).or_default() += count);
    assert_eq!(counts(ply_triangles(&inside.path().join("two.ply"))), expected);
    let unknown = run_in(inside.path(), "export m.trex -o no.ply --material nobody --json -q");
    assert!(unknown.expect_error(2, "usage")["what"].as_str().unwrap().contains("nobody"));
}

/// A name means one material, where two inputs have it, too.
#[test]
fn names_that_stand_twice_are_told_apart() {
    let inside = folder();
    for (name, kd) in [("a", "0.8 0.1 0.1"), ("b", "0.1 0.1 0.8")] {
        let mesh = format!("mtllib {name}.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl steel\nf 1 2 3\n");
        let more = if name == "b" { "f 1 3 4\n" } else { "" };
        std::fs::write(inside.path().join(format!("{name}.obj")), mesh + more).unwrap();
        std::fs::write(inside.path().join(format!("{name}.mtl")), format!("newmtl steel\nKd {kd}\n"))
            .unwrap();
    }
    document_in(inside.path(), "build a.obj b.obj -o m.trex --no-asvo");
    // Faces before the first `usemtl` would have `default`.
    let expected = serde_json::json!(["default", "steel", "default.2", "steel.2"]);
    assert_eq!(document_in(inside.path(), "info m.trex")["materials"], expected);
    for (name, count) in [("steel", 1), ("steel.2", 2)] {
        let line = format!("export m.trex -o part.ply --overwrite --material {name}");
        assert_eq!(document_in(inside.path(), &line)["triangle_count"], count, "{name}");
    }
}

/// Words that begin alike, and one that has the number of another: each face comes back with its colour.
#[test]
fn names_that_are_one_word_are_told_apart() {
    let inside = folder();
    let names = ["a b", "a_b", "a_b.2", "a\tb"];
    let (mut faces, mut library) = (String::from("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\n"), String::new());
    for (at, name) in names.iter().enumerate() {
        faces += &format!("usemtl {name}\n{}", "f 1 2 3\n".repeat(at + 1));
        library += &format!("newmtl {name}\nKd 0.{} 0 0\n", at + 1);
    }
    std::fs::write(inside.path().join("m.obj"), faces).unwrap();
    std::fs::write(inside.path().join("m.mtl"), library).unwrap();
    document_in(inside.path(), "build m.obj -o m.trex --no-asvo");
    document_in(inside.path(), "export m.trex -o back.obj");
    document_in(inside.path(), "build back.obj -o back.trex --no-asvo");
    let of_colours = |name: &str| {
        let path = inside.path().join(name);
        let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
        let red = |name: &str| file.materials()[file.material_names().index_of(name).unwrap()].kd[0];
        let mut reds: Vec<String> = content(&path).1.iter().map(|(_, name)| red(name).to_string()).collect();
        reds.sort_unstable();
        reds
    };
    let expected: Vec<String> = (1..=names.len()).flat_map(|n| vec![format!("0.{n}"); n]).collect();
    assert_eq!((of_colours("m.trex"), of_colours("back.trex")), (expected.clone(), expected));
}

/// Coordinates that single precision would make infinite, or zero.
#[test]
fn what_singles_cannot_hold_is_refused_by_formats_of_singles() {
    let inside = folder();
    for (name, far) in [("large", "1e40"), ("small", "1e-50"), ("held", "1e30")] {
        let mesh = format!("v 0 0 0\nv {far} 0 0\nv 0 {far} 0\nf 1 2 3\n");
        std::fs::write(inside.path().join(format!("{name}.obj")), mesh).unwrap();
        document_in(inside.path(), &format!("build {name}.obj -o {name}.trex --no-asvo"));
    }
    let before = listing(inside.path());
    for line in ["large.trex -o a.glb", "large.trex -o a.stl", "small.trex -o a.glb", "small.trex -o a.stl"] {
        run_in(inside.path(), &format!("export {line} --json -q")).expect_error(2, "usage");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
    let expected = triangles(&inside.path().join("held.trex"));
    for format in ["glb", "stl"] {
        document_in(inside.path(), &format!("export held.trex -o back.{format}"));
        document_in(inside.path(), &format!("build back.{format} -o back.trex --no-asvo --overwrite"));
        let reach =
            |triangles: &[[[f64; 3]; 3]]| triangles.iter().flatten().flatten().copied().fold(0.0, f64::max);
        let (back, expected) = (reach(&triangles(&inside.path().join("back.trex"))), reach(&expected));
        assert!((back - expected).abs() < 1e-6 * expected, "{format}: {back} {expected}");
    }
    document_in(inside.path(), "export large.trex -o far.ply");
    document_in(inside.path(), "export small.trex -o near.obj");
}

/// Materials of the same names look alike.
#[track_caller]
fn check_materials(expected: &Path, found: &Path) {
    let [expected, found] = [expected, found].map(|path| PageFile::open(path, &Budget::unlimited()).unwrap());
    let numbers = |material: &Material| {
        let Material { kd, ks, ns, ke, d, mirror, .. } = *material;
        [&kd[..], &ks, &ke, &[if mirror { 0.0 } else { ns }, d]].concat()
    };
    for (name, material) in expected.material_names().iter().zip(expected.materials()) {
        let Some(index) = found.material_names().index_of(name) else { continue };
        let back = &found.materials()[index];
        assert_eq!(back.mirror, material.mirror, "{name}");
        for (a, b) in numbers(material).into_iter().zip(numbers(back)) {
            assert!((a - b).abs() <= 1e-5 * a.abs(), "{name}: {material:?} came back as {back:?}");
        }
    }
}

/// A comment is not believed: where a vertex lies elsewhere, the lattice is chosen as for any other file.
#[test]
fn a_lattice_that_does_not_hold_is_not_taken() {
    let inside = folder();
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0.3\nf 1 2 3\n";
    for (name, comment) in [
        ("none", ""),
        ("coarse", "# trex lattice 2^-1 0e0 0e0 0e0\n"),
        ("beyond", "# trex lattice 2^0 5e0 0e0 0e0\n"),
        ("fine", "# trex lattice 2^-690 0e0 0e0 0e0\n"),
    ] {
        std::fs::write(inside.path().join(format!("{name}.obj")), format!("{comment}{square}")).unwrap();
        let built = document_in(inside.path(), &format!("build {name}.obj -o {name}.trex --no-asvo"));
        assert_eq!(built["triangle_count"], 1, "{name}");
        let lattice = content(&inside.path().join(format!("{name}.trex"))).0;
        assert_eq!(lattice, content(&inside.path().join("none.trex")).0, "{name}");
    }
    // One that holds is.
    let square = "# trex lattice 2^-3 -1e0 0e0 0e0\nv 0 0 0\nv 1 0 0\nv 1 1 0.25\nf 1 2 3\n";
    std::fs::write(inside.path().join("held.obj"), square).unwrap();
    document_in(inside.path(), "build held.obj -o held.trex --no-asvo");
    let held = content(&inside.path().join("held.trex")).0;
    assert_eq!(held, Lattice { origin: [-1.0, 0.0, 0.0], exponent: -3 });
}

#[test]
fn what_cannot_be_exported_leaves_nothing() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:40k --no-asvo", "m.trex");
    let file = PageFile::open(&inside.path().join("m.trex"), &Budget::unlimited()).unwrap();
    let mut bytes = std::fs::read(file.path()).unwrap();
    bytes[file.pages()[1].offset as usize + 100] ^= 1;
    std::fs::write(inside.path().join("bad.trex"), bytes).unwrap();
    std::fs::write(inside.path().join("there.ply"), "mine").unwrap();
    std::fs::hard_link(inside.path().join("m.trex"), inside.path().join("same.mtl")).unwrap();
    let before = listing(inside.path());
    for (line, exit, code) in [
        ("export bad.trex -o a.ply", 3, "damaged"),
        ("export bad.trex -o a.obj", 3, "damaged"),
        ("export bad.trex -o a.glb", 3, "damaged"),
        ("export m.trex -o there.ply", 2, "usage"),
        ("export m.trex -o m.trex --overwrite", 2, "usage"),
        ("export m.trex -o same.obj --overwrite", 2, "usage"),
        ("export m.trex -o a.xyz", 2, "usage"),
        ("export m.trex -o a.ply --box 90,90,90,91,91,91", 2, "usage"),
        ("export there.ply -o a.ply", 3, "input-format"),
        ("export m.trex -o a.ply --memory-limit 30MiB", 4, "memory-limit"),
    ] {
        run_in(inside.path(), &format!("{line} --json -q")).expect_error(exit, code);
        assert_eq!(listing(inside.path()), before, "{line}");
    }
    for bounds in ["0,0,0,1,1", "0,0,0,1,1,nan", "0,0,0,1,1,0", "a"] {
        run_in(inside.path(), &format!("export m.trex -o a.ply --box {bounds}")).expect(2);
    }
}
