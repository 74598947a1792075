//! `Mmap`: copies from a mapping of the file. On request only: the peer that everybody knows.
//!
//! Unsafe code stands here because a mapped file can change under the mapping.
//!
//! Invariants: 1. reads complete in the order of their submission; 2. what was copied is dropped from the mapping and
//! from the page cache, so resident memory stays at one read; 3. the mapping is touched by the kernel alone, which
//! copies from it by `process_vm_readv`: where a file was cut short or its device fails, that is an error of the call,
//! and no SIGBUS. No handler of signals is needed, which a library could not install without a global; 4. nothing
//! behind the end that the file has after the copy counts as read: the rest of its last page in memory reads as zeros.
#![allow(unsafe_code)]

use super::page_cache::drop_cached;
use super::{ALIGN_BYTES, Backend, IoDescription, RawCompletion, RawRead, Wait, check_read};
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use memmap2::{Advice, UncheckedAdvice};
use rustix::io::Errno;
use std::collections::VecDeque;
use std::fs::File;
use std::io;
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
        // SAFETY: no reference into the mapping is ever made: the kernel alone reads it (invariant 3).
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|error| Error::io("map", path, &error))?;
        let _ = map.advise(Advice::Random);
        let description = IoDescription::new("mmap", false, "mmap was asked for".into());
        let mapped = Mmap { map, file, depth, queue: VecDeque::with_capacity(depth), description };
        // Some sandboxes refuse the call that copies.
        mapped.copy(0, &mut [0; 1]).map_err(|error| {
            let numbers = format!("process_vm_readv: {error}");
            let refused = Error::new(Code::Usage, "mapped reads do not work here").at(path).numbers(numbers);
            refused.next(NextStep::AutomaticIo)
        })?;
        Ok(mapped)
    }

    /// Copies from the mapping, at `start`; gives how many bytes the file has there.
    fn copy(&self, start: usize, target: &mut [u8]) -> io::Result<usize> {
        let start = start.min(self.map.len());
        let bytes = target.len().min(self.map.len() - start);
        let to = libc::iovec { iov_base: target.as_mut_ptr().cast(), iov_len: bytes };
        let from = libc::iovec { iov_base: self.map.as_ptr().wrapping_add(start) as *mut _, iov_len: bytes };
        // SAFETY: it writes to `target` alone, at most its length, and only looks at the mapping, which is ours; what
        // cannot be read there is an error of the call.
        let copied = unsafe { libc::process_vm_readv(libc::getpid(), &to, 1, &from, 1, 0) };
        let failed = (copied < 0).then(io::Error::last_os_error);
        let left = self.file.metadata()?.len().saturating_sub(start as u64);
        let there = usize::try_from(left).unwrap_or(usize::MAX).min(bytes);
        match failed {
            // Behind the end of a file that is shorter now.
            Some(_) if there == 0 => Ok(0),
            // Pages that belong to the file and cannot be had.
            Some(error) if error.raw_os_error() == Some(libc::EFAULT) => Err(Errno::IO.into()),
            Some(error) => Err(error),
            None => Ok((copied as usize).min(there)),
        }
    }

    fn forget(&self, start: usize, bytes: usize) {
        let first = start / ALIGN_BYTES * ALIGN_BYTES;
        // SAFETY: dropping pages of a private read-only file mapping only means that they are read again when
        // touched again; no reference into the map is alive.
        let _ = unsafe {
            self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, first, start + bytes - first)
        };
        drop_cached(&self.file, start as u64, bytes as u64);
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

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>) {
        // One copy a call: a page fault is a wait, and the caller has decoding to hand out in between.
        if wait == Wait::No {
            return;
        }
        if let Some(mut read) = self.queue.pop_front() {
            let start = usize::try_from(read.offset).unwrap_or(usize::MAX).min(self.map.len());
            let result = self.copy(start, read.target());
            self.forget(start, read.bytes.min(self.map.len() - start));
            done.push(RawCompletion { read, result });
        }
    }
}
