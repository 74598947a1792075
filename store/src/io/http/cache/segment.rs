//! `Segment`: a file that holds some ranges of 16 MiB, and says which.
//!
//! ```text
//! 0       magic, 8 bytes
//! 8       xxh3 of what follows up to the last range
//! 16      count of ranges, u64
//! 24      ranges: begin, end (u32 each), ascending, none touches the next
//! 16 KiB  the bytes, each at its place; holes between them
//! ```
//!
//! Invariants
//! 1. A range is written down after its bytes are.
//! 2. A list that does not match its hash, as after a loss of power or two writers at once, is an empty one.
//! 3. Each call opens, reads or writes, and is done: nothing is held between calls.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;
use std::time::{Duration, SystemTime};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes of a file that one segment is for.
pub(super) const SEGMENT_BYTES: u64 = 16 << 20;
/// Bytes of the list.
pub(super) const LIST_BYTES: usize = 16 << 10;
const MAGIC: [u8; 8] = *b"trexseg1";
/// Where the list begins.
const RANGES_AT: usize = 24;
/// Most ranges of a segment: what finds no place in the list is not kept.
const RANGES_MAX: usize = (LIST_BYTES - RANGES_AT) / 8;
/// How old the time of the last use may be.
const USED_WITHIN: Duration = Duration::from_secs(60);

/// One open segment.
pub(super) struct Segment(File);

impl Segment {
    /// One that is there.
    pub(super) fn open(path: &Path) -> io::Result<Segment> {
        OpenOptions::new().read(true).write(true).open(path).map(Segment)
    }

    /// One that is made if it is not there, for its owner alone.
    pub(super) fn create(path: &Path) -> io::Result<Segment> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false).mode(0o600);
        options.open(path).map(Segment)
    }

    /// Fills `out` with the bytes from `from` on.
    ///
    /// # Errors
    /// `NotFound` where some of them are not here; what the system says.
    pub(super) fn read(&self, out: &mut [u8], from: u32) -> io::Result<()> {
        let end = from + out.len() as u32;
        let ranges = self.ranges()?;
        if !ranges.iter().any(|range| range[0] <= from && end <= range[1]) {
            return Err(io::ErrorKind::NotFound.into());
        }
        self.0.read_exact_at(out, LIST_BYTES as u64 + u64::from(from))?;
        let now = SystemTime::now();
        let used = self.0.metadata()?.modified()?;
        if now.duration_since(used).is_ok_and(|since| since > USED_WITHIN) {
            self.0.set_modified(now)?;
        }
        Ok(())
    }

    /// Keeps these bytes, which are those from `from` on.
    pub(super) fn keep(&self, bytes: &[u8], from: u32) -> io::Result<()> {
        self.0.write_all_at(bytes, LIST_BYTES as u64 + u64::from(from))?;
        let mut ranges = self.ranges()?;
        let mut new = [from, from + bytes.len() as u32];
        // Those that it touches become one with it.
        ranges.retain(|range| {
            let is_apart = range[1] < new[0] || new[1] < range[0];
            if !is_apart {
                new = [new[0].min(range[0]), new[1].max(range[1])];
            }
            is_apart
        });
        let at = ranges.partition_point(|range| range[0] < new[0]);
        ranges.insert(at, new);
        if ranges.len() <= RANGES_MAX { self.write_ranges(&ranges) } else { Ok(()) }
    }

    /// Of so many bytes from `from` on nothing is here any more.
    pub(super) fn forget(&self, from: u32, bytes: usize) -> io::Result<()> {
        let end = from + bytes as u32;
        let outside = |range: [u32; 2]| [[range[0], range[1].min(from)], [range[0].max(end), range[1]]];
        let mut left: Vec<[u32; 2]> = self.ranges()?.into_iter().flat_map(outside).collect();
        left.retain(|range| range[0] < range[1]);
        // One that was cut in two may be the last that had a place.
        left.truncate(RANGES_MAX);
        self.write_ranges(&left)
    }

    /// The ranges that are here.
    fn ranges(&self) -> io::Result<Vec<[u32; 2]>> {
        let mut list = vec![0; LIST_BYTES];
        let length = self.0.read_at(&mut list, 0)?;
        let word = |at: usize| {
            list.get(at..at + 8).map(|bytes| u64::from_le_bytes(bytes.try_into().expect("8 bytes")))
        };
        let count = word(16).map_or(0, |count| count.min(RANGES_MAX as u64)) as usize;
        let end = RANGES_AT + 8 * count;
        let is_sound = length >= end && list.starts_with(&MAGIC) && word(8) == Some(xxh3_64(&list[16..end]));
        if !is_sound {
            return Ok(Vec::new());
        }
        let number = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("4 bytes"));
        Ok(list[RANGES_AT..end]
            .chunks_exact(8)
            .map(|range| [number(&range[..4]), number(&range[4..])])
            .collect())
    }

    fn write_ranges(&self, ranges: &[[u32; 2]]) -> io::Result<()> {
        let mut list = Vec::with_capacity(RANGES_AT + 8 * ranges.len());
        list.extend_from_slice(&MAGIC);
        list.extend_from_slice(&[0; 8]);
        list.extend_from_slice(&(ranges.len() as u64).to_le_bytes());
        ranges.iter().flatten().for_each(|number| list.extend_from_slice(&number.to_le_bytes()));
        let hash = xxh3_64(&list[16..]);
        list[8..16].copy_from_slice(&hash.to_le_bytes());
        self.0.write_all_at(&list, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_that_was_torn_is_empty() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0.segment");
        let segment = Segment::create(&path).unwrap();
        assert!(segment.read(&mut [0; 1], 0).is_err());
        segment.keep(&[1, 2, 3, 4], 100).unwrap();
        segment.keep(&[5, 6], 200).unwrap();
        let mut out = [0; 2];
        segment.read(&mut out, 102).unwrap();
        assert_eq!(out, [3, 4]);
        for at in [0, 9, 17, 24, 33] {
            let mut byte = [0];
            segment.0.read_exact_at(&mut byte, at).unwrap();
            segment.0.write_all_at(&[byte[0] ^ 8], at).unwrap();
            assert!(segment.read(&mut out, 102).is_err(), "byte {at}");
            segment.0.write_all_at(&byte, at).unwrap();
            segment.read(&mut out, 102).unwrap();
        }
        // Cut within its bytes: an error, not zeros.
        File::options().write(true).open(&path).unwrap().set_len(LIST_BYTES as u64 + 103).unwrap();
        assert!(segment.read(&mut out, 102).is_err());
    }

    #[test]
    fn more_ranges_than_the_list_has_places_are_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let segment = Segment::create(&folder.path().join("0.segment")).unwrap();
        let ranges: Vec<[u32; 2]> = (0..RANGES_MAX as u32).map(|at| [2 * at, 2 * at + 1]).collect();
        segment.0.write_all_at(&[9; 10_000], LIST_BYTES as u64).unwrap();
        segment.write_ranges(&ranges).unwrap();
        segment.keep(&[1], 9_000).unwrap();
        assert!(segment.read(&mut [0], 9_000).is_err());
        segment.keep(&[1], 1).unwrap();
        segment.read(&mut [0; 3], 0).unwrap();
        segment.keep(&[1], 9_000).unwrap();
        segment.read(&mut [0], 9_000).unwrap();
    }
}
