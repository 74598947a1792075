//! Builds in shards, as many machines make them: merged they are the bytes of one build, whatever was killed, moved or
//! made twice on the way.

use crate::command::{cannot_run_without, document_in, folder, hash_of, listing, run_in, trex_in};
use crate::{colours, normals};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Builds INPUTS in so many shards, and merges them in an order that is none; `flags` are those of all builds. Gives
/// the document of the merge.
fn merge_shards(inside: &Path, inputs: &str, count: u32, flags: &str) -> serde_json::Value {
    let mut names = vec![];
    for number in 1..=count {
        let name = format!("{number}of{count}.trexfrag");
        let line = format!("build {inputs} --plan plan --shard {number}/{count} -o {name} {flags}");
        let built = document_in(inside, &line);
        assert_eq!((&built["shard"], &built["was_there"]), (&number.into(), &false.into()), "{built:#}");
        names.push(name);
    }
    names.reverse();
    document_in(inside, &format!("merge {} -o merged.trex --overwrite", names.join(" ")))
}

/// Each model by one build and in 1, 3 and 8 shards: the hash of the whole file is the oracle.
#[track_caller]
fn check(inside: &Path, inputs: &str, flags: &str) {
    let whole = document_in(inside, &format!("build {inputs} -o whole.trex --overwrite {flags}"));
    let scanned = document_in(inside, &format!("scan {inputs} -o plan --overwrite {flags}"));
    assert_eq!(scanned["triangle_count"], whole["triangle_count"], "{scanned:#}");
    let dropped = ["--colors drop", "--normals drop"].into_iter().find(|flag| flags.contains(flag));
    for count in [1, 3, 8] {
        let merged = merge_shards(inside, inputs, count, dropped.unwrap_or_default());
        let hashes = ["whole.trex", "merged.trex"].map(|name| hash_of(&inside.join(name)));
        assert_eq!(hashes[0], hashes[1], "{inputs} {flags} in {count} shards");
        for key in ["result_hash", "page_count", "rejected_collapsed", "keeping_error", "upper_leaf_count"] {
            assert_eq!(merged[key], whole[key], "{key}");
        }
        for number in 1..=count {
            std::fs::remove_file(inside.join(format!("{number}of{count}.trexfrag"))).unwrap();
        }
    }
    let kept = ["in.ply", "a.obj", "a.mtl", "b.obj", "b.mtl", "plan", "whole.trex", "merged.trex"];
    assert!(listing(inside).keys().all(|name| kept.contains(&name.as_str())), "{:?}", listing(inside));
}

#[test]
fn an_iso_surface_in_shards_is_the_bytes_of_one_build() {
    let inside = folder();
    check(inside.path(), "gen:isosurface:200k:5", "--voxels 64/256");
    check(inside.path(), "gen:isosurface:200k:5", "--no-asvo --grid-bits 14");
}

#[test]
fn a_mesh_with_colours_in_shards_is_the_bytes_of_one_build() {
    let inside = folder();
    let (vertices, triangles) = colours::sheet(330);
    let ply = colours::ply(&vertices, &triangles, "uchar", false);
    std::fs::write(inside.path().join("in.ply"), ply).unwrap();
    check(inside.path(), "in.ply", "");
    check(inside.path(), "in.ply", "--colors drop");
}

#[test]
fn a_mesh_with_normals_in_shards_is_the_bytes_of_one_build() {
    let inside = folder();
    std::fs::write(inside.path().join("in.ply"), normals::waves(330).0).unwrap();
    check(inside.path(), "in.ply", "");
    check(inside.path(), "in.ply", "--normals drop");
}

/// Two files, each with lamps among its materials, of triangles of all sizes.
#[test]
fn two_files_with_materials_in_shards_are_the_bytes_of_one_build() {
    let inside = folder();
    document_in(inside.path(), "gen pipes --triangles 150k --seed 3 -o a.obj");
    document_in(inside.path(), "gen soup --triangles 200k --seed 4 -o b.obj");
    check(inside.path(), "a.obj b.obj", "--render-limit 128MiB");
}

/// A plan that holds the triangles is enough for its shards; it is told by the same id as one without.
#[test]
fn shards_of_a_plan_with_triangles_need_no_inputs() {
    let inside = folder();
    let inside = inside.path();
    document_in(inside, "gen pipes --triangles 150k --seed 3 -o a.obj");
    document_in(inside, "gen soup --triangles 200k --seed 4 -o b.obj");
    document_in(inside, "build a.obj b.obj -o whole.trex --voxels 64/256");
    let ids = ["plan", "small-plan", "plain-plan"].map(|name| {
        let flags = match name {
            "plan" => "--keep-triangles",
            "small-plan" => "--keep-triangles --memory-limit 100MiB --threads 1",
            _ => "",
        };
        document_in(inside, &format!("scan a.obj b.obj -o {name} --voxels 64/256 {flags}"))["plan_id"].clone()
    });
    assert!(ids.iter().all(|id| *id == ids[0]), "{ids:?}");
    for name in ["a.obj", "a.mtl", "b.obj", "b.mtl"] {
        std::fs::rename(inside.join(name), inside.join(format!("elsewhere-{name}"))).unwrap();
    }
    let plan_before = hash_of(&inside.join("plan"));
    // Two side by side, and one of the plan of another scan.
    let line = |number: u32, plan: &str| {
        format!(
            "build --plan {plan} --shard {number}/3 -o {number}.trexfrag --threads 1 --journal-every 20ms"
        )
    };
    let beside = trex_in(inside, &format!("{} -q", line(1, "plan"))).stdout(Stdio::null()).spawn().unwrap();
    document_in(inside, &line(2, "plan"));
    assert!(beside.wait_with_output().unwrap().status.success());
    document_in(inside, &line(3, "small-plan"));
    document_in(inside, "merge 3.trexfrag 1.trexfrag 2.trexfrag -o merged.trex");
    let hashes = ["whole.trex", "merged.trex"].map(|name| hash_of(&inside.join(name)));
    assert_eq!(hashes[0], hashes[1]);
    assert_eq!(hash_of(&inside.join("plan")), plan_before, "a shard has changed its plan");
    // Inputs that are named are still held against the plan's.
    let other = "build elsewhere-b.obj --plan plan --shard 1/1 -o out";
    run_in(inside, &format!("{other} --json -q")).expect_error(3, "input-mismatch");
    let same = "build elsewhere-a.obj elsewhere-b.obj --plan plan --shard 1/1 -o out";
    document_in(inside, same);
    let dropped = "build --plan plan --shard 1/1 -o dropped --colors drop";
    run_in(inside, &format!("{dropped} --json -q")).expect_error(2, "usage");
    let none =
        run_in(inside, "build --plan plain-plan --shard 1/3 -o none --json -q").expect_error(2, "usage");
    assert!(none["next_step"].as_str().unwrap().contains("--keep-triangles"), "{none:#}");
}

/// A scan that is killed leaves nothing, and starts again; a shard of its plan takes no scratch for triangles.
#[test]
fn a_killed_scan_starts_again() {
    let inside = folder();
    let inside = inside.path();
    document_in(inside, "gen scan --triangles 400k -o in.ply");
    let before = listing(inside);
    let line = "scan in.ply -o plan --keep-triangles --no-asvo";
    for moment in [10, 30, 50] {
        assert!(kill_when(inside, line, |time| time >= Duration::from_millis(moment)), "it ended before");
        assert_eq!(listing(inside), before, "something is left behind");
    }
    document_in(inside, line);
    let built = document_in(inside, "build --plan plan --shard 1/2 -o 1.trexfrag");
    assert_eq!(built["scratch_peak_bytes"], 0, "{built:#}");
    assert!(listing(inside).keys().eq(["1.trexfrag", "in.ply", "plan"]), "{:?}", listing(inside));
}

/// The order of the stream counts, not the number of threads, the limit, or where inputs and folders are.
#[test]
fn shards_are_built_anywhere() {
    let (here, there) = (folder(), folder());
    document_in(here.path(), "gen scan --triangles 300k -o in.ply");
    document_in(here.path(), "build in.ply -o whole.trex --voxels 64");
    document_in(here.path(), "scan in.ply -o plan --voxels 64 --threads 1 --memory-limit 96MiB");
    std::fs::create_dir(there.path().join("elsewhere")).unwrap();
    std::fs::copy(here.path().join("in.ply"), there.path().join("elsewhere/of-another-name.ply")).unwrap();
    std::fs::copy(here.path().join("plan"), there.path().join("plan")).unwrap();
    let first = "build in.ply --plan plan --shard 1/2 -o 1.trexfrag --threads 3";
    document_in(here.path(), first);
    let second = "build elsewhere/of-another-name.ply --plan plan --shard 2/2 -o 2.trexfrag --threads 1 \
                  --memory-limit 112MiB --temp-dir elsewhere --no-resume";
    document_in(there.path(), second);
    let again = there.path().join("2.trexfrag");
    let line = format!("merge 1.trexfrag {} -o merged.trex --memory-limit 96MiB", again.display());
    let merged = document_in(here.path(), &line);
    assert!(merged["memory"]["peak_rss_bytes"].as_u64().unwrap() <= 96 << 20, "{merged:#}");
    let hashes = ["whole.trex", "merged.trex"].map(|name| hash_of(&here.path().join(name)));
    assert_eq!(hashes[0], hashes[1]);
    run_in(here.path(), "verify merged.trex --deep").expect(0);
}

/// A fragment that is there is left as it is: nothing is written, nothing is read but its head.
#[test]
fn a_shard_that_is_there_is_left_alone() {
    let inside = folder();
    document_in(inside.path(), "scan gen:soup:60k -o plan");
    let line = "build gen:soup:60k --plan plan --shard 1/1 -o 1.trexfrag";
    let built = document_in(inside.path(), line);
    let path = inside.path().join("1.trexfrag");
    let (hash, changed) = (hash_of(&path), path.metadata().unwrap().modified().unwrap());
    let again = document_in(inside.path(), line);
    assert_eq!((&again["was_there"], &again["chunk_count"]), (&true.into(), &built["chunk_count"]));
    assert_eq!((hash_of(&path), path.metadata().unwrap().modified().unwrap()), (hash, changed));
    // One of another share, or one that is damaged, is kept unless its replacement is allowed.
    let other = "build gen:soup:60k --plan plan --shard 1/2 -o 1.trexfrag";
    run_in(inside.path(), &format!("{other} --json -q")).expect_error(2, "usage");
    let replaced = document_in(inside.path(), &format!("{other} --overwrite"));
    assert_eq!(replaced["was_there"], false);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.pop();
    std::fs::write(&path, bytes).unwrap();
    run_in(inside.path(), &format!("{other} --json -q")).expect_error(2, "usage");
    assert_eq!(document_in(inside.path(), &format!("{other} --overwrite"))["was_there"], false);
}

/// Kills a command once `is_time`; false where it ended before.
fn kill_when(inside: &Path, line: &str, is_time: impl Fn(Duration) -> bool) -> bool {
    let mut child = trex_in(inside, line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begin = Instant::now();
    loop {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        if is_time(begin.elapsed()) {
            child.kill().unwrap();
            child.wait().unwrap();
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Killed at any moment, a shard and a merge are started again to the same bytes, with nothing left beside them.
#[test]
fn killed_shards_and_merges_go_on_to_the_same_bytes() {
    let inside = folder();
    let input = "gen:pipes:500k:2";
    document_in(inside.path(), &format!("build {input} -o whole.trex --voxels 64"));
    document_in(inside.path(), &format!("scan {input} -o plan --voxels 64"));
    let left = |ending: &str| listing(inside.path()).keys().any(|name| name.ends_with(ending));
    let line = |number: u32| {
        format!("build {input} --plan plan --shard {number}/2 -o {number}.trexfrag --journal-every 20ms")
    };
    let before = listing(inside.path());
    document_in(inside.path(), &line(1));
    document_in(inside.path(), &line(2));
    let fragments = [1, 2].map(|number| hash_of(&inside.path().join(format!("{number}.trexfrag"))));
    let (mut among_chunks, mut killed) = (0, 0);
    for number in [1, 2] {
        let path = inside.path().join(format!("{number}.trexfrag"));
        std::fs::remove_file(&path).unwrap();
        for moment in [20, 120, 250, 400] {
            killed += u32::from(kill_when(inside.path(), &line(number), |time| {
                time >= Duration::from_millis(moment)
            }));
            if path.exists() {
                break;
            }
            among_chunks += u32::from(left(".chunks"));
        }
        // One of them is met among its chunks for certain: its journal says so.
        if !path.exists() && kill_when(inside.path(), &line(number), |_| left(".chunks")) {
            among_chunks += 1;
            let resumed = document_in(inside.path(), &line(number));
            let sorted = resumed["resumed_sorted_count"].as_u64().unwrap();
            assert!(sorted > 0 && Some(sorted) == resumed["triangle_count"].as_u64(), "{resumed:#}");
        } else {
            document_in(inside.path(), &line(number));
        }
        assert_eq!(hash_of(&path), fragments[number as usize - 1], "shard {number}");
    }
    assert!(killed > 0 && among_chunks > 0, "{killed} killed, {among_chunks} among chunks");
    let merge = "merge 1.trexfrag 2.trexfrag -o merged.trex";
    for moment in [5, 30, 80] {
        kill_when(inside.path(), merge, |time| time >= Duration::from_millis(moment));
        if inside.path().join("merged.trex").exists() {
            std::fs::remove_file(inside.path().join("merged.trex")).unwrap();
        }
    }
    document_in(inside.path(), merge);
    let hashes = ["whole.trex", "merged.trex"].map(|name| hash_of(&inside.path().join(name)));
    assert_eq!(hashes[0], hashes[1]);
    for name in ["1.trexfrag", "2.trexfrag", "merged.trex"] {
        std::fs::remove_file(inside.path().join(name)).unwrap();
    }
    assert_eq!(listing(inside.path()), before, "something is left behind");
}

/// The lines of `docs/many-machines.md`, by GNU parallel on this machine.
#[test]
fn parallel_builds_the_shards() {
    if !Command::new("parallel").arg("--version").output().is_ok_and(|ran| ran.status.success()) {
        return cannot_run_without("parallel");
    }
    let inside = folder();
    document_in(inside.path(), "scan gen:pipes:60k -o plant.trexplan --keep-triangles");
    let trex = trex_in(inside.path(), "").get_program().to_owned();
    let line = "build --plan plant.trexplan --threads 1 -q";
    let made = Command::new("parallel")
        .args(["--will-cite", "--jobs", "2"])
        .arg(format!("{} {line} --shard {{}}/4 -o shard-{{}}.trexfrag", trex.to_string_lossy()))
        .args([":::", "1", "2", "3", "4"])
        .current_dir(inside.path())
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let names: Vec<String> = (1..=4).map(|number| format!("shard-{number}.trexfrag")).collect();
    document_in(inside.path(), &format!("merge {} -o merged.trex", names.join(" ")));
    document_in(inside.path(), "build gen:pipes:60k -o whole.trex");
    let [whole, merged] = ["whole.trex", "merged.trex"].map(|name| hash_of(&inside.path().join(name)));
    assert_eq!(whole, merged);
}
