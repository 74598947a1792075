//! Records: small files that are replaced as a whole, each a head in JSON and blobs, under one hash.
//!
//! ```text
//! XXH3-64 of the rest (8 bytes) | count of parts (8) | length of each part (8 each) | head | blobs
//! ```
//!
//! Invariants: 1. a record is the one that was written last or the one before, never a part of one: it is written under
//! another name, synced, renamed, and its folder synced; 2. what does not match its hash counts as absent; 3. memory to
//! read one is leased by its length.

use crate::budget::Budget;
use crate::error::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Bytes before the head of a record without blobs.
const WORD_BYTES: usize = 8;
/// Most parts of a record.
const PARTS: usize = 16;
/// Memory to read a record, over its length: its bytes, and what is parsed of them.
pub(crate) const READING: u64 = 4;

/// A record that was read.
pub(crate) struct JournalRecord<T> {
    pub(crate) head: T,
    pub(crate) blobs: Vec<Vec<u8>>,
}

/// The name under which a record is written.
pub(crate) fn unfinished(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    name.into()
}

/// Writes the record `path`, whose folder is `folder`.
pub(crate) fn write(path: &Path, folder: &Path, head: &impl Serialize, blobs: &[&[u8]]) -> Result<()> {
    let (unfinished, failed) = (unfinished(path), |e| Error::writing("write the journal", path, &e));
    let mut file = File::create(&unfinished).map_err(failed)?;
    write_to(&mut file, head, blobs).map_err(failed)?;
    file.sync_all().map_err(failed)?;
    std::fs::rename(&unfinished, path).map_err(failed)?;
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)
}

/// Writes the bytes of a record; gives their hash.
pub(crate) fn write_to(out: &mut dyn Write, head: &impl Serialize, blobs: &[&[u8]]) -> std::io::Result<u64> {
    let head = serde_json::to_vec(head).expect("heads are plain data");
    let parts: Vec<&[u8]> = std::iter::once(head.as_slice()).chain(blobs.iter().copied()).collect();
    assert!(parts.len() <= PARTS);
    let mut lengths = Vec::from((parts.len() as u64).to_le_bytes());
    parts.iter().for_each(|part| lengths.extend((part.len() as u64).to_le_bytes()));
    let mut hasher = Xxh3::new();
    hasher.update(&lengths);
    parts.iter().for_each(|part| hasher.update(part));
    out.write_all(&hasher.digest().to_le_bytes())?;
    out.write_all(&lengths)?;
    parts.iter().try_for_each(|part| out.write_all(part))?;
    Ok(hasher.digest())
}

/// Reads the record `path`; `None` where there is none that is whole.
pub(crate) fn read<T: DeserializeOwned>(path: &Path, budget: &Budget) -> Result<Option<JournalRecord<T>>> {
    let failed = |e| Error::io("read the journal", path, &e);
    let length = match path.metadata() {
        Ok(found) => found.len(),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(error)),
    };
    let _lease = budget.lease("the journal", length.saturating_mul(READING))?;
    Ok(parse(&std::fs::read(path).map_err(failed)?))
}

/// The record of these bytes; `None` where they are no whole one.
pub(crate) fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Option<JournalRecord<T>> {
    let word = |at: usize| Some(u64::from_le_bytes(bytes.get(at..at + WORD_BYTES)?.try_into().ok()?));
    let mut hasher = Xxh3::new();
    hasher.update(bytes.get(WORD_BYTES..)?);
    let count = usize::try_from(word(WORD_BYTES)?).ok().filter(|count| (1..=PARTS).contains(count))?;
    if hasher.digest() != word(0)? {
        return None;
    }
    let mut parts = Vec::with_capacity(count);
    let mut rest = bytes.get((2 + count) * WORD_BYTES..)?;
    for part in 0..count {
        let (this, after) = rest.split_at_checked(usize::try_from(word((2 + part) * WORD_BYTES)?).ok()?)?;
        parts.push(this);
        rest = after;
    }
    let head = serde_json::from_slice(parts[0]).ok()?;
    rest.is_empty()
        .then(|| JournalRecord { head, blobs: parts[1..].iter().map(|part| part.to_vec()).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_whole_or_absent() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record");
        let budget = Budget::unlimited();
        assert!(read::<Vec<u32>>(&path, &budget).unwrap().is_none());
        write(&path, folder.path(), &vec![1, 2], &[b"first"]).unwrap();
        write(&path, folder.path(), &vec![3, 4, 5], &[b"", b"second"]).unwrap();
        let record = read::<Vec<u32>>(&path, &budget).unwrap().unwrap();
        assert_eq!((record.head, record.blobs), (vec![3, 4, 5], vec![Vec::new(), b"second".to_vec()]));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let bytes = std::fs::read(&path).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(parse::<Vec<u32>>(&flipped).is_none(), "bit {bit}");
        }
        for length in 0..bytes.len() {
            assert!(parse::<Vec<u32>>(&bytes[..length]).is_none(), "{length} bytes");
        }
    }
}
