//! Builds that are killed (SIGKILL) at random moments and started again: the bytes are those of a build that was let
//! alone, and nothing is left beside them. `TREX_KILLS` asks for more kills than a normal run makes.

use crate::command::{document_in, folder, hash_of, listing, run_in, said, trex_in};
use crate::random::Random;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Kills of a normal run.
const KILLS: u32 = 12;
/// Records so often that kills meet all kinds of moments.
const OFTEN: &str = "--journal-every 20ms --threads 2";

/// Runs a build for so long, then kills it with SIGKILL. Whether it had ended before.
fn killed_after(inside: &Path, line: &str, time: Duration) -> bool {
    let mut child = trex_in(inside, line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begin = Instant::now();
    while begin.elapsed() < time {
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{line}: {status}");
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    // It may have ended by itself a moment ago.
    child.wait().unwrap().success()
}

#[test]
fn killed_builds_go_on_to_the_same_bytes() {
    let kills = std::env::var("TREX_KILLS").map_or(KILLS, |count| count.parse().unwrap());
    let inside = folder();
    document_in(inside.path(), "gen scan --triangles 300k -o scan.ply");
    let mut random = Random::seeded(31);
    let (mut killed, mut among_batches, mut among_chunks) = (0, 0, 0);
    // Of each build that was killed, what it took in all over one that was let alone, by kill.
    let mut lost_s = vec![];
    let inputs = ["gen:pipes:600k --voxels 64/256", "scan.ply gen:soup:300k --voxels 256"];
    for (index, input) in inputs.into_iter().enumerate() {
        let whole = format!("whole{index}.trex");
        let begin = Instant::now();
        document_in(inside.path(), &format!("build {input} -o {whole} --threads 2"));
        let time = begin.elapsed();
        let whole = hash_of(&inside.path().join(whole));
        let before = listing(inside.path());
        let share = kills.div_ceil(inputs.len() as u32);
        let mut left = share;
        while left > 0 {
            let line = format!("build {input} -o out.trex {OFTEN} --json -q");
            // Several kills of one build: those after the first meet one that goes on.
            let (started, killed_before) = (Instant::now(), killed);
            let mut has_ended = false;
            while left > 0 && !has_ended {
                let part = 1.1 * random.unit();
                let is_whole = killed_after(inside.path(), &line, time.mul_f64(part));
                killed += u32::from(!is_whole);
                let is_left =
                    |ending: &str| listing_all(inside.path()).iter().any(|name| name.ends_with(ending));
                among_batches += u32::from(!is_whole && is_left(".sorted"));
                among_chunks += u32::from(!is_whole && is_left(".done"));
                // The kill may come between the rename and the removal of what is left.
                has_ended = is_whole || inside.path().join("out.trex").exists();
                left -= 1;
            }
            if !has_ended {
                run_in(inside.path(), &line).expect(0);
            }
            if killed > killed_before {
                let kills = f64::from(killed - killed_before);
                lost_s.push((started.elapsed().as_secs_f64() - time.as_secs_f64()) / kills);
            }
            assert_eq!(hash_of(&inside.path().join("out.trex")), whole, "{input}: other bytes");
            std::fs::remove_file(inside.path().join("out.trex")).unwrap();
            // A kill after the rename leaves what the build was going to remove.
            run_in(inside.path(), "build --clean -o out.trex").expect(0);
            assert_eq!(listing(inside.path()), before, "{input}");
        }
    }
    said(&format!(
        "{killed} builds killed, {among_batches} of them with cells to go on from, {among_chunks} with chunks"
    ));
    let (mean, most) =
        (lost_s.iter().sum::<f64>() / lost_s.len() as f64, lost_s.iter().copied().fold(0.0, f64::max));
    said(&format!("a kill cost {mean:.2} s on average over builds, {most:.2} s at most"));
    assert!(killed > 0, "no kill met a build at work");
}

/// What a kill leaves is listed, told apart from other work, and removed.
#[test]
fn what_a_kill_leaves_is_listed_and_removed() {
    let inside = folder();
    std::fs::create_dir(inside.path().join("scratch")).unwrap();
    let line = format!("build gen:pipes:600k --voxels 64 -o out.trex {OFTEN} --temp-dir scratch");
    let has = |ending: &str| {
        let names = std::fs::read_dir(inside.path()).unwrap();
        names.into_iter().any(|name| name.unwrap().file_name().to_string_lossy().ends_with(ending))
    };
    let mut child = trex_in(inside.path(), &line).stderr(Stdio::null()).spawn().unwrap();
    let begin = Instant::now();
    while !has(".chunks") {
        assert!(begin.elapsed() < Duration::from_secs(120) && child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(1));
    }
    let busy = run_in(inside.path(), &format!("{line} --json -q"));
    assert!(busy.expect_error(2, "usage")["what"].as_str().unwrap().contains("at work"));
    child.kill().unwrap();
    child.wait().unwrap();

    let listed = run_in(inside.path(), "info .");
    listed.expect(0);
    assert!(
        listed.stdout.contains("unfinished: ./out.trex") && listed.stdout.contains("--clean"),
        "{}",
        listed.stdout
    );
    let document = document_in(inside.path(), "info out.trex");
    let unfinished = &document["unfinished"][0];
    assert_eq!(unfinished["is_running"], false, "{document:#}");
    assert!(unfinished["bytes"].as_u64().unwrap() > 0 && unfinished["file_count"].as_u64().unwrap() >= 3);

    let other = line.replace("--voxels 64", "--voxels 256").replace("pipes", "soup");
    let refused = run_in(inside.path(), &format!("{other} --json -q")).expect_error(2, "usage");
    let told = refused["numbers"].as_str().unwrap();
    for words in ["gen:pipes:600k then, gen:soup:600k now", "upper: 64", "upper: 256"] {
        assert!(told.contains(words), "{words} is missing in {told}");
    }
    // Beside a file that is whole, too.
    document_in(inside.path(), "build gen:soup:10k --no-asvo -o other.trex");
    std::fs::rename(inside.path().join("other.trex"), inside.path().join("out.trex")).unwrap();
    assert!(run_in(inside.path(), "info out.trex").stderr.contains("trex build --clean"));
    std::fs::remove_file(inside.path().join("out.trex")).unwrap();
    run_in(inside.path(), "build --clean -o .").expect(0);
    assert_eq!(listing_all(inside.path()), ["scratch"]);
    assert!(listing_all(&inside.path().join("scratch")).is_empty());
    assert!(run_in(inside.path(), "build --clean -o .").stdout.contains("no unfinished builds"));
    run_in(inside.path(), "info out.trex").expect(3);
}

/// Ctrl-C keeps what was done, says so, and the same command goes on; with `--no-resume` nothing stays.
#[test]
fn an_interrupt_keeps_what_was_done_and_says_so() {
    let inside = folder();
    let line = format!("build gen:pipes:600k --voxels 64 -o out.trex {OFTEN}");
    let interrupted = |line: &str, ending: &str| {
        let mut command = trex_in(inside.path(), &format!("{line} --json -q"));
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let begin = Instant::now();
        while !listing_all(inside.path()).iter().any(|name| name.ends_with(ending)) {
            assert!(begin.elapsed() < Duration::from_secs(120), "{line}");
            std::thread::sleep(Duration::from_millis(1));
        }
        let signal = format!("kill -TERM {}", child.id());
        assert!(std::process::Command::new("sh").args(["-c", &signal]).status().unwrap().success());
        let ran = crate::command::ran(line, child.wait_with_output().unwrap());
        ran.expect(130);
        ran.document()
    };
    let error = interrupted(&format!("{line} --no-resume"), ".part");
    assert!(error["next_step"].as_str().unwrap().contains("nothing was published"), "{error:#}");
    assert!(listing_all(inside.path()).is_empty());
    let error = interrupted(&line, ".chunks");
    let next = error["next_step"].as_str().unwrap();
    assert!(next.contains("same command again") && next.contains("--clean"), "{error:#}");
    assert!(error["numbers"].as_str().unwrap().contains("kept"), "{error:#}");
    let resumed = document_in(inside.path(), &line);
    document_in(inside.path(), &line.replace("out.trex", "whole.trex"));
    assert_eq!(hash_of(&inside.path().join("out.trex")), hash_of(&inside.path().join("whole.trex")));
    assert!(resumed["phase_ms"]["partition"] == 0, "the input was read again: {resumed:#}");
    assert_eq!(listing_all(inside.path()), ["out.trex", "whole.trex"]);
    // An input that is wrong leaves nothing.
    std::fs::write(inside.path().join("bad.ply"), "ply\nformat ascii 1.0\nelement vertex 9\n").unwrap();
    run_in(inside.path(), "build gen:soup:10k bad.ply -o bad.trex").expect(3);
    assert_eq!(listing_all(inside.path()), ["bad.ply", "out.trex", "whole.trex"]);
}

/// All names in a folder, hidden ones too.
fn listing_all(inside: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(inside).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
