//! System calls that fail where they never do: what the kernel answers is changed by strace, in the command as it
//! ships.

use crate::command::{
    Ran, TREX, cannot_run, cannot_run_without, document_in, folder, hash_of, listing, ran, run_in, said,
};
use crate::fixtures::built_in;
use crate::support::content;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use trex_store::io::{Fault, FaultPlan, IoOptions};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Code, PageFile};

/// Reads some eighty pages.
const RENDER: &str = "render m.trex -o out.png --overwrite --resolution 320x240 --spp 1 --memory-limit 64MiB \
                      --json --integrator direct";

/// A folder; `None`, said aloud, where strace cannot be had.
pub(crate) fn traced_folder() -> Option<tempfile::TempDir> {
    let traced = Command::new("strace").args(["-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    if !traced.is_ok_and(|status| status.success()) {
        cannot_run_without("strace");
        return None;
    }
    Some(folder())
}

/// A model of 114 pages.
fn model() -> Option<tempfile::TempDir> {
    let inside = traced_folder()?;
    built_in(inside.path(), "gen:pipes:1M --voxels 64", "m.trex");
    Some(inside)
}

/// Runs `trex LINE` with what strace changes; for a minute at most.
fn run_with(inside: &Path, inject: &str, line: &str) -> Ran {
    run_logged(inside, inject, line, Path::new("/dev/null"))
}

/// As [`run_with`]; the calls go to `log`.
fn run_logged(inside: &Path, inject: &str, line: &str, log: &Path) -> Ran {
    let call = inject.split(':').next().unwrap();
    let mut command = Command::new("timeout");
    command.args(["60", "strace", "-f", "-qq", "-o"]).arg(log).args(["-e", &format!("trace={call}")]);
    command.args(["-e", &format!("inject={inject}"), TREX]).args(line.split_whitespace());
    ran(line, command.current_dir(inside).stdin(Stdio::null()).output().unwrap())
}

/// A call that failed once left reads in the ring's queue: the loader panicked when it was full, pages whose reads did
/// not come back were taken for damaged, and a render hung for ever, or ended as well done.
#[test]
fn a_ring_that_fails_costs_a_line() {
    let Some(inside) = model() else { return };
    let whole = document_in(inside.path(), &RENDER.replace(" --json", ""));
    let picture = hash_of(&inside.path().join("out.png"));
    if whole["io_backend"]["backend"] != "uring" {
        return cannot_run("this machine has no io_uring");
    }
    // No time is asked for: it is the ring that is tried here.
    let stress = "stress m.trex --json --progress none --scenario flip --switches 2 --integrator direct --lod-error 0 \
                  --resolution 320x240 --require whole.p50=60000";
    let stressed = run_with(inside.path(), "io_uring_enter:error=EIO:when=3+", stress);
    stressed.expect(0);
    let document = stressed.document();
    assert_eq!(document["io_backend"]["backend"], "pread", "{document:#}");
    assert!(
        stressed.stderr.contains(document["io_backend"]["notice"].as_str().unwrap()),
        "{}",
        stressed.stderr
    );
    // A picture makes nine such calls at least.
    for (errno, when) in [("ENOMEM", "5"), ("EIO", "7"), ("ENOMEM", "3"), ("EIO", "6+")] {
        let rendered = run_with(inside.path(), &format!("io_uring_enter:error={errno}:when={when}"), RENDER);
        rendered.expect(0);
        let document = rendered.document();
        assert_eq!(document["exact"], true, "{errno} {when}: {document:#}");
        assert_eq!(hash_of(&inside.path().join("out.png")), picture, "{errno} {when}");
        assert_eq!(document["io_backend"]["backend"], "pread", "{errno} {when}");
        let notice = document["io_backend"]["notice"].as_str().unwrap();
        let told = rendered.stderr.lines().filter(|line| line.contains(notice)).count();
        assert_eq!(told, 1, "{notice}:\n{}", rendered.stderr);
    }
}

/// A kernel that says that more bytes arrived than were asked for: an assert in the loader. Nobody may wait for it.
#[test]
fn a_loader_that_panics_ends_the_command() {
    let Some(inside) = model() else { return };
    // Each reading thread makes more calls than the one that opens the file.
    let render = format!("{RENDER} --io pread").replace("integrator direct", "integrator path");
    let render = render.replace("64MiB", "38MiB").replace("--spp 1", "--spp 16");
    for more in ["", " --time-limit 30"] {
        let start = Instant::now();
        let ended = run_with(inside.path(), "pread64:retval=1000000000:when=16+", &format!("{render}{more}"));
        assert!(start.elapsed() < Duration::from_secs(20), "{more}: took {:?}", start.elapsed());
        ended.expect(70);
        let document = ended.document();
        assert_eq!((&document["code"], &document["exit"]), (&"bug".into(), &70.into()), "{document:#}");
        assert!(document["what"].as_str().unwrap().contains("trex-load-0"), "{document:#}");
        assert_eq!(ended.stderr.matches("error:").count(), 1, "{}", ended.stderr);
    }
    run_in(inside.path(), RENDER).expect(0);
}

/// A bit that turned on the way, on a disk that is whole, cost the page for the rest of the run.
#[test]
fn a_page_that_comes_damaged_is_read_again_by_another_way() {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k --voxels 64", "m.trex");
    let path = inside.path().join("m.trex");
    let pool_of = |plan| {
        let file = Arc::new(PageFile::open(&path, &Budget::unlimited()).unwrap());
        let backend = Fault::new(trex_store::io::open(&path, &IoOptions::default()).unwrap(), plan);
        let options = PoolOptions::default();
        PagePool::with_backend(file, Box::new(backend), &path, &Budget::unlimited(), &options).unwrap()
    };
    let (whole, faulty) =
        (pool_of(FaultPlan::default()), pool_of(FaultPlan { flip_per_1024: 1024, ..FaultPlan::default() }));
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let count = file.pages().len() as u32;
    assert!(count > 2, "{count} pages are too few");
    for page in 0..count {
        let [whole, faulty] = [&whole, &faulty].map(|pool| content(&file, &pool.pin_blocking(page).unwrap()));
        assert!(whole == faulty, "page {page}");
    }
    assert_eq!((whole.stats().damaged, whole.stats().read_retries), (0, 0));
    // A read of several pages has one bit that is wrong.
    let stats = faulty.stats();
    assert!(stats.damaged == 0 && stats.read_retries > 0, "{stats:?}");

    // What is damaged on the disk is damaged, whoever reads it.
    let entry = PageFile::open(&path, &Budget::unlimited()).unwrap().pages()[1];
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[entry.offset as usize + 9] ^= 4;
    std::fs::write(&path, bytes).unwrap();
    let pool = pool_of(FaultPlan::default());
    assert_eq!(pool.pin_blocking(1).err().unwrap().code(), Code::Damaged);
    assert!(pool.pin_blocking(0).is_ok() && pool.pin_blocking(2).is_ok());
    assert_eq!((pool.stats().damaged, pool.stats().read_retries), (1, 1));
}

/// Each call of a build by which something comes to the disk, failing in turn: nothing is published but the whole file,
/// and nothing is left; a call that a signal interrupted is made again. `TREX_FAULTS=full` takes every call.
#[test]
fn every_write_and_sync_of_a_build_that_fails_is_told() {
    let Some(inside) = traced_folder() else { return };
    let line = "build gen:soup:10k --voxels 64 -o out.trex --threads 1 --journal-every 1ms --json -q";
    run_in(inside.path(), line).expect(0);
    let output = inside.path().join("out.trex");
    let whole = hash_of(&output);
    std::fs::remove_file(&output).unwrap();
    let before = listing(inside.path());
    let is_full = std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full");
    let (mut count, log) = (0, folder());
    let log = log.path().join("calls");
    for call in ["pwrite64", "fdatasync", "fsync", "rename", "renameat2", "ftruncate", "flock"] {
        for (errno, exit) in [("EIO", 7), ("ENOSPC", 5), ("EINTR", 0)] {
            let is_again = ["pwrite64", "fdatasync", "fsync", "ftruncate", "flock"].contains(&call);
            if exit == 0 && !is_again {
                continue;
            }
            // Many writes are alike.
            let step = match (is_full, call) {
                (true, _) => 1,
                (false, "pwrite64") => 9,
                (false, _) => 4,
            };
            for when in (1..2000).step_by(step) {
                let begin = Instant::now();
                let inject = format!("{call}:error={errno}:when={when}");
                let ended = run_logged(inside.path(), &inject, line, &log);
                // What was changed is marked: a run without was past the last call of its kind.
                let has_failed = std::fs::read_to_string(&log).unwrap().contains("(INJECTED)");
                assert!(
                    begin.elapsed() < Duration::from_secs(20),
                    "{call} {errno} {when}: {:?}",
                    begin.elapsed()
                );
                let is_published = output.exists();
                if is_published {
                    assert_eq!(hash_of(&output), whole, "{call} {errno} {when}");
                    std::fs::remove_file(&output).unwrap();
                }
                assert_eq!(listing(inside.path()), before, "{call} {errno} {when} left something");
                let expected = if has_failed { exit } else { 0 };
                assert_eq!(ended.code, Some(expected), "{call} {errno} {when}: {}", ended.stderr);
                assert!(expected != 0 || is_published, "{call} {errno} {when}");
                ended.document();
                if !has_failed {
                    break;
                }
                count += 1;
            }
        }
    }
    said(&format!("{count} builds with a call that fails, each whole or told"));
}
