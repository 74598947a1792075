//! Every verb inside control groups of exactly its `--memory-limit`, from the smallest that anybody would give to a
//! roomy one, on honest files and on hostile ones: it works, or says what is wrong or how much it needs; the kernel
//! never has to end it. `TREX_FAULTS=full` takes all sizes.

use crate::cgroup::Cgroup;
use crate::command::{document_in, folder, said};
use crate::lies::Forger;
use std::fs;
use std::path::Path;

const MIB: u64 = 1 << 20;
/// Sizes of groups, in MiB.
const ALL: [u64; 5] = [64, 80, 96, 128, 256];
const SOME: [u64; 2] = [64, 128];

/// What each verb is asked for of `m.trex`, and whether it writes.
const LINES: [&str; 9] = [
    "info m.trex",
    "verify m.trex --quick",
    "verify m.trex",
    "verify m.trex --deep",
    "export m.trex -o out.ply --overwrite",
    "build m.ply -o built.trex --voxels 64 --threads 2 --overwrite",
    "render m.trex -o out.png --resolution 320x240 --spp 1 --integrator photon --photons 10k --overwrite",
    "render m.trex -o out.png --integrator direct --resolution 320x240 --spp 1 --overwrite --allow-damage",
    "stress m.trex --scenario flip --switches 4 --hold 300 --resolution 320x240",
];

/// Statuses that say what is wrong with a file or a limit; a panic would be 70, a kill none.
fn is_reported(code: Option<i32>, line: &str, is_honest: bool) -> bool {
    match code {
        Some(0 | 4) => true,
        // Stress judges its times: on a busy machine they are missed. An honest file is not damaged.
        Some(1) => !is_honest || line.starts_with("stress"),
        Some(3) => !is_honest,
        _ => false,
    }
}

/// An honest file that is called damaged, and a missed verdict on one, were one and the same status here.
#[test]
fn an_honest_file_is_never_damaged() {
    assert!(is_reported(Some(1), "stress m.trex", true) && is_reported(Some(1), "verify m.trex", false));
    for line in LINES.iter().filter(|line| !line.starts_with("stress")) {
        assert!(!is_reported(Some(1), line, true) && !is_reported(Some(3), line, true), "{line}");
    }
}

/// Runs all lines in groups of these sizes; how many ran, and how many of them had too little room.
fn all_lines(inside: &Path, what: &str, is_honest: bool) -> Option<(u32, u32)> {
    let is_full = std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full");
    let sizes: &[u64] = if is_full { &ALL } else { &SOME };
    let (mut count, mut refused) = (0, 0);
    for &size in sizes {
        for line in LINES {
            let group = Cgroup::new("wall", size * MIB)?;
            let ran = group.run_in(inside, &format!("{line} --memory-limit {size}MiB --json -q"));
            let place = format!("{what}, {size} MiB: {}: {:?}\n{}", ran.line, ran.code, ran.stderr);
            assert_eq!(group.oom_kill_count(), 0, "{place}");
            assert!(is_reported(ran.code, line, is_honest), "{place}");
            // One document, whatever came of it.
            let document = ran.document();
            if ran.code == Some(4) {
                let least = document["smallest_limit_bytes"].as_u64();
                assert!(least.is_none_or(|least| least > size * MIB), "{place}: {least:?} would do");
                refused += 1;
            }
            count += 1;
        }
    }
    Some((count, refused))
}

#[test]
fn no_verb_is_killed_at_any_size_on_any_file() {
    let inside = folder();
    let (model, ply) = (inside.path().join("m.trex"), inside.path().join("m.ply"));
    document_in(inside.path(), "gen scan --triangles 140k -o m.ply");
    document_in(inside.path(), "build m.ply -o m.trex --voxels 256");
    let Some((mut count, refused)) = all_lines(inside.path(), "an honest file", true) else { return };
    assert!(refused < count / 2, "{refused} of {count} had too little room");

    // A header that says more than there is, and more than there can be.
    let text = String::from_utf8_lossy(&fs::read(&ply).unwrap()[..200]).into_owned();
    let face_count = text.lines().find_map(|line| line.strip_prefix("element face ")).unwrap().to_owned();
    let mut bytes = fs::read(&ply).unwrap();
    let at = text.find(&face_count).unwrap();
    bytes[at..at + face_count.len()].fill(b'9');
    fs::write(&ply, bytes).unwrap();
    let mut hostile = |what: &str, forger: &Forger| {
        let _ = fs::remove_file(&model);
        fs::copy(forger.folder().join("lie.trex"), &model).unwrap();
        count += all_lines(inside.path(), what, false).map_or(0, |(count, _)| count);
    };
    hostile("a page that is a bomb", &Forger::new().seal_page_bomb());
    let forger = Forger::new();
    forger.seal_octree(|upper| upper.node_count = 1 << 40);
    hostile("an octree that is huge", &forger);
    for (at, octree) in forger.octree_bombs().take(2) {
        forger.seal_octree_bytes(&octree, 1 << 20);
        hostile(&format!("an octree with a bomb at {at}"), &forger);
    }
    said(&format!("{count} runs in control groups of exactly their limit, none killed"));
}
