//! The command's contract that needs no mesh: help, versions, usage errors, streams.

use crate::command::{Ran, TREX, folder, run_in};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};

const VERBS: [&str; 8] = ["demo", "gen", "build", "info", "verify", "export", "render", "view"];

#[track_caller]
fn trex(line: &str, code: i32) -> Ran {
    let ran = run_in(Path::new("."), line);
    ran.expect(code);
    ran
}

#[track_caller]
fn stdout(line: &str) -> String {
    trex(line, 0).stdout
}

#[test]
fn help_lists_the_verbs_and_the_exit_statuses() {
    let help = stdout("--help");
    for word in VERBS.into_iter().chain(["bench", "image", "Examples:", "Exit status:", "130"]) {
        assert!(help.contains(word), "{word} is missing in:\n{help}");
    }
}

#[test]
fn every_verb_explains_its_flags_units_and_defaults() {
    for verb in VERBS.into_iter().chain(["bench rays", "bench io", "image diff", "image merge"]) {
        let help = stdout(&format!("{verb} --help"));
        for word in
            ["Example", "--memory-limit", "512MiB", "auto = 50%", "--threads", "--json", "[default: auto]"]
        {
            assert!(help.contains(word), "trex {verb} --help lacks {word}:\n{help}");
        }
    }
    let writes = |verb: &&str| ["demo", "gen", "build", "export", "render"].contains(verb);
    for verb in VERBS.iter().filter(|verb| writes(verb)).chain(&["image diff", "image merge"]) {
        assert!(stdout(&format!("{verb} --help")).contains("--overwrite"), "{verb}");
    }
}

/// Paragraphs below the flags are broken at the width of the help alone; other breaks left single words on lines.
#[test]
fn paragraphs_of_the_help_fill_their_lines() {
    let others = [
        "",
        "stress",
        "scan",
        "merge",
        "bench rays",
        "bench io",
        "bench tradeoff",
        "bench scale",
        "image diff",
        "image merge",
    ];
    for verb in VERBS.into_iter().chain(others) {
        let help = stdout(&format!("{verb} --help"));
        let lines: Vec<&str> = help.lines().collect();
        let is_prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
        for pair in lines.windows(2).filter(|pair| is_prose(pair[0]) && is_prose(pair[1])) {
            let next = pair[1].split(' ').next().unwrap();
            let is_full = pair[0].len() + 1 + next.len() > 100;
            assert!(is_full || pair[0].ends_with('.'), "trex {verb} --help: {:?}", pair);
        }
    }
}

/// What only a comparison of methods turns once stood between the size of a picture and its samples.
#[test]
fn what_only_research_turns_is_explained_last() {
    for verb in ["render", "view", "stress"] {
        let help = stdout(&format!("{verb} --help"));
        let headings: Vec<&str> =
            help.lines().filter(|line| line.ends_with(':') && !line.starts_with([' ', 'E'])).collect();
        assert_eq!(headings.last(), Some(&"Research options:"), "{verb}: {headings:?}");
        let research = help.find("Research options:").unwrap();
        for flag in ["--k-nearest", "--bake", "--occluders", "--fetch-block", "--tile-order", "--saliency"] {
            let at = help.find(&format!("\n      {flag}")).unwrap_or_else(|| panic!("{verb} lacks {flag}"));
            assert!(at > research, "{verb}: {flag} stands before its heading");
        }
    }
}

/// `-v` once printed values of Rust: `Percent(50) on HostMemory { physical_bytes: Some(..) }`. `demo` ends with what to
/// do next.
#[test]
fn people_read_sentences() {
    let inside = folder();
    let ran = run_in(inside.path(), "demo --triangles 10k --resolution 8x8 --spp 1 -o small.png -v");
    ran.expect(0);
    assert!(ran.stdout.trim_end().ends_with("live in a browser: trex view small.trex"), "{}", ran.stdout);
    for words in ["memory limit 256 MiB, a fixed amount; ", "pages are read by ", "memory: reserve "] {
        assert!(ran.stderr.contains(words), "no {words:?} in {}", ran.stderr);
    }
    let is_debug =
        |line: &str| line.contains(['{', '}']) || line.contains("Some(") || line.contains("Percent(");
    let debug: Vec<&str> = ran.stderr.lines().filter(|line| is_debug(line)).collect();
    assert!(debug.is_empty(), "{debug:#?}");
}

/// Millions of triangles were built before it was said that their picture cannot be written.
#[test]
fn the_demo_looks_at_its_picture_before_it_builds() {
    let inside = folder();
    std::fs::write(inside.path().join("mine.png"), "mine").unwrap();
    let before = crate::command::listing(inside.path());
    for picture in ["demo.jpg", "mine.png"] {
        let ran = run_in(inside.path(), &format!("demo --triangles 10k -o {picture} --json -q"));
        ran.expect_error(2, "usage");
        assert_eq!(crate::command::listing(inside.path()), before, "{picture}");
    }
}

#[test]
fn the_version_is_the_packages() {
    assert_eq!(stdout("--version"), format!("trex {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn usage_errors_exit_2_name_the_value_and_leave_stdout_empty() {
    for (line, named) in [
        ("", "Usage"),
        ("fly", "fly"),
        ("build", "INPUT"),
        ("build a.ply", "--output"),
        ("build a.ply -o b.trex --voxels 9", "--voxels"),
        ("build a.ply -o b.trex --grid-bits 99", "99"),
        ("build a.ply -o b.trex --error 1 --grid-bits 20", "--grid-bits"),
        // These were once ignored without a word.
        ("render a.trex -o b.png --tile-order row", "--tile-order"),
        ("render a.trex -o b.png --saliency itti", "--saliency"),
        ("render a.trex -o b.png --fetch-block 64", "--fetch-block"),
        ("info a.ply --memory-limit 512M", "512MiB"),
        ("info a.ply --memory-limit 0%", "1% to 100%"),
        ("info a.ply --threads 0", "--threads"),
        ("info a.ply -q -v", "--quiet"),
        ("gen cube --triangles 5 -o a.ply", "isosurface"),
        ("gen soup --triangles 0 -o a.ply", "--triangles"),
        ("render a.trex -o a.png --resolution 0x5", "WIDTHxHEIGHT"),
        ("render a.trex -o a.png --camera-position 1,2", "x,y,z"),
        ("render a.trex -o a.png --integrator phonon", "photon"),
        ("render a.trex -o a.png --fov-x 40 --fov-y 40", "--fov-y"),
        ("image", "Usage"),
        ("image diff a.png", "<B>"),
        ("image diff a.png b.png --metric psnr", "--threshold"),
        ("image diff a.png b.png --threshold 1 --metric ssim", "relmse"),
        ("image diff a.png b.png --threshold nan", "finite"),
        ("image diff a.png b.png --scale-max 1", "--output"),
        ("image diff a.png b.png --epsilon 0", "above zero"),
    ] {
        let ran = trex(line, 2);
        assert!(ran.stderr.contains(named), "trex {line}: {named} is missing in:\n{}", ran.stderr);
        assert!(ran.stdout.is_empty(), "trex {line}");
    }
}

#[test]
fn a_usage_error_is_a_document_when_documents_are_asked_for() {
    let document: Value = trex("info a.ply --json --memory-limit lots", 2).document();
    assert_eq!(document["schema"], "trex.error/1");
    assert_eq!(document["code"], "usage");
    assert_eq!(document["exit"], 2);
    assert!(document["what"].as_str().unwrap().contains("lots"), "{document}");
}

/// It once came without numbers.
#[test]
fn a_flag_of_deadlines_without_one_is_an_error_in_four_parts() {
    for flag in ["--tile-order row", "--saliency itti", "--fetch-block 64"] {
        let ran = trex(&format!("render a.trex -o b.png {flag} --json"), 2);
        let document = ran.expect_error(2, "usage");
        assert!(
            document["where"].as_str().is_some_and(|place| !place.is_empty() && flag.starts_with(place)),
            "{document}"
        );
        let numbers = document["numbers"].as_str().unwrap();
        assert!(numbers.contains("0.1 ms") && ran.stderr.contains(numbers), "{document}");
    }
}

#[test]
fn a_reader_that_hangs_up_is_no_error() {
    let mut child = Command::new(TREX)
        .args(["render", "--help"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}
