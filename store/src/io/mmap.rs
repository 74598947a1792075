//! `Mmap`: copies from a mapping of the file. On request only: the peer that everybody knows.
//!
//! Unsafe code stands here because a mapped file can change under the mapping.
//!
//! Invariants: 1. reads complete in the order of their submission; 2. what was copied is dropped from the mapping and
//! from the page cache, so resident memory stays at one read; 3. a file that is cut short while mapped ends the
//! process with SIGBUS: `.trex` files are immutable once published, and the other backends have no such hazard.
#![allow(unsafe_code)]

use super::open::drop_cached;
use super::{ALIGN_BYTES, Backend, IoDescription, RawDone, RawRead, Wait, check_read};
use crate::error::{Error, Result};
use memmap2::{Advice, UncheckedAdvice};
use std::collections::VecDeque;
use std::fs::File;
use std::path::Path;

/// Reads from a mapping.
pub struct Mmap {
    map: memmap2::Mmap,
    file: File,
    depth: usize,
    queue: VecDeque<RawRead>,
    description: IoDescription,
}

impl Mmap {
    /// Maps `file`; `path` is for messages.
    ///
    /// # Errors
    /// [`Code::Io`](crate::Code::Io) when the file cannot be mapped.
    pub fn new(file: File, path: &Path, depth: usize) -> Result<Mmap> {
        // SAFETY: the mapping is only read, and only by copies of bytes; files are immutable once published
        // (invariant 3 says what happens to who breaks that).
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|error| Error::io("map", path, &error))?;
        let _ = map.advise(Advice::Random);
        let description = IoDescription::new("mmap", false, "mmap was asked for".into());
        Ok(Mmap { map, file, depth, queue: VecDeque::with_capacity(depth), description })
    }

    fn forget(&self, start: usize, bytes: usize) {
        let first = start / ALIGN_BYTES * ALIGN_BYTES;
        // SAFETY: dropping pages of a private read-only file mapping only means that they are read again when
        // touched again; no reference into the map is alive.
        let _ = unsafe {
            self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, first, start + bytes - first)
        };
        drop_cached(&self.file, start as u64, bytes);
    }
}

impl Backend for Mmap {
    fn describe(&self) -> &IoDescription {
        &self.description
    }

    fn align_bytes(&self) -> usize {
        1
    }

    fn depth(&self) -> usize {
        self.depth
    }

    fn in_flight(&self) -> usize {
        self.queue.len()
    }

    fn submit(&mut self, read: RawRead) {
        check_read(&read, self.queue.len(), self.depth, 1);
        self.queue.push_back(read);
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawDone>) {
        // One copy a call: a page fault is a wait, and the caller has decoding to hand out in between.
        if wait == Wait::No {
            return;
        }
        if let Some(mut read) = self.queue.pop_front() {
            let start = usize::try_from(read.offset).unwrap_or(usize::MAX).min(self.map.len());
            let bytes = read.bytes.min(self.map.len() - start);
            read.target()[..bytes].copy_from_slice(&self.map[start..start + bytes]);
            self.forget(start, bytes);
            done.push(RawDone { result: Ok(bytes), read });
        }
    }
}
