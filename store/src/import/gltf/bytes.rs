//! Where the bytes of a buffer lie, and how they are read: in a file at an offset, or in the spool, which holds what a
//! file has only in an encoded form.
//!
//! ```text
//! GLB, .bin                       -> BufferPlace::File
//! data URI, compressed view,
//! sparse accessor                 -> decoded once, SpoolWriter -> BufferPlace::Spooled
//! ```
//!
//! Invariants: 1. memory is a block of the spool for each source, and one for the writer, leased by who makes them;
//! 2. a read outside of the place is refused by an assert: lengths are checked when a place is made; 3. blocks of the
//! spool are sealed, and one that does not come back as it was written is an error.

use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::progress::Interrupt;
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

/// Bytes of content in a block of the spool.
pub(super) const SPOOL_BLOCK_BYTES: usize = 16 << 10;
/// Bytes that a source leases.
const SOURCE_BYTES: u64 = (SEAL_BYTES + SPOOL_BLOCK_BYTES) as u64;

/// Bytes of a buffer.
#[derive(Clone, Debug)]
pub(super) enum BufferPlace {
    /// In a file, from an offset on.
    File { path: Arc<Path>, offset: u64, bytes: u64 },
    /// In the spool, from an offset in the content of its blocks on.
    Spooled { offset: u64, bytes: u64 },
}

impl BufferPlace {
    /// Length.
    pub(super) fn bytes(&self) -> u64 {
        match self {
            BufferPlace::File { bytes, .. } | BufferPlace::Spooled { bytes, .. } => *bytes,
        }
    }

    /// A part of this place, which lies in it.
    pub(super) fn part(&self, from: u64, bytes: u64) -> BufferPlace {
        assert!(from + bytes <= self.bytes(), "a part outside of its buffer");
        match self {
            BufferPlace::File { path, offset, .. } => {
                BufferPlace::File { path: path.clone(), offset: offset + from, bytes }
            }
            BufferPlace::Spooled { offset, .. } => BufferPlace::Spooled { offset: offset + from, bytes },
        }
    }
}

/// A file without a name for what has to be decoded before it can be read. Made when the first byte is written.
pub(super) struct Spool {
    scratch: Option<Arc<ScratchFile>>,
    kept: SpoolUse,
    next_block: u64,
    options: ImportOptions,
}

/// What becomes of what is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SpoolUse {
    /// It can be read back.
    Kept,
    /// Nothing: its length is all that is asked for, and no file is made.
    Counted,
}

impl Spool {
    /// An empty one, in the scratch folder of `options`.
    pub(super) fn new(kept: SpoolUse, options: &ImportOptions) -> Spool {
        Spool { scratch: None, kept, next_block: 0, options: options.clone() }
    }

    /// What is leased for reading.
    pub(super) fn budget(&self) -> &Budget {
        &self.options.budget
    }

    /// Begins to write a place of its own.
    pub(super) fn writer(&mut self) -> Result<SpoolWriter<'_>> {
        let lease = self.options.budget.lease("a block of the importer's scratch file", SOURCE_BYTES)?;
        if self.scratch.is_none() && self.kept == SpoolUse::Kept {
            self.scratch = Some(Arc::new(ScratchFile::create(&self.options.temp_dir)?));
        }
        let mut block = Vec::with_capacity(SEAL_BYTES + SPOOL_BLOCK_BYTES);
        block.resize(SEAL_BYTES, 0);
        let first_block = self.next_block;
        Ok(SpoolWriter { spool: self, block, first_block, bytes: 0, _lease: lease })
    }
}

/// Writes a place of the spool from its beginning to its end.
pub(super) struct SpoolWriter<'a> {
    spool: &'a mut Spool,
    block: Vec<u8>,
    first_block: u64,
    bytes: u64,
    _lease: Lease,
}

impl SpoolWriter<'_> {
    /// Appends.
    pub(super) fn write(&mut self, mut bytes: &[u8]) -> Result<()> {
        self.bytes += bytes.len() as u64;
        while !bytes.is_empty() {
            let room = SEAL_BYTES + SPOOL_BLOCK_BYTES - self.block.len();
            let (now, rest) = bytes.split_at(room.min(bytes.len()));
            self.block.extend_from_slice(now);
            bytes = rest;
            if self.block.len() == SEAL_BYTES + SPOOL_BLOCK_BYTES {
                self.flush()?;
            }
        }
        Ok(())
    }

    /// The place of all that was written.
    pub(super) fn finish(mut self) -> Result<BufferPlace> {
        if self.block.len() > SEAL_BYTES {
            self.block.resize(SEAL_BYTES + SPOOL_BLOCK_BYTES, 0);
            self.flush()?;
        }
        let offset = self.first_block * SPOOL_BLOCK_BYTES as u64;
        Ok(BufferPlace::Spooled { offset, bytes: self.bytes })
    }

    fn flush(&mut self) -> Result<()> {
        self.spool.options.interrupt.check()?;
        let at = self.spool.next_block * self.block.len() as u64;
        seal(&mut self.block, at);
        if let Some(scratch) = &self.spool.scratch {
            scratch.write(&self.block, at)?;
        }
        self.spool.next_block += 1;
        self.block.truncate(SEAL_BYTES);
        Ok(())
    }
}

/// Bytes of a place, read at offsets.
pub(super) struct ByteSource {
    place: BufferPlace,
    from: SourceFile,
    interrupt: Interrupt,
    _lease: Lease,
}

enum SourceFile {
    Plain(File),
    /// The block at hand is kept, for reads in a row.
    Sealed {
        scratch: Arc<ScratchFile>,
        block: Vec<u8>,
        at: u64,
    },
}

impl ByteSource {
    /// Opens a place.
    pub(super) fn open(place: &BufferPlace, spool: &Spool) -> Result<ByteSource> {
        let options = &spool.options;
        let (from, leased) = match place {
            BufferPlace::File { path, offset, bytes } => {
                let failed = |error| Error::io("open the input", path, &error);
                let file = File::open(path).map_err(failed)?;
                if file.metadata().map_err(failed)?.len() < offset + bytes {
                    return Err(became_shorter(path, offset + bytes));
                }
                (SourceFile::Plain(file), 0)
            }
            BufferPlace::Spooled { .. } => {
                let scratch = spool.scratch.clone().expect("a spooled place has been written");
                (SourceFile::Sealed { scratch, block: Vec::new(), at: u64::MAX }, SOURCE_BYTES)
            }
        };
        let lease = options.budget.lease("a block of the importer's scratch file", leased)?;
        Ok(ByteSource { place: place.clone(), from, interrupt: options.interrupt.clone(), _lease: lease })
    }

    /// Length of the place.
    pub(super) fn bytes(&self) -> u64 {
        self.place.bytes()
    }

    /// The bytes from `at` on.
    pub(super) fn read(&mut self, at: u64, into: &mut [u8]) -> Result<()> {
        assert!(at + into.len() as u64 <= self.bytes(), "a read outside of its buffer");
        self.interrupt.check()?;
        match (&mut self.from, &self.place) {
            (SourceFile::Plain(file), BufferPlace::File { path, offset, .. }) => {
                file.read_exact_at(into, offset + at).map_err(|error| match error.kind() {
                    std::io::ErrorKind::UnexpectedEof => {
                        became_shorter(path, offset + at + into.len() as u64)
                    }
                    _ => Error::io("read the input", path, &error),
                })
            }
            (SourceFile::Sealed { scratch, block, at: held }, BufferPlace::Spooled { offset, .. }) => {
                let (mut at, mut done) = (offset + at, 0);
                while done < into.len() {
                    let wanted = at / SPOOL_BLOCK_BYTES as u64;
                    if *held != wanted {
                        let offset = wanted * (SEAL_BYTES + SPOOL_BLOCK_BYTES) as u64;
                        *held = u64::MAX;
                        scratch.read(offset, SEAL_BYTES + SPOOL_BLOCK_BYTES, offset, block)?;
                        *held = wanted;
                    }
                    let content = &block[SEAL_BYTES + (at % SPOOL_BLOCK_BYTES as u64) as usize..];
                    let count = content.len().min(into.len() - done);
                    into[done..done + count].copy_from_slice(&content[..count]);
                    done += count;
                    at += count as u64;
                }
                Ok(())
            }
            _ => unreachable!("a source is opened for its place"),
        }
    }
}

fn became_shorter(path: &Path, needed: u64) -> Error {
    Error::new(Code::InputTruncated, "the file became shorter while it was read")
        .at(path)
        .numbers(format!("{needed} bytes were there when it was opened"))
        .next("wait until the program that writes it is done")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_the_spool_come_back_at_any_offset() {
        let folder = tempfile::tempdir().unwrap();
        let options = ImportOptions::unlimited(folder.path());
        let mut spool = Spool::new(SpoolUse::Kept, &options);
        let bytes = |count: usize, step: usize| (0..count).map(|i| (i * step) as u8).collect::<Vec<u8>>();
        let contents = [bytes(3, 1), bytes(50_000, 7), bytes(SPOOL_BLOCK_BYTES, 5), Vec::new()];
        let mut places = Vec::new();
        for content in &contents {
            let mut writer = spool.writer().unwrap();
            content.chunks(999).for_each(|piece| writer.write(piece).unwrap());
            places.push(writer.finish().unwrap());
        }
        for (content, place) in contents.iter().zip(&places) {
            let mut source = ByteSource::open(place, &spool).unwrap();
            assert_eq!(source.bytes(), content.len() as u64);
            for at in (0..content.len()).step_by(1237) {
                let mut read = vec![0; (content.len() - at).min(20_000)];
                source.read(at as u64, &mut read).unwrap();
                assert!(read == content[at..at + read.len()]);
            }
        }
        drop(spool);
        assert_eq!(options.budget.used_bytes(), 0);
    }
}
