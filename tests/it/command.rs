//! The command as tests run it: arguments in, exit status, streams and documents out; folders before and after.
// Tests say on stderr what they measured.
#![allow(clippy::print_stderr)]

use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use xxhash_rust::xxh3::xxh3_64;

/// The binary under test.
pub(crate) const TREX: &str = env!("CARGO_BIN_EXE_trex");

/// What a run of the command left.
pub(crate) struct Ran {
    /// What was run, for messages.
    pub(crate) line: String,
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Set to 1 where every test has to run: what cannot run there fails.
const REQUIRE_ALL: &str = "TREX_REQUIRE_ALL";
/// Programs, by name and with blanks between, that are there: a test that needs one of them and cannot run fails.
const REQUIRED: &str = "TREX_REQUIRE";

/// Says aloud that a test, or a part of one, does not run here, and why; a failure where all have to run.
#[track_caller]
pub(crate) fn cannot_run(why: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    let is_required = std::env::var_os(REQUIRE_ALL).is_some_and(|value| value == "1");
    assert!(!is_required, "{test} cannot run here, and {REQUIRE_ALL} is set: {why}");
    // Not `eprintln!`, which the runner captures and shows with failures alone. A closed stderr is no failure.
    let _ = writeln!(std::io::stderr().lock(), "\nNOT RUN: {test}: {why}");
}

/// As [`cannot_run`], for want of a program; a failure where that one is required.
#[track_caller]
pub(crate) fn cannot_run_without(program: &str) {
    let required = std::env::var(REQUIRED).unwrap_or_default();
    let is_required = required.split_whitespace().any(|name| name == program);
    assert!(!is_required, "{program} is missing, or may not run, and {REQUIRED} names it");
    cannot_run(&format!("{program} is not installed, or may not run"));
}

/// Says what a test saw, for those who run it with `--nocapture`.
pub(crate) fn said(what: &str) {
    eprintln!("{what}");
}

/// A fresh folder on a disk. The system's temporary folder may lie in memory, which a control group would count.
pub(crate) fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

/// `trex` with the words of `line`, run in `folder`, whose relative paths the line may use.
pub(crate) fn trex_in(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(TREX);
    command.args(line.split_whitespace()).current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs `trex LINE` in `folder`.
pub(crate) fn run_in(folder: &Path, line: &str) -> Ran {
    ran(line, trex_in(folder, line).output().unwrap())
}

/// Runs `trex LINE --json -q` in `folder`, expects success, gives the document.
#[track_caller]
pub(crate) fn document_in(folder: &Path, line: &str) -> Value {
    let ran = run_in(folder, &format!("{line} --json -q"));
    ran.expect(0);
    ran.document()
}

/// The parts of an output that tests look at.
pub(crate) fn ran(line: &str, output: Output) -> Ran {
    Ran {
        line: format!("trex {line}"),
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

impl Ran {
    /// Fails unless the exit status is `code`.
    #[track_caller]
    pub(crate) fn expect(&self, code: i32) {
        assert_eq!(self.code, Some(code), "{}\n{}{}", self.line, self.stdout, self.stderr);
    }

    /// The one document on stdout.
    #[track_caller]
    pub(crate) fn document(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{}: {error} in:\n{}", self.line, self.stdout))
    }

    /// Fails unless the run ended in `exit` and told an error of `code` in four parts, on stderr and as a document.
    /// Gives the document. The run must have had `--json`.
    #[track_caller]
    pub(crate) fn expect_error(&self, exit: i32, code: &str) -> Value {
        self.expect(exit);
        let document = self.document();
        let context = format!("{}: {document:#}\n{}", self.line, self.stderr);
        assert_eq!(document["schema"], "trex.error/1", "{context}");
        assert_eq!(document["code"], code, "{context}");
        assert_eq!(document["exit"], exit, "{context}");
        // What is said of the command line, or of a file that was not opened, may have no numbers.
        let parts: &[&str] = match code {
            "usage" => &["what", "next_step"],
            "input-unreadable" => &["what", "where", "next_step"],
            _ => &["what", "where", "numbers", "next_step"],
        };
        for part in parts {
            let text = document[part].as_str().unwrap_or_default();
            assert!(!text.is_empty(), "no {part} in {context}");
            assert!(self.stderr.contains(text), "stderr lacks the {part} of {context}");
        }
        assert!(!self.stderr.contains("panicked"), "{context}");
        document
    }
}

/// Files below a folder by relative name: length and hash. Folders end in `/`.
pub(crate) fn listing(folder: &Path) -> BTreeMap<String, (u64, u64)> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(inside) = folders.pop() {
        for entry in std::fs::read_dir(&inside).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                found.insert(name + "/", (0, 0));
                folders.push(path);
            } else {
                // Not readable for us: its length is all that can be compared.
                let bytes = std::fs::read(&path).unwrap_or_default();
                found.insert(name, (path.metadata().unwrap().len(), xxh3_64(&bytes)));
            }
        }
    }
    found
}

/// Hash of a file's bytes.
#[track_caller]
pub(crate) fn hash_of(path: &Path) -> u64 {
    xxh3_64(&std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

/// A picture's pixels, decoded: width, height, bytes.
pub(crate) fn pixels(path: &Path) -> (u32, u32, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    bytes.truncate(info.buffer_size());
    (info.width, info.height, bytes)
}

/// The folder of real models, or `None`, said aloud.
pub(crate) fn models() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/models"));
    if !folder.is_dir() {
        cannot_run(&format!("there is no {}", folder.display()));
        return None;
    }
    Some(folder.to_path_buf())
}
