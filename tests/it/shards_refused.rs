//! What builds in shards refuse: fragments and plans that do not belong together, are damaged, or are of other inputs;
//! each with its place, its numbers and the next step, and with nothing written.

use crate::command::{document_in, folder, listing, run_in};
use crate::random::Random;
use std::path::Path;

/// A small model in two shards, and its plan.
fn shards_in(inside: &Path, input: &str, plan: &str, names: [&str; 2]) {
    document_in(inside, &format!("scan {input} -o {plan} --voxels 64"));
    for (number, name) in (1..).zip(names) {
        document_in(inside, &format!("build {input} --plan {plan} --shard {number}/2 -o {name}"));
    }
}

/// Runs a line that must be refused; gives the error, all of its words together.
#[track_caller]
fn refusal(inside: &Path, line: &str, exit: i32, code: &str) -> String {
    let before = listing(inside);
    let error = run_in(inside, &format!("{line} --json -q")).expect_error(exit, code);
    assert_eq!(listing(inside), before, "{line} has written something");
    error.to_string()
}

#[test]
fn fragments_that_do_not_belong_together_are_refused_by_name() {
    let inside = folder();
    let inside = inside.path();
    shards_in(inside, "gen:pipes:60k:1", "plan", ["a", "b"]);
    shards_in(inside, "gen:pipes:60k:2", "other-plan", ["other-a", "other-b"]);
    document_in(inside, "build gen:pipes:60k:1 --plan plan --shard 1/3 -o third");
    for (fragments, words) in [
        ("a other-b", "of different plans"),
        ("third b", "of different numbers of shards"),
        ("a", "of 2 shards there are not: 2"),
        ("b", "of 2 shards there are not: 1"),
        ("third", "of 3 shards there are not: 2, 3"),
        ("a b a", "there twice"),
    ] {
        let told = refusal(inside, &format!("merge {fragments} -o out.trex"), 3, "input-mismatch");
        assert!(told.contains(words), "{fragments}: {told}");
    }
    document_in(inside, "merge b a -o whole.trex");
    for other in ["plan", "whole.trex", "/dev/null"] {
        let code = if other == "/dev/null" { "input-unreadable" } else { "input-format" };
        refusal(inside, &format!("merge a {other} -o out.trex"), 3, code);
    }
    refusal(inside, "merge a none -o out.trex", 3, "input-unreadable");
    refusal(inside, "merge a b -o whole.trex", 2, "usage");
    refusal(inside, "merge a b -o a --overwrite", 2, "usage");
    refusal(inside, "merge a b -o none/out.trex", 2, "usage");
    // The head of a fragment of another version.
    let mut bytes = std::fs::read(inside.join("b")).unwrap();
    bytes[8] += 1;
    std::fs::write(inside.join("b"), bytes).unwrap();
    let told = refusal(inside, "merge a b -o out.trex", 3, "version");
    assert!(told.contains("trex build --plan"), "{told}");
}

#[test]
fn shards_of_other_inputs_or_plans_are_refused() {
    let inside = folder();
    let inside = inside.path();
    document_in(inside, "gen scan --triangles 60k -o in.ply");
    document_in(inside, "scan in.ply -o plan");
    let shard =
        |inputs: &str, flags: &str| format!("build {inputs} --plan plan --shard 1/2 -o out.trexfrag {flags}");
    for inputs in ["gen:scan:60k", "in.ply in.ply"] {
        let told = refusal(inside, &shard(inputs, ""), 3, "input-mismatch");
        assert!(told.contains("in the plan"), "{told}");
    }
    let told = refusal(inside, &shard("in.ply", "--colors drop"), 3, "input-mismatch");
    assert!(told.contains("colours: none in the plan, dropped now"), "{told}");
    for flags in ["--no-asvo", "--grid-bits 20", "--error 0.1", "--voxels 64", "--upper-budget 9MiB"] {
        run_in(inside, &format!("{} --json -q", shard("in.ply", flags))).expect(2);
    }
    refusal(inside, "build in.ply --plan in.ply --shard 1/2 -o out.trexfrag", 3, "input-format");
    refusal(inside, "build in.ply --plan none --shard 1/2 -o out.trexfrag", 3, "input-unreadable");
    refusal(inside, "build in.ply --plan plan --shard 1/2 -o plan --overwrite", 2, "usage");
    refusal(inside, "build in.ply --plan plan --shard 1/2 -o in.ply --overwrite", 2, "usage");
    refusal(inside, "scan in.ply -o plan", 2, "usage");
    refusal(inside, "scan in.ply -o in.ply --overwrite", 2, "usage");
    // Bytes that the stamp does not see: a vertex between two of its parts.
    document_in(inside, "gen scan --triangles 400k -o in.ply --overwrite");
    document_in(inside, "scan in.ply -o plan --overwrite");
    let mut bytes = std::fs::read(inside.join("in.ply")).unwrap();
    let step = (bytes.len() - 4096) / 64;
    assert!(step > 8192, "the parts of a stamp lie side by side");
    bytes[10 * step + 4096 + 2048] ^= 1;
    std::fs::write(inside.join("in.ply"), bytes).unwrap();
    let refused = run_in(inside, &format!("{} --json -q", shard("in.ply", "")));
    let told = refused.document().to_string();
    assert!([2, 3].contains(&refused.code.unwrap()), "{told}");
    assert!(!inside.join("out.trexfrag").exists());
}

/// Any byte of a plan or a fragment that has changed, and any length.
#[test]
fn damaged_plans_and_fragments_are_refused() {
    let inside = folder();
    let inside = inside.path();
    shards_in(inside, "gen:pipes:30k:1", "plan", ["a", "b"]);
    document_in(inside, "scan gen:pipes:30k:1 -o full-plan --voxels 64 --keep-triangles");
    let mut random = Random::seeded(5);
    for (name, line) in [
        ("full-plan", "build --plan full-plan --shard 1/1 -o out"),
        ("plan", "build gen:pipes:30k:1 --plan plan --shard 1/2 -o out"),
        ("b", "merge a b -o out"),
        ("a", "merge a b -o out"),
    ] {
        let bytes = std::fs::read(inside.join(name)).unwrap();
        let length = bytes.len();
        let places = [0, 9, 13, 20, length - 1, length - 9, length - 30].into_iter();
        let some: Vec<usize> = (0..25).map(|_| random.below(length as i64) as usize).collect();
        for at in places.chain(some) {
            let mut changed = bytes.clone();
            changed[at] ^= 1 << random.below(8);
            std::fs::write(inside.join(name), &changed).unwrap();
            let refused = run_in(inside, &format!("{line} --json -q"));
            let code = refused.document()["code"].as_str().unwrap().to_owned();
            assert!(["damaged", "input-format", "version"].contains(&code.as_str()), "byte {at}: {code}");
            refused.expect_error(3, &code);
            assert!(!inside.join("out").exists(), "byte {at} of {name}");
        }
        for kept in [0, 7, 16, length / 2, length - 1] {
            std::fs::write(inside.join(name), &bytes[..kept]).unwrap();
            let refused = run_in(inside, &format!("{line} --json -q"));
            let code = refused.document()["code"].as_str().unwrap().to_owned();
            refused.expect_error(3, &code);
        }
        std::fs::write(inside.join(name), &bytes).unwrap();
    }
    document_in(inside, "merge a b -o out");
}

/// A limit holds for all three; one that is too small is refused, with one that is not.
#[test]
fn limits_hold_for_shards_and_merges() {
    let inside = folder();
    let inside = inside.path();
    document_in(inside, "gen scan --triangles 400k -o in.ply");
    let limit = 100 << 20;
    let lines = [
        "scan in.ply -o plan --voxels 256",
        "build in.ply --plan plan --shard 1/2 -o a",
        "build in.ply --plan plan --shard 2/2 -o b",
        "scan in.ply -o full-plan --voxels 256 --keep-triangles",
        "build --plan full-plan --shard 1/1 -o all",
        "merge a b -o out.trex",
    ];
    for line in lines {
        let refused = run_in(inside, &format!("{line} --memory-limit 25MiB --json -q"));
        let smallest = refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
        assert!(smallest > 25 << 20, "{line}: {smallest}");
        document_in(inside, &format!("{line} --memory-limit {smallest}B"));
        let output = inside.join(line.split_whitespace().skip_while(|word| *word != "-o").nth(1).unwrap());
        std::fs::remove_file(output).unwrap();
        let ran = document_in(inside, &format!("{line} --memory-limit {limit}B"));
        let memory = &ran["memory"];
        for key in ["ledger_peak_bytes", "peak_rss_bytes"] {
            assert!(memory[key].as_u64().unwrap() <= limit, "{line}: {memory:#}");
        }
    }
}
