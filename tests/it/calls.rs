//! Every call of scripted sessions of build, render, stress and view that fails, in every way that it can: the result
//! is whole, or the failure is told, and nothing else is left. `TREX_FAULTS=full` takes every call and every errno, in
//! parts that resume where that is asked for (`campaign.rs`); a normal run takes some of each.
//!
//! ```text
//! a run that is let alone -> count of each call, the result
//! for each call, errno and n: the n-th such call of every thread fails -> status, document, folder, result
//! ```

use crate::campaign::Campaign;
use crate::command::{Ran, TREX, hash_of, listing, ran, run_in, said};
use crate::faults::traced_folder;
use crate::fixtures::built_in;
use crate::view::ViewProcess;
use serde_json::json;
use std::collections::BTreeMap;
use std::fs;
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::Message;

/// Within this a run has ended, whatever failed.
const ENDED_WITHIN: Duration = Duration::from_secs(20);
/// What the kernel answers a call that reads, one that writes, and one to the ring.
const READS: [&str; 7] = ["EIO", "EINTR", "ENOMEM", "EAGAIN", "EBADF", "ENODEV", "EOVERFLOW"];
const WRITES: [&str; 6] = ["EIO", "EINTR", "ENOSPC", "EDQUOT", "EFBIG", "EROFS"];
const RINGS: [&str; 5] = ["EIO", "EINTR", "ENOMEM", "EAGAIN", "EBADF"];
/// Status of a program that could not be loaded: who loads it reads, too.
const LOADER_FAILED: i32 = 127;
/// Calls of a kind that a run makes, and of which each so many fails in a normal run.
const SOME: usize = 5;

/// What is run, and what of it fails.
struct Session {
    line: &'static str,
    /// What it makes, if that is a file; it is there and whole, or not there.
    output: Option<&'static str>,
    calls: &'static [(&'static str, &'static [&'static str])],
    /// Statuses of a run that did what it was to do.
    done: &'static [i32],
}

const SESSIONS: [Session; 6] = [
    Session {
        line: "build in.ply -o out.trex --voxels 64 --threads 1 --journal-every 1ms --json -q",
        output: Some("out.trex"),
        calls: &[
            ("read", &READS),
            ("pread64", &READS),
            ("pwrite64", &WRITES),
            ("fdatasync", &WRITES),
            ("fsync", &WRITES),
            ("rename", &WRITES),
            ("renameat2", &WRITES),
            ("ftruncate", &WRITES),
            ("fallocate", &WRITES),
            ("flock", &["EIO", "EINTR", "ENOLCK"]),
        ],
        done: &[0],
    },
    Session {
        line: "build in.glb -o out.trex --voxels 64 --threads 1 --json -q",
        output: Some("out.trex"),
        calls: &[("read", &READS), ("pread64", &READS)],
        done: &[0],
    },
    Session {
        line: "render m.trex -o out.png --resolution 96x64 --spp 1 --photons 5k --threads 2 --json -q",
        output: Some("out.png"),
        calls: &[
            ("read", &READS),
            ("pread64", &READS),
            ("io_uring_enter", &RINGS),
            ("write", &WRITES),
            ("fsync", &WRITES),
            ("rename", &WRITES),
            ("renameat2", &WRITES),
        ],
        done: &[0],
    },
    Session {
        line: "render m.trex -o out.exr --resolution 96x64 --spp 1 --integrator direct --io pread --json -q",
        output: Some("out.exr"),
        calls: &[("pread64", &READS), ("write", &WRITES), ("lseek", &["EIO"]), ("fsync", &WRITES)],
        done: &[0],
    },
    Session {
        line: "stress m.trex --scenario flip --switches 2 --hold 20 --resolution 64x48 --photons 5k --json -q",
        output: None,
        calls: &[("read", &READS), ("pread64", &READS), ("io_uring_enter", &RINGS)],
        // Whether times were kept is another matter.
        done: &[0, 1],
    },
    Session {
        line: "verify m.trex --deep --json -q",
        output: None,
        calls: &[("read", &READS), ("pread64", &READS)],
        done: &[0],
    },
];

/// Runs `trex LINE` with `more` flags of strace; its calls go to `log`.
fn traced(inside: &Path, line: &str, more: &[&str], log: &Path) -> Ran {
    let mut command = Command::new("timeout");
    // Calls that are not looked at do not stop the thread that makes them.
    command
        .args(["-s", "KILL", "60", "strace", "-f", "--seccomp-bpf", "-qq", "-o"])
        .arg(log)
        .args(more)
        .arg(TREX);
    command.args(line.split_whitespace()).current_dir(inside).stdin(Stdio::null());
    ran(line, command.output().unwrap())
}

/// How often each thread makes `call` at most, and how often the first has before our `main`: what the loader of
/// programs reads there is not ours.
fn counts(inside: &Path, session: &Session, call: &str, log: &Path) -> (usize, usize) {
    let whole = traced(inside, session.line, &["-e", &format!("trace={call},sigaltstack")], log);
    assert!(session.done.contains(&whole.code.unwrap_or(-1)), "{}: {}", whole.line, whole.stderr);
    let (mut by_thread, mut before) = (BTreeMap::<String, usize>::new(), None);
    for line in fs::read_to_string(log).unwrap().lines() {
        let Some((thread, what)) = line.split_once(char::is_whitespace) else { continue };
        let what = what.trim_start();
        if what.starts_with("sigaltstack") {
            before.get_or_insert(by_thread.values().sum());
        } else if what.starts_with(&format!("{call}(")) {
            *by_thread.entry(thread.to_owned()).or_default() += 1;
        }
    }
    (by_thread.into_values().max().unwrap_or(0), before.unwrap_or(0))
}

/// What must hold of a run of which a call failed.
fn check(
    inside: &Path,
    session: &Session,
    ended: &Ran,
    place: &str,
    before: &FileHashes,
    whole: Option<u64>,
) {
    let code = ended.code.unwrap_or(-1);
    let is_done = session.done.contains(&code);
    assert!(is_done || [3, 4, 5, 7].contains(&code), "{place}: {code}\n{}{}", ended.stdout, ended.stderr);
    // Where the document itself cannot be written, stderr says so.
    let has_stdout = !ended.stderr.contains("where: stdout");
    let document = if has_stdout { ended.document() } else { json!(null) };
    if !is_done && has_stdout {
        assert_eq!(document["schema"], "trex.error/1", "{place}: {document:#}");
        let parts = ["what", "where", "next_step"].map(|part| document[part].as_str().unwrap_or_default());
        assert!(parts.iter().all(|part| !part.is_empty()), "{place}: {document:#}");
    }
    if let Some(output) = session.output.map(|output| inside.join(output)) {
        let there = output.exists().then(|| hash_of(&output));
        assert!(there == whole || !is_done && there.is_none(), "{place}: {there:?} is another result");
        // A file that is there although the run failed: that is said.
        assert!(
            is_done || !has_stdout || there.is_none() || ended.stderr.contains("the file is there"),
            "{place}: {document:#}"
        );
        remove(&output);
    }
    assert!(&listing(inside) == before, "{place} left something");
}

type FileHashes = BTreeMap<String, (u64, u64)>;

/// Removes an output, and the scene beside it, of a mesh that has a camera.
fn remove(output: &Path) {
    for path in [output, &output.with_extension("toml")] {
        // It may not be there.
        let _ = fs::remove_file(path);
    }
}

/// The calls by which a result comes to the disk: one that fails for good and is not told is a lie.
fn may_not_be_swallowed(session: &Session, call: &str, errno: &str) -> bool {
    let reaches_disk = ["pwrite64", "write", "fdatasync", "fsync", "rename", "renameat2"].contains(&call);
    session.output.is_some() && reaches_disk && errno != "EINTR"
}

#[test]
fn every_call_that_fails_is_made_again_or_told() {
    let Some(inside) = traced_folder() else { return };
    let (inside, logs) = (inside.path(), crate::command::folder());
    let log = logs.path().join("calls");
    built_in(inside, "gen:pipes:20k --voxels 64/256", "m.trex");
    run_in(inside, "gen scan --triangles 10k -o in.ply -q").expect(0);
    let glb = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds/glb/small.glb");
    fs::copy(glb, inside.join("in.glb")).unwrap();
    let mut campaign = Campaign::named("calls");
    for session in &SESSIONS {
        let before = listing(inside);
        let first = run_in(inside, session.line);
        assert!(session.done.contains(&first.code.unwrap_or(-1)), "{}: {}", first.line, first.stderr);
        let whole = session.output.map(|output| hash_of(&inside.join(output)));
        session.output.iter().for_each(|output| remove(&inside.join(output)));
        let scene = Scene { inside, session, before: &before, whole, log: &log };
        for (at, (call, errnos)) in session.calls.iter().enumerate() {
            scene.fail_each(call, errnos, at, &mut campaign);
        }
    }
    let [told, whole] = ["told", "whole"].map(|outcome| campaign.count(outcome));
    said(&format!("{} runs with a call that fails, {told} of them told, all others whole", told + whole));
}

/// True where every case is to be run.
fn is_full() -> bool {
    std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full")
}

/// Where a session runs, and what it leaves when it is let alone.
struct Scene<'a> {
    inside: &'a Path,
    session: &'a Session,
    before: &'a FileHashes,
    whole: Option<u64>,
    log: &'a Path,
}

impl Scene<'_> {
    /// Runs the session with each `call` failing in turn, by each errno; of a normal run, some that `at` chooses.
    fn fail_each(&self, call: &str, errnos: &[&str], at: usize, campaign: &mut Campaign) {
        let Scene { inside, session, before, whole, log } = *self;
        let (calls, loader) = counts(inside, session, call, log);
        session.output.iter().for_each(|output| remove(&inside.join(output)));
        let step = if is_full() { 1 } else { calls.div_ceil(SOME).max(1) };
        for (turn, errno) in errnos.iter().enumerate().filter(|(turn, _)| is_full() || turn % 3 == at % 3) {
            for when in (loader + 1 + turn % step..=calls).step_by(step) {
                let place = format!("{}: {call} {when}: {errno}", session.line);
                if !campaign.is_due(&place) {
                    continue;
                }
                let (trace, inject) =
                    (format!("trace={call}"), format!("inject={call}:error={errno}:when={when}"));
                let begin = Instant::now();
                let ended = traced(inside, session.line, &["-e", &trace, "-e", &inject], log);
                assert!(begin.elapsed() < ENDED_WITHIN, "{place}: {:?}", begin.elapsed());
                check(inside, session, &ended, &place, before, whole);
                let is_met = fs::read_to_string(log).unwrap().contains("(INJECTED)");
                let is_told = is_met && ended.code != Some(0);
                assert!(
                    !is_met || is_told || !may_not_be_swallowed(session, call, errno),
                    "{place} was swallowed"
                );
                let outcome = if is_told { "told" } else { "whole" };
                campaign.passed(&place, if is_met { outcome } else { "not met" });
            }
        }
    }
}

/// Looks at a viewer's picture until it is there, or the viewer says no more.
pub(crate) fn look(address: &str) {
    let Some((base, token)) = address.split_once("/#token=") else { return };
    let host = base.trim_start_matches("http://");
    let Ok(stream) = TcpStream::connect(host) else { return };
    stream.set_read_timeout(Some(ENDED_WITHIN / 2)).unwrap();
    let Ok((mut page, _)) = tungstenite::client(format!("ws://{host}/socket"), stream) else { return };
    let hello = json!({"type": "hello", "token": token, "size": [64, 48]});
    let mut said = page.send(Message::text(hello.to_string()));
    while said.is_ok() {
        said = match page.read() {
            Ok(Message::Binary(bytes)) => {
                let frame = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                page.send(Message::text(json!({"type": "ack", "frame": frame}).to_string()))
            }
            Ok(Message::Text(text)) if ["\"done\"", "\"damaged\""].iter().any(|end| text.contains(end)) => {
                return;
            }
            other => other.map(drop),
        };
    }
}

/// The process called `trex` at or below process `id`.
fn trex_below(id: u32) -> Option<u32> {
    let name = fs::read_to_string(format!("/proc/{id}/comm")).ok()?;
    if name.trim() == "trex" {
        return Some(id);
    }
    let children = fs::read_to_string(format!("/proc/{id}/task/{id}/children")).ok()?;
    children.split_whitespace().find_map(|child| trex_below(child.parse().ok()?))
}

/// A viewer whose calls fail: it ends as it should when it is told to, or has said why it ended before.
#[test]
fn every_call_of_a_viewer_that_fails_is_survived_or_told() {
    const SOCKETS: [&str; 4] = ["ECONNRESET", "EINTR", "ENOMEM", "EPIPE"];
    let Some(inside) = traced_folder() else { return };
    let inside = inside.path();
    built_in(inside, "gen:pipes:20k --voxels 64/256", "m.trex");
    let line = "view m.trex --no-open --json --spp 1 --photons 5k --resolution 64x48";
    let logs = crate::command::folder();
    let log = logs.path().join("calls");
    let (mut turn, mut campaign) = (0, Campaign::named("calls of a viewer"));
    for (call, errnos, most) in [
        ("pread64", &READS[..], 12),
        ("io_uring_enter", &RINGS[..], 12),
        ("recvfrom", &SOCKETS[..], 8),
        ("sendto", &SOCKETS[..], 12),
        ("accept4", &["ECONNABORTED", "EMFILE", "EINTR"][..], 2),
        ("clone3", &["EAGAIN"][..], 8),
    ] {
        for (errno, when) in errnos.iter().flat_map(|errno| (1..=most).map(move |when| (errno, when))) {
            turn += 1;
            let place = format!("{call} {when}: {errno}");
            // The first thread was that of signals: without it nothing but SIGKILL ended a viewer.
            let is_chosen = turn % 9 == 0 || (call, when) == ("clone3", 1);
            if !is_full() && !is_chosen || !campaign.is_due(&place) {
                continue;
            }
            let mut command = Command::new("timeout");
            command.args(["-s", "KILL", "60", "strace", "-f", "--seccomp-bpf", "-qq", "-o"]).arg(&log);
            command.args(["-e", &format!("trace={call}")]);
            command.args(["-e", &format!("inject={call}:error={errno}:when={when}"), TREX]);
            command.args(line.split_whitespace()).current_dir(inside);
            let viewing = ViewProcess::start_as(command, line.to_owned());
            look(viewing.address());
            let told = Instant::now();
            // The loader, whose calls fail as well, ends by itself, and knows no interrupt.
            let is_loading = viewing.address().contains("error while loading");
            if let Some(id) = trex_below(viewing.id()).filter(|_| !is_loading) {
                let signal = format!("kill -INT {id}");
                let _ = Command::new("sh").args(["-c", &signal]).stderr(Stdio::null()).status();
            }
            let ended = viewing.wait();
            assert!(told.elapsed() < ENDED_WITHIN, "{place}: {:?}", told.elapsed());
            let code = ended.code.unwrap_or(-1);
            if code == LOADER_FAILED {
                campaign.passed(&place, "not met");
                continue;
            }
            assert!([0, 1, 3, 4, 5, 7].contains(&code), "{place}: {code}\n{}{}", ended.stdout, ended.stderr);
            ended.document();
            let is_met = fs::read_to_string(&log).unwrap().contains("(INJECTED)");
            campaign.passed(&place, if is_met { "met" } else { "not met" });
        }
    }
    let count = campaign.count("met");
    assert!(count > 5, "{count} viewers had a call that failed");
    said(&format!("{count} viewers with a call that fails, each ended as it should or told why"));
}
