//! The ladder: which backend opens a file, direct or buffered, and the reason in words.
//!
//! ```text
//! --io auto   : uring -> pread                --direct auto : O_DIRECT -> buffered, dropped from the cache
//! --io NAME   : that one, or an error         --direct on   : O_DIRECT, or an error
//! ```
//!
//! Invariants: 1. `auto` always opens a file that can be opened at all; 2. what was asked by name is met or refused,
//! never replaced; 3. direct reading is proven by a read at open, not believed from a flag (tmpfs and some network
//! file systems accept the flag and refuse the read).

use super::pread::pread;
use super::source::Source;
use super::{ALIGN_BYTES, Backend, Failover, Mmap, StagingBuffer, Uring};
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use rustix::fs::OFlags;
use serde::Serialize;
use std::fs::File;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

/// Deepest queue that may be asked for.
pub const DEPTH_MAX: usize = 1024;

/// `--io`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum IoChoice {
    /// The best that works here.
    #[default]
    Auto,
    /// io_uring.
    Uring,
    /// Threads that call `pread`.
    Pread,
    /// A mapping of the file, copied from.
    Mmap,
}

/// `--direct`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DirectChoice {
    /// Past the page cache where the file system allows it.
    #[default]
    Auto,
    /// Past the page cache, or not at all.
    On,
    /// Through the page cache; what was read is dropped from it.
    Off,
}

impl FromStr for IoChoice {
    type Err = Error;
    fn from_str(text: &str) -> Result<IoChoice> {
        match text {
            "auto" => Ok(IoChoice::Auto),
            "uring" => Ok(IoChoice::Uring),
            "pread" => Ok(IoChoice::Pread),
            "mmap" => Ok(IoChoice::Mmap),
            _ => Err(unknown_choice("backend", text, "auto, uring, pread or mmap")),
        }
    }
}

impl FromStr for DirectChoice {
    type Err = Error;
    fn from_str(text: &str) -> Result<DirectChoice> {
        match text {
            "auto" => Ok(DirectChoice::Auto),
            "on" => Ok(DirectChoice::On),
            "off" => Ok(DirectChoice::Off),
            _ => Err(unknown_choice("choice of direct reading", text, "auto, on or off")),
        }
    }
}

fn unknown_choice(what: &str, text: &str, known: &str) -> Error {
    Error::new(Code::Usage, format!("there is no {what} {text:?}")).next(format!("use {known}"))
}

/// Bytes of memory that a connection takes: buffers of TLS and of messages, and what is touched of a stack.
pub const CONNECTION_BYTES: u64 = 160 << 10;

/// How to read.
#[derive(Clone, Debug)]
pub struct IoOptions {
    /// Which backend.
    pub io: IoChoice,
    /// Past the page cache or through it.
    pub direct: DirectChoice,
    /// Most reads in flight, 1 to 1024. 32 fills the queue of a fast SSD without letting urgent reads grow old.
    pub depth: usize,
    /// Threads of the `pread` backend; no more than `depth` are started. Each has a stack of 64 KiB.
    pub pread_threads: usize,
    /// Connections beside those that a file behind a network has anyway, each for one more read in flight, and of
    /// [`CONNECTION_BYTES`].
    pub connections: usize,
}

impl Default for IoOptions {
    fn default() -> IoOptions {
        IoOptions {
            io: IoChoice::Auto,
            direct: DirectChoice::Auto,
            depth: 32,
            pread_threads: 16,
            connections: 0,
        }
    }
}

/// Opens `path` for reading in the way that `options` ask for.
///
/// # Errors
/// [`Code::InputUnreadable`] when the file cannot be opened; [`Code::Usage`] when what was asked by name does not
/// work here.
pub fn open(path: &Path, options: &IoOptions) -> Result<Box<dyn Backend>> {
    if options.depth == 0 || options.depth > DEPTH_MAX {
        return Err(Error::new(Code::Usage, "the I/O depth is out of range")
            .numbers(format!("{} asked, 1 to {DEPTH_MAX} allowed", options.depth))
            .next("use 32"));
    }
    if options.io == IoChoice::Mmap {
        if options.direct == DirectChoice::On {
            return Err(refused("mmap cannot read past the page cache", path, "a mapping is the page cache"));
        }
        let file = File::open(path).map_err(|error| Error::io("open", path, &error))?;
        return Ok(Box::new(Mmap::new(file, path, options.depth)?));
    }
    let (source, direct_reason) = open_source(path, options.direct)?;
    if options.io == IoChoice::Pread {
        let reason = format!("pread was asked for; {direct_reason}");
        return Ok(Box::new(pread(source, options.depth, options.pread_threads, reason)));
    }
    let reason = format!("the kernel offers io_uring; {direct_reason}");
    match Uring::new(source.clone(), options.depth, reason) {
        Ok(ring) => Ok(Box::new(Failover::new(ring, source, options.pread_threads))),
        Err(error) if options.io == IoChoice::Uring => {
            Err(refused("io_uring does not work here", path, &error.to_string()))
        }
        Err(error) => {
            let reason = format!("io_uring does not work here ({error}); {direct_reason}");
            Ok(Box::new(pread(source, options.depth, options.pread_threads, reason)))
        }
    }
}

fn refused(what: &str, path: &Path, numbers: &str) -> Error {
    Error::new(Code::Usage, what).at(path).numbers(numbers).next(NextStep::AutomaticIo)
}

pub(super) fn open_source(path: &Path, choice: DirectChoice) -> Result<(Source, String)> {
    let buffered = |reason: String| {
        let file = File::open(path).map_err(|error| Error::io("open", path, &error))?;
        // Pages lie in no order that read-ahead could guess.
        let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::Random);
        Ok((Source { file: Arc::new(file), direct: false }, reason))
    };
    if choice == DirectChoice::Off {
        return buffered("buffered reads were asked for".into());
    }
    match open_direct(path) {
        Ok(file) => {
            let source = Source { file: Arc::new(file), direct: true };
            Ok((source, "the file system reads past the page cache".into()))
        }
        Err(error) if choice == DirectChoice::On => {
            File::open(path).map_err(|error| Error::io("open", path, &error))?;
            Err(refused("this file system does not read past the page cache", path, &error.to_string()))
        }
        Err(error) => buffered(format!("no reads past the page cache here ({error})")),
    }
}

/// Opens with O_DIRECT and reads one block to see that it works.
fn open_direct(path: &Path) -> std::io::Result<File> {
    let flags = OFlags::DIRECT.bits() as i32;
    let file = std::fs::OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    let mut block = StagingBuffer::new(ALIGN_BYTES).map_err(std::io::Error::other)?;
    rustix::io::retry_on_intr(|| rustix::io::pread(&file, &mut block[..], 0))?;
    Ok(file)
}
