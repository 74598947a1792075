//! Normals from PLY, OBJ and glTF: the direction that the file states, at the corner that it states it of.

use super::gltf::NormalsGlb;
use super::{Fixture, SourceMesh};
use crate::cluster::Normal;

/// Corners of a quad, and a normal of each, not of unit length.
const CORNERS: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 3.0, 0.0], [0.0, 3.0, 0.0]];
const NORMALS: [[f64; 3]; 4] = [[0.0, 0.0, 2.0], [0.5, 0.0, 0.5], [-0.25, 0.5, 1.0], [0.0, -3.0, 4.0]];

/// Compares the direction at each corner with that of `normals` for the place there.
#[track_caller]
fn check(mesh: &SourceMesh, places: &[[f64; 3]; 4], normals: &[[f64; 3]; 4]) {
    assert!(!mesh.triangles.is_empty());
    for (place, normal) in mesh.triangles.as_flattened().iter().zip(mesh.normals.as_flattened()) {
        let at = places.iter().position(|other| (0..3).all(|i| (other[i] - place[i]).abs() < 1e-6)).unwrap();
        let length = normals[at].iter().map(|v| v * v).sum::<f64>().sqrt();
        let found = normal.vector().expect("a normal");
        let cos: f64 = found.iter().zip(normals[at]).map(|(&a, b)| f64::from(a) * b / length).sum();
        assert!(cos > 0.25f64.to_radians().cos(), "{found:?} at {place:?}, not {:?}", normals[at]);
    }
}

#[test]
fn of_ply_in_text_and_bytes() {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float nx\nproperty double x\nproperty double y\n\
             property float ny\nproperty double z\nproperty float nz\nproperty uchar red\nproperty uchar green\n\
             property uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let mut text = header("ascii");
    let mut bytes = header("binary_little_endian").into_bytes();
    for ([x, y, z], [nx, ny, nz]) in CORNERS.iter().zip(&NORMALS) {
        text += &format!("{nx} {x} {y} {ny} {z} {nz} 9 8 7\n");
        let single = |value: &f64| (*value as f32).to_le_bytes();
        bytes.extend(single(nx).into_iter().chain(x.to_le_bytes()).chain(y.to_le_bytes()));
        bytes.extend(single(ny).into_iter().chain(z.to_le_bytes()).chain(single(nz)).chain([9, 8, 7]));
    }
    text += "3 0 1 2\n4 0 1 2 3\n";
    for face in [&[0u32, 1, 2][..], &[0, 1, 2, 3]] {
        bytes.push(face.len() as u8);
        bytes.extend(face.iter().flat_map(|index| index.to_le_bytes()));
    }
    for content in [text.into_bytes(), bytes] {
        let mesh = Fixture::new("a.ply", &content).read().unwrap();
        assert_eq!((mesh.triangles.len(), mesh.stats.dropped_attribute_count), (3, 0));
        check(&mesh, &CORNERS, &NORMALS);
        assert!(mesh.colours.as_flattened().iter().all(|colour| *colour == [9, 8, 7]));
    }
    // Two of three are no normal.
    let mesh = Fixture::new("a.ply", header("ascii").replace("nz", "nw").as_bytes()).read();
    assert!(mesh.is_err() || mesh.unwrap().normals.is_empty());
}

#[test]
fn of_obj_by_their_own_indices() {
    let rows = |name: &str, of: &[[f64; 3]; 4]| -> String {
        of.iter().map(|[x, y, z]| format!("{name} {x} {y} {z}\n")).collect()
    };
    // Normals stand in another order than vertices, and before them.
    let backwards = [3, 2, 1, 0].map(|at: usize| NORMALS[at]);
    let text = format!("{}{}", rows("vn", &backwards), rows("v", &CORNERS));
    for faces in ["f 1//4 2//3 3//2 4//1\n", "f 1/9/4 2/9/-2 -2//2 4//-4 # end\nf 1//4 3//2 4//1\n"] {
        let mesh = Fixture::new("a.obj", format!("{text}{faces}").as_bytes()).read().unwrap();
        check(&mesh, &CORNERS, &NORMALS);
        assert!(mesh.stats.warnings.is_empty());
    }
    let mesh = Fixture::new("a.obj", format!("{text}f 1//4 2//5 3/7\n").as_bytes()).read().unwrap();
    assert!(mesh.normals[0][0] != Normal::NONE && mesh.normals[0][1..] == [Normal::NONE; 2]);
    assert_eq!(mesh.stats.warnings.len(), 1, "{:?}", mesh.stats.warnings);
    let mesh = Fixture::new("a.obj", format!("vn 1 x 0\n{text}f 1//1 2//2 3\n").as_bytes()).read().unwrap();
    assert_eq!(mesh.normals[0][0], Normal::NONE);
    assert!(mesh.normals[0][1] != Normal::NONE);
}

/// A node that scales, and one that mirrors: normals stay across their planes, on the front of the triangle.
#[test]
fn of_gltf_under_the_transform_of_their_node() {
    for [sx, sy, sz] in [[1.0, 1.0, 1.0], [2.0, 0.5, 4.0], [-2.0, 0.5, 4.0], [-1.0, -1.0, -1.0]] {
        let glb = NormalsGlb { corners: &CORNERS, normals: &NORMALS, scale: [sx, sy, sz] };
        let mesh = Fixture::new("a.glb", &glb.bytes()).read().unwrap();
        assert_eq!((mesh.triangles.len(), mesh.stats.dropped_attribute_count), (2, 0));
        // The inverse of a scale is that of each axis; its transpose is itself.
        let places = CORNERS.map(|[x, y, z]| [sx * x, sy * y, sz * z]);
        check(&mesh, &places, &NORMALS.map(|[x, y, z]| [x / sx, y / sy, z / sz]));
    }
}
