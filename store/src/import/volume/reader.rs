//! `SampleReader`: the samples of a volume, one after the other, as they lie in their file or unpacked.
//!
//! ```text
//! FileBytes (positioned reads) -> samples
//!                              `-> MultiGzDecoder | ZlibDecoder -> skip -> samples
//! ```
//!
//! Invariants: 1. no more is unpacked than the header declares; 2. what lies behind is dropped from the page cache in
//! steps; 3. a rewound reader gives the same bytes, or an error.

use super::layout::{SamplePacking, VolumeLayout};
use crate::error::{Code, Error, Result};
use crate::import::input::{DROP_STEP_BYTES, drop_page_cache};
use crate::progress::Interrupt;
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::Arc;

/// Bytes that are read before an interrupt is looked at.
const STEP_BYTES: usize = 1 << 20;
/// Bytes that a decoder takes: the window of deflate, its tables, and what it reads ahead.
pub(super) const DECODER_BYTES: u64 = 256 << 10;

/// A file from one byte to another.
struct FileBytes {
    file: Arc<File>,
    at: u64,
    end: u64,
    dropped: u64,
}

impl Read for FileBytes {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let most = (self.end - self.at).min(out.len() as u64) as usize;
        let count = self.file.read_at(&mut out[..most], self.at)?;
        self.at += count as u64;
        if self.at - self.dropped >= DROP_STEP_BYTES {
            drop_page_cache(&self.file, self.dropped, self.at - self.dropped);
            self.dropped = self.at;
        }
        Ok(count)
    }
}

/// The samples of a volume.
pub(super) struct SampleReader {
    file: Arc<File>,
    path: PathBuf,
    packing: SamplePacking,
    from: u64,
    to: u64,
    unpacked_skip: u64,
    /// `None` before the first byte.
    bytes: Option<Box<dyn Read + Send>>,
    /// Bytes of samples that were read.
    done: u64,
    interrupt: Interrupt,
}

impl SampleReader {
    /// Stands before the first sample.
    pub(super) fn new(layout: &VolumeLayout, file: File, interrupt: &Interrupt) -> SampleReader {
        SampleReader {
            file: Arc::new(file),
            path: layout.file_path.clone(),
            packing: layout.packing,
            from: layout.offset,
            to: layout.end,
            unpacked_skip: layout.unpacked_skip,
            bytes: None,
            done: 0,
            interrupt: interrupt.clone(),
        }
    }

    /// Goes back to the first sample.
    pub(super) fn rewind(&mut self) {
        (self.bytes, self.done) = (None, 0);
    }

    /// Bytes of samples that were read.
    pub(super) fn done(&self) -> u64 {
        self.done
    }

    /// Fills `out` with the next bytes.
    pub(super) fn read(&mut self, out: &mut [u8]) -> Result<()> {
        for step in out.chunks_mut(STEP_BYTES) {
            self.interrupt.check()?;
            self.begun()?.read_exact(step).map_err(|error| self.failed(&error))?;
            self.done += step.len() as u64;
        }
        Ok(())
    }

    /// Reads on where samples are packed and all of them have come, so that their sum is checked. The bytes that were
    /// there too many.
    pub(super) fn finish(&mut self) -> Result<bool> {
        if self.packing == SamplePacking::None {
            return Ok(false);
        }
        let mut beyond = [0];
        let count = self.begun()?.read(&mut beyond).map_err(|error| self.failed(&error))?;
        Ok(count > 0)
    }

    /// The stream of samples, behind what is left out before them.
    fn begun(&mut self) -> Result<&mut Box<dyn Read + Send>> {
        if self.bytes.is_none() {
            let file = FileBytes { file: self.file.clone(), at: self.from, end: self.to, dropped: self.from };
            let mut bytes: Box<dyn Read + Send> = match self.packing {
                SamplePacking::None => Box::new(file),
                SamplePacking::Gzip => Box::new(MultiGzDecoder::new(file)),
                SamplePacking::Zlib => Box::new(ZlibDecoder::new(file)),
            };
            let mut left = self.unpacked_skip;
            while left > 0 {
                self.interrupt.check()?;
                let step = left.min(STEP_BYTES as u64);
                let skipped = io::copy(&mut bytes.by_ref().take(step), &mut io::sink());
                match skipped.map_err(|error| self.failed(&error))? {
                    0 => return Err(self.failed(&io::ErrorKind::UnexpectedEof.into())),
                    skipped => left -= skipped,
                }
            }
            self.bytes = Some(bytes);
        }
        Ok(self.bytes.as_mut().expect("just begun"))
    }

    fn failed(&self, error: &io::Error) -> Error {
        let numbers = format!("{} bytes of samples have come: {error}", self.done);
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Error::new(Code::InputTruncated, "the samples end early")
                .at_byte(&self.path, self.to)
                .numbers(numbers)
                .next("copy or download the file again"),
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
                Error::new(Code::InputFormat, "the packed samples are damaged")
                    .at_byte(&self.path, self.from)
                    .numbers(numbers)
                    .next("copy or download the file again")
            }
            _ => Error::io("read the input", &self.path, error),
        }
    }
}
