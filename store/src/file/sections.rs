//! What stands before the tables are known: the superblock, and sections as bytes.
//!
//! Invariants: 1. lengths are those of a superblock that was parsed, which fit the file; 2. nothing is opened but
//! regular files; 3. nothing that was read counts before its hash was compared.

use super::twice;
use crate::error::{Code, Error, Result};
use crate::io::Origin;
use crate::layout::*;
use crate::next_step::NextStep;
use crate::octree::{LowerLinks, LowerSize, UpperOctree, UpperSize};
use crate::url::is_url;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

/// See [`PageFile::upper_size`].
pub(crate) fn upper_size(file: &Origin, block: &Superblock, path: &Path) -> Result<Option<UpperSize>> {
    let kind = SectionKind::Upper;
    let Some(section) = block.find_section(kind) else { return Ok(None) };
    let mut head = [0; UpperOctree::HEAD_BYTES];
    let length = (section.bytes as usize).min(head.len());
    file.read_exact_at(&mut head[..length], section.offset).map_err(|e| Error::io("read", path, &e))?;
    let material_count = block.section(SectionKind::Materials).count;
    UpperOctree::peek(&head[..length], section.bytes, material_count as usize)
        .filter(|size| size.leaf_count == section.count)
        .map(Some)
        .ok_or_else(|| out_of_range(section, kind, path))
}

/// See [`PageFile::lower_size`].
pub(crate) fn lower_size(file: &Origin, block: &Superblock, path: &Path) -> Result<Option<LowerSize>> {
    let kind = SectionKind::Lower;
    let Some(section) = block.find_section(kind) else { return Ok(None) };
    let mut head = [0; LowerLinks::HEAD_BYTES];
    let length = (section.bytes as usize).min(head.len());
    file.read_exact_at(&mut head[..length], section.offset).map_err(|e| Error::io("read", path, &e))?;
    LowerLinks::peek(&head[..length], section.count, section.bytes)
        .map(Some)
        .ok_or_else(|| out_of_range(section, kind, path))
}

/// The bytes of a section of the file with this id, which match its hash.
pub(super) fn checked_section(
    file: &Origin,
    section: Section,
    (kind, file_id): (SectionKind, u64),
    path: &Path,
) -> Result<Vec<u8>> {
    twice(file, (section.offset, section.bytes), || {
        let mut bytes = vec![0; section.bytes as usize];
        file.read_exact_at(&mut bytes, section.offset).map_err(|e| Error::io("read", path, &e))?;
        if section_hash(&bytes, file_id, section.kind) != section.hash {
            return Err(damaged_section(section, kind, path, "does not match its hash"));
        }
        Ok(bytes)
    })
}

/// What `parse` makes of the bytes of a section, which match its hash, while no more than a piece of them is in memory.
/// `parse` need not read to the end; what it gives may be of bytes that are damaged, and is then not used.
pub(crate) fn streamed_section<T>(
    file: &Origin,
    section: Section,
    (kind, file_id): (SectionKind, u64),
    path: &Path,
    mut parse: impl FnMut(&mut HashedSection<'_>) -> Result<T>,
) -> Result<T> {
    twice(file, (section.offset, section.bytes), || {
        let mut reader = HashedSection::new(file, section, file_id);
        let parsed = parse(&mut reader);
        if parsed.as_ref().is_err_and(|error| error.code() != Code::Damaged) {
            return parsed;
        }
        match reader.finish() {
            Err(error) => Err(Error::io("read", path, &error)),
            Ok(false) => Err(damaged_section(section, kind, path, "does not match its hash")),
            Ok(true) => parsed,
        }
    })
}

/// Reads a section from its first byte, and hashes what it hands out.
pub(crate) struct HashedSection<'a> {
    file: &'a Origin,
    section: Section,
    /// Bytes that were read.
    done: u64,
    hasher: Xxh3,
    failed: Option<std::io::Error>,
}

impl<'a> HashedSection<'a> {
    fn new(file: &'a Origin, section: Section, file_id: u64) -> HashedSection<'a> {
        let hasher = section_hasher(file_id, section.kind);
        HashedSection { file, section, done: 0, hasher, failed: None }
    }

    /// Reads what is left, and compares all of it with the hash.
    fn finish(mut self) -> std::io::Result<bool> {
        let mut piece = vec![0; FRAME_BYTES];
        while self.failed.is_none() && self.read(&mut piece).is_ok_and(|length| length > 0) {}
        self.failed.map_or(Ok(self.hasher.digest() == self.section.hash), Err)
    }
}

impl Read for HashedSection<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let length = (self.section.bytes - self.done).min(out.len() as u64) as usize;
        let at = self.section.offset + self.done;
        self.file.fetch_run((at, length as u64), self.section.offset + self.section.bytes);
        let read = self.file.read_exact_at(&mut out[..length], at);
        if let Err(error) = read {
            let kind = error.kind();
            self.failed.get_or_insert(error);
            return Err(kind.into());
        }
        self.hasher.update(&out[..length]);
        self.done += length as u64;
        Ok(length)
    }
}

/// Opens a regular file for reading.
///
/// # Errors
/// Those of [`Origin::open`] for what is no address; [`Code::InputUnreadable`] for an address.
pub fn open_regular(path: &Path) -> Result<File> {
    if is_url(path) {
        return Err(Error::new(Code::InputUnreadable, "this is no file of this machine")
            .at(path)
            .next("copy the file here: page files alone are read from the web"));
    }
    Ok(match Origin::open(path)? {
        Origin::File(file) => file,
        #[cfg(feature = "http")]
        Origin::Http(_) => unreachable!("addresses were told apart"),
    })
}

/// The head, or the tail where the head is damaged; the other way round where the tail is at hand.
pub(crate) fn read_superblock(file: &Origin, path: &Path) -> Result<Superblock> {
    let length = file.length().map_err(|e| Error::io("open", path, &e))?;
    if length < 2 * SUPERBLOCK_BYTES as u64 {
        return Err(Error::new(Code::InputFormat, "this is no trex file: it is too short")
            .at(path)
            .numbers(format!("{length} bytes, at least {}", 2 * SUPERBLOCK_BYTES))
            .next(NextStep::Build));
    }
    let (head, tail) = (0, length - SUPERBLOCK_BYTES as u64);
    let [first, other] = if file.is_far() { [tail, head] } else { [head, tail] };
    let mut bytes = [0; SUPERBLOCK_BYTES];
    file.read_exact_at(&mut bytes, first).map_err(|e| Error::io("read", path, &e))?;
    let block = Superblock::parse(&bytes, path).or_else(|error| {
        if error.code() == Code::Version {
            return Err(error);
        }
        file.read_exact_at(&mut bytes, other).map_err(|_| error.clone())?;
        Superblock::parse(&bytes, path).map_err(|_| error)
    })?;
    if block.file_bytes != length {
        return Err(Error::new(Code::Damaged, "the file has another length than it was published with")
            .at(path)
            .numbers(format!("{length} bytes, expected {}", block.file_bytes))
            .next("copy the file again, or build it again"));
    }
    Ok(block)
}

pub(super) fn out_of_range(section: Section, kind: SectionKind, path: &Path) -> Error {
    damaged_section(section, kind, path, "holds a number out of its range")
}

pub(super) fn damaged_section(section: Section, kind: SectionKind, path: &Path, what: &str) -> Error {
    Error::new(Code::Damaged, format!("the section `{}` {what}", kind.name()))
        .at_byte(path, section.offset)
        .numbers(format!("{} bytes, {} entries", section.bytes, section.count))
        .next(NextStep::Verify)
}
