//! Real files, where they are at hand: every corner against the `gltf` crate, which parses them by itself.

use super::super::models::models;
use super::super::{SourceTriangle, read};
use crate::import::ImportOptions;
use gltf::mesh::Mode;
use std::path::Path;

/// Triangles of the default scene, by the crate. Buffers are the binary chunk, or lie beside.
fn by_the_crate(path: &Path) -> Vec<SourceTriangle> {
    let bytes = std::fs::read(path).unwrap();
    let gltf = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
    let buffers: Vec<Vec<u8>> = gltf
        .buffers()
        .map(|buffer| match buffer.source() {
            gltf::buffer::Source::Bin => gltf.blob.clone().unwrap(),
            gltf::buffer::Source::Uri(uri) => std::fs::read(path.with_file_name(uri)).unwrap(),
        })
        .collect();
    let mut triangles = Vec::new();
    let mut open: Vec<_> = gltf.default_scene().unwrap().nodes().map(|node| (node, IDENTITY)).collect();
    while let Some((node, above)) = open.pop() {
        let world = product(above, node.transform().matrix().map(|column| column.map(f64::from)));
        open.extend(node.children().map(|child| (child, world)));
        for primitive in node.mesh().into_iter().flat_map(|mesh| mesh.primitives()) {
            assert_eq!(primitive.mode(), Mode::Triangles);
            let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()]));
            let corners: Vec<[f64; 3]> = reader.read_positions().unwrap().map(|p| placed(world, p)).collect();
            let indices: Vec<usize> =
                reader.read_indices().unwrap().into_u32().map(|index| index as usize).collect();
            triangles.extend(indices.chunks_exact(3).map(|t| [corners[t[0]], corners[t[1]], corners[t[2]]]));
        }
    }
    triangles
}

type Matrix = [[f64; 4]; 4];

const IDENTITY: Matrix =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

/// a b, by columns.
fn product(a: Matrix, b: Matrix) -> Matrix {
    std::array::from_fn(|column| {
        std::array::from_fn(|row| (0..4).map(|inner| a[inner][row] * b[column][inner]).sum())
    })
}

fn placed(world: Matrix, p: [f32; 3]) -> [f64; 3] {
    let p = [f64::from(p[0]), f64::from(p[1]), f64::from(p[2]), 1.0];
    std::array::from_fn(|row| (0..4).map(|inner| world[inner][row] * p[inner]).sum())
}

#[test]
fn real_files_hold_what_another_reader_finds_in_them() {
    let Some(folder) = models() else { return };
    for (name, count) in [
        ("2CylinderEngine.glb", 121_496),
        ("CornellBox.glb", 36),
        ("Duck.glb", 4212),
        ("FlightHelmet/FlightHelmet.gltf", 94_722),
    ] {
        let path = folder.join("gltf").join(name);
        let scratch = tempfile::tempdir().unwrap();
        let found = read(&path, &ImportOptions::unlimited(scratch.path())).unwrap().triangles;
        let expected = by_the_crate(&path);
        assert_eq!((found.len(), expected.len()), (count, count), "{name}");
        let extent =
            expected.as_flattened().as_flattened().iter().fold(0.0f64, |most, value| most.max(value.abs()));
        // Means of all products of two numbers of a triangle: they do not depend on the order of triangles, and on all
        // else that makes them.
        let (found, expected) = (products(&found, extent), products(&expected, extent));
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() <= 1e-5, "{name}: {a}, expected {b}");
        }
    }
}

/// Means over all triangles of the products of each two of its nine numbers and 1, in units of `extent`.
fn products(triangles: &[SourceTriangle], extent: f64) -> Vec<f64> {
    let mut sums = vec![0.0; 100];
    for triangle in triangles {
        let mut numbers = [1.0; 10];
        numbers[..9].copy_from_slice(triangle.as_flattened());
        numbers[..9].iter_mut().for_each(|number| *number /= extent);
        for (at, sum) in sums.iter_mut().enumerate() {
            *sum += numbers[at / 10] * numbers[at % 10] / triangles.len() as f64;
        }
    }
    sums
}

/// The duck in 12 bits and compressed is the duck, within the step of 12 bits.
#[test]
fn a_compressed_duck_is_a_duck() {
    let Some(folder) = models() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let options = ImportOptions::unlimited(scratch.path());
    let boxes = ["Duck.glb", "Duck-vp-12-vt-12-vn-12.glb"].map(|name| {
        let triangles = read(&folder.join("gltf").join(name), &options).unwrap().triangles;
        assert_eq!(triangles.len(), 4212);
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for corner in triangles.as_flattened() {
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(corner[axis]);
                bounds[1][axis] = bounds[1][axis].max(corner[axis]);
            }
        }
        let area: f64 = triangles.iter().map(area).sum();
        (bounds, area)
    });
    let [(duck, area), (packed, packed_area)] = &boxes;
    let extent = duck[1][0] - duck[0][0];
    for (a, b) in duck.as_flattened().iter().zip(packed.as_flattened()) {
        assert!((a - b).abs() < extent / 2000.0, "{boxes:?}");
    }
    assert!((area / packed_area - 1.0).abs() < 0.01, "{boxes:?}");
}

pub(super) fn area(t: &SourceTriangle) -> f64 {
    let (u, v): ([f64; 3], [f64; 3]) =
        (std::array::from_fn(|i| t[1][i] - t[0][i]), std::array::from_fn(|i| t[2][i] - t[0][i]));
    let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    cross.iter().map(|part| part * part).sum::<f64>().sqrt() / 2.0
}
