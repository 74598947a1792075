//! Volumes through the command: files of each kind to the same model, several surfaces, what is told, what is refused,
//! and the limit as the kernel counts.

use crate::cgroup::Cgroup;
use crate::command::{document_in, folder, listing, models, run_in, said};
use crate::view::{ViewProcess, text_until};
use std::collections::HashMap;
use std::fs;
use std::path::Path;
use trex_store::import::{ImportOptions, VolumeOptions, open};
use trex_store::{Budget, TriangleBatch};

/// Samples of 32 bits along x: two balls that touch no border.
fn balls([x, y, z]: [usize; 3]) -> Vec<f32> {
    let scale = x.min(y).min(z) as f32;
    let ball = |at: [usize; 3], center: [f32; 3], radius: f32| {
        let squared: f32 = (0..3).map(|a| (at[a] as f32 / scale - center[a]).powi(2)).sum();
        100.0 * (radius - squared.sqrt())
    };
    let places = (0..z).flat_map(|k| (0..y).flat_map(move |j| (0..x).map(move |i| [i, j, k])));
    places.map(|at| ball(at, [0.5, 0.4, 0.45], 0.3).max(ball(at, [0.6, 0.7, 0.6], 0.22))).collect()
}

fn bytes(samples: &[f32]) -> Vec<u8> {
    samples.iter().flat_map(|sample| sample.to_le_bytes()).collect()
}

fn nrrd(size: [usize; 3], samples: &[f32], more: &str) -> Vec<u8> {
    let [x, y, z] = size;
    let head = format!(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {x} {y} {z}\nendian: little\nencoding: raw\n{more}\n"
    );
    [head.as_bytes(), &bytes(samples)].concat()
}

const SIZE: [usize; 3] = [50, 52, 54];

#[test]
fn files_of_each_kind_are_the_same_model() {
    let inside = folder();
    let (path, samples) = (|name: &str| inside.path().join(name), balls(SIZE));
    fs::write(path("a.nrrd"), nrrd(SIZE, &samples, "")).unwrap();
    fs::write(path("plain.raw"), bytes(&samples)).unwrap();
    let swapped: Vec<u8> = samples.iter().flat_map(|sample| sample.to_be_bytes()).collect();
    fs::write(path("swapped.RAW"), swapped).unwrap();
    let head = "NRRD0004\ntype: float\ndimension: 3\nsizes: 50 52 54\nendian: little\nencoding: raw\n";
    fs::write(path("b.nhdr"), format!("{head}data file: plain.raw\n")).unwrap();
    let head = "ObjectType = Image\nNDims = 3\nDimSize = 50 52 54\nElementType = MET_FLOAT\n";
    fs::write(path("c.mhd"), format!("{head}ElementDataFile = plain.raw\n")).unwrap();
    let built = |input: &str, flags: &str| {
        document_in(
            inside.path(),
            &format!("build {input} -o out.trex --overwrite --no-asvo --iso -2.5 {flags}"),
        )
    };
    let first = built("a.nrrd", "");
    for (input, flags) in [
        ("a.nrrd", "--threads 1 --memory-limit 80MiB"),
        ("b.nhdr", ""),
        ("c.mhd", ""),
        ("plain.raw", "--size 50x52x54 --type float32"),
        ("swapped.RAW", "--size 50x52x54 --type float32be --spacing 1,1,1"),
    ] {
        assert_eq!(built(input, flags)["result_hash"], first["result_hash"], "{input}");
    }
    let stretched = built("plain.raw", "--size 50x52x54 --type float32 --spacing 1,1,2");
    assert_eq!(stretched["triangle_count"], first["triangle_count"]);
    assert_ne!(stretched["result_hash"], first["result_hash"]);
    let info = document_in(inside.path(), "info c.mhd");
    assert_eq!(
        (info["format"].as_str(), info["encoding"].as_str()),
        (Some("metaimage"), Some("binary_little_endian"))
    );
    assert_eq!(info["volume"]["size"], serde_json::json!([50, 52, 54]));
    let info = document_in(inside.path(), "info swapped.RAW --size 50x52x54 --type float32be");
    assert_eq!(
        (info["volume"]["sample_type"].as_str(), info["encoding"].as_str()),
        (Some("float32"), Some("binary_big_endian"))
    );
}

/// What a page file holds is as closed as what went in: each side of a triangle there and back.
#[test]
fn surfaces_stay_closed_and_apart() {
    let inside = folder();
    fs::write(inside.path().join("a.nrrd"), nrrd(SIZE, &balls(SIZE), "spacings: 0.5 0.5 0.7\n")).unwrap();
    let ran = run_in(inside.path(), "build a.nrrd -o a.trex --no-asvo --iso 5 --iso 12.5 --threads 2");
    ran.expect(0);
    assert!(ran.stderr.contains("plan: volumes of 53 slabs"), "{}", ran.stderr);
    assert!(!ran.stderr.contains("border"), "{}", ran.stderr);
    let info = document_in(inside.path(), "info a.trex");
    assert_eq!(info["materials"], serde_json::json!(["iso_5", "iso_12.5"]));
    for name in ["iso_5", "iso_12.5"] {
        let line = format!("export a.trex -o {name}.ply --material {name}");
        assert!(document_in(inside.path(), &line)["triangle_count"].as_u64().unwrap() > 1000);
        let mut source =
            open(&inside.path().join(format!("{name}.ply")), &ImportOptions::unlimited(inside.path()))
                .unwrap();
        let (mut batch, mut sides) = (TriangleBatch::default(), HashMap::<[[u64; 3]; 2], i64>::new());
        while source.next_batch(&mut batch).unwrap() {
            for corners in &batch.corners {
                let [a, b, c] = corners.map(|corner| corner.map(|part| (part + 0.0).to_bits()));
                for [from, to] in [[a, b], [b, c], [c, a]] {
                    *sides.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
                }
            }
        }
        assert!(sides.values().all(|&sum| sum == 0), "{name} is open");
    }
}

#[test]
fn what_is_open_is_told() {
    let inside = folder();
    let size = [20, 21, 22];
    let slope: Vec<f32> = (0..20 * 21 * 22).map(|at| (at % 20) as f32 - 9.7).collect();
    fs::write(inside.path().join("a.nrrd"), nrrd(size, &slope, "")).unwrap();
    let ran = run_in(inside.path(), "build a.nrrd -o a.trex --no-asvo --iso 0");
    ran.expect(0);
    let told = "iso_0 meets the border of the volume at the first y, the last y, the first z, the last z: it is open";
    assert!(ran.stderr.contains(told), "{}", ran.stderr);
    // No crossing at all.
    let error =
        run_in(inside.path(), "build a.nrrd -o b.trex --iso 1e6 --json -q").expect_error(3, "input-empty");
    assert!(error["where"].as_str().unwrap().ends_with("a.nrrd"), "{error:#}");
}

#[test]
fn what_is_missing_is_asked_for() {
    let inside = folder();
    fs::write(inside.path().join("a.nrrd"), nrrd(SIZE, &balls(SIZE), "")).unwrap();
    fs::write(inside.path().join("a.raw"), (0..64).collect::<Vec<u8>>()).unwrap();
    let head = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 4 4\nencoding: raw\ndata file: a.raw\n";
    fs::write(inside.path().join("a.nhdr"), head).unwrap();
    let before = listing(inside.path());
    for (line, exit, code, words) in [
        ("build a.nrrd -o out.trex", 2, "usage", "--iso VALUE"),
        ("build gen:soup:10k -o out.trex --iso 5", 2, "usage", "leave --iso out"),
        ("build a.nrrd -o out.trex --iso 5 --size 4x4x4 --type uint8", 2, "usage", "leave --size out"),
        ("info a.nrrd --size 4x4x4 --type uint8", 2, "usage", "leave --size out"),
        ("build a.raw -o out.trex --iso 5", 3, "input-format", "--size XxYxZ --type TYPE"),
        ("info a.raw", 3, "input-format", "--size XxYxZ --type TYPE"),
        ("build a.raw -o out.trex --iso 5 --size 4x4x3 --type uint8", 3, "input-format", "--size XxYxZ"),
        ("build a.nhdr -o a.raw --overwrite --iso 5", 2, "usage", "another output"),
    ] {
        let error = run_in(inside.path(), &format!("{line} --json -q")).expect_error(exit, code);
        assert!(error["next_step"].as_str().unwrap().contains(words), "{line}: {error:#}");
        assert_eq!(listing(inside.path()), before, "{line} left something behind");
    }
    for (line, words) in [
        ("view a.nrrd --no-open", "trex view a.nrrd --iso VALUE"),
        ("view gen:soup:10k --iso 5 --no-open", "leave --iso out"),
        ("view a.trex --iso 5 --no-open", "leave --iso out"),
    ] {
        let ran = run_in(inside.path(), line);
        ran.expect(2);
        assert!(ran.stderr.contains(words), "{line}: {}", ran.stderr);
    }
    for line in [
        "--iso nan",
        "--iso 5 --size 4x4x4",
        "--iso 5 --type uint8",
        "--size 0x4x4 --type uint8",
        "--spacing 1,0,1",
    ] {
        run_in(inside.path(), &format!("build a.raw -o out.trex {line}")).expect(2);
    }
}

/// A volume is shown at a value, by a file of that value's own, which is built once.
#[test]
fn a_volume_is_viewed_at_its_value() {
    let inside = folder();
    fs::write(inside.path().join("a.nrrd"), nrrd(SIZE, &balls(SIZE), "")).unwrap();
    let viewed = |iso: &str| {
        let line =
            format!("a.nrrd {iso} --quiet --spp 1 --photons 5k --resolution 64x48 --memory-limit 160MiB");
        let viewing = ViewProcess::start(inside.path(), &line);
        viewing.told_after_waits(|text| text["type"] == "welcome");
        text_until(&mut viewing.page(), |text| text["progress"] == "done");
        let ran = viewing.end();
        ran.expect(0);
        ran.document()["scene"].as_str().unwrap().to_owned()
    };
    assert_eq!(viewed("--iso 0"), "a.nrrd.iso-0.trex");
    let built = fs::metadata(inside.path().join("a.nrrd.iso-0.trex")).unwrap().modified().unwrap();
    assert_eq!(viewed("--iso 0 --iso 8.5"), "a.nrrd.iso-0-8.5.trex");
    assert_eq!(viewed("--iso 0"), "a.nrrd.iso-0.trex");
    let now = fs::metadata(inside.path().join("a.nrrd.iso-0.trex")).unwrap().modified().unwrap();
    assert_eq!(now, built, "it was built again");
    let info = document_in(inside.path(), "info a.nrrd.iso-0-8.5.trex");
    assert_eq!(info["material_count"], 2, "{info:#}");
}

/// 64 MiB of samples under a limit of as much, which is a wall.
#[test]
fn slabs_stay_below_the_limit() {
    let inside = folder();
    let size = [256, 256, 256];
    fs::write(inside.path().join("large.nrrd"), nrrd(size, &balls(size), "")).unwrap();
    let Some(group) = Cgroup::new("volume", 64 << 20) else { return };
    let line =
        "build large.nrrd -o large.trex --iso 0 --voxels 64 --threads 2 --memory-limit 64MiB --json -q";
    let ran = group.run_in(inside.path(), line);
    assert_eq!((group.oom_kill_count(), ran.code), (0, Some(0)), "{}", ran.stderr);
}

/// Slices for which the limit has no room at all: the limit that is named has room for the build, too.
#[test]
fn the_limit_that_is_named_is_enough() {
    let inside = folder();
    let size = [512, 512, 3];
    fs::write(inside.path().join("wide.nrrd"), nrrd(size, &balls(size), "")).unwrap();
    let line = "build wide.nrrd -o wide.trex --iso -20 --no-asvo --threads 1 --json -q";
    let error =
        run_in(inside.path(), &format!("{line} --memory-limit 25MiB")).expect_error(4, "memory-limit");
    assert!(error["what"].as_str().unwrap().contains("two slices"), "{error:#}");
    let smallest = error["smallest_limit_bytes"].as_u64().unwrap();
    run_in(inside.path(), &format!("{line} --memory-limit {smallest}B")).expect(0);
}

/// A head by MRI, where it is at hand.
#[test]
fn a_real_volume_has_its_surface() {
    let Some(models) = models() else { return };
    let path = models.join("volume/ch2_mri.mhd");
    let options = |values: &[f64]| ImportOptions {
        volumes: VolumeOptions { iso_values: values.to_vec(), raw: None },
        ..ImportOptions::new(Budget::new(1 << 30), Path::new("."))
    };
    let mut source = open(&path, &options(&[60.0])).unwrap();
    let (mut batch, mut count) = (TriangleBatch::default(), 0);
    while source.next_batch(&mut batch).unwrap() {
        count += batch.len();
    }
    said(&format!("{count} triangles at 60"));
    assert!((1_500_000..2_000_000).contains(&count), "{count}");
}
