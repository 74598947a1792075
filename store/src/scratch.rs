//! `ScratchFile`: what a build spills to disk comes back as it was written, or as an error.
//!
//! ```text
//! block = XXH3-64 of the rest, seeded with the block's name (8 bytes) | content
//! ```
//!
//! A disk or a cable that turns one bit would otherwise make a model that is wrong and whose every hash is right.
//!
//! Invariants: 1. the file is unlinked from the start, and a killed build leaves nothing, but for those that a journal
//! names (`build`); 2. no byte of a block is looked
//! at before its hash was checked, past the page cache where it did not match; 3. the length of a block is known to who
//! wrote it, and never read from the file; 4. a name is given once in a file, so a block in another's place does not
//! pass.

use crate::error::{Code, Error, Result};
use crate::file::open_regular;
use crate::io::drop_cached;
use crate::next_step::NextStep;
use rustix::fs::fdatasync;
use rustix::io::retry_on_intr;
use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// Bytes of a block before its content.
pub(crate) const SEAL_BYTES: usize = 8;

/// Where a scratch file is.
pub(crate) enum Place {
    /// Without a name, in this folder.
    Unnamed(PathBuf),
    /// A new one of this name, which a journal keeps or removes.
    New(PathBuf),
    /// The one that a build before this left under this name.
    Left(PathBuf),
}

/// What a file of blocks is to those who read its errors.
#[derive(Clone, Copy, PartialEq, Eq)]
enum BlockFileKind {
    Scratch,
    /// Of a build in shards.
    Fragment,
    /// Of a build in shards, with its triangles.
    ShardPlan,
}

/// A file of blocks.
pub(crate) struct ScratchFile {
    file: File,
    /// The file, or its folder where it has no name.
    folder: PathBuf,
    kind: BlockFileKind,
}

/// Writes the hash of `block[SEAL_BYTES..]` to its first bytes.
pub(crate) fn seal(block: &mut [u8], name: u64) {
    let (hash, content) = block.split_at_mut(SEAL_BYTES);
    hash.copy_from_slice(&xxh3_64_with_seed(content, name).to_le_bytes());
}

impl ScratchFile {
    /// A new file in `folder`, without a name.
    pub(crate) fn create(folder: &Path) -> Result<ScratchFile> {
        ScratchFile::at(Place::Unnamed(folder.to_path_buf()))
    }

    /// The file of a place.
    pub(crate) fn at(place: Place) -> Result<ScratchFile> {
        let mut options = OpenOptions::new();
        options.read(true).write(true);
        let (file, folder) = match place {
            Place::Unnamed(folder) => (tempfile::tempfile_in(&folder), folder),
            Place::New(path) => (options.create(true).truncate(true).mode(0o600).open(&path), path),
            Place::Left(path) => (options.open(&path), path),
        };
        let file = file.map_err(|e| Error::writing("create a scratch file", &folder, &e))?;
        Ok(ScratchFile { file, folder, kind: BlockFileKind::Scratch })
    }

    /// A fragment of a build, whose blocks are read alone.
    pub(crate) fn of_fragment(path: PathBuf) -> Result<ScratchFile> {
        let file = open_regular(&path)?;
        Ok(ScratchFile { file, folder: path, kind: BlockFileKind::Fragment })
    }

    /// A plan of a build in shards that is open, whose blocks are read alone.
    pub(crate) fn of_plan(file: File, path: PathBuf) -> ScratchFile {
        ScratchFile { file, folder: path, kind: BlockFileKind::ShardPlan }
    }

    /// Waits until all that was written is on the disk.
    pub(crate) fn sync(&self) -> Result<()> {
        let synced = retry_on_intr(|| fdatasync(&self.file));
        synced.map_err(|e| self.failed("write to", &e.into()))
    }

    /// The file, for what is neither reading nor writing.
    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Writes sealed blocks.
    pub(crate) fn write(&self, blocks: &[u8], offset: u64) -> Result<()> {
        self.file.write_all_at(blocks, offset).map_err(|e| self.failed("write to", &e))
    }

    /// Reads the block of so many bytes, seal included, and gives its content.
    pub(crate) fn read<'a>(
        &self,
        offset: u64,
        bytes: usize,
        name: u64,
        buffer: &'a mut Vec<u8>,
    ) -> Result<&'a [u8]> {
        buffer.resize(bytes, 0);
        let mut hashes = (0, 0);
        for is_again in [false, true] {
            if is_again {
                drop_cached(&self.file, offset, bytes as u64);
            }
            self.file.read_exact_at(buffer, offset).map_err(|e| self.failed("read", &e))?;
            let (hash, content) = buffer.split_first_chunk::<SEAL_BYTES>().expect("a block is sealed");
            hashes = (xxh3_64_with_seed(content, name), u64::from_le_bytes(*hash));
            if hashes.0 == hashes.1 {
                return Ok(&buffer[SEAL_BYTES..]);
            }
        }
        let numbers = format!("{bytes} bytes: hash {:016x}, expected {:016x}", hashes.0, hashes.1);
        Err(self.damaged(offset).numbers(numbers))
    }

    /// Reads bytes as they stand: nobody looks at what is in their blocks.
    pub(crate) fn read_plain(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        self.file.read_exact_at(buffer, offset).map_err(|e| self.failed("read", &e))
    }

    /// The error of a block that is not what was written.
    pub(crate) fn damaged(&self, offset: u64) -> Error {
        let damaged = |what: &str, next| {
            Error::new(Code::Damaged, what)
                .at_byte(&self.folder, offset)
                .numbers("a block is not what was written, or cannot be one of a build")
                .next(next)
        };
        match self.kind {
            BlockFileKind::Scratch => {
                Error::new(Code::Io, "the scratch file gave back other bytes than were written")
                    .at_byte(&self.folder, offset)
                    .next(NextStep::CheckScratchDisk)
            }
            BlockFileKind::Fragment => damaged("a fragment of a build is damaged", NextStep::BuildShardAgain),
            BlockFileKind::ShardPlan => {
                damaged("a plan of a build in shards is damaged", NextStep::ScanAgain)
            }
        }
    }

    /// The error of a call that failed: `doing` what to the file.
    pub(crate) fn failed(&self, doing: &str, error: &std::io::Error) -> Error {
        let name = match self.kind {
            BlockFileKind::Scratch => "the scratch file",
            BlockFileKind::Fragment => "the fragment",
            BlockFileKind::ShardPlan => "the plan",
        };
        let failed = Error::writing(&format!("{doing} {name}"), &self.folder, error);
        if error.kind() == ErrorKind::StorageFull && self.kind == BlockFileKind::Scratch {
            return failed.next(NextStep::FreeScratchSpace);
        }
        failed
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    impl ScratchFile {
        /// Turns one bit, as a bad disk would.
        pub(crate) fn flip(&self, bit: u64) {
            let mut byte = [0];
            self.file.read_exact_at(&mut byte, bit / 8).unwrap();
            byte[0] ^= 1 << (bit % 8);
            self.file.write_all_at(&byte, bit / 8).unwrap();
        }
    }

    #[test]
    fn a_block_comes_back_or_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = ScratchFile::create(folder.path()).unwrap();
        let mut block: Vec<u8> = (0..100).collect();
        seal(&mut block, 7);
        scratch.write(&block, 50).unwrap();
        let read = |name| scratch.read(50, 100, name, &mut Vec::new()).map(<[u8]>::to_vec);
        assert_eq!(read(7).unwrap(), &block[SEAL_BYTES..]);
        assert_eq!(read(8).unwrap_err().code(), Code::Io, "another block's name");
        for bit in 8 * 50..8 * 150 {
            scratch.flip(bit);
            let error = read(7).unwrap_err();
            assert!(
                error.place().ends_with("at byte 50")
                    && *error.next_step_kind() == NextStep::CheckScratchDisk,
                "{error}"
            );
            scratch.flip(bit);
        }
        assert!(read(7).is_ok());
    }
}
