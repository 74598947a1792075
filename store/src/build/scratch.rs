//! The scratch file: runs of snapped triangles, LZ4 blocks appended once and read once.
//!
//! ```text
//! run     = seal (`crate::scratch`), least corner 3 x 8 bytes, 10 widths, LZ4(columns)
//! columns = corner 0 minus the least corner; corners 1 and 2 minus corner 0 (zigzag); material
//! column  = as many byte planes as its width says: what its greatest value takes
//! ```
//!
//! Invariants: 1. a run is named by its offset; it comes back as it was, or as an error; 2. what was written leaves
//! the page cache soon, so that a memory limit is not filled with it; 3. a segment whose runs are all consumed goes
//! back to the disk as a whole: giving back run by run fragments the file, and a file system that discards freed
//! blocks at once (ext4 `discard`) then takes longer to drop the file than the build took to make it.

use crate::error::{Error, Result};
use crate::scratch::{Place, SEAL_BYTES, ScratchFile, seal};
use lz4_flex::block::get_maximum_output_size;
use rustix::fs::{Advice, FallocateFlags, fadvise, fallocate, fdatasync};
use rustix::io::retry_on_intr;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};

/// A triangle on the lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LatticeTriangle {
    pub(super) q: [[i64; 3]; 3],
    pub(super) material: u16,
}

/// Where a run lies.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Run {
    pub(super) offset: u64,
    pub(super) bytes: u32,
    pub(super) triangle_count: u32,
}

impl Run {
    /// Whether it can lie in a scratch file of so many bytes, for what a record says.
    pub(super) fn is_sound(&self, scratch_bytes: u64) -> bool {
        let head = SEAL_BYTES + HEAD_BYTES;
        let most = head + get_maximum_output_size(RUN_TRIANGLES * COLUMNS * WIDTH_MOST);
        (1..=RUN_TRIANGLES).contains(&(self.triangle_count as usize))
            && (head..=most).contains(&(self.bytes as usize))
            && self.offset.checked_add(u64::from(self.bytes)).is_some_and(|end| end <= scratch_bytes)
    }
}

/// Triangles of a full run.
pub(super) const RUN_TRIANGLES: usize = 4096;

/// Dirty bytes after which they are written back and dropped from the page cache.
const FLUSH_BYTES: u64 = 16 << 20;
/// Bits of a lattice coordinate.
const COORDINATE_MASK: i64 = (1 << crate::geom::Lattice::MAX_BITS) - 1;
/// Unit of giving space back; no run crosses the end of one.
const SEGMENT_BYTES: u64 = 32 << 20;
/// Columns of a run: nine coordinates and the material.
const COLUMNS: usize = 10;
/// Most bytes of a value.
const WIDTH_MOST: usize = 5;
/// Bytes between the seal and the columns.
const HEAD_BYTES: usize = 3 * 8 + COLUMNS;

/// The file. One thread appends; any read.
pub(super) struct Scratch {
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
    pub(super) fn create(place: Place) -> Result<Scratch> {
        Ok(Scratch::from(ScratchFile::at(place)?, 0))
    }

    /// The one that a build before this has left, of `end` bytes.
    pub(super) fn left(path: PathBuf, end: u64) -> Result<Scratch> {
        Ok(Scratch::from(ScratchFile::at(Place::Left(path))?, end))
    }

    fn from(file: ScratchFile, end: u64) -> Scratch {
        let state = State { end, flushed: end, live: HashMap::new(), is_held: false };
        Scratch { file, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no panic while held")
    }

    /// Says how many triangles of the runs of one that was left are still to be read.
    pub(super) fn set_unread(&self, unread: impl Iterator<Item = (Run, u32)>) {
        let mut state = self.state();
        for (run, triangle_count) in unread {
            *state.live.entry(run.offset / SEGMENT_BYTES).or_default() += u64::from(triangle_count);
        }
    }

    /// Bytes written.
    pub(super) fn bytes(&self) -> u64 {
        self.state().end
    }

    /// Appends a run made by [`Encoder`].
    pub(super) fn append(&self, mut encoded: Vec<u8>, triangle_count: usize) -> Result<Run> {
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
    pub(super) fn flush(&self) -> Result<()> {
        let file = self.file.file();
        retry_on_intr(|| fdatasync(file))
            .map_err(|e| self.file.failed("write to the scratch file", &e.into()))?;
        let mut state = self.state();
        drop_cache(file, state.flushed, state.end - state.flushed);
        state.flushed = state.end;
        Ok(())
    }

    /// Reads a run and appends its triangles to `out`.
    pub(super) fn read(&self, run: &Run, buffer: &mut Vec<u8>, out: &mut Vec<LatticeTriangle>) -> Result<()> {
        let content = self.file.read(run.offset, run.bytes as usize, run.offset, buffer)?;
        drop_cache(self.file.file(), run.offset, u64::from(run.bytes));
        decode(content, run.triangle_count as usize, out).ok_or_else(|| self.damaged(run.offset))
    }

    /// The error of a run that is not what was written.
    pub(super) fn damaged(&self, offset: u64) -> Error {
        self.file.damaged(offset)
    }

    /// Counts triangles of a run as consumed; gives a segment that holds no others back to the file system, where
    /// it can.
    pub(super) fn consume(&self, run: &Run, triangle_count: u32) {
        let segment = run.offset / SEGMENT_BYTES;
        let mut state = self.state();
        let left = state.live.get_mut(&segment).expect("who reads a run has told of it");
        *left -= u64::from(triangle_count);
        if *left == 0 && !state.is_held && state.end / SEGMENT_BYTES > segment {
            self.drop_segment(segment);
        }
    }

    /// Gives no segment back from now on: there is a record that speaks of all runs.
    pub(super) fn hold(&self) {
        self.state().is_held = true;
    }

    /// That record is gone: gives back what could have been since.
    pub(super) fn let_go(&self) {
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
pub(super) fn drop_cache(file: &File, offset: u64, bytes: u64) {
    let _ = fadvise(file, offset, std::num::NonZeroU64::new(bytes), Advice::DontNeed);
}

/// Makes runs, in memory that is used again.
#[derive(Default)]
pub(super) struct Encoder {
    values: Vec<u64>,
    planes: Vec<u8>,
}

impl Encoder {
    /// The bytes of a run, with room for its seal.
    pub(super) fn encode(&mut self, triangles: &[LatticeTriangle]) -> Vec<u8> {
        let least = |axis: usize| triangles.iter().map(|t| t.q[0][axis]).min().unwrap_or(0);
        let base = [0, 1, 2].map(least);
        self.planes.clear();
        let widths: [u8; COLUMNS] = std::array::from_fn(|column| {
            let (corner, axis) = (column / 3, column % 3);
            self.values.clear();
            match corner {
                0 => self.values.extend(triangles.iter().map(|t| (t.q[0][axis] - base[axis]) as u64)),
                1 | 2 => {
                    self.values.extend(triangles.iter().map(|t| zigzag(t.q[corner][axis] - t.q[0][axis])));
                }
                _ => self.values.extend(triangles.iter().map(|t| u64::from(t.material))),
            }
            let all = self.values.iter().fold(0, |all, value| all | value);
            let width = (u64::BITS - all.leading_zeros()).div_ceil(8);
            for plane in 0..width {
                self.planes.extend(self.values.iter().map(|value| (value >> (8 * plane)) as u8));
            }
            width as u8
        });
        let room = get_maximum_output_size(self.planes.len());
        let mut out = Vec::with_capacity(SEAL_BYTES + HEAD_BYTES + room);
        out.resize(SEAL_BYTES, 0);
        out.extend(base.iter().flat_map(|b| b.to_le_bytes()));
        out.extend(widths);
        let head = out.len();
        out.resize(head + room, 0);
        let packed = lz4_flex::block::compress_into(&self.planes, &mut out[head..]);
        out.truncate(head + packed.expect("there is room for what cannot be compressed"));
        out
    }
}

/// Appends the triangles of a run, of which `bytes` are what follows the seal; `None` when that is no run of so many.
fn decode(bytes: &[u8], n: usize, out: &mut Vec<LatticeTriangle>) -> Option<()> {
    let (head, packed) = bytes.split_at_checked(HEAD_BYTES)?;
    let (base, widths) = head.split_at(24);
    let base: [i64; 3] =
        std::array::from_fn(|a| i64::from_le_bytes(base[8 * a..8 * a + 8].try_into().expect("8")));
    if widths.iter().any(|&width| usize::from(width) > WIDTH_MOST) {
        return None;
    }
    let bytes = n * widths.iter().map(|&width| usize::from(width)).sum::<usize>();
    let planes = lz4_flex::block::decompress(packed, bytes).ok().filter(|planes| planes.len() == bytes)?;
    let from = out.len();
    out.resize(from + n, LatticeTriangle::default());
    let (out, mut planes) = (&mut out[from..], planes.as_slice());
    for (column, &width) in widths.iter().enumerate() {
        let (these, rest) = planes.split_at(n * usize::from(width));
        planes = rest;
        match width {
            0 => set_column::<0>(these, column, base, out),
            1 => set_column::<1>(these, column, base, out),
            2 => set_column::<2>(these, column, base, out),
            3 => set_column::<3>(these, column, base, out),
            4 => set_column::<4>(these, column, base, out),
            _ => set_column::<WIDTH_MOST>(these, column, base, out),
        }
    }
    Some(())
}

/// Sets a column of triangles, whose corner 0 is set before the others.
fn set_column<const WIDTH: usize>(
    planes: &[u8],
    column: usize,
    base: [i64; 3],
    triangles: &mut [LatticeTriangle],
) {
    let n = triangles.len();
    let planes: [&[u8]; WIDTH] = std::array::from_fn(|plane| &planes[plane * n..][..n]);
    let value =
        |i: usize| (0..WIDTH).fold(0u64, |all, plane| all | u64::from(planes[plane][i]) << (8 * plane));
    let (corner, axis) = (column / 3, column % 3);
    for (i, t) in triangles.iter_mut().enumerate() {
        match corner {
            0 => t.q[0][axis] = base[axis] + value(i) as i64,
            1 | 2 => t.q[corner][axis] = (t.q[0][axis] + unzigzag(value(i))) & COORDINATE_MASK,
            _ => t.material = value(i) as u16,
        }
    }
}

/// Differences of 40-bit coordinates, modulo 2^40, small ones of either sign first: 40 bits hold them all.
fn zigzag(difference: i64) -> u64 {
    let value = difference << 24 >> 24;
    ((value << 1) ^ (value >> 63)) as u64
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::os::unix::fs::MetadataExt;

    #[test]
    fn segments_stay_while_a_record_speaks_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = Scratch::create(Place::Unnamed(folder.path().to_path_buf())).unwrap();
        let blocks = |scratch: &Scratch| scratch.file.file().metadata().unwrap().blocks();
        let corner = |i: i64| [i * 0x1234_5678 % 0xff_ffff_ffff, i * 0x7654_3211 % 0xff_ffff_ffff, i];
        let triangles: Vec<_> = (0..RUN_TRIANGLES as i64)
            .map(|i| LatticeTriangle { q: [corner(i), corner(i + 7), corner(2 * i)], material: 0 })
            .collect();
        let mut runs = Vec::new();
        scratch.hold();
        while scratch.bytes() < SEGMENT_BYTES {
            let run = Encoder::default().encode(&triangles);
            runs.push(scratch.append(run, triangles.len()).unwrap());
        }
        scratch.flush().unwrap();
        let full = blocks(&scratch);
        runs.iter().for_each(|run| scratch.consume(run, run.triangle_count));
        assert_eq!(blocks(&scratch), full);
        let mut back = Vec::new();
        scratch.read(&runs[0], &mut Vec::new(), &mut back).unwrap();
        assert_eq!(back, triangles);
        scratch.let_go();
        assert!(blocks(&scratch) < full / 2, "{} blocks of {full}", blocks(&scratch));
    }

    proptest! {
        #[test]
        fn runs_survive(
            corners in proptest::collection::vec((any::<[[u32; 3]; 3]>(), any::<u16>()), 1..300),
            cut in 0u32..32,
            shift in 0u32..8,
        ) {
            let triangles: Vec<_> = corners
                .iter()
                .map(|(q, material)| LatticeTriangle {
                    q: q.map(|c| c.map(|v| i64::from(v >> cut) << shift)),
                    material: *material,
                })
                .collect();
            let mut back = Vec::new();
            let run = Encoder::default().encode(&triangles);
            decode(&run[SEAL_BYTES..], triangles.len(), &mut back).unwrap();
            prop_assert_eq!(back, triangles);
        }
    }
}
