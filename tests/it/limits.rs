//! Limits that are too small: exit status 4 with the smallest one that would do, and that one does.

use crate::command::{document_in, folder, listing, run_in};
use crate::fixtures::model_with;
use crate::view::{ViewProcess, smallest_limit_mib};
use std::path::Path;
use trex_render::{CpuStage, Layers, MemoryPlan, PartNeeds, PictureNeeds, RenderKeys, RenderSettings};
use trex_store::build::Voxels;
use trex_view::view_bytes;

/// Runs `trex LINE` under a hopeless limit, then under the smallest that was named, then under one byte less.
#[track_caller]
fn check(inside: &Path, line: &str) {
    let before = listing(inside);
    let under = |limit: u64| run_in(inside, &format!("{line} --memory-limit {limit}B --json -q"));
    let document = under(1 << 20).expect_error(4, "memory-limit");
    assert_eq!(listing(inside), before, "{line} left something behind");
    let smallest = document["smallest_limit_bytes"].as_u64().unwrap_or_else(|| panic!("{line}: {document}"));
    let less = under(smallest - 1).expect_error(4, "memory-limit");
    assert_eq!(less["smallest_limit_bytes"], smallest, "{line}: another limit, the closer one comes");
    let enough = under(smallest);
    enough.expect(0);
    let peak = enough.document()["memory"]["peak_rss_bytes"].as_u64();
    assert!(peak.is_none_or(|peak| peak <= smallest), "{line}: VmHWM {peak:?} under {smallest}");
}

#[test]
fn the_smallest_limit_that_is_named_works() {
    let inside = folder();
    // A chunk (of at most 2^17 triangles) for every worker, so that each has work.
    document_in(inside.path(), "gen scan --triangles 140k -o scan.ply");
    document_in(inside.path(), "gen scan --triangles 140k -o scan.obj");
    document_in(inside.path(), "gen scan --triangles 100k -o scan.stl");
    document_in(inside.path(), "build scan.stl -o scan.trex");
    for picture in ["large.exr", "large.png"] {
        let line =
            format!("render scan.trex -o {picture} --integrator direct --resolution 1500x1100 --spp 1");
        document_in(inside.path(), &line);
    }
    for line in [
        "build gen:isosurface:300k:3 -o out.trex --overwrite --threads 3",
        "build scan.ply -o out.trex --overwrite --threads 1 --voxels 64",
        "build scan.obj -o out.trex --overwrite --threads 2 --voxels 64",
        "build scan.stl -o out.trex --overwrite --threads 2 --voxels 64",
        "build scan.stl gen:soup:10k scan.obj --no-asvo -o out.trex --overwrite --threads 2",
        "render scan.trex -o out.png --integrator direct --resolution 64x48 --spp 1 --overwrite --threads 1",
        "render scan.trex -o out.png --integrator direct --resolution 64x48 --spp 1 --overwrite --threads 3",
        "render scan.trex -o out.exr --integrator direct --resolution 64x48 --spp 1 --layers depth,id --overwrite",
        "gen soup --triangles 10k -o out.ply --overwrite --threads 1",
        "gen soup --triangles 10k -o out.stl --overwrite --threads 2",
        "stress scan.trex --scenario squeeze --switches 4 --hold 10 --resolution 32x32 --photons 1k",
        "verify scan.trex",
        "image diff large.exr large.exr",
        "image diff large.exr large.png -o diff.png --overwrite",
        "image diff large.png large.png",
    ] {
        check(inside.path(), line);
    }
}

/// `info` once named the limit of a picture in direct light, 60 MiB, where a `render` with nothing said takes three
/// times that.
#[test]
fn info_tells_the_smallest_limit_of_a_picture() {
    let inside = folder();
    document_in(inside.path(), "build gen:scan:100k -o scan.trex");
    let info = document_in(inside.path(), "info scan.trex --threads 2");
    let smallest = info["smallest_limit_bytes"].as_u64().unwrap();
    let line = |limit: u64| {
        format!("render scan.trex -o out.png --spp 1 --threads 2 --memory-limit {limit}B --json -q")
    };
    let refused = run_in(inside.path(), &line(smallest - 1)).expect_error(4, "memory-limit");
    assert_eq!(refused["smallest_limit_bytes"], smallest);
    run_in(inside.path(), &line(smallest)).expect(0);
    // The viewer takes a smaller picture where a larger one has no room, unless a size was asked for.
    let refuses_less = |file: &str, info: &serde_json::Value, threads: u32| {
        let smallest = info["smallest_limit_view_bytes"].as_u64().unwrap();
        let line = format!(
            "view {file} --no-open --resolution 1280x720 --threads {threads} --memory-limit {}B --json -q",
            smallest - 1
        );
        let refused = run_in(inside.path(), &line).expect_error(4, "memory-limit");
        assert_eq!(refused["smallest_limit_bytes"], smallest, "{file}");
    };
    refuses_less("scan.trex", &info, 2);

    document_in(inside.path(), "build gen:scan:100k -o bare.trex --no-asvo");
    let info = document_in(inside.path(), "info bare.trex --threads 1");
    refuses_less("bare.trex", &info, 1);
    check(inside.path(), "render bare.trex -o bare.png --spp 1 --threads 1 --overwrite");
    let smallest = info["smallest_limit_bytes"].as_u64().unwrap();
    let line = format!("render bare.trex -o less.png --threads 1 --memory-limit {}B --json -q", smallest - 1);
    let refused = run_in(inside.path(), &line).expect_error(4, "memory-limit");
    assert_eq!(refused["smallest_limit_bytes"], smallest);
}

/// Light of earlier pictures once took the room that was planned for the viewer: at 1600x900 it was refused under
/// limits that the same line called enough.
#[test]
fn the_viewer_opens_a_large_picture_under_the_smallest_limit() {
    let inside = folder();
    document_in(inside.path(), "build gen:scan:100k -o scan.trex");
    let line = "scan.trex --resolution 1920x1080 --threads 2 --spp 1";
    let limit = smallest_limit_mib(inside.path(), line);
    for limit in [limit, limit + 8, limit + 24] {
        let viewing = ViewProcess::start(inside.path(), &format!("{line} --memory-limit {limit}MiB"));
        assert!(viewing.address().starts_with("http"), "{limit} MiB");
        viewing.told_after_waits(|text| text["type"] == "welcome");
        viewing.end().expect(0);
    }
}

/// What grows with the picture once left 39 of 256 MiB to pages at 1920x1080: a view of 100M triangles read each page
/// again and again. The plan of a small file stands for that of a large one, whose tables, octree and staging are
/// given.
#[test]
fn a_viewer_leaves_pages_half_of_a_small_limit_and_a_third_beside_a_large_picture() {
    const MIB: u64 = 1 << 20;
    const LIMIT: u64 = 256 * MIB;
    /// What the file of an iso-surface of 100M triangles takes, frames and picture not counted, with the reserve.
    const OTHERS: u64 = 57 * MIB;
    let built = model_with("gen:isosurface:100k", Voxels::Resolution(64));
    for (resolution, part) in [([1280, 720], 2), ([1920, 1080], 3)] {
        let settings = RenderSettings::new(RenderKeys { resolution, ..RenderKeys::default() }).unwrap();
        let copies_bytes = view_bytes(resolution);
        let layers = Layers::default();
        let g_needs = CpuStage::NEEDS;
        let needs = PictureNeeds {
            settings,
            layers,
            portion: None,
            workers: 2,
            g_needs,
            is_live: true,
            copies_bytes,
            parts: PartNeeds::default(),
        };
        let plan = MemoryPlan::new(&built.file, &needs, LIMIT).unwrap();
        let frames = LIMIT - OTHERS - plan.film_bytes;
        assert!(
            frames >= LIMIT / part,
            "{resolution:?}: {} MiB, film {}",
            frames / MIB,
            plan.film_bytes / MIB
        );
    }
}
