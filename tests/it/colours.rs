//! Colours of vertices and faces: what a mesh file says of them stands in the page file, and comes back, corner by
//! corner.

use crate::command::{document_in, folder, hash_of, run_in, said};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use trex_store::layout::PageKind;
use trex_store::{Budget, PageFile};

pub(crate) type Corner = ([i64; 3], [u8; 3]);
/// How often each triangle is there: its corners, the least first, in the order that they go round.
type ColouredCounts = BTreeMap<[Corner; 3], usize>;

fn counts(triangles: impl IntoIterator<Item = [Corner; 3]>) -> ColouredCounts {
    let mut counts = ColouredCounts::new();
    for mut corners in triangles {
        let first = (0..3).min_by_key(|&i| corners[i]).unwrap();
        corners.rotate_left(first);
        *counts.entry(corners).or_default() += 1;
    }
    counts
}

/// A sheet of `n` times `n` squares at whole numbers, as vertices and triangles; colours run smoothly, but for a square
/// hole of another colour, at whose edge vertices stand twice.
pub(crate) fn sheet(n: i64) -> (Vec<Corner>, Vec<[u32; 3]>) {
    let is_inside = |x: i64, y: i64| x > n / 3 && x < n / 2 && y > n / 3 && y < n / 2;
    let mut vertices = Vec::new();
    let mut index_of = BTreeMap::new();
    let mut triangles = Vec::new();
    for (x, y) in (0..n).flat_map(|x| (0..n).map(move |y| (x, y))) {
        let mut vertex = |dx: i64, dy: i64| {
            let (x, y, part) = (x + dx, y + dy, is_inside(x, y));
            *index_of.entry((x, y, part)).or_insert_with(|| {
                let smooth = [(x * 200 / n) as u8, (y * 255 / n) as u8, 90];
                vertices.push(([x, y, x * y % 7], if part { [250, 10, 20] } else { smooth }));
                vertices.len() as u32 - 1
            })
        };
        let [a, b, c, d] = [vertex(0, 0), vertex(1, 0), vertex(1, 1), vertex(0, 1)];
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    (vertices, triangles)
}

fn corners(vertices: &[Corner], triangles: &[[u32; 3]]) -> Vec<[Corner; 3]> {
    triangles.iter().map(|corners| corners.map(|i| vertices[i as usize])).collect()
}

/// A PLY file: `kind` is the type of its colours, binary or `ascii`.
pub(crate) fn ply(vertices: &[Corner], triangles: &[[u32; 3]], kind: &str, is_ascii: bool) -> Vec<u8> {
    let form = if is_ascii { "ascii" } else { "binary_little_endian" };
    let mut file = format!(
        "ply\nformat {form} 1.0\nelement vertex {}\nproperty {kind} red\nproperty {kind} green\nproperty {kind} blue\n\
         property float x\nproperty float y\nproperty float z\nelement face {}\n\
         property list uchar uint vertex_indices\nend_header\n",
        vertices.len(),
        triangles.len()
    )
    .into_bytes();
    for (position, colour) in vertices {
        for &channel in colour {
            let share = f32::from(channel) / 255.0;
            match kind {
                _ if is_ascii && kind == "float" => file.extend(format!("{share} ").bytes()),
                _ if is_ascii => file.extend(format!("{channel} ").bytes()),
                "uchar" => file.push(channel),
                "ushort" => file.extend((u16::from(channel) * 257).to_le_bytes()),
                _ => file.extend(share.to_le_bytes()),
            }
        }
        for &value in position {
            match is_ascii {
                true => file.extend(format!("{value} ").bytes()),
                false => file.extend((value as f32).to_le_bytes()),
            }
        }
        file.extend(is_ascii.then_some(b'\n'));
    }
    for triangle in triangles {
        match is_ascii {
            true => file.extend(format!("3 {} {} {}\n", triangle[0], triangle[1], triangle[2]).bytes()),
            false => {
                file.extend([3].into_iter().chain(triangle.iter().flat_map(|index| index.to_le_bytes())))
            }
        }
    }
    file
}

/// Triangles with colours of a PLY file, as `ply-rs-bw` reads them.
fn read_ply(path: &Path) -> Vec<[Corner; 3]> {
    let ply =
        Parser::<DefaultElement>::new().read_ply(&mut BufReader::new(File::open(path).unwrap())).unwrap();
    let real = |property: &Property| match *property {
        Property::Float(value) => f64::from(value),
        Property::Double(value) => value,
        _ => panic!("no real number"),
    };
    let byte = |property: Option<&Property>| match property {
        Some(Property::UChar(value)) => *value,
        None => 255,
        _ => panic!("no byte"),
    };
    let vertex = |v: &DefaultElement| {
        let position = ["x", "y", "z"].map(|a| real(&v[a]));
        assert!(position.iter().all(|value| value.fract() == 0.0), "{position:?}");
        (position.map(|value| value as i64), ["red", "green", "blue"].map(|channel| byte(v.get(channel))))
    };
    let vertices: Vec<Corner> = ply.payload["vertex"].iter().map(vertex).collect();
    let face = |face: &DefaultElement| match &face["vertex_indices"] {
        Property::ListUInt(list) => [0, 1, 2].map(|corner| vertices[list[corner] as usize]),
        _ => panic!("no list of uint"),
    };
    ply.payload["face"].iter().map(face).collect()
}

/// Builds `file`, checks every byte, exports, and compares. Pages of colours, and their bytes.
#[track_caller]
fn check(inside: &Path, file: &str, expected: &ColouredCounts) -> (usize, u64) {
    document_in(inside, &format!("build {file} -o m.trex --overwrite --voxels 64"));
    let verdict = document_in(inside, "verify m.trex --deep");
    assert_eq!(verdict["verdict"], "clean", "{file}");
    document_in(inside, "export m.trex -o back.ply --overwrite");
    assert!(counts(read_ply(&inside.join("back.ply"))) == *expected, "{file}");
    for back in ["back.obj", "back.glb"] {
        document_in(inside, &format!("export m.trex -o {back} --overwrite"));
        document_in(inside, &format!("build {back} -o again.trex --overwrite --no-asvo"));
        document_in(inside, "export again.trex -o again.ply --overwrite");
        assert!(counts(read_ply(&inside.join("again.ply"))) == *expected, "{file} by way of {back}");
    }
    let file = PageFile::open(&inside.join("m.trex"), &Budget::unlimited()).unwrap();
    let colours = file.pages().iter().filter(|page| page.kind == PageKind::Colours);
    assert_eq!(colours.clone().count() as u64, file.superblock().colour_page_count);
    (colours.clone().count(), colours.map(|page| u64::from(page.stored_bytes)).sum())
}

#[test]
fn colours_of_vertices_come_back_from_every_encoding() {
    let inside = folder();
    let (vertices, triangles) = sheet(120);
    let expected = counts(corners(&vertices, &triangles));
    for (kind, is_ascii) in
        [("uchar", false), ("ushort", false), ("float", false), ("uchar", true), ("float", true)]
    {
        std::fs::write(inside.path().join("a.ply"), ply(&vertices, &triangles, kind, is_ascii)).unwrap();
        let (pages, bytes) = check(inside.path(), "a.ply", &expected);
        let per_triangle = bytes as f64 / triangles.len() as f64;
        said(&format!("{kind}: {pages} pages of colours, {per_triangle:.2} B a triangle"));
        // A vertex has three bytes, and there are half as many vertices as triangles.
        assert!(pages > 0 && per_triangle < 0.9, "{per_triangle}");
    }
}

#[test]
fn colours_of_faces_come_back() {
    let inside = folder();
    let (vertices, triangles) = sheet(40);
    let white: Vec<Corner> = vertices.iter().map(|&(position, _)| (position, [255; 3])).collect();
    let colour = |face: usize| [(face * 7 % 256) as u8, (face / 16 % 256) as u8, 3];
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face {}\nproperty uchar red\nproperty list uchar int vertex_indices\n\
         property uchar green\nproperty uchar blue\nend_header\n",
        vertices.len(),
        triangles.len()
    )
    .into_bytes();
    vertices.iter().for_each(|(p, _)| p.iter().for_each(|&v| file.extend((v as f32).to_le_bytes())));
    for (face, triangle) in triangles.iter().enumerate() {
        let [r, g, b] = colour(face);
        file.extend([r, 3]);
        triangle.iter().for_each(|index| file.extend(index.to_le_bytes()));
        file.extend([g, b]);
    }
    std::fs::write(inside.path().join("a.ply"), file).unwrap();
    let mut expected = corners(&white, &triangles);
    for (face, corners) in expected.iter_mut().enumerate() {
        corners.iter_mut().for_each(|(_, of)| *of = colour(face));
    }
    check(inside.path(), "a.ply", &counts(expected));
}

#[test]
fn white_is_no_colour() {
    let inside = folder();
    let (vertices, triangles) = sheet(30);
    let white: Vec<Corner> = vertices.iter().map(|&(position, _)| (position, [255; 3])).collect();
    std::fs::write(inside.path().join("a.ply"), ply(&white, &triangles, "uchar", false)).unwrap();
    let (pages, _) = check(inside.path(), "a.ply", &counts(corners(&white, &triangles)));
    assert_eq!(pages, 0);
    // And what is dropped is white.
    std::fs::write(inside.path().join("b.ply"), ply(&vertices, &triangles, "uchar", false)).unwrap();
    document_in(inside.path(), "build b.ply -o b.trex --colors drop --voxels 64");
    document_in(inside.path(), "build b.ply -o kept.trex --voxels 64");
    let [dropped, kept] = ["b", "kept"].map(|name| inside.path().join(format!("{name}.trex")));
    assert!(hash_of(&kept) != hash_of(&dropped));
    let mesh = |name: &str| {
        document_in(inside.path(), &format!("export {name}.trex -o {name}.back.ply"));
        read_ply(&inside.path().join(format!("{name}.back.ply")))
    };
    assert!(mesh("b").iter().flatten().all(|(_, colour)| *colour == [255; 3]));
}

#[test]
fn damage_to_colours_is_named() {
    let inside = folder();
    let (vertices, triangles) = sheet(60);
    std::fs::write(inside.path().join("a.ply"), ply(&vertices, &triangles, "uchar", false)).unwrap();
    document_in(inside.path(), "build a.ply -o m.trex --no-asvo");
    let file = PageFile::open(&inside.path().join("m.trex"), &Budget::unlimited()).unwrap();
    let at = file.pages().iter().position(|page| page.kind == PageKind::Colours).unwrap();
    let mut bytes = std::fs::read(file.path()).unwrap();
    bytes[file.pages()[at].offset as usize + 9] ^= 4;
    std::fs::write(inside.path().join("bad.trex"), bytes).unwrap();
    let ran = run_in(inside.path(), "verify bad.trex");
    ran.expect(1);
    assert!(ran.stdout.contains(&format!("page {at} (colours)")), "{}", ran.stdout);
    run_in(inside.path(), "export bad.trex -o a2.ply --json -q").expect_error(3, "damaged");
    // Without them the surface is drawn as its material.
    let render = "render bad.trex --integrator direct --resolution 8x8 --json -q";
    let ran = run_in(inside.path(), &format!("{render} -o a.png"));
    ran.expect(1);
    assert!(ran.stdout.contains("without its colours"), "{}", ran.stdout);
    run_in(inside.path(), &format!("{render} -o b.png --allow-damage")).expect(0);
}
