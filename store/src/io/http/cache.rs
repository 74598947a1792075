//! `RangeCache`: ranges of one version of a file behind an address, kept on this machine's disk.
//!
//! ```text
//! FOLDER/                       any number of files, versions and processes
//!   32 hexadecimal digits/      one version of one file: hash of its address, length, ETag or date
//!     12.segment                16 MiB of it from 12 * 16 MiB on: those ranges that were read (`segment`)
//! ```
//!
//! Invariants
//! 1. What is read from it is compared with hashes by whoever reads, as what a server gives is. Bytes that did not
//!    match are forgotten here, and asked of the server again.
//! 2. Nothing is removed but segments, by their names, and folders that they leave empty.
//! 3. A cache that cannot be written, or is full of others' files, ends nothing: nothing more is kept, and
//!    [`RangeCache::trouble`] says why.
//! 4. What it holds in memory does not grow with what it holds on disk.

mod segment;

use crate::io::network::CacheOptions;
use segment::{LIST_BYTES, SEGMENT_BYTES, Segment};
use std::collections::BinaryHeap;
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

/// Ending of the names of segments.
const ENDING: &str = "segment";
/// Segments that are removed before the folder is looked through again.
const REMOVED_AT_ONCE: usize = 256;

/// What is kept of one version of one file.
pub(super) struct RangeCache {
    /// Of all versions and files.
    folder: PathBuf,
    /// Of this version.
    place: PathBuf,
    limit_bytes: u64,
    writer: Mutex<CacheWriter>,
}

/// What one writer at a time knows.
#[derive(Default)]
struct CacheWriter {
    /// Bytes of all segments, as far as is known; none before the folder was looked through.
    used_bytes: Option<u64>,
    /// Why nothing more is kept.
    trouble: Option<String>,
}

impl RangeCache {
    /// The place of the version `version` (any text that tells it from others) of the file at `address`.
    pub(super) fn new(options: &CacheOptions, address: &str, version: &str) -> RangeCache {
        let name = xxhash_rust::xxh3::xxh3_128(format!("{address}\n{version}").as_bytes());
        RangeCache {
            folder: options.folder.clone(),
            place: options.folder.join(format!("{name:032x}")),
            limit_bytes: options.limit_bytes,
            writer: Mutex::default(),
        }
    }

    /// Fills `out` with the bytes from `offset` on; false where some of them are not here.
    pub(super) fn read(&self, out: &mut [u8], offset: u64) -> bool {
        let mut pieces = pieces(offset, out.len());
        pieces.all(|piece| {
            let bytes = &mut out[piece.at..piece.at + piece.bytes];
            Segment::open(&self.path(piece.segment))
                .and_then(|segment| segment.read(bytes, piece.from))
                .is_ok()
        })
    }

    /// Keeps these bytes, which are those from `offset` on.
    pub(super) fn keep(&self, bytes: &[u8], offset: u64) {
        let mut writer = self.lock();
        if writer.trouble.is_none()
            && let Err(error) = self.try_keep(bytes, offset, &mut writer)
        {
            writer.trouble = Some(format!("nothing more is kept in {}: {error}", self.folder.display()));
        }
    }

    /// These bytes are asked of the server again.
    pub(super) fn forget(&self, offset: u64, bytes: u64) {
        let _one_at_a_time = self.lock();
        for piece in pieces(offset, bytes as usize) {
            let path = self.path(piece.segment);
            let forgotten = Segment::open(&path).and_then(|segment| segment.forget(piece.from, piece.bytes));
            // What cannot be marked goes as a whole.
            if forgotten.is_err() {
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Why nothing more is kept, once that is so.
    pub(super) fn trouble(&self) -> Option<String> {
        self.lock().trouble.clone()
    }

    /// The folder of all files, as it is told.
    pub(super) fn folder(&self) -> std::path::Display<'_> {
        self.folder.display()
    }

    fn lock(&self) -> MutexGuard<'_, CacheWriter> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn path(&self, segment: u64) -> PathBuf {
        self.place.join(format!("{segment}.{ENDING}"))
    }

    fn try_keep(&self, bytes: &[u8], offset: u64, writer: &mut CacheWriter) -> io::Result<()> {
        if writer.used_bytes.is_none() {
            // For its owner alone: models may be nobody else's business.
            DirBuilder::new().recursive(true).mode(0o700).create(&self.folder)?;
        }
        let added: u64 = pieces(offset, bytes.len()).map(|piece| disk_bytes(piece.bytes)).sum();
        let used = match writer.used_bytes {
            Some(used) => used + added,
            None => used_bytes(&self.folder)? + added,
        };
        writer.used_bytes = Some(if used <= self.limit_bytes { used } else { self.make_room(added)? });
        for piece in pieces(offset, bytes.len()) {
            let part = &bytes[piece.at..piece.at + piece.bytes];
            // Its folder may go in between, which another process has emptied.
            let segment = self.segment(piece.segment).or_else(|error| match error.kind() {
                io::ErrorKind::NotFound => self.segment(piece.segment),
                _ => Err(error),
            });
            segment?.keep(part, piece.from)?;
        }
        Ok(())
    }

    /// The file of a segment, in its folder.
    fn segment(&self, segment: u64) -> io::Result<Segment> {
        DirBuilder::new().recursive(true).mode(0o700).create(&self.place)?;
        Segment::create(&self.path(segment))
    }

    /// Removes what was not used for longest until `wanted` more bytes and an eighth of the limit are free; bytes that
    /// are used then, with those.
    fn make_room(&self, wanted: u64) -> io::Result<u64> {
        let most = (self.limit_bytes - self.limit_bytes / 8).saturating_sub(wanted);
        loop {
            let (mut used, mut oldest) = (0, BinaryHeap::new());
            each_segment(&self.folder, |path, used_at, bytes| {
                used += bytes;
                oldest.push((used_at, bytes, path));
                if oldest.len() > REMOVED_AT_ONCE {
                    oldest.pop();
                }
            })?;
            let before = used;
            for (_, bytes, path) in oldest.into_sorted_vec() {
                if used <= most {
                    break;
                }
                remove(&path)?;
                // Folders that others use, or that are not empty, stay.
                let _ = path.parent().map(fs::remove_dir);
                used -= bytes;
            }
            if used <= most || used == before {
                return Ok(used + wanted);
            }
        }
    }
}

/// A part of a range that lies in one segment.
struct SegmentPart {
    segment: u64,
    /// Place in the segment.
    from: u32,
    /// Place in the range.
    at: usize,
    bytes: usize,
}

/// A range, cut where segments end.
fn pieces(offset: u64, bytes: usize) -> impl Iterator<Item = SegmentPart> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let begin = offset + at as u64;
        let (segment, from) = (begin / SEGMENT_BYTES, begin % SEGMENT_BYTES);
        let piece = SegmentPart {
            segment,
            from: from as u32,
            at,
            bytes: (bytes - at).min((SEGMENT_BYTES - from) as usize),
        };
        at += piece.bytes;
        (piece.bytes > 0).then_some(piece)
    })
}

/// Most bytes of disk that so many more in a segment take: whole blocks, and its list where they are the first.
fn disk_bytes(bytes: usize) -> u64 {
    const BLOCK_BYTES: usize = 4096;
    (bytes + 2 * BLOCK_BYTES + LIST_BYTES) as u64
}

/// Bytes of disk of all segments of a folder.
fn used_bytes(folder: &Path) -> io::Result<u64> {
    let mut used = 0;
    each_segment(folder, |_, _, bytes| used += bytes)?;
    Ok(used)
}

/// Removes a segment, unless another process has.
fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// Calls `with` for each segment of a folder: path, when it was used last, bytes of disk. What goes meanwhile is passed
/// over.
fn each_segment(folder: &Path, mut with: impl FnMut(PathBuf, SystemTime, u64)) -> io::Result<()> {
    for place in fs::read_dir(folder)? {
        let place = place?;
        let name = place.file_name();
        let is_ours = name.len() == 32 && name.as_encoded_bytes().iter().all(u8::is_ascii_hexdigit);
        let Ok(files) = fs::read_dir(place.path()) else { continue };
        for file in files.filter(|_| is_ours).filter_map(Result::ok) {
            let path = file.path();
            // Nothing is followed: a link is no segment.
            let Ok(found) = file.metadata() else { continue };
            if path.extension().is_some_and(|ending| ending == ENDING) && found.is_file() {
                with(path, found.modified()?, found.blocks() * 512);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(folder: &Path, limit_bytes: u64) -> CacheOptions {
        CacheOptions { folder: folder.join("cache"), limit_bytes }
    }

    fn content(offset: u64, bytes: usize) -> Vec<u8> {
        (offset..offset + bytes as u64).map(|at| ((at * 31) >> 3) as u8).collect()
    }

    /// Against a map of what was kept: any ranges, also over the border of segments.
    #[test]
    fn what_was_kept_comes_back_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let cache = RangeCache::new(&options(folder.path(), 1 << 30), "https://host/x", "1");
        let begin = SEGMENT_BYTES - 3_000;
        let mut kept = vec![false; 6_000];
        let mut state = 1_u64;
        let mut below = |most: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) % most
        };
        for round in 0..400 {
            let (from, bytes) = (below(5_800), below(200) as usize);
            let at = from as usize..from as usize + bytes;
            match round % 4 {
                0 => {
                    cache.keep(&content(begin + from, bytes), begin + from);
                    kept[at].fill(true);
                }
                1 if round % 20 == 1 => {
                    cache.forget(begin + from, bytes as u64);
                    kept[at].fill(false);
                }
                _ => {
                    let mut out = vec![0; bytes];
                    let is_there = cache.read(&mut out, begin + from);
                    assert_eq!(is_there, kept[at].iter().all(|is_kept| *is_kept), "round {round}");
                    assert!(!is_there || out == content(begin + from, bytes), "round {round}");
                }
            }
        }
        assert_eq!(cache.trouble(), None);
        // Another process finds them, another version does not.
        let mut out = vec![0; 10];
        cache.keep(&content(0, 10), 0);
        assert!(RangeCache::new(&options(folder.path(), 1 << 30), "https://host/x", "1").read(&mut out, 0));
        assert!(!RangeCache::new(&options(folder.path(), 1 << 30), "https://host/x", "2").read(&mut out, 0));
        assert!(!RangeCache::new(&options(folder.path(), 1 << 30), "https://host/y", "1").read(&mut out, 0));
    }

    #[test]
    fn the_oldest_go_when_the_limit_is_reached_and_files_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let limit = 4 << 20;
        let options = options(folder.path(), limit);
        fs::create_dir_all(options.folder.join("0123456789abcdef0123456789abcdef")).unwrap();
        let others =
            [options.folder.join("notes"), options.folder.join("0123456789abcdef0123456789abcdef/x")];
        others.iter().for_each(|path| fs::write(path, [7; 9_000]).unwrap());
        let cache = RangeCache::new(&options, "https://host/x", "1");
        let mut out = vec![0; 1 << 20];
        for segment in 0..10 {
            cache.keep(&content(segment * SEGMENT_BYTES, 1 << 20), segment * SEGMENT_BYTES);
            assert!(cache.read(&mut out, segment * SEGMENT_BYTES), "what was kept last is here");
            assert!(used_bytes(&options.folder).unwrap() <= limit, "after {segment}");
            // Times of files are coarse.
            let path = cache.path(segment);
            let time = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1_000 + segment);
            fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        assert!(!cache.read(&mut out, 0) && cache.read(&mut out, 8 * SEGMENT_BYTES));
        assert!(others.iter().all(|path| path.exists()));
        assert_eq!(cache.trouble(), None);
    }

    /// As by another process that shares the folder: it ended the cache of whoever came second.
    #[test]
    fn a_segment_that_is_gone_already_is_no_trouble() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0.segment");
        fs::write(&path, [7; 9]).unwrap();
        assert!(remove(&path).is_ok() && !path.exists() && remove(&path).is_ok());
        assert!(remove(folder.path()).is_err());
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_told_and_ends_nothing() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("cache"), "a file").unwrap();
        let cache = RangeCache::new(&options(folder.path(), 1 << 30), "https://host/x", "1");
        cache.keep(&[1, 2, 3], 0);
        assert!(cache.trouble().unwrap().contains("nothing more is kept"));
        assert!(!cache.read(&mut [0; 3], 0));
        cache.forget(0, 3);
    }
}
