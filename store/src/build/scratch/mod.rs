//! The scratch file: runs of snapped triangles, appended once and read once.
//!
//! ```text
//! triangles -> `run`: bytes -> `run_writer`: a thread -> `Scratch`: the file
//! ```
//!
//! Invariants: 1. a run is named by its offset; it comes back as it was, or as an error; 2. what was written leaves
//! the page cache soon, so that a memory limit is not filled with it; 3. a segment whose runs are all consumed goes
//! back to the disk as a whole: giving back run by run fragments the file, and a file system that discards freed
//! blocks at once (ext4 `discard`) then takes longer to drop the file than the build took to make it.

mod run;
pub(super) mod run_writer;

pub(crate) use run::{Encoder, LatticeTriangle, RUN_TRIANGLES, Run, TriangleList};

use crate::error::{Error, Result};
use crate::scratch::{Place, SEAL_BYTES, ScratchFile, seal};
use run::decode;
use rustix::fs::{Advice, FallocateFlags, fadvise, fallocate, fdatasync};
use rustix::io::retry_on_intr;
use std::collections::HashMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};

/// Dirty bytes after which they are written back and dropped from the page cache.
const FLUSH_BYTES: u64 = 16 << 20;
/// Unit of giving space back; no run crosses the end of one.
const SEGMENT_BYTES: u64 = 32 << 20;
/// The file. One thread appends; any read.
pub(crate) struct Scratch {
    file: ScratchFile,
    state: Mutex<State>,
}

struct State {
    end: u64,
    flushed: u64,
    /// Triangles not yet consumed, per segment.
    live: HashMap<u64, u64>,
    /// Segments stay that hold no others: a record speaks of their runs.
    is_held: bool,
}

impl Scratch {
    /// A new one.
    pub(crate) fn create(place: Place) -> Result<Scratch> {
        Ok(Scratch::in_file(ScratchFile::at(place)?, 0))
    }

    /// The one that a build before this has left, of `end` bytes.
    pub(crate) fn reopen(path: PathBuf, end: u64) -> Result<Scratch> {
        Ok(Scratch::in_file(ScratchFile::at(Place::Left(path))?, end))
    }

    /// The one in a file, of which the first `end` bytes are taken.
    pub(crate) fn in_file(file: ScratchFile, end: u64) -> Scratch {
        let state = State { end, flushed: end, live: HashMap::new(), is_held: false };
        Scratch { file, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no panic while held")
    }

    /// Counts the triangles of runs that are still to be read, for a file that a build before this has left.
    pub(crate) fn set_unread(&self, unread: impl Iterator<Item = (Run, u32)>) {
        let mut state = self.state();
        for (run, triangle_count) in unread {
            *state.live.entry(run.offset / SEGMENT_BYTES).or_default() += u64::from(triangle_count);
        }
    }

    /// Bytes written.
    pub(crate) fn bytes(&self) -> u64 {
        self.state().end
    }

    /// Appends a run made by [`Encoder`].
    pub(crate) fn append(&self, mut encoded: Vec<u8>, triangle_count: usize) -> Result<Run> {
        let offset = {
            let mut state = self.state();
            if state.end / SEGMENT_BYTES != (state.end + encoded.len() as u64) / SEGMENT_BYTES {
                state.end = state.end.next_multiple_of(SEGMENT_BYTES);
            }
            let offset = state.end;
            *state.live.entry(offset / SEGMENT_BYTES).or_default() += triangle_count as u64;
            state.end += encoded.len() as u64;
            offset
        };
        seal(&mut encoded, offset);
        self.file.write(&encoded, offset)?;
        let is_full = {
            let state = self.state();
            state.end - state.flushed >= FLUSH_BYTES
        };
        if is_full {
            self.flush()?;
        }
        Ok(Run { offset, bytes: encoded.len() as u32, triangle_count: triangle_count as u32 })
    }

    /// Writes back what is dirty and drops it from the page cache.
    pub(crate) fn flush(&self) -> Result<()> {
        let file = self.file.file();
        retry_on_intr(|| fdatasync(file)).map_err(|e| self.file.failed("write to", &e.into()))?;
        let mut state = self.state();
        drop_cache(file, state.flushed, state.end - state.flushed);
        state.flushed = state.end;
        Ok(())
    }

    /// Reads a run and appends its triangles to `out`.
    pub(crate) fn read(&self, run: &Run, buffer: &mut Vec<u8>, out: &mut TriangleList) -> Result<()> {
        self.read_sealed(run, buffer)?;
        let content = &buffer[SEAL_BYTES..];
        decode(content, run.triangle_count as usize, out).ok_or_else(|| self.damaged(run.offset))
    }

    /// Reads a run as it stands, seal included.
    pub(crate) fn read_sealed(&self, run: &Run, buffer: &mut Vec<u8>) -> Result<()> {
        self.file.read(run.offset, run.bytes as usize, run.offset, buffer)?;
        drop_cache(self.file.file(), run.offset, u64::from(run.bytes));
        Ok(())
    }

    /// The error of a run that is not what was written.
    pub(crate) fn damaged(&self, offset: u64) -> Error {
        self.file.damaged(offset)
    }

    /// Counts triangles of a run as consumed; gives a segment that holds no others back to the file system, where
    /// it can.
    pub(crate) fn consume(&self, run: &Run, triangle_count: u32) {
        let segment = run.offset / SEGMENT_BYTES;
        let mut state = self.state();
        let left = state.live.get_mut(&segment).expect("runs that are read were counted before");
        *left -= u64::from(triangle_count);
        if *left == 0 && !state.is_held && state.end / SEGMENT_BYTES > segment {
            self.drop_segment(segment);
        }
    }

    /// Gives no segment back from now on: a record speaks of all runs.
    pub(crate) fn keep_segments(&self) {
        self.state().is_held = true;
    }

    /// Gives segments back again, those first that could have been since: the record is gone.
    pub(crate) fn release_segments(&self) {
        let mut state = self.state();
        state.is_held = false;
        let last = state.end / SEGMENT_BYTES;
        let empty = state.live.iter().filter(|(segment, left)| **left == 0 && **segment < last);
        empty.for_each(|(&segment, _)| self.drop_segment(segment));
    }

    fn drop_segment(&self, segment: u64) {
        let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        let _ = fallocate(self.file.file(), flags, segment * SEGMENT_BYTES, SEGMENT_BYTES);
    }
}

/// Drops a range from the page cache; a file system that cannot does no harm.
pub(crate) fn drop_cache(file: &File, offset: u64, bytes: u64) {
    let _ = fadvise(file, offset, std::num::NonZeroU64::new(bytes), Advice::DontNeed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attributes::CornerAttributes;
    use std::os::unix::fs::MetadataExt;

    #[test]
    fn segments_stay_while_a_record_speaks_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = Scratch::create(Place::Unnamed(folder.path().to_path_buf())).unwrap();
        let blocks = |scratch: &Scratch| scratch.file.file().metadata().unwrap().blocks();
        let corner = |i: i64| [i * 0x1234_5678 % 0xff_ffff_ffff, i * 0x7654_3211 % 0xff_ffff_ffff, i];
        let mut triangles = TriangleList::default();
        for i in 0..RUN_TRIANGLES as i64 {
            let q = [corner(i), corner(i + 7), corner(2 * i)];
            triangles.push(LatticeTriangle { q, material: 0 }, &CornerAttributes::NONE);
        }
        let mut runs = Vec::new();
        scratch.keep_segments();
        while scratch.bytes() < SEGMENT_BYTES {
            let run = Encoder::default().encode(&triangles);
            runs.push(scratch.append(run, triangles.len()).unwrap());
        }
        scratch.flush().unwrap();
        let full = blocks(&scratch);
        runs.iter().for_each(|run| scratch.consume(run, run.triangle_count));
        assert_eq!(blocks(&scratch), full);
        let mut back = TriangleList::default();
        scratch.read(&runs[0], &mut Vec::new(), &mut back).unwrap();
        assert_eq!(back, triangles);
        scratch.release_segments();
        assert!(blocks(&scratch) < full / 2, "{} blocks of {full}", blocks(&scratch));
    }
}
