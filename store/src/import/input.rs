//! `Input`: one file seen through a sliding window of fixed size.
//!
//! ```text
//! file    |=========dropped=========|----------|#########window#########|...........|
//!                                        base^      ^start           ^end
//! ```
//!
//! Invariants: 1. memory is one leased buffer of [`WINDOW_BYTES`], whatever the file holds; 2. `base + start` is the
//! offset of the next byte; `window()` is the file's content from there on; 3. only regular files are opened, so
//! the length is known before anything is read; 4. what lies behind is dropped from the page cache in steps.

use super::options::ImportOptions;
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::progress::Interrupt;
use rustix::fs::Advice;
use std::fs::File;
use std::num::NonZeroU64;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Bytes of the window. One read of this size costs the disk what it costs to seek, so larger gains nothing.
pub(super) const WINDOW_BYTES: usize = 1 << 20;

/// Bytes after which the page cache behind the reader is dropped: rare enough to cost nothing, small beside any
/// memory limit that a mesh can be opened under.
pub(super) const DROP_STEP_BYTES: u64 = 16 << 20;

/// A regular file that is read mostly forward.
pub(super) struct Input {
    file: File,
    path: PathBuf,
    length: u64,
    buffer: Vec<u8>,
    base: u64,
    start: usize,
    end: usize,
    dropped: u64,
    interrupt: Interrupt,
    _lease: Lease,
}

impl Input {
    /// Opens a regular file that holds at least one byte.
    pub(super) fn open(path: &Path, options: &ImportOptions) -> Result<Input> {
        let failed = |error| Error::io("open the input", path, &error);
        // Asked before the open: opening a pipe would wait for a writer.
        let kind = std::fs::metadata(path).map_err(failed)?;
        if kind.is_dir() {
            return Err(Error::new(Code::InputUnreadable, "the input is a folder")
                .at(path)
                .next("name a mesh file inside of it"));
        }
        if !kind.is_file() {
            return Err(Error::new(Code::InputUnreadable, "the input is not a regular file")
                .at(path)
                .next("save it to a file first: it is read twice, and at more than one place"));
        }
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        if length == 0 {
            return Err(Error::new(Code::InputEmpty, "the input is an empty file")
                .at(path)
                .numbers("0 bytes")
                .next("check how the file was written"));
        }
        let lease = options.budget.lease("the read window of an importer", WINDOW_BYTES as u64)?;
        Ok(Input {
            file,
            path: path.to_path_buf(),
            length,
            buffer: vec![0; WINDOW_BYTES],
            base: 0,
            start: 0,
            end: 0,
            dropped: 0,
            interrupt: options.interrupt.clone(),
            _lease: lease,
        })
    }

    /// The file's path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes in the file.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Offset of the next byte.
    pub(super) fn offset(&self) -> u64 {
        self.base + self.start as u64
    }

    /// Bytes from here to the end of the file.
    pub(super) fn left(&self) -> u64 {
        self.length - self.offset()
    }

    /// A second handle to the same file, for reads elsewhere in it.
    pub(super) fn second_handle(&self) -> Result<File> {
        self.file.try_clone().map_err(|error| Error::io("open the input again", &self.path, &error))
    }

    /// The bytes at hand from `offset()` on; as many as the last [`Input::fill`] left.
    pub(super) fn window(&self) -> &[u8] {
        &self.buffer[self.start..self.end]
    }

    /// Makes the window hold at least `want` bytes, or all that is left of the file.
    #[inline]
    pub(super) fn fill(&mut self, want: usize) -> Result<()> {
        debug_assert!(want <= WINDOW_BYTES);
        if self.end - self.start >= want { Ok(()) } else { self.refill(want) }
    }

    /// Steps over `count` bytes of the window.
    #[inline]
    pub(super) fn consume(&mut self, count: usize) {
        debug_assert!(count <= self.end - self.start);
        self.start += count;
    }

    /// Steps over `to` bytes of the window and gives those in `from..to` of them.
    #[inline]
    pub(super) fn split(&mut self, from: usize, to: usize) -> &[u8] {
        let begin = self.start;
        self.consume(to);
        &self.buffer[begin + from..begin + to]
    }

    /// The next `count` bytes, at most a window of them.
    #[inline]
    pub(super) fn take(&mut self, count: usize) -> Result<&[u8]> {
        self.fill(count)?;
        if self.end - self.start < count {
            return Err(self.truncated(count as u64));
        }
        Ok(self.split(0, count))
    }

    /// Steps over `count` bytes without reading them.
    pub(super) fn skip(&mut self, count: u64) -> Result<()> {
        if count > self.left() {
            return Err(self.truncated(count));
        }
        self.seek(self.offset() + count);
        Ok(())
    }

    /// Goes on at `offset`, which lies in the file or at its end.
    pub(super) fn seek(&mut self, offset: u64) {
        assert!(offset <= self.length, "a seek past the end of the input");
        match offset.checked_sub(self.base) {
            Some(inside) if inside <= self.end as u64 => self.start = inside as usize,
            _ => {
                self.base = offset;
                self.start = 0;
                self.end = 0;
                self.dropped = self.dropped.min(offset);
            }
        }
    }

    /// The error of a file that ends before `needed` more bytes have come.
    pub(super) fn truncated(&self, needed: u64) -> Error {
        Error::new(Code::InputTruncated, "the file ends early")
            .at_byte(&self.path, self.offset())
            .numbers(format!("{needed} bytes needed here, {} left of {}", self.left(), self.length))
            .next("copy or download the file again")
    }

    #[cold]
    fn refill(&mut self, want: usize) -> Result<()> {
        self.buffer.copy_within(self.start..self.end, 0);
        self.base += self.start as u64;
        self.end -= self.start;
        self.start = 0;
        self.drop_behind();
        while self.end < want && self.base + (self.end as u64) < self.length {
            self.interrupt.check()?;
            let at = self.base + self.end as u64;
            // Never past the length found at the start: a file that grows meanwhile changes nothing.
            let most = ((self.length - at) as usize).min(WINDOW_BYTES - self.end);
            match self.file.read_at(&mut self.buffer[self.end..self.end + most], at) {
                Ok(0) => {
                    return Err(Error::new(
                        Code::InputTruncated,
                        "the file became shorter while it was read",
                    )
                    .at_byte(&self.path, at)
                    .numbers(format!("it had {} bytes when it was opened", self.length))
                    .next("wait until the program that writes it is done"));
                }
                Ok(count) => self.end += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Error::io("read the input", &self.path, &error)),
            }
        }
        Ok(())
    }

    fn drop_behind(&mut self) {
        if self.base.saturating_sub(self.dropped) >= DROP_STEP_BYTES {
            drop_page_cache(&self.file, self.dropped, self.base - self.dropped);
            self.dropped = self.base;
        }
    }
}

/// Asks the kernel to forget `length` bytes of `file`. Only a hint: where it is refused, memory is reclaimed later.
pub(super) fn drop_page_cache(file: &File, offset: u64, length: u64) {
    if let Some(length) = NonZeroU64::new(length) {
        let _ = rustix::fs::fadvise(file, offset, Some(length), Advice::DontNeed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn window_slides_over_the_whole_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bytes");
        let bytes: Vec<u8> = (0..WINDOW_BYTES * 2 + 777).map(|i| (i * 7 + i / 256) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let mut input = Input::open(&path, &ImportOptions::unlimited(folder.path())).unwrap();
        let mut seen = Vec::new();
        while input.left() > 0 {
            let step = 10_007.min(input.left() as usize);
            seen.extend_from_slice(input.take(step).unwrap());
        }
        assert!(seen == bytes);
        assert_eq!(input.take(1).unwrap_err().code(), Code::InputTruncated);
        input.seek(5);
        assert_eq!(input.take(3).unwrap(), &bytes[5..8]);
        assert_eq!(input.skip(bytes.len() as u64).unwrap_err().code(), Code::InputTruncated);
    }
}
