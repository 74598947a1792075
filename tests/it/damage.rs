//! Damaged page files: `verify` names what is damaged and exits 1; `render` draws what is whole, says what is not, and
//! never more differs than lies behind the damage; where the tables are gone there is an error, no picture.

use crate::command::{document_in, folder, listing, pixels, run_in};
use crate::fixtures::built_in;
use serde_json::Value;
use std::path::Path;
use trex_store::layout::{PageKind, SectionKind};
use trex_store::verify::page_boxes;
use trex_store::{Budget, PageFile};

const HEAD_BYTES: u64 = 1024;

/// A built model in its folder, and its bytes.
struct Victim {
    inside: tempfile::TempDir,
    bytes: Vec<u8>,
    file: PageFile,
}

impl Victim {
    fn build(spec: &str) -> Victim {
        let inside = folder();
        built_in(inside.path(), spec, "whole.trex");
        let path = inside.path().join("whole.trex");
        let bytes = std::fs::read(&path).unwrap();
        let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
        Victim { inside, bytes, file }
    }

    fn folder(&self) -> &Path {
        self.inside.path()
    }

    /// Writes `bad.trex`: the file with one bit flipped at each offset.
    fn flip(&self, offsets: &[u64]) {
        let mut bytes = self.bytes.clone();
        offsets.iter().for_each(|&at| bytes[at as usize] ^= 0x10);
        std::fs::write(self.folder().join("bad.trex"), bytes).unwrap();
    }

    /// `verify bad.trex`, which must say that it is damaged; gives the document.
    #[track_caller]
    fn damage(&self) -> Value {
        let ran = run_in(self.folder(), "verify bad.trex --json -q");
        ran.expect(1);
        let document = ran.document();
        assert_eq!(document["schema"], "trex.verify/1");
        assert_eq!(document["verdict"], "damaged", "{document:#}");
        let text = run_in(self.folder(), "verify bad.trex");
        text.expect(1);
        assert!(text.stdout.contains("damaged"), "{}", text.stdout);
        document
    }

    /// Everything that reads page files must refuse `bad.trex` with `code`.
    #[track_caller]
    fn refused(&self, code: &str) {
        let before = listing(self.folder());
        for line in ["info bad.trex", "render bad.trex -o out.png --resolution 8x8 --integrator direct"] {
            run_in(self.folder(), &format!("{line} --json -q")).expect_error(3, code);
        }
        assert_eq!(listing(self.folder()), before);
    }
}

#[test]
fn verify_names_damaged_pages_with_offsets_and_boxes() {
    let victim = Victim::build("gen:scan:60k --voxels 64");
    let clean = run_in(victim.folder(), "verify whole.trex");
    clean.expect(0);
    assert!(clean.stdout.contains("clean"), "{}", clean.stdout);
    let (pages, bounds) = (victim.file.pages(), victim.file.superblock().bounds);
    assert!(pages.len() >= 4, "{} pages are too few for this test", pages.len());
    let boxes = page_boxes(&victim.file);
    let chosen = [0, 2, pages.len() - 1];
    // First byte, last byte, one in between.
    let at: Vec<u64> = chosen
        .iter()
        .zip([0, 1, 2])
        .map(|(&page, place)| pages[page].offset + u64::from(pages[page].stored_bytes - 1) * place / 2)
        .collect();
    victim.flip(&at);
    let document = victim.damage();
    assert_eq!(document["damage_count"], 3);
    assert_eq!(document["page_count"], pages.len());
    let text = run_in(victim.folder(), "verify bad.trex").stdout;
    for (damage, &page) in document["damage"].as_array().unwrap().iter().zip(&chosen) {
        let entry = &pages[page];
        assert_eq!(damage["page"], page, "{damage}");
        assert_eq!(damage["offset"], entry.offset, "{damage}");
        assert_eq!(damage["bytes"], entry.stored_bytes, "{damage}");
        for axis in 0..3 {
            let (lo, hi) = (
                damage["bounds"]["lo"][axis].as_f64().unwrap(),
                damage["bounds"]["hi"][axis].as_f64().unwrap(),
            );
            assert_eq!((lo, hi), (boxes[page].lo[axis], boxes[page].hi[axis]));
            assert!(lo < hi && hi >= bounds.lo[axis] && lo <= bounds.hi[axis], "{damage}");
        }
        for word in [format!("page {page}"), format!("bytes {}..", entry.offset), "box [".into()] {
            assert!(text.contains(&word), "{word} is missing in:\n{text}");
        }
    }
}

/// Every byte is under a hash: a flip anywhere is found.
#[test]
fn a_flip_anywhere_is_found() {
    let victim = Victim::build("gen:pipes:20k --voxels 64");
    let length = victim.bytes.len() as u64;
    let step = (length / 60).max(1);
    let ends = [0, 8, HEAD_BYTES - 1, HEAD_BYTES, length - HEAD_BYTES - 1, length - HEAD_BYTES, length - 1];
    for at in ends.into_iter().chain((0..length).step_by(step as usize)) {
        victim.flip(&[at]);
        let ran = run_in(victim.folder(), "verify bad.trex --json -q");
        assert_eq!(ran.code, Some(1), "a flip at byte {at} of {length}: {}{}", ran.stdout, ran.stderr);
        let damage = &ran.document()["damage"][0];
        let (offset, bytes) = (damage["offset"].as_u64().unwrap(), damage["bytes"].as_u64().unwrap());
        assert!((offset..offset + bytes).contains(&at), "a flip at byte {at}: {damage}");
    }
}

#[test]
fn a_head_or_a_tail_alone_will_do() {
    let victim = Victim::build("gen:soup:20k --voxels 64");
    let length = victim.bytes.len() as u64;
    let whole = document_in(
        victim.folder(),
        "render whole.trex -o whole.png --resolution 16x16 --spp 1 --integrator direct",
    );
    for (what, at) in
        [("magic", 0), ("head", 500), ("tail", length - 500), ("the tail's magic", length - HEAD_BYTES)]
    {
        victim.flip(&[at]);
        let line = "render bad.trex -o bad.png --resolution 16x16 --spp 1 --overwrite --integrator direct";
        let opened = document_in(victim.folder(), line);
        assert_eq!(opened["image"]["mean"], whole["image"]["mean"], "{what}");
        assert_eq!(opened["exact"], true, "{what}");
        let damage = &victim.damage()["damage"][0];
        assert_eq!(damage["bytes"], HEAD_BYTES, "{what}: {damage}");
    }
    victim.flip(&[500, length - 500]);
    victim.damage();
    victim.refused("damaged");
}

#[test]
fn damaged_tables_are_an_error_and_no_picture() {
    let victim = Victim::build("gen:pipes:20k --voxels 64");
    let sections = SectionKind::ALL.map(|kind| victim.file.superblock().section(kind));
    for section in sections.into_iter().filter(|section| section.bytes > 0) {
        victim.flip(&[section.offset + section.bytes / 2]);
        let damage = victim.damage();
        assert_eq!(damage["damage"][0]["offset"], section.offset, "section {}: {damage:#}", section.kind);
        victim.refused("damaged");
    }
}

/// The octree is read by those who use it: they refuse, the others draw what they drew before.
#[test]
fn a_damaged_octree_is_refused_by_those_who_read_it() {
    let victim = Victim::build("gen:pipes:20k --voxels 64");
    let section = victim.file.superblock().find_section(SectionKind::Upper).unwrap();
    let picture = |file: &str, integrator: &str| {
        format!(
            "render {file} -o out.png --overwrite --resolution 16x16 --spp 1 --photons 1k --integrator {integrator}"
        )
    };
    let whole = document_in(victim.folder(), &picture("whole.trex", "direct"));
    // Head: resolution, leaves, facets, steps, place, nodes; then streams.
    let head = [0, 4, 8, 12, 20, 44];
    for at in head.into_iter().chain([52, 60, section.bytes / 2, section.bytes - 1]) {
        victim.flip(&[section.offset + at]);
        let document = victim.damage();
        assert_eq!(document["damage_count"], 1, "byte {at}: {document:#}");
        let damage = &document["damage"][0];
        assert!(damage["what"].as_str().unwrap().contains("upper octree"), "byte {at}: {damage}");
        assert_eq!((&damage["offset"], &damage["bytes"]), (&section.offset.into(), &section.bytes.into()));
        for integrator in ["photon", "ao", "debug-upper", "debug-occluders"] {
            let ran = run_in(victim.folder(), &format!("{} --json -q", picture("bad.trex", integrator)));
            let error = ran.expect_error(3, "damaged");
            assert!(error["what"].as_str().unwrap().contains("upper octree"), "byte {at}: {error:#}");
        }
        let drawn = document_in(victim.folder(), &picture("bad.trex", "direct"));
        assert_eq!(drawn["image"]["mean"], whole["image"]["mean"], "byte {at}");
        assert_eq!(drawn["exact"], true, "byte {at}");
    }
}

/// A damaged page of units is named with its box; rays go on in the octree above it, and the picture says so.
#[test]
fn damaged_units_fall_back_to_the_upper_octree() {
    let victim = Victim::build("gen:pipes:10k --voxels 64/256");
    let (pages, bounds) = (victim.file.pages(), victim.file.superblock().bounds);
    let units: Vec<usize> = (0..pages.len()).filter(|&page| pages[page].kind == PageKind::Units).collect();
    let picture = |file: &str, integrator: &str| {
        format!(
            "render {file} -o out.png --overwrite --resolution 32x32 --spp 2 --photons 1k --integrator {integrator}"
        )
    };
    victim.flip(&[pages[units[1]].offset + 9]);
    victim.damage();
    let deep = run_in(victim.folder(), "verify bad.trex --deep --json -q");
    deep.expect(1);
    let damage = &deep.document()["damage"][0];
    assert_eq!(damage["page"], units[1], "{damage}");
    for axis in 0..3 {
        let [lo, hi] = ["lo", "hi"].map(|end| damage["bounds"][end][axis].as_f64().unwrap());
        assert!(lo < hi && hi >= bounds.lo[axis] && lo <= bounds.hi[axis], "{damage}");
    }
    // All of them: what is left is the upper octree.
    victim.flip(&units.iter().map(|&page| pages[page].offset + 9).collect::<Vec<_>>());
    assert_eq!(victim.damage()["damage_count"], units.len());
    for integrator in ["photon", "ao", "debug-lower"] {
        let drawn = document_in(victim.folder(), &(picture("bad.trex", integrator) + " --allow-damage"));
        assert_eq!(drawn["exact"], false, "{integrator}");
        let named = drawn["damaged_pages"].as_array().unwrap();
        assert!(named.iter().all(|page| units.iter().any(|unit| page == unit)), "{named:?}");
    }
    let [lower, upper] =
        [("bad.trex", "debug-lower"), ("whole.trex", "debug-upper")].map(|(file, integrator)| {
            let drawn = document_in(victim.folder(), &(picture(file, integrator) + " --allow-damage"));
            drawn["image"]["mean"][0].as_f64().unwrap()
        });
    // Rays go by other cells: those that graze an edge may part.
    assert!((lower / upper - 1.0).abs() < 2e-3, "{lower}, not {upper}");
    let [bad, whole] = ["bad.trex", "whole.trex"]
        .map(|file| document_in(victim.folder(), &picture(file, "direct"))["image"]["mean"].clone());
    assert_eq!(bad, whole);
}

/// The links are read by those who use them, as the octree is.
#[test]
fn damaged_links_are_refused_by_those_who_read_them() {
    let victim = Victim::build("gen:pipes:10k --voxels 64/256");
    let section = victim.file.superblock().find_section(SectionKind::Lower).unwrap();
    for at in [0, 4, 12, section.bytes - 1] {
        victim.flip(&[section.offset + at]);
        let damage = &victim.damage()["damage"][0];
        assert!(damage["what"].as_str().unwrap().contains("lower octrees"), "byte {at}: {damage}");
        let line = "render bad.trex -o out.png --overwrite --resolution 8x8 --spp 1 --integrator";
        let ran = run_in(victim.folder(), &format!("{line} ao --json -q"));
        assert!(ran.expect_error(3, "damaged")["what"].as_str().unwrap().contains("lower octrees"));
        assert_eq!(document_in(victim.folder(), &format!("{line} direct"))["exact"], true, "byte {at}");
    }
}

#[test]
fn files_that_were_cut_or_are_something_else_are_refused() {
    let victim = Victim::build("gen:soup:20k --voxels 64");
    let bad = victim.folder().join("bad.trex");
    for left in [victim.bytes.len() - 1, victim.bytes.len() / 2, 3000] {
        std::fs::write(&bad, &victim.bytes[..left]).unwrap();
        victim.damage();
        victim.refused("damaged");
    }
    std::fs::write(&bad, [victim.bytes.as_slice(), b"more"].concat()).unwrap();
    victim.damage();
    victim.refused("damaged");
    for bytes in [&b""[..], b"TREX", &[7; 5000], &victim.bytes[..1500]] {
        std::fs::write(&bad, bytes).unwrap();
        victim.refused("input-format");
        run_in(victim.folder(), "verify bad.trex --json -q").expect_error(3, "input-format");
    }
}

/// Damage costs the pages that it hit, and nothing else: pixels that do not look through their boxes stay the same.
#[test]
fn a_picture_of_a_damaged_file_differs_only_where_the_damage_is() {
    let victim = Victim::build("gen:scan:120k --voxels 64");
    let (pages, boxes) = (victim.file.pages(), page_boxes(&victim.file));
    let bounds = victim.file.superblock().bounds;
    // From far outside along z: what lies outside of a box in x and y (with the camera's slant) is not touched.
    let center: [f64; 3] = std::array::from_fn(|a| 0.5 * (bounds.lo[a] + bounds.hi[a]));
    let size = (0..3).map(|a| bounds.hi[a] - bounds.lo[a]).fold(0.0, f64::max);
    let (side, far, degrees) = (128u32, 40.0 * size, 1.6f64);
    // The page that comes nearest to the camera: nothing stands before all of it.
    let page = (0..pages.len()).max_by(|&a, &b| boxes[a].hi[2].total_cmp(&boxes[b].hi[2])).unwrap();
    victim.flip(&[pages[page].offset + 100]);
    let line = |file: &str, output: &str| {
        format!(
            "render {file} -o {output} --integrator direct --resolution {side}x{side} --spp 2 \
             --exposure 1 --camera-position {},{},{} \
             --camera-target {},{},{} --camera-up 0,1,0 --fov-x {degrees}",
            center[0],
            center[1],
            center[2] + far,
            center[0],
            center[1],
            center[2]
        )
    };
    let whole = document_in(victim.folder(), &line("whole.trex", "whole.png"));
    let damaged = document_in(victim.folder(), &(line("bad.trex", "bad.png") + " --allow-damage"));
    assert_eq!((whole["exact"].clone(), damaged["exact"].clone()), (Value::from(true), Value::from(false)));
    assert_eq!(damaged["damaged_pages"], Value::from(vec![page]));
    assert_eq!(damaged["image"]["width"], side);
    let text = run_in(victim.folder(), &format!("{} --overwrite", line("bad.trex", "bad.png")));
    text.expect(1);
    assert!(text.stdout.contains("not whole: 1 damaged page"), "{}", text.stdout);
    assert!(text.stderr.contains(&format!("damaged page {page}, drawn as empty")), "{}", text.stderr);
    let [lo, hi] = [boxes[page].lo, boxes[page].hi].map(|corner| format!("{corner:?}"));
    assert!(text.stderr.contains(&format!("box {lo} to {hi}")), "{}", text.stderr);

    let ((width, _, whole), (_, _, bad)) =
        (pixels(&victim.folder().join("whole.png")), pixels(&victim.folder().join("bad.png")));
    let channels = whole.len() / (width * side) as usize;
    let pixel_size = 2.0 * far * (degrees.to_radians() / 2.0).tan() / f64::from(side);
    // Shadows fall elsewhere: only where the page itself is seen must the picture change, and a pixel that changes
    // looks at the page, or at what it shadows: below, so it lies within the model.
    let (mut inside, mut outside) = (0, 0);
    for (at, (a, b)) in whole.chunks(channels).zip(bad.chunks(channels)).enumerate() {
        let x = center[0] + ((at as u32 % width) as f64 + 0.5 - f64::from(side) / 2.0) * pixel_size;
        let y = center[1] - ((at as u32 / width) as f64 + 0.5 - f64::from(side) / 2.0) * pixel_size;
        let b_box = &boxes[page];
        let seen = |v: f64, axis: usize| {
            v > b_box.lo[axis] - 2.0 * pixel_size && v < b_box.hi[axis] + 2.0 * pixel_size
        };
        if a != b {
            if seen(x, 0) && seen(y, 1) { inside += 1 } else { outside += 1 }
        }
    }
    assert!(inside > 10, "only {inside} pixels changed where the page is");
    assert!(
        outside < (side * side / 20) as usize,
        "{outside} pixels changed elsewhere, {inside} where the page is"
    );
}

/// All pages damaged: a picture of the sky, and where that is allowed the exit status is 0.
#[test]
fn even_a_file_with_no_whole_page_gives_a_picture() {
    let victim = Victim::build("gen:soup:20k --voxels 64");
    let offsets: Vec<u64> = victim.file.pages().iter().map(|page| page.offset).collect();
    victim.flip(&offsets);
    let line = "render bad.trex -o bad.png --resolution 16x16 --spp 1 --integrator direct";
    let document = document_in(victim.folder(), &format!("{line} --allow-damage"));
    assert_eq!(document["exact"], false);
    assert!(!document["damaged_pages"].as_array().unwrap().is_empty());
    assert_eq!(victim.damage()["damage_count"], offsets.len());
}
