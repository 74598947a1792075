//! Golden bytes: a page file of the present version, kept as it was written, and the input that it was made of. What it
//! holds is read from the input's text by a few lines that share no code with the store.
//!
//! A change of the format makes a file of the next version here; one of the same version is never made anew.

use crate::command::{document_in, folder, run_in};
use std::path::Path;
use std::sync::Arc;
use trex_store::cluster::FrameView;
use trex_store::layout::{FRAME_BYTES, PageKind, VERSION};
use trex_store::{Budget, ExportOptions, PageFile, PageTriangles, TriangleBatch, TriangleSource, verify};
use xxhash_rust::xxh3::xxh3_64;

const INPUT: &str = include_str!("golden/model.obj");
const MATERIALS: &str = include_str!("golden/model.mtl");
const FILE: &[u8] = include_bytes!("golden/v7.page-file");
/// What it was made with.
const BUILD: &str = "build model.obj -o model.trex --voxels 64/256 --overwrite";

/// A triangle, its least corner first, and the name of its material.
type FileTriangle = ([[f64; 3]; 3], String);

fn stated(corners: [[f64; 3]; 3], material: &str) -> FileTriangle {
    let [a, b, c] = corners;
    let turns = [[a, b, c], [b, c, a], [c, a, b]];
    let least = turns.into_iter().min_by(|a, b| a.partial_cmp(b).unwrap()).unwrap();
    (least, material.to_owned())
}

fn sorted(mut triangles: Vec<FileTriangle>) -> Vec<FileTriangle> {
    triangles.sort_by(|a, b| a.partial_cmp(b).unwrap());
    triangles
}

/// The numbers of a corner: of its vertex, and of its normal where it has one.
fn corner(word: &str) -> Vec<usize> {
    word.split("//").map(|number| number.parse().unwrap()).collect()
}

/// The normals of the corners of the input, by place and material: none where there is none.
fn input_normals() -> Vec<([f64; 3], Option<[f64; 3]>)> {
    let rows = |name: &str| -> Vec<[f64; 3]> {
        let rows = INPUT.lines().filter_map(|line| line.strip_prefix(name));
        rows.map(|row| row.split(' ').map(|v| v.parse().unwrap()).collect::<Vec<_>>().try_into().unwrap())
            .collect()
    };
    let (vertices, normals) = (rows("v "), rows("vn "));
    let faces = INPUT.lines().filter_map(|line| line.strip_prefix("f "));
    let corners = faces.flat_map(|face| face.split(' ').map(corner));
    corners.map(|at| (vertices[at[0] - 1], at.get(1).map(|&normal| normals[normal - 1]))).collect()
}

/// The triangles of the input that can be drawn.
fn input_triangles() -> Vec<FileTriangle> {
    let (mut vertices, mut material, mut triangles) = (Vec::<[f64; 3]>::new(), "", Vec::new());
    for line in INPUT.lines() {
        let mut words = line.split(' ');
        match words.next().unwrap() {
            "v" => vertices.push([0; 3].map(|_| words.next().unwrap().parse().unwrap())),
            "usemtl" => material = words.next().unwrap(),
            "f" => {
                let corners = [0; 3].map(|_| vertices[corner(words.next().unwrap())[0] - 1]);
                let [a, b, c] = corners;
                if corners.as_flattened().iter().all(|v| v.is_finite()) && a != b && b != c && c != a {
                    triangles.push(stated(corners, material));
                }
            }
            _ => {}
        }
    }
    sorted(triangles)
}

fn file_triangles(file: &PageFile) -> Vec<FileTriangle> {
    let lattice = file.superblock().lattice;
    let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
    let mut all = Vec::new();
    for (page, entry) in (0..).zip(file.pages()).filter(|(_, entry)| entry.kind == PageKind::Mesh) {
        file.read_page(page, &mut frame, &mut buffers).unwrap();
        let before = all.len();
        FrameView::new(&frame).for_each_cluster(|cluster| {
            let mesh = cluster.decode();
            for (index, corners) in mesh.triangles.iter().enumerate() {
                let corners = corners.map(|i| lattice.position(mesh.vertices[usize::from(i)]));
                let material = file.material_names().get(usize::from(cluster.material(index))).unwrap();
                all.push(stated(corners, material));
            }
        });
        assert_eq!(all.len() - before, entry.triangle_count as usize);
    }
    sorted(all)
}

#[test]
fn the_golden_file_is_read_as_it_was_written() {
    let inside = folder();
    let path = inside.path().join("golden.trex");
    std::fs::write(&path, FILE).unwrap();
    let deep = verify::Options { level: verify::Level::Deep, bytes_per_s: None };
    let verdict = verify::check(&path, &deep, &Budget::unlimited(), &|_, _| Ok(())).unwrap();
    assert_eq!((verdict.damage_count, verdict.triangle_count), (0, 61));
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    assert_eq!(file_triangles(&file), input_triangles());
    check_normals(&path);
    let names: Vec<&str> = file.material_names().iter().collect();
    assert_eq!(names, ["default", "grey", "red", "lamp"]);
    let block = file.superblock();
    assert_eq!(
        (block.input_triangle_count, block.rejected_degenerate, block.rejected_non_finite),
        (63, 1, 1)
    );
    assert_eq!((file.emitters().len(), block.error_bound), (1, 0.0));
    let (upper, _lease) = file.upper(&Budget::unlimited()).unwrap().unwrap();
    assert_eq!((upper.grid().resolution, upper.leaf_count()), (64, 64));
    let lower = file.lower_size().unwrap().unwrap();
    assert_eq!((lower.refinement.factor(), lower.leaf_count), (4, 540));
}

/// Each corner of the file has a normal that the input has there, within what ten bits a coordinate tell.
fn check_normals(path: &Path) {
    let (expected, mut batch) = (input_normals(), TriangleBatch::default());
    let file = Arc::new(PageFile::open(path, &Budget::unlimited()).unwrap());
    let mut source = PageTriangles::open(file, &ExportOptions::default(), &Budget::unlimited()).unwrap();
    let (mut with, mut without) = (0, 0);
    while source.next_batch(&mut batch).unwrap() {
        for (triangle, corners) in batch.corners.iter().enumerate() {
            for (place, normal) in corners.iter().zip(batch.attributes.of(triangle).normals) {
                let found = normal.vector();
                let is_it = |wanted: &Option<[f64; 3]>| match (wanted, found) {
                    (Some(wanted), Some(found)) => {
                        wanted.iter().zip(found).all(|(a, b)| (a - f64::from(b)).abs() < 4e-3)
                    }
                    (wanted, found) => wanted.is_none() && found.is_none(),
                };
                let here = expected.iter().filter(|(at, _)| at == place).any(|(_, wanted)| is_it(wanted));
                assert!(here, "{found:?} at {place:?}");
                *if found.is_some() { &mut with } else { &mut without } += 1;
            }
        }
    }
    assert_eq!((with, without), (3 * 24, 3 * 37));
}

#[test]
fn the_golden_input_gives_the_golden_bytes() {
    let inside = folder();
    std::fs::write(inside.path().join("model.obj"), INPUT).unwrap();
    std::fs::write(inside.path().join("model.mtl"), MATERIALS).unwrap();
    for threads in [1, 2, 3] {
        document_in(inside.path(), &format!("{BUILD} --threads {threads}"));
        let bytes = std::fs::read(inside.path().join("model.trex")).unwrap();
        assert!(bytes == FILE, "{threads} threads: other bytes than those of version {VERSION}");
    }
}

/// The file with another version in both superblocks, sealed again.
fn of_version(version: u32) -> Vec<u8> {
    let mut bytes = FILE.to_vec();
    let tail = bytes.len() - 1024;
    for at in [0, tail] {
        bytes[at + 8..at + 12].copy_from_slice(&version.to_le_bytes());
        let hash = xxh3_64(&bytes[at..at + 1016]);
        bytes[at + 1016..at + 1024].copy_from_slice(&hash.to_le_bytes());
    }
    bytes
}

/// Until 1.0 only the present version is read. The message says what to do.
#[test]
fn files_of_other_versions_are_refused_with_the_way_out() {
    assert_eq!(of_version(VERSION), FILE, "the golden file is one of the present version");
    let inside = folder();
    let path = inside.path().join("other.trex");
    let lines = [
        "info other.trex",
        "verify other.trex",
        "render other.trex -o out.png --integrator direct --resolution 8x8",
    ];
    for (version, way_out) in [(0, "build it again"), (VERSION + 1, "newer trex"), (u32::MAX, "newer trex")] {
        std::fs::write(&path, of_version(version)).unwrap();
        for line in lines {
            let error = run_in(inside.path(), &format!("{line} --json -q")).expect_error(3, "version");
            let next = error["next_step"].as_str().unwrap();
            assert!(next.contains(way_out) && next.contains("trex build"), "{line}: {next}");
            assert!(error["numbers"].as_str().unwrap().contains(&format!("version {version}")), "{error:#}");
        }
        assert!(!Path::new(&inside.path().join("out.png")).exists());
    }
}
