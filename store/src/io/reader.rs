//! `Reader`: reads of whole extents on top of a raw backend.
//!
//! ```text
//! extent          |          offset ---- stored_bytes ----|
//! raw read   |--- head ---|--------- wanted --------------|- tail -|      (multiples of the backend's alignment)
//! arrival                 staging[head .. head + stored_bytes]
//! ```
//!
//! Invariants
//! 1. Each submitted read comes back as one [`Arrival`], with exactly the bytes asked for or with an error that names
//!    path and offset.
//! 2. Work on one read is bounded: [`INTERRUPTIONS_MAX`] short reads and interruptions, [`FAILURES_MAX`] failures;
//!    what no second read mends ends it at once.
//! 3. Nothing is allocated or copied per read.

use super::{Backend, Extent, IoDescription, RawCompletion, RawRead, StagingBuffer, Wait};
use crate::error::{Code, Error, Result, try_again};
use std::io::ErrorKind;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Short reads, EINTR and EAGAIN that one read may meet. Kernels cut reads at segment borders, some signals
/// repeat; a device that is still not done after sixteen is broken.
pub const INTERRUPTIONS_MAX: u32 = 16;

/// Failures (EIO and the like) that one read may meet. The kernel has retried each of them already.
pub const FAILURES_MAX: u32 = 3;

/// Bytes of staging that a read of up to `bytes` at any offset needs: the covering aligned range.
pub fn staging_bytes_for(bytes: usize) -> usize {
    // Head and tail each are below one block.
    bytes.next_multiple_of(super::ALIGN_BYTES) + super::ALIGN_BYTES
}

/// A read that is done.
pub struct Arrival {
    /// The tag of its `submit`.
    pub tag: u32,
    /// The buffer, back from the backend.
    pub staging: StagingBuffer,
    /// Where in the buffer the extent lies; or why it does not.
    pub result: Result<Range<usize>>,
}

/// State of a read in flight. The slot index is the tag of the raw read.
#[derive(Clone)]
struct ReadInFlight {
    tag: u32,
    offset: u64,
    head: usize,
    wanted: usize,
    raw_bytes: usize,
    /// Where the last short read stopped, from `offset`; 0 before there was one.
    cut: usize,
    interruptions: u32,
    failures: u32,
}

/// Counters of a reader.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReaderStats {
    /// Raw reads that were submitted, repeats included.
    pub reads: u64,
    /// Bytes that arrived, with heads and tails.
    pub bytes: u64,
    /// Raw reads that had to be repeated or continued.
    pub retries: u64,
}

/// Reads extents of one file.
pub struct Reader {
    backend: Box<dyn Backend>,
    path: PathBuf,
    pending: Vec<Option<ReadInFlight>>,
    free: Vec<u32>,
    done: Vec<RawCompletion>,
    stats: ReaderStats,
}

impl Reader {
    /// Reads through `backend`; `path` is for messages.
    pub fn new(backend: Box<dyn Backend>, path: &Path) -> Reader {
        let depth = backend.depth();
        Reader {
            path: path.to_owned(),
            pending: vec![None; depth],
            free: (0..depth as u32).collect(),
            done: Vec::with_capacity(depth),
            stats: ReaderStats::default(),
            backend,
        }
    }

    /// Which backend, and why.
    pub fn describe(&self) -> &IoDescription {
        self.backend.describe()
    }

    /// How many more reads can be submitted now.
    pub fn room(&self) -> usize {
        self.free.len()
    }

    /// Reads submitted that have not come back.
    pub fn in_flight(&self) -> usize {
        self.pending.len() - self.free.len()
    }

    /// Counters of what was read so far.
    pub fn stats(&self) -> ReaderStats {
        self.stats
    }

    /// Starts to read `extent` into `staging`, at the latest with the next [`Reader::complete`].
    ///
    /// # Panics
    /// When there is no [`Reader::room`], the extent is empty, or `staging` is shorter than
    /// [`staging_bytes_for`] the extent.
    pub fn submit(&mut self, tag: u32, extent: Extent, staging: StagingBuffer) {
        let align = self.backend.align_bytes() as u64;
        let start = extent.offset / align * align;
        let raw_bytes = (extent.end().next_multiple_of(align) - start) as usize;
        assert!(extent.stored_bytes > 0, "read of an empty extent");
        assert!(raw_bytes <= staging.len(), "{raw_bytes} bytes into staging of {}", staging.len());
        let index = self.free.pop().expect("more reads than the depth allows");
        self.pending[index as usize] = Some(ReadInFlight {
            tag,
            offset: start,
            head: (extent.offset - start) as usize,
            wanted: extent.stored_bytes as usize,
            raw_bytes,
            cut: 0,
            interruptions: 0,
            failures: 0,
        });
        self.send(RawRead { tag: index, offset: start, at: 0, bytes: raw_bytes, failures: 0, staging });
    }

    /// Appends what has arrived to `arrivals`. With [`Wait::One`], sleeps until there is at least one, unless nothing
    /// is in flight.
    pub fn complete(&mut self, wait: Wait, arrivals: &mut Vec<Arrival>) {
        let before = arrivals.len();
        loop {
            let mut done = std::mem::take(&mut self.done);
            self.backend.complete(wait, &mut done);
            for raw in done.drain(..) {
                if let Some(arrival) = self.judge(raw) {
                    arrivals.push(arrival);
                }
            }
            self.done = done;
            if wait == Wait::No || arrivals.len() > before || self.in_flight() == 0 {
                return;
            }
        }
    }

    fn send(&mut self, read: RawRead) {
        self.stats.reads += 1;
        self.backend.submit(read);
    }

    /// Done, failed, or once more?
    fn judge(&mut self, raw: RawCompletion) -> Option<Arrival> {
        let RawCompletion { mut read, result } = raw;
        let index = read.tag as usize;
        let pending = self.pending[index].as_mut().expect("a completion without a read");
        let mut ends = false;
        let error = match result {
            Ok(got) => {
                assert!(got <= read.bytes, "{got} bytes arrived of {} asked", read.bytes);
                self.stats.bytes += got as u64;
                let have = read.at + got;
                if have >= pending.head + pending.wanted {
                    let range = pending.head..pending.head + pending.wanted;
                    return Some(self.finish(read, Ok(range)));
                }
                // A block that is cut twice at the same byte is the last one of the file.
                if got == 0 || have == pending.cut {
                    let error = ends_early(&self.path, pending, have);
                    return Some(self.finish(read, Err(error)));
                }
                pending.cut = have;
                // Go on from the last whole block that came.
                pending.interruptions += 1;
                read.at = have / self.backend.align_bytes() * self.backend.align_bytes();
                None
            }
            Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => {
                pending.interruptions += 1;
                Some(error)
            }
            Err(error) => {
                pending.failures += 1;
                ends = is_final(&error);
                Some(error)
            }
        };
        if ends || pending.failures >= FAILURES_MAX || pending.interruptions >= INTERRUPTIONS_MAX {
            let error = gives_up(&self.path, pending, error);
            return Some(self.finish(read, Err(error)));
        }
        read.bytes = pending.raw_bytes - read.at;
        read.offset = pending.offset + read.at as u64;
        read.failures = pending.failures;
        self.stats.retries += 1;
        self.send(read);
        None
    }

    fn finish(&mut self, read: RawRead, result: Result<Range<usize>>) -> Arrival {
        let pending = self.pending[read.tag as usize].take().expect("a read that ends twice");
        self.free.push(read.tag);
        Arrival { tag: pending.tag, staging: read.staging, result }
    }
}

/// True for what no second read mends.
pub(super) fn is_final(error: &std::io::Error) -> bool {
    use ErrorKind::{InvalidInput, NotFound, PermissionDenied, StaleNetworkFileHandle, Unsupported};
    matches!(error.kind(), InvalidInput | NotFound | PermissionDenied | StaleNetworkFileHandle | Unsupported)
}

fn ends_early(path: &Path, pending: &ReadInFlight, have: usize) -> Error {
    let offset = pending.offset + pending.head as u64;
    Error::new(Code::Damaged, "the file ends early")
        .at_byte(path, offset)
        .numbers(format!("{} of {} bytes are there", have.saturating_sub(pending.head), pending.wanted))
        .next("copy or build the file again")
}

fn gives_up(path: &Path, pending: &ReadInFlight, error: Option<std::io::Error>) -> Error {
    let cause = error.map_or("the reads stay short".to_owned(), |error| error.to_string());
    let tries = pending.failures + pending.interruptions;
    Error::new(Code::Io, "cannot read")
        .at_byte(path, pending.offset + pending.head as u64)
        .numbers(format!("{cause}, {tries} tries, {} bytes", pending.wanted))
        .next(try_again(path, "check the device (dmesg) and try again"))
}
