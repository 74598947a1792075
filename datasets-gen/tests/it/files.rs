//! What is written is what was streamed, as other readers see it; and nothing is left behind.

use super::{collect, open};
use datasets_gen::write::{ExistingOutput, WriteOptions};
use datasets_gen::{Kind, write};
use ply_rs_bw::ply::{DefaultElement, Property};
use std::path::Path;
use trex_store::{Code, Interrupt};

type Triangle = [[f64; 3]; 3];

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn read_ply(path: &Path) -> Vec<Triangle> {
    let mut file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let ply = ply_rs_bw::parser::Parser::<DefaultElement>::new().read_ply(&mut file).unwrap();
    let real = |property: &Property| match *property {
        Property::Float(value) => f64::from(value),
        Property::Double(value) => value,
        _ => panic!("no real number"),
    };
    let vertices: Vec<[f64; 3]> =
        ply.payload["vertex"].iter().map(|vertex| ["x", "y", "z"].map(|axis| real(&vertex[axis]))).collect();
    let face = |face: &DefaultElement| match &face["vertex_indices"] {
        Property::ListUInt(list) => [0, 1, 2].map(|corner| vertices[list[corner] as usize]),
        _ => panic!("no list of uint"),
    };
    ply.payload["face"].iter().map(face).collect()
}

#[test]
fn ply_reads_back_to_the_bit_and_shares_vertices() {
    let folder = tempfile::tempdir().unwrap();
    for kind in Kind::ALL {
        let path = folder.path().join(format!("{}.ply", kind.as_str()));
        let mut source = open(kind, 20_000, 2);
        let written = write(&mut *source, &path, &WriteOptions::default()).unwrap();
        assert_eq!(written.bytes, path.metadata().unwrap().len());
        let expected = collect(&mut *open(kind, 20_000, 1));
        assert_eq!(written.triangle_count, expected.len() as u64);
        assert!(read_ply(&path) == expected.corners, "{kind:?}");
        if matches!(kind, Kind::Isosurface | Kind::Scan) {
            // Half a vertex per triangle, 12 bytes each, and 13 bytes a face.
            assert!(written.bytes < 21 * written.triangle_count, "{kind:?}: {}", written.bytes);
        }
    }
    assert_eq!(names(folder.path()), ["isosurface.ply", "pipes.ply", "scan.ply", "soup.ply"]);
}

#[test]
fn stl_reads_back_in_single_precision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant.STL");
    let mut source = open(Kind::Pipes, 10_000, 2);
    let written = write(&mut *source, &path, &WriteOptions::default()).unwrap();
    let expected = collect(&mut *open(Kind::Pipes, 10_000, 1));
    assert_eq!(written.bytes, 84 + 50 * expected.len() as u64);
    let mesh = stl_io::read_stl(&mut std::fs::File::open(&path).unwrap()).unwrap();
    assert_eq!(mesh.faces.len(), expected.len());
    for (face, corners) in mesh.faces.iter().zip(&expected.corners) {
        let read = face.vertices.map(|index| <[f32; 3]>::from(mesh.vertices[index]).map(f64::from));
        assert_eq!(read, *corners);
    }
}

#[test]
fn obj_reads_back_with_its_materials() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant.obj");
    let mut source = open(Kind::Pipes, 10_000, 2);
    let written = write(&mut *source, &path, &WriteOptions::default()).unwrap();
    let expected = collect(&mut *open(Kind::Pipes, 10_000, 1));
    let (models, materials) = tobj::load_obj(&path, &tobj::LoadOptions::default()).unwrap();
    let materials = materials.unwrap();
    assert_eq!(materials.len(), source.materials().len());
    for (read, (name, known)) in materials.iter().zip(source.materials().named()) {
        assert_eq!(
            (read.name.as_str(), read.diffuse, read.shininess),
            (name, Some(known.kd), Some(known.ns))
        );
        assert_eq!(read.illumination_model == Some(3), known.mirror);
    }
    let triangles: usize = models.iter().map(|model| model.mesh.indices.len() / 3).sum();
    assert_eq!((triangles as u64, written.triangle_count), (expected.len() as u64, expected.len() as u64));
    let mut at = 0;
    for model in &models {
        for face in model.mesh.indices.chunks_exact(3) {
            let corner = |slot: usize| {
                let from = 3 * face[slot] as usize;
                [0, 1, 2].map(|axis| f64::from(model.mesh.positions[from + axis]))
            };
            assert_eq!([corner(0), corner(1), corner(2)], expected.corners[at]);
            assert_eq!(model.mesh.material_id, Some(expected.material[at] as usize));
            at += 1;
        }
    }
    assert_eq!(names(folder.path()), ["plant.mtl", "plant.obj"]);
}

#[test]
fn an_existing_output_is_kept_unless_replaced() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.ply", "a.stl", "a.obj"] {
        let path = folder.path().join(name);
        std::fs::write(&path, "old").unwrap();
        let mut source = open(Kind::Soup, 10_000, 1);
        let refused = write(&mut *source, &path, &WriteOptions::default()).unwrap_err();
        assert_eq!(refused.code(), Code::Usage);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        let options = WriteOptions { existing: ExistingOutput::Replace, ..WriteOptions::default() };
        write(&mut *source, &path, &options).unwrap();
        assert!(path.metadata().unwrap().len() > 100_000);
    }
    assert_eq!(names(folder.path()), ["a.mtl", "a.obj", "a.ply", "a.stl"]);
}

#[test]
fn failures_leave_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let interrupt = Interrupt::default();
    interrupt.raise();
    for name in ["a.ply", "a.stl", "a.obj"] {
        let options = WriteOptions { interrupt: interrupt.clone(), ..WriteOptions::default() };
        let stopped =
            write(&mut *open(Kind::Soup, 10_000, 1), &folder.path().join(name), &options).unwrap_err();
        assert_eq!(stopped.code(), Code::Interrupted);
    }
    let nameless =
        write(&mut *open(Kind::Soup, 10_000, 1), &folder.path().join("a.xyz"), &WriteOptions::default());
    assert_eq!(nameless.unwrap_err().code(), Code::Usage);
    let homeless = folder.path().join("missing/a.ply");
    let missing = write(&mut *open(Kind::Soup, 10_000, 1), &homeless, &WriteOptions::default());
    assert_eq!(missing.unwrap_err().code(), Code::Usage);
    assert!(names(folder.path()).is_empty());
}
