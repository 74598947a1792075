//! The reader under the decoders: it remembers where they stood when they gave up.
//!
//! Invariants: 1. a failure of the device, the end of the file and a byte that makes no sense are told apart,
//! whatever the decoder made of them; 2. a raised interrupt ends the next read.

use super::head::{Format, Origin};
use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};
use trex_store::{Code, Error, Result};

/// First bytes of a PNG.
const PNG_MAGIC: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// First bytes of an OpenEXR file.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// A reader that is watched.
pub(super) struct Source<'a, R> {
    inner: R,
    /// Where it comes from.
    pub(super) origin: Origin<'a>,
    position_bytes: u64,
    ended: bool,
    failed: Option<io::Error>,
}

impl<'a, R: BufRead + Seek> Source<'a, R> {
    pub(super) fn new(inner: R, origin: Origin<'a>) -> Self {
        Source { inner, origin, position_bytes: 0, ended: false, failed: None }
    }

    /// Back to the first byte.
    pub(super) fn rewind(&mut self) -> Result<()> {
        match self.seek(SeekFrom::Start(0)) {
            Ok(_) => Ok(()),
            Err(error) => Err(self.refused(&error.to_string())),
        }
    }

    /// The format, by the first bytes; the source stands at its start afterwards.
    pub(super) fn format(&mut self) -> Result<Format> {
        self.rewind()?;
        let mut magic = Vec::with_capacity(PNG_MAGIC.len());
        if let Err(error) = self.by_ref().take(PNG_MAGIC.len() as u64).read_to_end(&mut magic) {
            return Err(self.refused(&error.to_string()));
        }
        self.rewind()?;
        self.ended = false;
        if magic == PNG_MAGIC {
            return Ok(Format::Png);
        }
        if magic.starts_with(&EXR_MAGIC) {
            return Ok(Format::Exr);
        }
        let what = if magic.is_empty() {
            Error::new(Code::InputEmpty, "the picture is empty")
        } else {
            Error::new(Code::InputFormat, "the file is neither a PNG nor an EXR")
        };
        Err(what
            .at(self.origin.path)
            .numbers(format!("{} bytes, the first of them {magic:02x?}", self.origin.file_bytes))
            .next("name pictures that end in .png or .exr"))
    }

    /// The error of a decoder that gave up with `why`.
    pub(super) fn refused(&mut self, why: &str) -> Error {
        if let Err(interrupted) = self.origin.interrupt.check() {
            return interrupted;
        }
        if let Some(failed) = &self.failed {
            return Error::io("read the picture", self.origin.path, failed);
        }
        let numbers = format!("{} bytes long; {why}", self.origin.file_bytes);
        let error = if self.ended {
            Error::new(Code::InputTruncated, "the picture ends early")
        } else {
            Error::new(Code::InputFormat, "the picture cannot be decoded")
        };
        error
            .at_byte(self.origin.path, self.position_bytes)
            .numbers(numbers)
            .next("write or copy the picture again")
    }
}

impl<R: BufRead> BufRead for Source<'_, R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.origin.interrupt.is_raised() {
            return Err(io::Error::other("interrupted"));
        }
        match self.inner.fill_buf() {
            Ok(bytes) => {
                self.ended |= bytes.is_empty();
                Ok(bytes)
            }
            Err(error) => {
                if error.kind() != ErrorKind::Interrupted {
                    self.failed = Some(again(&error));
                }
                Err(error)
            }
        }
    }

    fn consume(&mut self, bytes: usize) {
        self.position_bytes += bytes as u64;
        self.inner.consume(bytes);
    }
}

impl<R: BufRead> Read for Source<'_, R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        if to.is_empty() {
            return Ok(0);
        }
        let count = self.fill_buf()?.read(to)?;
        self.consume(count);
        Ok(count)
    }
}

impl<R: Seek> Seek for Source<'_, R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self.inner.seek(to) {
            Ok(position) => {
                self.position_bytes = position;
                Ok(position)
            }
            Err(error) => {
                // A place before the start or past all numbers comes from a table in the file.
                if error.kind() != ErrorKind::InvalidInput {
                    self.failed = Some(again(&error));
                }
                Err(error)
            }
        }
    }
}

/// The same error once more: the decoder takes the first.
fn again(error: &io::Error) -> io::Error {
    error.raw_os_error().map_or_else(|| error.kind().into(), io::Error::from_raw_os_error)
}
