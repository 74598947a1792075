//! The promise of `--memory-limit`, by the kernel's count: build and render inside a control group of exactly the
//! limit. Nothing is killed, VmHWM stays at or below the limit, and the result is that of plenty of memory.

use crate::cgroup::Cgroup;
use crate::command::{cannot_run, document_in, folder, hash_of};
use serde_json::Value;
use std::path::Path;

const MIB: u64 = 1 << 20;

/// Runs `trex LINE` inside a group of `limit_bytes`; gives the document, or `None` where there are no groups.
#[track_caller]
fn confined(inside: &Path, name: &str, limit_bytes: u64, line: &str) -> Option<Value> {
    let group = Cgroup::new(name, limit_bytes)?;
    let ran = group.run_in(inside, &format!("{line} --memory-limit {limit_bytes}B --json -q"));
    assert_eq!(group.oom_kill_count(), 0, "{}: killed at {limit_bytes} bytes\n{}", ran.line, ran.stderr);
    ran.expect(0);
    let document = ran.document();
    let memory = &document["memory"];
    assert_eq!(memory["limit_bytes"], limit_bytes, "{line}");
    let peak = memory["peak_rss_bytes"].as_u64().unwrap();
    assert!(peak <= limit_bytes, "{line}: VmHWM {peak} is above the limit {limit_bytes}: {memory}");
    let kernel = group.peak_bytes().unwrap_or(0);
    assert!(kernel <= limit_bytes, "{line}: the group held {kernel} of {limit_bytes}");
    Some(document)
}

/// The smallest limit that `trex LINE` names when it gets far too little.
#[track_caller]
fn smallest(inside: &Path, line: &str) -> u64 {
    let refused = crate::command::run_in(inside, &format!("{line} --memory-limit 25MiB --json -q"));
    refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap()
}

#[test]
fn builds_stay_within_a_group_of_their_limit() {
    let inside = folder();
    document_in(inside.path(), "gen scan --triangles 140k -o scan.ply");
    document_in(inside.path(), "gen pipes --triangles 140k -o pipes.obj");
    // More triangles than the smallest buffers of cells hold (16 MiB at 80 bytes); two readers; more records of voxels
    // than buffers of them hold.
    for (name, input) in [
        ("iso", "gen:isosurface:300k:3 --voxels 64"),
        ("ply", "scan.ply --voxels 64"),
        ("obj", "pipes.obj --voxels 64"),
        ("soup", "gen:soup:10k"),
    ] {
        let line = format!("build {input} -o {name}.trex --threads 2");
        let least = smallest(inside.path(), &line);
        let roomy =
            document_in(inside.path(), &format!("build {input} -o {name}-roomy.trex --memory-limit 1GiB"));
        let roomy_hash = hash_of(&inside.path().join(format!("{name}-roomy.trex")));
        for limit in [least, 96 * MIB] {
            let Some(tight) = confined(inside.path(), "build", limit, &format!("{line} --overwrite")) else {
                return;
            };
            assert_eq!(tight["result_hash"], roomy["result_hash"], "{input}");
            assert_eq!(
                hash_of(&inside.path().join(format!("{name}.trex"))),
                roomy_hash,
                "{input} at {limit}"
            );
        }
    }
}

#[test]
fn generating_stays_within_a_group_of_its_limit() {
    let inside = folder();
    for ending in ["ply", "obj", "stl"] {
        let line = format!("gen isosurface --triangles 300k --seed 3 --threads 2 -o iso.{ending}");
        let least = smallest(inside.path(), &line);
        if confined(inside.path(), "gen", least, &line).is_none() {
            return;
        }
    }
}

/// Every photon by itself, its tree, and those under way: all of it is foreseen.
#[test]
fn photons_in_a_tree_stay_within_a_group_of_their_limit() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:300k:3 -o iso.trex");
    let line = "render iso.trex -o p.png --integrator full-gi --photons 500k --resolution 64x64 --spp 1 --overwrite \
                --threads 2";
    let least = smallest(inside.path(), line);
    let Some(tight) = confined(inside.path(), "photons", least, line) else { return };
    let roomy = document_in(inside.path(), &format!("{line} --memory-limit 1GiB"));
    assert!(tight["photons"]["deposits"].as_u64().unwrap() > 200_000, "{}", tight["photons"]);
    assert_eq!(tight["photons"]["lost"], 0);
    assert_eq!(tight["image"]["mean"], roomy["image"]["mean"]);
}

#[test]
fn a_picture_under_the_smallest_limit_has_the_same_bytes() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:1M -o iso.trex --voxels 64");
    let line = |output: &str, flags: &str| {
        format!(
            "render iso.trex -o {output} --integrator direct --resolution 512x512 --spp 1 --overwrite {flags}"
        )
    };
    let roomy = document_in(inside.path(), &line("roomy.png", "--memory-limit 1GiB --threads 2"));
    assert_eq!(roomy["pool"]["evictions"], 0, "{}", roomy["pool"]);
    let expected = hash_of(&inside.path().join("roomy.png"));
    let mut evicting = 0;
    for flags in [
        "--threads 2",
        "--threads 1",
        "--threads 2 --io pread",
        "--threads 2 --io mmap",
        "--threads 1 --io uring",
        "--threads 2 --direct off",
    ] {
        let line = line("tight.png", flags);
        let least = smallest(inside.path(), &line);
        if flags.contains("uring") && !has_uring(inside.path()) {
            cannot_run("io_uring is not allowed here");
            continue;
        }
        let Some(tight) = confined(inside.path(), "render", least, &line) else { return };
        evicting += u64::from(tight["pool"]["evictions"].as_u64().unwrap() > 0);
        assert_eq!(tight["image"]["mean"], roomy["image"]["mean"], "{flags}");
        assert_eq!(hash_of(&inside.path().join("tight.png")), expected, "{flags}: other pixels");
        assert_eq!(tight["exact"], true, "{flags}");
    }
    assert!(evicting > 0, "no run had to evict: the limit was not tight");
}

fn has_uring(inside: &Path) -> bool {
    let line =
        "render iso.trex -o probe.png --integrator direct --resolution 8x8 --spp 1 --overwrite --io uring -q";
    crate::command::run_in(inside, line).code == Some(0)
}
