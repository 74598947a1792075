//! Failures told to people and to scripts: four parts on stderr, one document with `--json`, an exit status.
//!
//! Invariants: 1. every end of the program passes through [`Exit`]; 2. a `trex_store::Error` keeps its code and
//! its parts; anything else is an I/O failure of our own output, or a bug; 3. a panic in any thread is told
//! once, with what to report, and ends in status 70 within [`LEAVE_AFTER`], whatever the other threads wait for; 4. no
//! panic ends in an abort, which would have no status.

use crate::next_step;
use crate::progress::Console;
use crate::report::Output;
use serde::Serialize;
use std::io::{self, Write};
use std::panic::PanicHookInfo;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use trex_store::printable::{is_obeyed, lines, one_line};
use trex_store::{Code, Error};

/// Time for threads to end and for temporary files to go after a panic. Then the process ends as it stands.
const LEAVE_AFTER: Duration = Duration::from_millis(700);

/// How the standard library begins to say, as a panic of the thread, that a thread which has started gets no stack for
/// its signals. The system has no memory left for it: nobody's mistake.
const NO_SIGNAL_STACK: [&str; 2] =
    ["failed to allocate an alternative stack", "failed to set up alternative stack guard page"];
/// Its words for a panic where none can end a thread: it aborts the process next.
const CANNOT_UNWIND: &str = "panic in a function that cannot unwind";

/// A thread has panicked.
static PANICKED: AtomicBool = AtomicBool::new(false);

/// Exit status of the command; the numbers are part of its contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Done = 0,
    /// Ran, and the answer is no.
    No = 1,
    /// The command line makes no sense.
    Usage = 2,
    /// The input is bad: unreadable, malformed, damaged.
    BadInput = 3,
    /// The memory limit cannot be met.
    MemoryLimit = 4,
    /// No space on disk.
    Disk = 5,
    /// The device that was named is not there.
    NoAdapter = 6,
    /// Reading or writing failed.
    Io = 7,
    /// A mistake of ours.
    Bug = 70,
    /// Stopped by the user.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit as u8)
    }
}

impl From<Code> for Exit {
    fn from(code: Code) -> Exit {
        match code {
            Code::Usage => Exit::Usage,
            Code::InputFormat
            | Code::InputTruncated
            | Code::InputRange
            | Code::InputEmpty
            | Code::InputUnreadable
            | Code::InputMismatch
            | Code::SceneFormat
            | Code::Damaged
            | Code::Version => Exit::BadInput,
            Code::MemoryLimit => Exit::MemoryLimit,
            Code::DiskFull => Exit::Disk,
            Code::NoAdapter => Exit::NoAdapter,
            Code::Io => Exit::Io,
            Code::Interrupted => Exit::Interrupted,
            Code::Bug => Exit::Bug,
            // A code that this table has not met: nobody decided on its status.
            _ => Exit::Bug,
        }
    }
}

/// The body of `trex.error/1`.
#[derive(Debug, Serialize)]
struct Failure {
    code: &'static str,
    what: String,
    #[serde(rename = "where")]
    place: String,
    numbers: String,
    next_step: String,
    smallest_limit_bytes: Option<u64>,
    exit: u8,
}

impl Failure {
    fn from_error(error: &anyhow::Error) -> (Failure, Exit) {
        if let Some(error) = error.downcast_ref::<Error>() {
            return Failure::from_store(error);
        }
        if let Some(io) = error.chain().find_map(|cause| cause.downcast_ref::<io::Error>()) {
            let failure = Failure {
                what: format!("{error:#}"),
                ..Failure::from_store(&Error::io("write the result", "stdout".as_ref(), io)).0
            };
            let exit = if failure.code == Code::DiskFull.as_str() { Exit::Disk } else { Exit::Io };
            return (Failure { exit: exit as u8, ..failure }, exit);
        }
        (Failure::bug(format!("{error:#}")), Exit::Bug)
    }

    fn from_store(error: &Error) -> (Failure, Exit) {
        let exit = Exit::from(error.code());
        let failure = Failure {
            code: error.code().as_str(),
            what: error.what().to_owned(),
            place: next_step::place(error),
            numbers: error.numbers_text().to_owned(),
            next_step: next_step::words(error.next_step_kind()),
            smallest_limit_bytes: error.smallest_limit_bytes(),
            exit: exit as u8,
        };
        (failure, exit)
    }

    /// What a panic with this `message` is, told in full by `text`.
    fn from_panic(message: &str, text: impl FnOnce() -> String) -> (Failure, Exit) {
        if NO_SIGNAL_STACK.iter().any(|begin| message.starts_with(begin)) {
            let refused = Error::thread_refused("a thread at its start", &message);
            return Failure::from_store(
                &refused.next("leave the process more memory (ulimit -v), or ask for less"),
            );
        }
        (Failure::bug(text()), Exit::Bug)
    }

    fn bug(what: String) -> Failure {
        Failure {
            code: "bug",
            what,
            place: format!("trex {} on {} {}", env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH),
            numbers: String::new(),
            next_step: "this is a mistake in trex, not yours: please report it with the command line and this message"
                .to_owned(),
            smallest_limit_bytes: None,
            exit: Exit::Bug as u8,
        }
    }

    /// What, then the parts that exist, one a line.
    fn text(&self) -> String {
        let mut text = format!("error: {} [{}]", one_line(&self.what), self.code);
        for (label, part) in [("where", &self.place), ("numbers", &self.numbers), ("next", &self.next_step)] {
            if !part.is_empty() {
                text.push_str(&format!("\n  {label}: {}", one_line(part)));
            }
        }
        text
    }
}

/// Tells `error` on stderr, and as a document with `--json`; says how the program ends.
pub fn tell(error: &anyhow::Error, console: &Console, output: &Output) -> Exit {
    let (failure, exit) = Failure::from_error(error);
    console.abandon();
    console.error(&failure.text());
    output.error_document(&failure);
    exit
}

/// Tells what clap says: help and version are results, the rest is a usage error.
pub fn tell_usage(error: &clap::Error, output: &Output) -> Exit {
    // The streams may be closed pipes; then there is nobody to tell. Words that a terminal would obey are told plain.
    let is_tame = !std::env::args_os().any(|word| word.to_string_lossy().contains(is_obeyed));
    let _ = match is_tame {
        true => error.print(),
        false => write!(io::stderr().lock(), "{}", lines(&error.render().to_string())),
    };
    if !error.use_stderr() {
        return Exit::Done;
    }
    output.error_document(&Failure {
        code: Code::Usage.as_str(),
        what: error.to_string().lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned(),
        place: "command line".to_owned(),
        numbers: String::new(),
        next_step: "see trex --help".to_owned(),
        smallest_limit_bytes: None,
        exit: Exit::Usage as u8,
    });
    Exit::Usage
}

/// Makes every panic say what it is, whose fault, and what to report. Only the first is told: the others follow
/// from it. The process ends soon after it: some other thread may wait for ever for the one that is gone.
pub fn install_panic_hook(output: Output) {
    std::panic::set_hook(Box::new(move |info| {
        let leave = || std::process::exit(i32::from(Exit::Bug as u8));
        let message = message_of(info);
        if PANICKED.swap(true, Ordering::SeqCst) {
            if message == CANNOT_UNWIND {
                leave();
            }
            return;
        }
        let (failure, exit) = Failure::from_panic(message, || panic_text(info));
        let _ = writeln!(io::stderr().lock(), "\n{}", failure.text());
        output.error_document(&failure);
        if exit != Exit::Bug {
            std::process::exit(i32::from(exit as u8));
        }
        let leave_later = move || {
            std::thread::sleep(LEAVE_AFTER);
            leave();
        };
        if std::thread::Builder::new().name("trex-leave".into()).spawn(leave_later).is_err() {
            leave();
        }
    }));
}

/// Whether any thread has panicked: the program ends as a bug then, whatever else came of it.
pub fn has_panicked() -> bool {
    PANICKED.load(Ordering::SeqCst)
}

fn message_of<'a>(info: &'a PanicHookInfo<'_>) -> &'a str {
    let payload = info.payload();
    payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}

fn panic_text(info: &PanicHookInfo<'_>) -> String {
    let message = message_of(info);
    let thread = std::thread::current();
    let thread = thread.name().unwrap_or("unnamed");
    match info.location() {
        Some(place) => format!("{message} (at {}:{}, thread {thread})", place.file(), place.line()),
        None => format!("{message} (thread {thread})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_code_has_its_status() {
        for (code, status) in [
            (Code::Usage, 2),
            (Code::InputFormat, 3),
            (Code::InputTruncated, 3),
            (Code::InputRange, 3),
            (Code::InputEmpty, 3),
            (Code::InputUnreadable, 3),
            (Code::InputMismatch, 3),
            (Code::SceneFormat, 3),
            (Code::Damaged, 3),
            (Code::Version, 3),
            (Code::MemoryLimit, 4),
            (Code::DiskFull, 5),
            (Code::NoAdapter, 6),
            (Code::Io, 7),
            (Code::Interrupted, 130),
            (Code::Bug, 70),
        ] {
            assert_eq!(Exit::from(code) as u8, status, "{code:?}");
        }
    }

    #[test]
    fn a_store_error_keeps_its_parts_through_context() {
        let error = Error::new(Code::MemoryLimit, "no room")
            .at(Path::new("m.trex"))
            .numbers("5 of 3")
            .next("raise it")
            .smallest_limit(5);
        let (failure, exit) = Failure::from_error(&anyhow::Error::from(error).context("while building"));
        assert_eq!(exit, Exit::MemoryLimit);
        assert_eq!(
            failure.text(),
            "error: no room [memory-limit]\n  where: m.trex\n  numbers: 5 of 3\n  next: raise it"
        );
        let document = serde_json::to_value(&failure).unwrap();
        assert_eq!(document["where"], "m.trex");
        assert_eq!(document["smallest_limit_bytes"], 5);
        assert_eq!(document["exit"], 4);
    }

    #[test]
    fn stdout_that_fails_is_io_and_the_unknown_is_a_bug() {
        let full = anyhow::Error::from(io::Error::from(io::ErrorKind::StorageFull));
        assert_eq!(Failure::from_error(&full).1, Exit::Disk);
        let gone = anyhow::Error::from(io::Error::from(io::ErrorKind::TimedOut));
        assert_eq!(Failure::from_error(&gone).1, Exit::Io);
        let (failure, exit) = Failure::from_error(&anyhow::anyhow!("odd"));
        assert_eq!((failure.code, exit), ("bug", Exit::Bug));
        assert!(failure.text().contains("please report it"));
    }

    #[test]
    fn a_thread_that_gets_no_stack_is_no_bug() {
        let refused = format!("{}: Cannot allocate memory (os error 12)", NO_SIGNAL_STACK[0]);
        let (failure, exit) =
            Failure::from_panic(&refused, || unreachable!("it is told by the store's error"));
        assert_eq!((failure.code, exit, failure.numbers.as_str()), ("io", Exit::Io, refused.as_str()));
        assert_eq!(Failure::from_panic("odd", || "odd".to_owned()).1, Exit::Bug);
    }
}
