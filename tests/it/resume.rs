//! Builds that are killed (SIGKILL) at random moments and started again: the bytes are those of a build that was let
//! alone, and nothing is left beside them. `TREX_KILLS` asks for more kills than a normal run makes.

use crate::command::{document_in, folder, hash_of, listing, run_in, said, trex_in};
use crate::random::Random;
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Kills of a normal run that meet a build at work.
const KILLS: u32 = 8;
/// Records so often that kills meet all kinds of moments.
const OFTEN: &str = "--journal-every 20ms";
/// Threads and limits that builds go on with, whatever they had before.
const THREADS: [u32; 3] = [1, 2, 3];
const LIMITS: [&str; 4] = ["112MiB", "128MiB", "256MiB", "1GiB"];

/// A build that ran until it ended or was killed.
struct BuildRun {
    has_ended: bool,
    /// Processor time that it took: what else the machine does changes it little.
    cpu_s: f64,
}

/// State of a process and its processor time so far, as the kernel counts them; also of one that nobody waited for yet.
fn process_state(id: u32) -> (char, f64) {
    /// Of `/proc/ID/stat`: a hundred a second, on every machine.
    const TICKS_PER_S: f64 = 100.0;
    let text = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
    // The name, in brackets, may hold anything.
    let fields: Vec<&str> = text.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let ticks = |at: usize| fields[at].parse::<f64>().unwrap();
    (fields[0].chars().next().unwrap(), (ticks(11) + ticks(12)) / TICKS_PER_S)
}

/// Runs a build until it has ended or `is_over`, which hears its processor time; then it is killed by SIGKILL.
fn run_until(inside: &Path, line: &str, mut is_over: impl FnMut(f64) -> bool) -> BuildRun {
    let mut child = trex_in(inside, line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    // Its processor time is told until it has been waited for.
    let cpu_s = loop {
        let (state, cpu_s) = process_state(child.id());
        if state == 'Z' {
            break cpu_s;
        }
        if is_over(cpu_s) {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let status = child.wait().unwrap();
    // It may have ended by itself a moment before it was killed.
    assert!(status.success() || status.signal() == Some(9), "{line}: {status}");
    BuildRun { has_ended: status.success(), cpu_s }
}

/// How kills went.
#[derive(Default)]
struct KillCounts {
    killed: u32,
    /// Of these, with cells to go on from, and with chunks.
    among_batches: u32,
    among_chunks: u32,
    /// Of each build that was killed, what it took in all over one that was let alone, by kill.
    lost_s: Vec<f64>,
}

impl KillCounts {
    /// Kills one build, again and again, until it has come to its end or `most` kills have met it at work; those after
    /// the first meet one that goes on, with other threads and another limit.
    fn kill_one(&mut self, inside: &Path, input: &str, alone_s: f64, most: u32, random: &mut Random) {
        let (mut cpu_s, mut met, mut has_ended) = (0.0, 0, false);
        while !has_ended {
            let threads = THREADS[random.below(THREADS.len() as i64) as usize];
            let limit = LIMITS[random.below(LIMITS.len() as i64) as usize];
            let line = format!(
                "build {input} -o out.trex {OFTEN} --threads {threads} --memory-limit {limit} --json -q"
            );
            let moment = if met == most { f64::INFINITY } else { 1.1 * random.unit() * alone_s };
            // The kernel counts in hundredths of a second.
            let begin = Instant::now();
            let pause = Duration::from_secs_f64(0.01 * random.unit());
            let ran = run_until(inside, &line, |cpu_s| cpu_s >= moment && begin.elapsed() > pause);
            cpu_s += ran.cpu_s;
            // The kill may come between the rename and the removal of what is left.
            has_ended = ran.has_ended || inside.join("out.trex").exists();
            if !ran.has_ended {
                let is_left = |ending: &str| listing_all(inside).iter().any(|name| name.ends_with(ending));
                met += 1;
                self.among_batches += u32::from(is_left(".sorted"));
                self.among_chunks += u32::from(is_left(".done"));
            }
        }
        self.killed += met;
        if met > 0 {
            self.lost_s.push((cpu_s - alone_s) / f64::from(met));
        }
    }
}

#[test]
fn killed_builds_go_on_to_the_same_bytes() {
    let kills: u32 = std::env::var("TREX_KILLS").map_or(KILLS, |count| count.parse().unwrap());
    let inside = folder();
    document_in(inside.path(), "gen scan --triangles 300k -o scan.ply");
    let (mut random, mut counts) = (Random::seeded(31), KillCounts::default());
    let inputs = ["gen:pipes:600k --voxels 64/256", "scan.ply gen:soup:300k --voxels 256"];
    for (index, input) in inputs.into_iter().enumerate() {
        let whole = format!("whole{index}.trex");
        let line = format!("build {input} -o {whole} --threads 2 --json -q");
        let alone = run_until(inside.path(), &line, |_| false);
        assert!(alone.has_ended, "{line}");
        let whole = hash_of(&inside.path().join(whole));
        let before = listing(inside.path());
        let share = (kills * (index as u32 + 1)).div_ceil(inputs.len() as u32);
        while counts.killed < share {
            let most = share - counts.killed;
            counts.kill_one(inside.path(), input, alone.cpu_s, most, &mut random);
            assert_eq!(hash_of(&inside.path().join("out.trex")), whole, "{input}: other bytes");
            std::fs::remove_file(inside.path().join("out.trex")).unwrap();
            // A kill after the rename leaves what the build was going to remove.
            run_in(inside.path(), "build --clean -o out.trex").expect(0);
            assert_eq!(listing(inside.path()), before, "{input}");
        }
    }
    let KillCounts { killed, among_batches, among_chunks, lost_s } = counts;
    said(&format!(
        "{killed} builds killed, {among_batches} of them with cells to go on from, {among_chunks} with chunks"
    ));
    let (mean, most) =
        (lost_s.iter().sum::<f64>() / lost_s.len() as f64, lost_s.iter().copied().fold(0.0, f64::max));
    said(&format!("a kill cost {mean:.2} s of a processor on average over builds, {most:.2} s at most"));
}

/// What a kill costs that comes at the end of each phase, when most of it has been done since the last record:
/// processor time over that of a build that is let alone, seconds.
#[test]
#[ignore = "an instrument: prints a table, checks nothing but bytes; TREX_KILL_TRIANGLES says how large"]
fn what_a_kill_costs_by_phase() {
    let triangles = std::env::var("TREX_KILL_TRIANGLES").unwrap_or_else(|_| "3M".into());
    let inside = folder();
    document_in(inside.path(), &format!("gen scan --triangles {triangles} -o scan.ply"));
    let line = |out: &str| format!("build scan.ply -o {out} --voxels 256 --threads 2 --progress json");
    let alone = run_until(inside.path(), &line("whole.trex"), |_| false);
    let whole = hash_of(&inside.path().join("whole.trex"));
    said(&format!("{triangles} triangles, let alone: {:.2} s of a processor", alone.cpu_s));
    let mut phases = phases_of(inside.path(), &line("out.trex"), None).0;
    std::fs::remove_file(inside.path().join("out.trex")).unwrap();
    phases.remove(0);
    for phase in &phases {
        let (_, killed_s) = phases_of(inside.path(), &line("out.trex"), Some(phase));
        let rest = run_until(inside.path(), &line("out.trex"), |_| false);
        let lost_s = killed_s + rest.cpu_s - alone.cpu_s;
        said(&format!(
            "killed at the beginning of {phase}, after {killed_s:.2} s: {lost_s:.2} s lost, {:.1} %",
            100.0 * lost_s / alone.cpu_s
        ));
        assert_eq!(hash_of(&inside.path().join("out.trex")), whole, "{phase}");
        std::fs::remove_file(inside.path().join("out.trex")).unwrap();
    }
}

/// Runs a build that reports as JSON until it reports `end`, where it is killed. The phases that it reported, in their
/// order, and its processor time.
fn phases_of(inside: &Path, line: &str, end: Option<&str>) -> (Vec<String>, f64) {
    let mut child = trex_in(inside, line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut phases: Vec<String> = Vec::new();
    for line in BufReader::new(child.stderr.take().unwrap()).lines() {
        let Ok(report) = serde_json::from_str::<serde_json::Value>(&line.unwrap()) else { continue };
        let Some(phase) = report["phase"].as_str() else { continue };
        if !phases.iter().any(|known| known == phase) {
            phases.push(phase.to_owned());
        }
        if end == Some(phase) {
            child.kill().unwrap();
            break;
        }
    }
    while process_state(child.id()).0 != 'Z' {
        std::thread::sleep(Duration::from_millis(1));
    }
    let (_, cpu_s) = process_state(child.id());
    child.wait().unwrap();
    (phases, cpu_s)
}

/// What a kill leaves is listed, told apart from other work, and removed.
#[test]
fn what_a_kill_leaves_is_listed_and_removed() {
    let inside = folder();
    std::fs::create_dir(inside.path().join("scratch")).unwrap();
    let line = format!("build gen:pipes:600k --voxels 64 -o out.trex {OFTEN} --threads 2 --temp-dir scratch");
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
    let line = format!("build gen:pipes:600k --voxels 64 -o out.trex {OFTEN} --threads 2");
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
