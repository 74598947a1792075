//! Reading a file that is larger than memory: backends behind one trait, and the policy above them.
//!
//! ```text
//! pool -> Reader (alignment, retries, errors with a place)
//!           -> Backend: failover(uring, pread) | pread | mmap | http, s3 | memory | fault(another)
//!                                                                    (raw reads, may fall short or fail)
//! ```
//!
//! Invariants
//! 1. A [`StagingBuffer`] moves into the backend with its read and moves out with the completion. Nobody else can
//!    touch or free it while the kernel may write, since nobody else has it.
//! 2. Every read that was submitted completes exactly once, or the backend is dropped, which waits for it.
//! 3. A backend reports what the system said. Only [`Reader`] judges, retries and gives up.
//! 4. No device and no kernel ends the work by refusing a system call: a ring that fails is left for `pread`.
//! 5. At most [`Backend::depth`] reads are in flight: the queue stays on our side of the disk.

mod failover;
mod fault;
#[cfg(feature = "http")]
mod http;
mod memory;
mod mmap;
mod network;
mod open;
mod origin;
mod page_cache;
mod pread;
mod read_threads;
mod reader;
mod region;
mod source;
#[cfg(test)]
mod tests;
mod uring;

pub use failover::Failover;
pub use fault::{Fault, FaultPlan};
pub use memory::Memory;
pub use mmap::Mmap;
pub use network::{CacheOptions, NetworkOptions, S3Keys, S3Options, network_options, set_network_options};
pub use open::{CONNECTION_BYTES, DEPTH_MAX, DirectChoice, IoChoice, IoOptions, open};
pub use origin::Origin;
pub(crate) use page_cache::drop_cached;
pub use read_threads::ReadThreads;
pub use reader::{Arrival, FAILURES_MAX, INTERRUPTIONS_MAX, Reader, ReaderStats, staging_bytes_for};
pub(crate) use region::Region;
pub use source::{IoDescription, Source};
pub use uring::Uring;

use std::ops::{Deref, DerefMut};

/// Offsets, lengths and buffers of direct reads are multiples of this. 4096 suits every device with sectors of 512
/// or 4096 bytes, and is the page size where buffered reads are dropped from the cache.
pub const ALIGN_BYTES: usize = 4096;

/// Where a page lies in the file: byte-packed, any offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// First byte in the file.
    pub offset: u64,
    /// Bytes stored there. At least 1.
    pub stored_bytes: u32,
}

impl Extent {
    /// One past the last byte.
    pub fn end(&self) -> u64 {
        self.offset + u64::from(self.stored_bytes)
    }
}

/// A buffer for reads: anonymous memory of its own, aligned to [`ALIGN_BYTES`].
pub struct StagingBuffer(Region);

impl StagingBuffer {
    /// A zeroed buffer of at least `bytes`, rounded up to whole [`ALIGN_BYTES`].
    ///
    /// # Errors
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit) when the system refuses.
    pub fn new(bytes: usize) -> crate::Result<StagingBuffer> {
        Region::reserve(bytes.next_multiple_of(ALIGN_BYTES).max(ALIGN_BYTES)).map(StagingBuffer)
    }
}

impl Deref for StagingBuffer {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        self.0.bytes()
    }
}

impl DerefMut for StagingBuffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        self.0.bytes_mut()
    }
}

/// One read for a backend: file bytes `offset .. offset + bytes` to `staging[at .. at + bytes]`.
pub struct RawRead {
    /// Comes back unchanged.
    pub tag: u32,
    /// First byte in the file.
    pub offset: u64,
    /// First byte in the buffer.
    pub at: usize,
    /// How many bytes.
    pub bytes: usize,
    /// Times that it has failed before.
    pub failures: u32,
    /// The buffer, owned by the read.
    pub staging: StagingBuffer,
}

impl RawRead {
    /// The part of the buffer that the read fills.
    ///
    /// # Panics
    /// When the part lies outside of the buffer.
    pub fn target(&mut self) -> &mut [u8] {
        &mut self.staging[self.at..self.at + self.bytes]
    }
}

/// A read that has come back.
pub struct RawCompletion {
    /// The read with its buffer.
    pub read: RawRead,
    /// Bytes that arrived, fewer than asked at the end of the file and whenever the system likes; or its error.
    pub result: std::io::Result<usize>,
}

/// Whether [`Backend::complete`] may sleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wait {
    /// Take what is there.
    No,
    /// Sleep until at least one read has completed. Returns at once when none is in flight.
    One,
}

/// A way to read one file. Used by one thread at a time. Dropping it waits for all reads in flight.
pub trait Backend: Send {
    /// Which backend, direct or not, and why.
    fn describe(&self) -> &IoDescription;

    /// Offsets, lengths and buffer positions must be multiples of this: 1 or [`ALIGN_BYTES`].
    fn align_bytes(&self) -> usize;

    /// Most reads in flight at once.
    fn depth(&self) -> usize;

    /// Reads in flight: submitted and not yet handed out by [`Backend::complete`].
    fn in_flight(&self) -> usize;

    /// Takes a read over. It may start only with the next [`Backend::complete`].
    ///
    /// # Panics
    /// When `depth` reads are in flight already, or the read breaks the alignment or its buffer.
    fn submit(&mut self, read: RawRead);

    /// Starts what was submitted and appends what has completed to `done`, in any order.
    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>);
}

/// The checks that every backend makes on a read it takes over.
fn check_read(read: &RawRead, in_flight: usize, depth: usize, align: usize) {
    assert!(in_flight < depth, "{in_flight} reads in flight, depth {depth}");
    assert!(read.bytes > 0 && read.at + read.bytes <= read.staging.len(), "the read leaves its buffer");
    let aligned = read.offset.is_multiple_of(align as u64)
        && read.at.is_multiple_of(align)
        && read.bytes.is_multiple_of(align);
    assert!(aligned, "read of {} bytes at {} is not aligned to {align}", read.bytes, read.offset);
}
