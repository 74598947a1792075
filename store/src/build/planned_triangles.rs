//! `PlannedTriangles`: the triangles that a plan may hold, sorted, so that its shards read these and no inputs.
//!
//! ```text
//! record = counts | pieces of each chunk (u32)
//!                 | of each piece: offset of its run (u64), bytes, triangles, those before it, its triangles (u32)
//! ```
//!
//! Invariants: 1. the chunks are those of the whole model, in order, and their runs follow each other; a shard has some
//! that do; 2. each run is checked as it is read, in the file that the record was read from.

use super::draft::DraftFile;
use super::journal::record;
use super::options::BuildOptions;
use super::partition::cell_table::CellRange;
use super::partition::chunk::{Chunk, Piece};
use super::scratch::{Run, Scratch};
use super::shard_file::{ShardFile, append_record, blobs};
use crate::budget::{Budget, Lease};
use crate::error::{Error, Result};
use crate::scratch::{ScratchFile, seal};
use bytemuck::allocation::pod_collect_to_vec;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What the lists are called in messages.
const TABLES: &str = "the triangles of the plan";
/// Words of a piece in the record; its bytes, and those of a chunk.
const PIECE_WORDS: usize = 3;
const PIECE_BYTES: u64 = 8 * PIECE_WORDS as u64;
const CHUNK_BYTES: u64 = 4;

/// What stands before the blobs.
#[derive(Serialize, Deserialize)]
struct TrianglesHead {
    triangle_count: u64,
}

/// Where they are.
pub(super) struct PlannedTriangles {
    path: PathBuf,
    plan: File,
    /// Where the runs end.
    end: u64,
    chunks: Vec<Chunk>,
    /// Of the chunks, and once more of those of a shard.
    _lease: Lease,
}

impl PlannedTriangles {
    /// Appends the runs of chunks, one chunk behind the other, and their record. The scratch file gives back what was
    /// copied.
    pub(super) fn write(
        (scratch, chunks): (&Scratch, &[Chunk]),
        file: &mut DraftFile<'_>,
        options: &BuildOptions,
    ) -> Result<()> {
        let pieces = || chunks.iter().flat_map(|chunk| &chunk.pieces);
        // As lists, and once more as the record; and a run.
        let bytes = pieces().count() as u64 * PIECE_BYTES + chunks.len() as u64 * CHUNK_BYTES;
        let longest = pieces().map(|piece| piece.run.bytes).max().unwrap_or(0);
        let _lease = options.budget.lease(TABLES, 2 * bytes + u64::from(longest))?;
        let counts: Vec<u32> = chunks.iter().map(|chunk| chunk.pieces.len() as u32).collect();
        let mut words = Vec::with_capacity(pieces().count() * PIECE_WORDS);
        let (mut buffer, mut last) = (Vec::new(), None);
        for Piece { run, skip, take } in pieces() {
            options.interrupt.check()?;
            // A run between two chunks has a piece in either, one behind the other.
            let copied = match last {
                Some((offset, copied)) if offset == run.offset => copied,
                _ => {
                    scratch.read_sealed(run, &mut buffer)?;
                    seal(&mut buffer, file.bytes());
                    Run { offset: file.append(&buffer)?, ..*run }
                }
            };
            last = Some((run.offset, copied));
            scratch.consume(run, *take);
            words.extend(words_of(&Piece { run: copied, skip: *skip, take: *take }));
        }
        let head = TrianglesHead { triangle_count: chunks.iter().map(|chunk| chunk.triangle_count).sum() };
        append_record(file, &head, &[bytemuck::cast_slice(&counts), bytemuck::cast_slice(&words)]).map(drop)
    }

    /// Reads the record at `place` in the plan `path`, of so many triangles.
    pub(super) fn read(
        (path, file): (&Path, &ShardFile<'_>),
        place: Range<u64>,
        triangle_count: u64,
        budget: &Budget,
    ) -> Result<PlannedTriangles> {
        let (end, bytes) = (place.start, place.end - place.start);
        let mut lease = budget.lease(TABLES, bytes.saturating_mul(record::READING))?;
        let (_, record) = file.record::<TrianglesHead>(place)?;
        let (head, counts, words) = {
            let (head, [counts, words]) = blobs(record).ok_or_else(|| file.not_whole())?;
            (head, pod_collect_to_vec::<u8, u32>(&counts), pod_collect_to_vec::<u8, u64>(&words))
        };
        let chunks = chunks_of(&counts, &words).ok_or_else(|| file.not_whole())?;
        let found: u64 = chunks.iter().map(|chunk| chunk.triangle_count).sum();
        let is_sound = head.triangle_count == triangle_count
            && found == triangle_count
            && chunks.iter().all(|chunk| chunk.is_sound(end));
        if !is_sound {
            return Err(file.not_whole());
        }
        // A piece takes what its words do.
        let kept_bytes = (size_of_val(&words[..]) + chunks.len() * size_of::<Chunk>()) as u64;
        drop(words);
        lease.shrink_to(kept_bytes);
        lease.grow(TABLES, kept_bytes)?;
        let (path, plan) = (path.to_path_buf(), file.blocks()?);
        Ok(PlannedTriangles { path, plan, end, chunks, _lease: lease })
    }

    /// The chunks of a range of cells, and the file of their runs; `None` where they are not those of its triangles.
    pub(super) fn chunks(&self, range: CellRange) -> Result<Option<(Scratch, Vec<Chunk>)>> {
        let mut next = 0;
        let is_inside = |chunk: &&Chunk| {
            let first = next;
            next += chunk.triangle_count;
            (range.first_triangle..range.first_triangle + range.triangle_count).contains(&first)
        };
        let chunks: Vec<Chunk> = self.chunks.iter().filter(is_inside).cloned().collect();
        if chunks.iter().map(|chunk| chunk.triangle_count).sum::<u64>() != range.triangle_count {
            return Ok(None);
        }
        let plan = self.plan.try_clone().map_err(|e| Error::io("read the plan", &self.path, &e))?;
        let scratch = Scratch::in_file(ScratchFile::of_plan(plan, self.path.clone()), self.end);
        Ok(Some((scratch, chunks)))
    }
}

fn words_of(piece: &Piece) -> [u64; PIECE_WORDS] {
    let pair = |low: u32, high: u32| u64::from(low) | u64::from(high) << 32;
    let Piece { run, skip, take } = piece;
    [run.offset, pair(run.bytes, run.triangle_count), pair(*skip, *take)]
}

fn piece_of(&[offset, run, part]: &[u64; PIECE_WORDS]) -> Piece {
    let pair = |word: u64| (word as u32, (word >> 32) as u32);
    let ((bytes, triangle_count), (skip, take)) = (pair(run), pair(part));
    Piece { run: Run { offset, bytes, triangle_count }, skip, take }
}

/// Chunks of so many pieces each; `None` where the words are not those of as many.
fn chunks_of(counts: &[u32], words: &[u64]) -> Option<Vec<Chunk>> {
    let (mut rest, []) = words.as_chunks::<PIECE_WORDS>() else { return None };
    // What is allocated has bytes in the record.
    if counts.len() > rest.len() || counts.contains(&0) {
        return None;
    }
    let mut chunks = Vec::with_capacity(counts.len());
    for &count in counts {
        let (these, after) = rest.split_at_checked(count as usize)?;
        let pieces: Vec<Piece> = these.iter().map(piece_of).collect();
        let triangle_count = pieces.iter().map(|piece| u64::from(piece.take)).sum();
        chunks.push(Chunk { pieces, triangle_count });
        rest = after;
    }
    rest.is_empty().then_some(chunks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_that_cannot_be_are_refused() {
        let run = Run { offset: 16, bytes: 99, triangle_count: 7 };
        let pieces = [(0, 3), (3, 4), (0, 7)].map(|(skip, take)| Piece { run, skip, take });
        let words: Vec<u64> = pieces.iter().flat_map(words_of).collect();
        let chunks = chunks_of(&[1, 2], &words).unwrap();
        assert_eq!(chunks.iter().map(|chunk| chunk.triangle_count).collect::<Vec<_>>(), [3, 11]);
        let again: Vec<u64> = chunks.iter().flat_map(|chunk| &chunk.pieces).flat_map(words_of).collect();
        assert_eq!(again, words);
        assert!(chunks_of(&[1, 1], &words).is_none(), "a piece of no chunk");
        assert!(chunks_of(&[1, 3], &words).is_none(), "more pieces than there are");
        assert!(chunks_of(&[0, 3], &words).is_none(), "an empty chunk");
        assert!(chunks_of(&[3], &words[1..]).is_none(), "a piece that is not whole");
    }
}
