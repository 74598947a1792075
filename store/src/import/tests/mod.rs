//! Tests of the importers through `open`: what each variant of a format delivers, what damaged files say, and that
//! no bytes make them panic. Oracles (`tobj`, `ply-rs-bw`, `stl_io`) share no code with the readers.

mod gltf;
mod hostile;
mod models;
mod normals;
mod obj;
mod obj_pictures;
mod ply;
mod stl;
mod volume;

use super::{ImportOptions, open};
use crate::budget::Budget;
use crate::cluster::Normal;
use crate::error::{Code, Error, Result};
use crate::source::{SourceStats, TriangleBatch, TriangleSource};
use std::path::{Path, PathBuf};

pub(super) type SourceTriangle = [[f64; 3]; 3];

/// A folder with one input in it.
pub(super) struct Fixture {
    folder: tempfile::TempDir,
    path: PathBuf,
}

impl Fixture {
    pub(super) fn new(name: &str, content: &[u8]) -> Fixture {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        Fixture { folder, path }
    }

    pub(super) fn options(&self) -> ImportOptions {
        ImportOptions::unlimited(self.folder.path())
    }

    pub(super) fn read(&self) -> Result<SourceMesh> {
        read(&self.path, &self.options())
    }
}

/// All that a source delivers.
#[derive(Debug)]
pub(super) struct SourceMesh {
    pub(super) triangles: Vec<SourceTriangle>,
    pub(super) colours: Vec<[[u8; 3]; 3]>,
    pub(super) normals: Vec<[Normal; 3]>,
    pub(super) material_names: Vec<String>,
    pub(super) stats: SourceStats,
}

/// Reads a file twice, with a rewind in between, and compares.
pub(super) fn read(path: &Path, options: &ImportOptions) -> Result<SourceMesh> {
    let mut source = open(path, options)?;
    let first = drain(&mut *source)?;
    source.rewind()?;
    let second = drain(&mut *source)?;
    assert!(same(&first.triangles, &second.triangles), "{}: the second pass differs", path.display());
    assert_eq!(first.material_names, second.material_names);
    assert_eq!(first.colours, second.colours);
    assert_eq!(first.normals, second.normals);
    let counters = |mesh: &SourceMesh| SourceStats { vertex_cache_misses: 0, ..mesh.stats.clone() };
    assert_eq!(format!("{:?}", counters(&first)), format!("{:?}", counters(&second)));
    Ok(second)
}

fn drain(source: &mut dyn TriangleSource) -> Result<SourceMesh> {
    let (mut triangles, mut colours, mut normals) = (Vec::new(), Vec::new(), Vec::new());
    let mut material_names = Vec::new();
    let mut batch = TriangleBatch::default();
    while source.next_batch(&mut batch)? {
        assert!(batch.len() <= 2 * TriangleBatch::TARGET_TRIANGLES);
        triangles.extend_from_slice(&batch.corners);
        colours.extend((0..batch.len()).map(|triangle| batch.attributes.of(triangle).colours));
        normals.extend((0..batch.len()).map(|triangle| batch.attributes.of(triangle).normals));
        material_names.extend(batch.material.iter().map(|&m| source.materials().name(m as usize).to_owned()));
    }
    assert!(batch.is_empty());
    let stats = source.stats();
    assert_eq!(stats.triangle_count, triangles.len() as u64);
    assert!(stats.bytes_read <= stats.bytes_total);
    Ok(SourceMesh { triangles, colours, normals, material_names, stats })
}

/// Equal bit for bit: NaN equals NaN.
pub(super) fn same(a: &[SourceTriangle], b: &[SourceTriangle]) -> bool {
    let bits = |triangles: &[SourceTriangle]| -> Vec<u64> {
        triangles.iter().flatten().flatten().map(|value| value.to_bits()).collect()
    };
    bits(a) == bits(b)
}

/// Corner names of a unit cube's vertices: `x + 2 y + 4 z`.
pub(super) fn corner(index: usize) -> [f64; 3] {
    [(index & 1) as f64, (index >> 1 & 1) as f64, (index >> 2 & 1) as f64]
}

/// Asserts that `content` under `name` gives the triangles between corners of the cube.
pub(super) fn check_corners(name: &str, content: &[u8], expected: &[[usize; 3]]) -> SourceMesh {
    let shown = String::from_utf8_lossy(content);
    let mesh = Fixture::new(name, content).read().unwrap_or_else(|error| panic!("{error}\n{shown}"));
    let expected: Vec<SourceTriangle> = expected.iter().map(|triangle| triangle.map(corner)).collect();
    assert_eq!(mesh.triangles, expected, "{shown}");
    mesh
}

/// Asserts that `content` under `name` is refused with `code`, in four parts, one of which holds `words`.
pub(super) fn check_error(name: &str, content: &[u8], code: Code, words: &str) -> Error {
    let fixture = Fixture::new(name, content);
    let error = fixture.read().map(|mesh| mesh.triangles.len()).expect_err(&String::from_utf8_lossy(content));
    assert_eq!(error.code(), code, "{error}");
    assert!(error.place().starts_with(&fixture.path.display().to_string()), "{error}");
    assert!(!error.what().is_empty() && !error.next_step().is_empty(), "{error}");
    assert!(error.to_string().contains(words), "{words:?} is not in: {error}");
    error
}

#[test]
fn formats_are_told_by_ending_and_content() {
    let obj = b"# c\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let stl = b"Solid a\nfacet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop \
                endfacet endsolid";
    let ply = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    for (name, content) in
        [("a.OBJ", &obj[..]), ("a", obj), ("a.sTl", stl), ("a.txt", stl), ("a.Ply", ply), ("a.x", ply)]
    {
        check_corners(name, content, &[[0, 1, 2]]);
        let marked = [b"\xef\xbb\xbf", content].concat();
        check_corners(name, &marked, &[[0, 1, 2]]);
    }
    check_error("a.obj", ply, Code::InputFormat, "named .obj, begins like .ply");
    check_error("a.ply", stl, Code::InputFormat, "begins like .stl");
    check_error("a.ply", obj, Code::InputFormat, "begins with a line `ply`");
    check_error("a.stl", &[&obj[..], &[b' '; 90]].concat(), Code::InputFormat, "does not begin with `solid`");
    check_error("a.off", b"OFF\n3 1 0\n", Code::InputFormat, "convert it to .ply");
}

#[test]
fn what_is_no_text_is_named() {
    let wide = |unit: fn(u8) -> Vec<u8>| {
        b"v 0 0 0\nf 1 2 3\n".iter().flat_map(|&byte| unit(byte)).collect::<Vec<u8>>()
    };
    let little = wide(|byte| vec![byte, 0]);
    let marked = |mark: &[u8]| [mark, &little].concat();
    for name in ["a.obj", "a.stl", "a.ply", "a"] {
        check_error(name, b"", Code::InputEmpty, "empty file");
        check_error(name, &little, Code::InputFormat, "UTF-16");
        check_error(name, &wide(|byte| vec![0, byte]), Code::InputFormat, "UTF-16");
        check_error(name, &wide(|byte| vec![byte, 0, 0, 0]), Code::InputFormat, "UTF-32");
        check_error(name, &marked(b"\xff\xfe"), Code::InputFormat, "UTF-16");
        check_error(name, &marked(b"\xfe\xff"), Code::InputFormat, "UTF-16");
        check_error(name, &marked(b"\xff\xfe\0\0"), Code::InputFormat, "UTF-32");
        check_error(name, b"\x1f\x8b\x08\0\0\0\0\0", Code::InputFormat, "gunzip");
    }
    check_error("a.obj", b"v 0 0 0\0\0", Code::InputFormat, "binary data");
}

#[test]
fn what_cannot_be_opened_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let options = ImportOptions::unlimited(folder.path());
    let error = |path: &Path| open(path, &options).map(|_| ()).unwrap_err();
    assert_eq!(error(folder.path()).code(), Code::InputUnreadable);
    assert_eq!(error(&folder.path().join("none.ply")).code(), Code::InputUnreadable);
    assert_eq!(error(Path::new("/dev/null")).code(), Code::InputUnreadable);
}

#[test]
fn memory_is_leased_first() {
    let fixture = Fixture::new("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let mut options = fixture.options();
    options.budget = Budget::new(crate::budget::RESERVE_BYTES + 100);
    assert_eq!(read(&fixture.path, &options).unwrap_err().code(), Code::MemoryLimit);
    options.budget = Budget::new(crate::budget::RESERVE_BYTES + (2 << 20));
    assert_eq!(read(&fixture.path, &options).unwrap().triangles.len(), 1);
    assert_eq!(options.budget.used_bytes(), 0);
}

#[test]
fn an_interrupt_stops_the_reading() {
    let fixture = Fixture::new("a.obj", b"v 0 0 0\n");
    let options = fixture.options();
    options.interrupt.raise();
    assert_eq!(read(&fixture.path, &options).unwrap_err().code(), Code::Interrupted);
}
