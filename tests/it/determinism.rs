//! The same input and options give the same bytes: at any thread count, under any limit, wherever scratch lies; and a
//! picture depends on file, camera, samples and seed alone.

use crate::command::{document_in, folder, hash_of};
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Builds `input` in three ways, with `tight` as the smallest limit; all files must be the same. What differs from run
/// to run by itself (a clock, addresses, who comes first) differs here, too.
fn check(inside: &Path, input: &str, tight: &str) {
    fs::create_dir_all(inside.join("scratch")).unwrap();
    let mut expected = None;
    for flags in [
        "--threads 2 --memory-limit 1GiB",
        "--threads 3 --memory-limit 200MiB",
        &format!("--threads 1 --memory-limit {tight} --temp-dir scratch"),
    ] {
        let built = document_in(inside, &format!("build {input} -o out.trex --overwrite {flags}"));
        let found = (hash_of(&inside.join("out.trex")), built["result_hash"].clone());
        let expected = expected.get_or_insert_with(|| found.clone());
        assert_eq!(&found, expected, "{input} {flags}: other bytes");
    }
}

#[test]
fn generated_models_give_the_same_bytes() {
    let inside = folder();
    // Two chunks each (of at most 2^17 triangles), but for the soup of huge triangles. Voxels take most of the time:
    // one model has as many as it gets by default.
    for input in ["gen:isosurface:140k:3", "gen:pipes:140k:2 --voxels 64", "gen:soup:10k:2 --voxels 64"] {
        check(inside.path(), input, "96MiB");
    }
}

/// A twisted ribbon through a cube: two chunks of triangles, as small as voxels at 1024, and little surface.
fn write_ribbon(path: &Path) {
    let (along, across) = (1000, 71);
    let mut text = String::new();
    for i in 0..=along {
        let t = f64::from(i) / f64::from(along);
        let (sin, cos) = (6.0 * t).sin_cos();
        for j in 0..=across {
            let w = 0.05 * (f64::from(j) / f64::from(across) - 0.5);
            writeln!(text, "v {} {} {}", t + w * cos, 0.9 * t - w * cos, 0.8 * t + w * sin).unwrap();
        }
    }
    for i in 0..along {
        for j in 0..across {
            let a = i * (across + 1) + j + 1;
            let b = a + across + 1;
            writeln!(text, "f {a} {} {}\nf {a} {} {b}", a + 1, b + 1, b + 1).unwrap();
        }
    }
    fs::write(path, text).unwrap();
}

#[test]
fn units_are_the_same_bytes() {
    let inside = folder();
    write_ribbon(&inside.path().join("ribbon.obj"));
    for input in ["gen:isosurface:10k:2 --voxels 64/256", "ribbon.obj --voxels 64/1024"] {
        check(inside.path(), input, "96MiB");
    }
}

#[test]
fn files_give_the_same_bytes() {
    let inside = folder();
    document_in(inside.path(), "gen isosurface --triangles 140k --seed 3 -o iso.ply");
    document_in(inside.path(), "gen pipes --triangles 140k -o pipes.obj");
    for (input, tight) in [
        ("iso.ply --voxels 64", "65MiB"),
        ("pipes.obj --voxels 64", "65MiB"),
        ("pipes.obj iso.ply gen:soup:10k --no-asvo", "96MiB"),
    ] {
        check(inside.path(), input, tight);
    }
}

#[test]
fn another_input_or_lattice_is_another_file() {
    let inside = folder();
    let mut ids: Vec<String> = [
        "gen:scan:10k:1",
        "gen:scan:10k:2",
        "gen:scan:11k:1",
        "gen:scan:10k:1 --grid-bits 20",
        "gen:scan:10k:1 gen:scan:10k:1",
    ]
    .iter()
    .map(|what| {
        document_in(inside.path(), &format!("build {what} -o out.trex --overwrite --voxels 64"))["result_hash"]
            .to_string()
    })
    .collect();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), 5, "{ids:?}");
}

#[test]
fn pictures_do_not_depend_on_threads_limits_or_backends() {
    let inside = folder();
    document_in(inside.path(), "build gen:pipes:200k:4 -o plant.trex --voxels 64");
    for (picture, view) in [
        ("out.png", "--resolution 160x120 --spp 4"),
        ("out.exr", "--resolution 96x96 --spp 2 --layers depth,normal,albedo,id"),
    ] {
        let mut expected = None;
        for flags in [
            "--threads 1",
            "--threads 2",
            "--threads 3 --memory-limit 64MiB",
            "--threads 2 --io mmap",
            "--threads 2 --io pread --direct off",
            "--threads 2 --seed 1",
        ] {
            let rendered = document_in(
                inside.path(),
                &format!("render plant.trex -o {picture} {view} --integrator direct --overwrite {flags}"),
            );
            // The lamps are inside, so that a sky is added, and an exposure that shows what it lights: alike, too.
            assert!(rendered["light"] == "studio" && rendered["exposure"].as_f64().unwrap() != 1.0);
            let decided = [&rendered["exposure"], &rendered["image"]["mean"]].map(Clone::clone);
            let found = (hash_of(&inside.path().join(picture)), decided);
            assert_eq!(
                &found,
                expected.get_or_insert_with(|| found.clone()),
                "{picture} {flags}: other pixels"
            );
        }
        document_in(
            inside.path(),
            &format!("render plant.trex -o {picture} {view} --integrator direct --overwrite --seed 2"),
        );
        assert_ne!(
            hash_of(&inside.path().join(picture)),
            expected.unwrap().0,
            "{picture}: the seed does nothing"
        );
    }
}
