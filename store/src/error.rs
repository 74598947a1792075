//! The one error of the store: four parts (what, where, numbers, next step) and a stable code.
//!
//! Invariants: 1. every error that reaches a user names a place (a path, with a line or a byte offset when
//! there is one); 2. `Code` strings never change once published; 3. only users' data, files and devices make
//! an `Error`: our own mistakes are asserts, and [`Code::Bug`] tells those who wait for a thread that met one;
//! 4. shown, each part is one line without control characters, whatever names it holds (`printable`).

use crate::next_step::{NextStep, Setting};
use crate::printable::one_line;
use crate::url::{is_s3, is_url};
use rustix::io::Errno;
use std::fmt;
use std::path::Path;

/// Result of every fallible call of the store.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Kinds of failures. The string form (`as_str`) is stable and is what `--json` prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Code {
    /// The request itself makes no sense (contradicting options, an output that exists).
    Usage,
    /// The input is not what its name or header says: wrong magic, text where numbers belong, UTF-16.
    InputFormat,
    /// The input ends early.
    InputTruncated,
    /// An index or a count in the input points outside of what the input holds.
    InputRange,
    /// The input holds no triangle that can be used.
    InputEmpty,
    /// The input cannot be opened: missing, a directory, no permission.
    InputUnreadable,
    /// Inputs that do not go together: pictures of different sizes.
    InputMismatch,
    /// A scene file has an unknown key or a value out of range.
    SceneFormat,
    /// The work cannot be done under the memory limit; `Error::smallest_limit_bytes` says what would do.
    MemoryLimit,
    /// No space left, or the quota is used up.
    DiskFull,
    /// A `.trex` file is damaged: a hash, a length or a magic is not what it must be.
    Damaged,
    /// A `.trex` file of a version or with required features that this build does not know.
    Version,
    /// Reading or writing failed.
    Io,
    /// The device that was named is not there, or cannot be used.
    NoAdapter,
    /// The user interrupted the work.
    Interrupted,
    /// A mistake of ours, met by somebody who waited for the thread that made it.
    Bug,
}

impl Code {
    /// All of them.
    pub const ALL: [Code; 15] = [
        Code::Usage,
        Code::InputFormat,
        Code::InputTruncated,
        Code::InputRange,
        Code::InputEmpty,
        Code::InputUnreadable,
        Code::InputMismatch,
        Code::SceneFormat,
        Code::MemoryLimit,
        Code::DiskFull,
        Code::Damaged,
        Code::Version,
        Code::Io,
        Code::Interrupted,
        Code::Bug,
    ];

    /// The stable name, as printed in messages and JSON.
    pub fn as_str(self) -> &'static str {
        match self {
            Code::Usage => "usage",
            Code::InputFormat => "input-format",
            Code::InputTruncated => "input-truncated",
            Code::InputRange => "input-range",
            Code::InputEmpty => "input-empty",
            Code::InputUnreadable => "input-unreadable",
            Code::InputMismatch => "input-mismatch",
            Code::SceneFormat => "scene-format",
            Code::MemoryLimit => "memory-limit",
            Code::DiskFull => "disk-full",
            Code::Damaged => "damaged",
            Code::Version => "version",
            Code::Io => "io",
            Code::NoAdapter => "no-adapter",
            Code::Interrupted => "interrupted",
            Code::Bug => "bug",
        }
    }
}

/// The next step where reading fails by no fault of what is read: `of_device`, for what is on one.
pub(crate) fn try_again(path: &Path, of_device: &'static str) -> &'static str {
    if is_url(path) { "check the network and the server, and try again" } else { of_device }
}

/// An error in four parts. `Display` prints them as lines: what, where, numbers, next step.
#[derive(Clone, Debug)]
pub struct Error(Box<Parts>);

#[derive(Clone, Debug)]
struct Parts {
    code: Code,
    what: String,
    place: String,
    numbers: String,
    next_step: NextStep,
    /// The next step in words.
    next_words: String,
    setting: Option<Setting>,
    smallest_limit_bytes: Option<u64>,
    kept_bytes: Option<u64>,
}

impl Error {
    /// An error with its first part; the others are added with [`Error::at`], [`Error::numbers`] and
    /// [`Error::next`].
    pub fn new(code: Code, what: impl Into<String>) -> Error {
        Error(Box::new(Parts {
            code,
            what: what.into(),
            place: String::new(),
            numbers: String::new(),
            next_step: NextStep::Text(String::new()),
            next_words: String::new(),
            setting: None,
            smallest_limit_bytes: None,
            kept_bytes: None,
        }))
    }

    /// Names the place: a path alone.
    pub fn at(mut self, path: &Path) -> Error {
        self.0.place = path.display().to_string();
        self
    }

    /// Names the place: a path and a line, counted from 1.
    pub fn at_line(mut self, path: &Path, line: u64) -> Error {
        self.0.place = format!("{}:{line}", path.display());
        self
    }

    /// Names the place: a path and a byte offset, counted from 0.
    pub fn at_byte(mut self, path: &Path, offset: u64) -> Error {
        self.0.place = format!("{} at byte {offset}", path.display());
        self
    }

    /// Names a place that is no path (a generator, a scene key).
    pub fn at_place(mut self, place: impl Into<String>) -> Error {
        self.0.place = place.into();
        self
    }

    /// Names the place: a setting of the caller.
    pub fn at_setting(mut self, setting: Setting) -> Error {
        self.0.setting = Some(setting);
        self.at_place(setting.to_string())
    }

    /// The numbers that show the failure: expected against found, needed against free.
    pub fn numbers(mut self, numbers: impl Into<String>) -> Error {
        self.0.numbers = numbers.into();
        self
    }

    /// Names the next step of the user.
    pub fn next(mut self, next_step: impl Into<NextStep>) -> Error {
        self.0.next_step = next_step.into();
        self.0.next_words = self.0.next_step.to_string();
        self
    }

    /// Adds the smallest memory limit (bytes) under which the work could be done.
    pub fn smallest_limit(mut self, bytes: u64) -> Error {
        self.0.smallest_limit_bytes = Some(bytes);
        self
    }

    /// Of a limit that is too small, which knows of one lease: named is the limit that has room for more.
    pub fn with_room(self, more_bytes: u64) -> Error {
        let Some(bytes) = self.0.smallest_limit_bytes else { return self };
        let bytes = bytes.saturating_add(more_bytes);
        self.next(NextStep::RaiseLimit { bytes }).smallest_limit(bytes)
    }

    /// Of a build that leaves `bytes` on disk, from which another resumes: the numbers say so, too.
    pub fn keeping(mut self, bytes: u64) -> Error {
        let kept = format!(
            "{} MiB are kept beside the output, or in the folder of scratch",
            bytes.div_ceil(1 << 20)
        );
        let Parts { numbers, kept_bytes, .. } = &mut *self.0;
        *numbers = if numbers.is_empty() { kept } else { format!("{numbers}; {kept}") };
        *kept_bytes = Some(bytes);
        self
    }

    /// An I/O failure while `doing` something to `path`; a full disk and a path that leads nowhere get their own codes.
    pub fn io(doing: &str, path: &Path, error: &std::io::Error) -> Error {
        use std::io::ErrorKind;
        // Kinds of the standard library have no name for it yet.
        let is_loop = error.raw_os_error() == Some(Errno::LOOP.raw_os_error());
        let (code, next) = match error.kind() {
            _ if is_loop => (Code::InputUnreadable, "check where the symbolic links lead".into()),
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
                (Code::DiskFull, NextStep::FreeSpace)
            }
            ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename => {
                (Code::InputUnreadable, "check the spelling of the path".into())
            }
            ErrorKind::PermissionDenied if is_s3(path) => (
                Code::InputUnreadable,
                "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY of somebody who may read it".into(),
            ),
            ErrorKind::PermissionDenied => {
                (Code::InputUnreadable, "check the permissions of the path".into())
            }
            ErrorKind::IsADirectory => (Code::InputUnreadable, "name a file, not a folder".into()),
            ErrorKind::StaleNetworkFileHandle => (Code::Io, "open it again".into()),
            ErrorKind::Unsupported | ErrorKind::InvalidInput if is_url(path) => {
                (Code::InputUnreadable, "copy the file here, or see what the server allows".into())
            }
            _ => (Code::Io, try_again(path, "check the device and try again").into()),
        };
        let numbers = match error.raw_os_error() {
            Some(number) => format!("{error} [errno {number}]"),
            None => error.to_string(),
        };
        Error::new(code, format!("cannot {doing}")).at(path).numbers(numbers).next(next)
    }

    /// An I/O failure while `doing` something to `path` that is written: as [`Error::io`], but a place that refuses is
    /// no fault of an input.
    pub fn writing(doing: &str, path: &Path, error: &std::io::Error) -> Error {
        let mut failed = Error::io(doing, path, error);
        if failed.code() == Code::InputUnreadable {
            failed.0.code = Code::Io;
            failed = failed.next("check that the folder is there and may be written to, or name another");
        }
        failed
    }

    /// The system did not start the thread of `place`.
    pub fn thread_refused(place: &str, error: &dyn fmt::Display) -> Error {
        Error::new(Code::Io, "the system refused a thread")
            .at_place(place)
            .numbers(error.to_string())
            .next("raise the limit on processes (ulimit -u), or end some")
    }

    /// The system did not start `count` threads for data-parallel work.
    pub fn threads_refused(count: usize, error: &dyn fmt::Display) -> Error {
        Error::thread_refused("the worker threads", &format!("{count} asked: {error}"))
            .next(NextStep::FewerThreads)
    }

    /// The error of those who wait for a thread that panicked, with what it panicked with.
    pub(crate) fn panicked(thread: &str, payload: &(dyn std::any::Any + Send)) -> Error {
        let text = payload.downcast_ref::<&str>().copied();
        let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        Error::new(Code::Bug, "a thread of trex panicked")
            .at_place(format!("thread {thread}"))
            .numbers(text.unwrap_or("without a message"))
            .next("this is a mistake in trex, not yours: please report it with this message")
    }

    /// The error of work that was interrupted by the user.
    pub fn interrupted() -> Error {
        Error::new(Code::Interrupted, "interrupted").next("nothing was published; run the command again")
    }

    /// The code.
    pub fn code(&self) -> Code {
        self.0.code
    }

    /// First part: what failed.
    pub fn what(&self) -> &str {
        &self.0.what
    }

    /// Second part: where. Empty only for [`Code::Interrupted`] and [`Code::Usage`].
    pub fn place(&self) -> &str {
        &self.0.place
    }

    /// Third part: the numbers. May be empty.
    pub fn numbers_text(&self) -> &str {
        &self.0.numbers
    }

    /// The setting that is the place, where one is.
    pub fn setting(&self) -> Option<Setting> {
        self.0.setting
    }

    /// Fourth part: what to do next, in words that name no flag and no command.
    pub fn next_step(&self) -> &str {
        &self.0.next_words
    }

    /// What to do next, for a command that has its own words for it.
    pub fn next_step_kind(&self) -> &NextStep {
        &self.0.next_step
    }

    /// The smallest limit that would do, for [`Code::MemoryLimit`].
    pub fn smallest_limit_bytes(&self) -> Option<u64> {
        self.0.smallest_limit_bytes
    }

    /// Bytes on disk from which a build resumes, where one was ended that can.
    pub fn kept_bytes(&self) -> Option<u64> {
        self.0.kept_bytes
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Parts { code, what, place, numbers, next_words, .. } = &*self.0;
        write!(f, "{} [{}]", one_line(what), code.as_str())?;
        for (label, part) in [("where", place), ("numbers", numbers), ("next", next_words)] {
            if !part.is_empty() {
                write!(f, "\n  {label}: {}", one_line(part))?;
            }
        }
        Ok(())
    }
}

impl std::error::Error for Error {}
