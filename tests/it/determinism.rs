//! The same input and options give the same bytes: at any thread count, under any limit, wherever scratch lies; and a
//! picture depends on file, camera, samples and seed alone.

use crate::command::{document_in, folder, hash_of};
use std::path::Path;

/// Builds `input` in many ways, with `tight` as the smallest limit; all files must be the same.
fn check(inside: &Path, input: &str, tight: &str) {
    std::fs::create_dir_all(inside.join("scratch")).unwrap();
    let mut expected = None;
    for flags in [
        "--threads 2 --memory-limit 1GiB",
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
    // Of several chunks each, but for the soup, whose huge triangles take most of the time.
    for input in ["gen:isosurface:200k:3", "gen:pipes:200k:2", "gen:soup:10k:2"] {
        check(inside.path(), input, "96MiB");
    }
}

#[test]
fn units_are_the_same_bytes() {
    let inside = folder();
    for input in ["gen:isosurface:40k:2 --voxels 64/256", "gen:scan:10k:2 --voxels 64/1024"] {
        check(inside.path(), input, "96MiB");
    }
}

#[test]
fn files_give_the_same_bytes() {
    let inside = folder();
    document_in(inside.path(), "gen isosurface --triangles 200k --seed 3 -o iso.ply");
    document_in(inside.path(), "gen pipes --triangles 200k -o pipes.obj");
    for (input, tight) in
        [("iso.ply", "65MiB"), ("pipes.obj", "65MiB"), ("pipes.obj iso.ply gen:soup:10k --no-asvo", "96MiB")]
    {
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
        document_in(inside.path(), &format!("build {what} -o out.trex --overwrite"))["result_hash"]
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
    document_in(inside.path(), "build gen:pipes:200k:4 -o plant.trex");
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
                &format!("render plant.trex -o {picture} {view} --overwrite {flags}"),
            );
            let found = (hash_of(&inside.path().join(picture)), rendered["image"]["mean"].clone());
            assert_eq!(
                &found,
                expected.get_or_insert_with(|| found.clone()),
                "{picture} {flags}: other pixels"
            );
        }
        document_in(inside.path(), &format!("render plant.trex -o {picture} {view} --overwrite --seed 2"));
        assert_ne!(
            hash_of(&inside.path().join(picture)),
            expected.unwrap().0,
            "{picture}: the seed does nothing"
        );
    }
}
