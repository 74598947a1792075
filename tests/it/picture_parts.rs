//! Pictures in parts, as many machines make them: put together they are the bytes of one render, and what does not
//! belong together is refused by name.

use crate::command::{cannot_run_without, document_in, folder, hash_of, listing, pixels, run_in, trex_in};
use crate::fixtures::built_in;
use std::ops::Range;
use std::path::Path;
use std::process::Command;

/// A plant with voxels, lamps and an exposure that are decided by a look, and light that is filtered.
const VIEW: &str = "plant.trex --resolution 100x76 --spp 4 --photons 20k --integrator photon --filter on";

fn plant(inside: &Path) {
    built_in(inside, "gen:pipes:60k:4 --voxels 64", "plant.trex");
}

/// Renders a picture of `view` by tiles, in `count` parts, and merges them in an order that is none.
fn merge_tiles(inside: &Path, view: &str, count: u32, output: &str) -> serde_json::Value {
    let mut names: Vec<String> = vec![];
    for number in 1..=count {
        let name = format!("{number}of{count}.trexpart");
        let line = format!("render {view} --tiles {number}/{count} -o {name} --overwrite");
        let rendered = document_in(inside, &line);
        assert_eq!(rendered["part"]["samples"][1], rendered["part"]["spp"], "{rendered:#}");
        names.push(name);
    }
    names.reverse();
    document_in(inside, &format!("image merge {} -o {output} --overwrite", names.join(" ")))
}

/// Each picture as a whole and in 1, 3 and 8 parts by tiles: `cmp` is the oracle.
#[test]
fn parts_by_tiles_are_the_bytes_of_one_render() {
    let inside = folder();
    plant(inside.path());
    for (view, picture) in [
        (VIEW.to_owned(), "png"),
        (format!("{VIEW} --layers depth,normal,albedo,id"), "exr"),
        (format!("{VIEW} --exposure auto --quality draft"), "png"),
        ("plant.trex --resolution 61x40 --integrator path --spp 3 --section 0,0,0,1,0,0".to_owned(), "exr"),
        ("plant.trex --resolution 33x70 --integrator full-gi --spp 2 --photons 5k".to_owned(), "exr"),
    ] {
        let whole = document_in(inside.path(), &format!("render {view} -o whole.{picture} --overwrite"));
        for count in [1, 3, 8] {
            let merged = merge_tiles(inside.path(), &view, count, &format!("merged.{picture}"));
            let same = Command::new("cmp")
                .args([format!("whole.{picture}"), format!("merged.{picture}")])
                .current_dir(inside.path())
                .output()
                .unwrap();
            assert!(same.status.success(), "{view} in {count}: {}", String::from_utf8_lossy(&same.stdout));
            assert_eq!((&merged["image"], &merged["exposure"]), (&whole["image"], &whole["exposure"]));
            assert_eq!(merged["part_count"], count);
        }
    }
}

/// Radiance of an EXR, by pixel.
fn radiance(path: &Path) -> Vec<[f32; 3]> {
    use exr::prelude::*;
    let image = read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![[0f32; 3]; size.width() * size.height()]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| {
            pixels[at.y() * *width + at.x()] = [r, g, b]
        },
    );
    image.unwrap().layer_data.channel_data.pixels.1
}

/// Sums of four samples and of twelve, against those of sixteen in one run: the bound of `docs/many-machines.md`. And a
/// cut has its bytes: rendered again by other thread counts and limits, named in another order.
#[test]
fn parts_by_samples_are_within_a_rounding_of_the_sums() {
    let inside = folder();
    plant(inside.path());
    let view = "plant.trex --resolution 64x48 --spp 16 --photons 20k --integrator photon --filter off";
    document_in(inside.path(), &format!("render {view} -o whole.exr --layers id"));
    for (a, b, flags, order, output) in [
        ("a", "b", "--threads 2", "a.trexpart b.trexpart", "once.exr"),
        ("c", "d", "--threads 1 --memory-limit 96MiB", "d.trexpart c.trexpart", "again.exr"),
    ] {
        for (name, samples) in [(a, "0..4"), (b, "4..16")] {
            let line = format!("render {view} --samples {samples} -o {name}.trexpart --layers id {flags}");
            assert_eq!(
                document_in(inside.path(), &line)["part"]["samples"][0],
                if name == a { 0 } else { 4 }
            );
        }
        document_in(inside.path(), &format!("image merge {order} -o {output}"));
    }
    let path = |name: &str| inside.path().join(name);
    assert_eq!(hash_of(&path("once.exr")), hash_of(&path("again.exr")), "a cut has its bytes");
    let (whole, merged) = (radiance(&path("whole.exr")), radiance(&path("once.exr")));
    let mut differ = 0;
    for (expected, found) in whole.iter().zip(&merged) {
        let brightest = expected.iter().copied().fold(0.0, f32::max);
        for c in 0..3 {
            // Twice sixteen adds and two, each off by 2^-38 of the brightest sum, and the step of an f32.
            let most = 34.0 * brightest * 2f32.powi(-38) + expected[c] * f32::EPSILON;
            assert!((expected[c] - found[c]).abs() <= most, "{expected:?} {found:?}");
            differ += usize::from(expected[c] != found[c]);
        }
    }
    assert!(whole.iter().any(|pixel| pixel[0] > 0.0) && differ * 20 < 3 * whole.len(), "{differ} differ");
}

/// A grid of parts: tiles and samples both.
#[test]
fn tiles_and_samples_are_cut_together() {
    let inside = folder();
    plant(inside.path());
    let view = "plant.trex --resolution 64x48 --spp 6 --integrator direct";
    for (name, flags) in
        [("a", "--tiles 1/2"), ("b", "--tiles 2/2 --samples 0..1"), ("c", "--tiles 2/2 --samples 1..6")]
    {
        document_in(inside.path(), &format!("render {view} {flags} -o {name}.trexpart"));
    }
    document_in(inside.path(), "image merge a.trexpart b.trexpart c.trexpart -o merged.png");
    document_in(inside.path(), &format!("render {view} -o whole.png"));
    let [(width, _, whole), (_, _, merged)] =
        ["whole.png", "merged.png"].map(|name| pixels(&inside.path().join(name)));
    // The first half is one part's; in the other a rounding may pass a border between two codes.
    let differ =
        |range: Range<usize>| whole[range.clone()].iter().zip(&merged[range]).filter(|(a, b)| a != b).count();
    let half = whole.len() / 2;
    assert!(width == 64 && differ(0..half) == 0 && differ(half..whole.len()) * 100 < half);
}

#[test]
fn parts_that_do_not_belong_together_are_refused_by_name() {
    let inside = folder();
    plant(inside.path());
    built_in(inside.path(), "gen:pipes:50k:4 --voxels 64", "other.trex");
    let base = "--resolution 40x32 --spp 2 --integrator direct --exposure 1";
    let part = |name: &str, line: &str| {
        document_in(inside.path(), &format!("render {line} -o {name}.trexpart"));
    };
    part("a", &format!("plant.trex {base} --tiles 1/2"));
    part("b", &format!("plant.trex {base} --tiles 2/2"));
    for (name, what, line) in [
        ("file", "file", format!("other.trex {base}")),
        ("seed", "seed", format!("plant.trex {base} --seed 2")),
        ("spp", "spp", format!("plant.trex {base} --spp 3").replacen(" --spp 2", "", 1)),
        ("size", "resolution", format!("plant.trex {base}").replace("40x32", "48x32")),
        ("exposure", "exposure", format!("plant.trex {base}").replace("--exposure 1", "--exposure 2")),
        ("view", "camera", format!("plant.trex {base} --camera-direction 1,0,0")),
        ("layers", "layers", format!("plant.trex {base} --layers id")),
        ("cut", "parts", format!("plant.trex {base} --section 0,0,0,0,0,1")),
    ] {
        part(name, &format!("{line} --tiles 2/2"));
        let before = listing(inside.path());
        let refused =
            run_in(inside.path(), &format!("image merge a.trexpart {name}.trexpart -o out.png --json -q"));
        let error = refused.expect_error(3, "input-mismatch");
        assert!(error["what"].as_str().unwrap().ends_with(&format!("another {what}")), "{name}: {error:#}");
        assert!(error["where"].as_str().unwrap().contains(name) && listing(inside.path()) == before);
    }
    for (parts, words) in [
        ("a.trexpart", "tiles 10..20 of 20, samples 0..2 of 2"),
        ("b.trexpart", "tiles 0..10 of 20, samples 0..2 of 2"),
        ("a.trexpart b.trexpart a.trexpart", "tiles 0..10 of 20, samples 0..2 of 2"),
    ] {
        let refused = run_in(inside.path(), &format!("image merge {parts} -o out.png --json -q"));
        let error = refused.expect_error(3, "input-mismatch");
        assert!(error.to_string().contains(words), "{parts}: {error:#}");
    }
    document_in(inside.path(), "image merge a.trexpart b.trexpart -o out.png");
    run_in(inside.path(), "image merge a.trexpart b.trexpart -o out.png --json -q").expect_error(2, "usage");
    run_in(inside.path(), "image merge a.trexpart out.png -o new.png --json -q")
        .expect_error(3, "input-format");
    run_in(inside.path(), "image merge a.trexpart b.trexpart -o a.trexpart --json -q")
        .expect_error(2, "usage");
}

#[test]
fn damaged_parts_are_refused_with_the_place() {
    let inside = folder();
    plant(inside.path());
    let base = "plant.trex --resolution 40x32 --spp 2 --integrator direct";
    document_in(inside.path(), &format!("render {base} --tiles 1/2 -o a.trexpart"));
    document_in(inside.path(), &format!("render {base} --tiles 2/2 -o b.trexpart"));
    let path = inside.path().join("b.trexpart");
    let bytes = std::fs::read(&path).unwrap();
    for at in [20, 200, bytes.len() / 2, bytes.len() - 3] {
        let mut changed = bytes.clone();
        changed[at] ^= 4;
        std::fs::write(&path, changed).unwrap();
        let refused = run_in(inside.path(), "image merge a.trexpart b.trexpart -o out.png --json -q");
        let error = refused.expect_error(3, "damaged");
        assert!(error["where"].as_str().unwrap().contains("b.trexpart at byte"), "{error:#}");
        assert!(!inside.path().join("out.png").exists());
    }
    std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    run_in(inside.path(), "image merge a.trexpart b.trexpart -o out.png --json -q")
        .expect_error(3, "damaged");
}

/// What a part does not go with is refused before any work; `info` tells what a part is.
#[test]
fn parts_are_asked_for_and_told() {
    let inside = folder();
    plant(inside.path());
    let base = "render plant.trex --resolution 40x32 --spp 2 --integrator direct";
    for line in [
        "--tiles 1/2 -o a.png",
        "--tiles 1/21 -o a.trexpart",
        "--tiles 0/2 -o a.trexpart",
        "--samples 1..3 -o a.trexpart",
        "--samples 1..1 -o a.trexpart",
        "--tiles 1/2 --time-limit 1s -o a.trexpart",
        "--samples 0..1 --t-max 33 -o a.trexpart",
        "-o a.trexpart",
    ] {
        let refused = run_in(inside.path(), &format!("{base} {line} --json -q"));
        refused.expect(2);
        assert_eq!(refused.document()["code"], "usage", "{line}");
    }
    document_in(inside.path(), &format!("{base} --tiles 2/4 --samples 0..1 -o a.trexpart"));
    let told = document_in(inside.path(), "info a.trexpart");
    assert_eq!(told["kind"], "a part of a picture");
    assert_eq!(told["part"]["tiles"], serde_json::json!([5, 10]));
    assert_eq!((&told["part"]["samples"][1], &told["facts"]["device"]), (&1.into(), &"cpu".into()));
    let file = document_in(inside.path(), "info plant.trex");
    assert_eq!(told["facts"]["file"], file["file_id"]);
    let said = run_in(inside.path(), "info a.trexpart");
    assert!(said.stdout.contains("tiles 5..10 of 20, samples 0..1 of 2"), "{}", said.stdout);
}

/// The memory of a merge is that of two strips: a picture whose film would not fit is merged under the limit, and a
/// limit below is refused with the one that works.
#[test]
fn a_merge_keeps_to_its_limit() {
    let inside = folder();
    plant(inside.path());
    // The film alone, with indirect light and layers, would take 70 MiB.
    let view = "plant.trex --resolution 1024x1600 --spp 1 --photons 10k --integrator photon --filter on --n-gather 1";
    for number in 1..=3 {
        document_in(inside.path(), &format!("render {view} --tiles {number}/3 -o {number}.trexpart"));
    }
    let line = "image merge 1.trexpart 2.trexpart 3.trexpart -o out.png";
    let refused = run_in(inside.path(), &format!("{line} --memory-limit 25MiB --json -q"));
    let smallest = refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
    assert!(smallest < 40 << 20, "{smallest}");
    let merged = document_in(inside.path(), &format!("{line} --memory-limit {smallest}B"));
    let memory = &merged["memory"];
    assert!(memory["ledger_peak_bytes"].as_u64().unwrap() <= smallest, "{memory:#}");
    assert!(memory["peak_rss_bytes"].as_u64().unwrap() <= smallest, "{memory:#}");
}

/// The lines of `docs/many-machines.md`, by GNU parallel on this machine.
#[test]
fn parallel_makes_the_parts() {
    if !Command::new("parallel").arg("--version").output().is_ok_and(|ran| ran.status.success()) {
        return cannot_run_without("parallel");
    }
    let inside = folder();
    plant(inside.path());
    let trex = trex_in(inside.path(), "").get_program().to_owned();
    let view = "plant.trex --resolution 64x48 --spp 2 --photons 10k --threads 1 -q";
    let made = Command::new("parallel")
        .args(["--will-cite", "--jobs", "2"])
        .arg(format!("{} render {view} --tiles {{}}/4 -o part-{{}}.trexpart", trex.to_string_lossy()))
        .args([":::", "1", "2", "3", "4"])
        .current_dir(inside.path())
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let names: Vec<String> = (1..=4).map(|number| format!("part-{number}.trexpart")).collect();
    document_in(inside.path(), &format!("image merge {} -o merged.png", names.join(" ")));
    document_in(inside.path(), &format!("render {} -o whole.png", view.replace(" -q", "")));
    let [whole, merged] = ["whole.png", "merged.png"].map(|name| hash_of(&inside.path().join(name)));
    assert_eq!(whole, merged);
}
