//! `pread`: a few threads that call `pread`. Works on every kernel and every file system.
//!
//! Invariant: buffered reads are dropped from the page cache once copied.

use super::page_cache::drop_cached;
use super::read_threads::{ReadThreads, ThreadsSetup};
use super::{IoDescription, RawRead, Source};

/// Stack of a reading thread: it calls `pread` and nothing else.
const STACK_BYTES: usize = 64 << 10;

/// Reads `source` with up to `threads` threads, at most `depth`.
pub(super) fn pread(source: Source, depth: usize, threads: usize, reason: String) -> ReadThreads {
    ReadThreads::new(ThreadsSetup {
        description: IoDescription::new("pread", source.direct, reason),
        align_bytes: source.align_bytes(),
        depth,
        threads,
        stack_bytes: STACK_BYTES,
        read: Box::new(move |read| read_once(&source, read)),
        notice: Box::new(|| None),
    })
}

fn read_once(source: &Source, read: &mut RawRead) -> std::io::Result<usize> {
    let (offset, bytes) = (read.offset, read.bytes);
    let got = rustix::io::retry_on_intr(|| rustix::io::pread(&source.file, read.target(), offset))?;
    if !source.direct {
        drop_cached(&source.file, offset, bytes as u64);
    }
    Ok(got)
}
