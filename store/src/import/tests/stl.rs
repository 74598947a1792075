//! STL: both forms, how they are told apart, and what is wrong with files that lie.

use super::{Fixture, SourceTriangle, check_corners, check_error, corner, same};
use crate::error::Code;
use std::io::Cursor;

const TRIANGLES: [[usize; 3]; 3] = [[0, 1, 3], [4, 7, 6], [2, 2, 5]];

fn binary(header: &[u8], count: u32) -> Vec<u8> {
    let mut content = vec![0; 80];
    content[..header.len()].copy_from_slice(header);
    content.extend(count.to_le_bytes());
    for triangle in TRIANGLES {
        content.extend([9.0f32; 3].iter().flat_map(|value| value.to_le_bytes()));
        content.extend(
            triangle.map(corner).as_flattened().iter().flat_map(|&value| (value as f32).to_le_bytes()),
        );
        content.extend([1, 2]);
    }
    content
}

fn facet(corners: &[usize]) -> String {
    let vertices: String = corners
        .iter()
        .map(|&index| format!("   vertex {}\n", corner(index).map(|v| format!("{v:e} ")).concat()))
        .collect();
    format!(" facet normal 0 nan -nan(ind)\n  outer loop\n{vertices}  endloop\n endfacet\n")
}

fn solid(name: &str, faces: &[[usize; 3]]) -> String {
    let facets: String = faces.iter().map(|face| facet(face)).collect();
    format!("solid {name}\n{facets}endsolid {name}\n")
}

/// The same file through another reader.
fn oracle(content: &[u8]) -> Vec<SourceTriangle> {
    let reader =
        stl_io::create_stl_reader(&mut Cursor::new(content)).unwrap().collect::<Result<Vec<_>, _>>().unwrap();
    reader
        .iter()
        .map(|triangle| triangle.vertices.map(|vertex| <[f32; 3]>::from(vertex).map(f64::from)))
        .collect()
}

#[test]
fn binary_files() {
    for header in [&b"made by a test"[..], b"solid but binary", b"solid\nfacet normal", &[0; 80], &[b' '; 80]]
    {
        let content = binary(header, 3);
        let mesh = check_corners("a.stl", &content, &TRIANGLES);
        if !header.starts_with(b"solid") {
            assert!(same(&mesh.triangles, &oracle(&content)));
        }
    }
    let mesh = check_corners("a.stl", &binary(b"x", 2), &TRIANGLES[..2]);
    assert_eq!(mesh.stats.warnings, ["50 bytes after the last triangle are not read"]);
    check_corners("a.stl", &binary(b"", 0)[..84], &[]);
}

#[test]
fn ascii_files() {
    let text = solid("a solid facet name", &TRIANGLES);
    let mesh = check_corners("a.stl", text.as_bytes(), &TRIANGLES);
    let plain = text.replace("nan -nan(ind)", "0 1").replace("a solid facet name", "x");
    assert!(same(&mesh.triangles, &oracle(plain.as_bytes())));
    for variant in
        [text.to_uppercase(), text.replace('\n', "\r\n"), text.replace('\n', "\r"), format!("\n \n{text}")]
    {
        check_corners("a.stl", variant.as_bytes(), &TRIANGLES);
    }
    let two = solid("", &TRIANGLES[..1]) + &solid("empty", &[]) + "\n\n" + &solid("b", &TRIANGLES[1..]);
    check_corners("a.stl", two.as_bytes(), &TRIANGLES);
    let odd = format!("solid\n{}{}endsolid", facet(&[0, 1, 3, 2]), facet(&[0, 1]));
    let mesh = check_corners("a.stl", odd.as_bytes(), &[[0, 1, 3], [0, 3, 2]]);
    assert_eq!((mesh.stats.polygon_count, mesh.stats.skipped_face_count), (1, 1));
}

#[test]
fn files_that_are_wrong() {
    let check = |content: &[u8], code: Code, words: &str| check_error("a.stl", content, code, words);
    check(&binary(b"x", 4), Code::InputTruncated, "4 triangles take 284 bytes, the file has 234");
    check(&binary(b"x", u32::MAX), Code::InputTruncated, "4294967295 triangles");
    check(&binary(b"solid", 4), Code::InputTruncated, "4 triangles");
    check(&binary(b"x", 3)[..70], Code::InputTruncated, "at least 84 bytes");
    check(b"solid a\n facet normal 0 0 1\n  outer loop\n vertex 0 0 x\n", Code::InputFormat, "a.stl:4");
    check(b"solid a\n facet normal 0 0 1\n  outer loop\n vertex 0 0\n", Code::InputFormat, "a.stl:4");
    check(b"solid a\n vertex 0 0 0\n", Code::InputFormat, "expected facet or endsolid, found `vertex`");
    check(b"solid a\n facet normal 0 0\n", Code::InputFormat, "three numbers");
    check(b"solid a\nendsolid a\nfacet\n", Code::InputFormat, "expected solid");
    check(b"solid a\n", Code::InputTruncated, "ends early");
    check(b"solid a\n facet", Code::InputTruncated, "ends early");
}

#[test]
fn large_files_come_in_batches() {
    let count = 50_000u32;
    let mut content = vec![0; 80];
    content.extend(count.to_le_bytes());
    for i in 0..count {
        content.extend((0..12).flat_map(|k| ((i * 12 + k) as f32).to_le_bytes()));
        content.extend([0, 0]);
    }
    let mesh = Fixture::new("a.stl", &content).read().unwrap();
    assert_eq!(mesh.triangles.len(), count as usize);
    assert!(same(&mesh.triangles, &oracle(&content)));
}
