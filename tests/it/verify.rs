//! `trex verify` at its levels: what each finds, what it costs, and what it says of what is lost.

use crate::command::{document_in, folder, run_in};
use crate::fixtures::built_in;
use std::path::Path;
use std::time::{Duration, Instant};
use trex_store::layout::{PageKind, SectionKind};
use trex_store::{Budget, PageFile};

const LEVELS: [&str; 3] = ["--quick", "", "--deep"];

/// A model with units below its octree, in `whole.trex`.
fn refined() -> (tempfile::TempDir, PageFile, Vec<u8>) {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k --voxels 64/256", "whole.trex");
    let path = inside.path().join("whole.trex");
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    (inside, file, bytes)
}

/// How `verify` ends at each level for the model with a flip at `offset`.
fn ends(inside: &Path, bytes: &[u8], offset: u64) -> [Option<i32>; 3] {
    let mut bad = bytes.to_vec();
    bad[offset as usize] ^= 0x20;
    std::fs::write(inside.join("bad.trex"), bad).unwrap();
    LEVELS.map(|level| run_in(inside, &format!("verify bad.trex -q {level}")).code)
}

#[test]
fn each_level_finds_what_those_before_it_find() {
    let (inside, file, bytes) = refined();
    let levels = LEVELS.map(|level| document_in(inside.path(), &format!("verify whole.trex {level}")));
    for (found, level) in levels.iter().zip(["quick", "hashes", "deep"]) {
        assert_eq!((&found["verdict"], &found["level"]), (&"clean".into(), &level.into()), "{found:#}");
        assert_eq!(found["damaged_triangle_count"], 0);
    }
    assert_eq!(
        (levels[0]["page_count"].as_u64(), levels[1]["page_count"].as_u64()),
        (Some(0), Some(file.pages().len() as u64))
    );
    assert!(levels[0]["bytes_read"].as_u64() < levels[1]["bytes_read"].as_u64());
    assert_eq!(levels[1]["bytes_read"], bytes.len());
    let block = file.superblock();
    let pages = [PageKind::Mesh, PageKind::Units]
        .map(|kind| file.pages().iter().find(|page| page.kind == kind).unwrap());
    for page in pages {
        let at = page.offset + u64::from(page.stored_bytes) / 2;
        assert_eq!(ends(inside.path(), &bytes, at), [Some(0), Some(1), Some(1)], "{:?}", page.kind);
    }
    for kind in [SectionKind::Upper, SectionKind::Lower] {
        let at = block.find_section(kind).unwrap();
        assert_eq!(
            ends(inside.path(), &bytes, at.offset + at.bytes - 1),
            [Some(0), Some(1), Some(1)],
            "{kind:?}"
        );
    }
    for kind in [SectionKind::PageTable, SectionKind::TopTree, SectionKind::Materials] {
        let at = block.section(kind);
        assert_eq!(ends(inside.path(), &bytes, at.offset + at.bytes / 2), [Some(1); 3], "{kind:?}");
    }
    for at in [100, bytes.len() as u64 - 100] {
        assert_eq!(ends(inside.path(), &bytes, at), [Some(1); 3], "a superblock");
    }
    run_in(inside.path(), "verify whole.trex --quick --deep").expect(2);
}

#[test]
fn what_is_lost_is_counted() {
    let (inside, file, mut bytes) = refined();
    let mesh = file.pages().partition_point(|page| page.kind == PageKind::Mesh);
    assert!(mesh > 2 && mesh < file.pages().len(), "{mesh} pages of the mesh");
    let chosen = [0, mesh - 1, mesh];
    chosen.iter().for_each(|&page| bytes[file.pages()[page].offset as usize + 3] ^= 1);
    std::fs::write(inside.path().join("bad.trex"), bytes).unwrap();
    for level in ["", "--deep"] {
        let ran = run_in(inside.path(), &format!("verify bad.trex --json -q {level}"));
        ran.expect(1);
        let document = ran.document();
        let damage = document["damage"].as_array().unwrap();
        assert_eq!(damage.len(), 3, "{document:#}");
        for (damage, &page) in damage.iter().zip(&chosen) {
            let entry = &file.pages()[page];
            assert_eq!(damage["page"], page);
            assert_eq!(damage["triangle_count"], entry.triangle_count);
            assert_eq!(damage["kind"], if page < mesh { "mesh" } else { "units" });
        }
        let lost = u64::from(file.pages()[0].triangle_count + file.pages()[mesh - 1].triangle_count);
        assert!(lost > 0);
        assert_eq!(document["damaged_triangle_count"], lost);
        assert_eq!(document["triangle_count"], file.superblock().triangle_count - lost);
        // Where units lie is known to who reads the octree above them.
        assert_eq!(damage[2]["bounds"].is_null(), level.is_empty(), "{level}: {}", damage[2]);
        let text = run_in(inside.path(), &format!("verify bad.trex {level}")).stdout;
        assert!(text.contains(&format!("{lost} triangles lost")) && text.contains("(voxels)"), "{text}");
    }
}

/// It took 171 MiB for a file that is drawn in 61.
#[test]
fn it_works_under_the_smallest_limit_of_a_picture() {
    let inside = folder();
    built_in(inside.path(), "gen:scan:300k --voxels 512", "m.trex");
    let render = "render m.trex -o out.png --resolution 16x16 --spp 1 --integrator direct --threads 1";
    let refused = run_in(inside.path(), &format!("{render} --memory-limit 1MiB --json -q"));
    let smallest = refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
    run_in(inside.path(), &format!("{render} --memory-limit {smallest}B -q")).expect(0);
    for level in ["--quick", ""] {
        let line = format!("verify m.trex {level} --memory-limit {smallest}B --json -q");
        let verified = run_in(inside.path(), &line);
        verified.expect(0);
        let peak = verified.document()["memory"]["peak_rss_bytes"].as_u64().unwrap();
        assert!(peak <= smallest, "{level}: {peak} bytes of {smallest}");
    }
}

#[test]
fn a_rate_is_kept() {
    let (inside, _, bytes) = refined();
    let time = |line: &str| {
        let begin = Instant::now();
        run_in(inside.path(), line).expect(0);
        begin.elapsed()
    };
    for level in ["", "--deep"] {
        let slow = time(&format!("verify whole.trex --rate {}B/s {level}", bytes.len()));
        assert!(slow >= Duration::from_millis(990), "{level}: {slow:?}");
    }
    assert!(time("verify whole.trex --rate 1GB") < Duration::from_secs(1));
    for bad in ["0B", "5", "-1MB", "fast"] {
        run_in(inside.path(), &format!("verify whole.trex --rate {bad}")).expect(2);
    }
}
