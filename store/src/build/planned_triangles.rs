//! `PlannedTriangles`: the triangles that a plan may hold, sorted, so that its shards read these and no inputs.
//!
//! ```text
//! record = counts | pieces of each chunk (u32)
//!                 | of each piece: offset of its run (u64), bytes, triangles, those before it, its triangles (u32)
//! ```
//!
//! Invariants: 1. the chunks are those of the whole model, in order, and a shard has some that follow each other; 2.
//! each run is checked as it is read.

use super::draft::DraftFile;
use super::journal::record;
use super::partition::cell_table::CellRange;
use super::partition::chunk::{Chunk, Piece};
use super::scratch::{Run, Scratch};
use super::shard_file::{HEAD_BYTES, ShardFile, append_record, blobs};
use crate::budget::{Budget, Lease};
use crate::error::Result;
use crate::scratch::ScratchFile;
use bytemuck::allocation::pod_collect_to_vec;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What the lists are called in messages.
const TABLES: &str = "the triangles of the plan";
/// Bytes of a piece in the record, and of a chunk.
const PIECE_BYTES: u64 = 24;
const CHUNK_BYTES: u64 = 4;

/// What stands before the blobs.
#[derive(Serialize, Deserialize)]
struct TrianglesHead {
    triangle_count: u64,
}

/// Where they are.
pub(super) struct PlannedTriangles {
    plan: PathBuf,
    /// Where the runs end.
    end: u64,
    chunks: Vec<Chunk>,
    _lease: Lease,
}

impl PlannedTriangles {
    /// Appends the record of chunks whose runs end where the file does.
    pub(super) fn write(chunks: &[Chunk], file: &mut DraftFile<'_>, budget: &Budget) -> Result<()> {
        let pieces = || chunks.iter().flat_map(|chunk| &chunk.pieces);
        // As lists, and once more as the record.
        let bytes = pieces().count() as u64 * PIECE_BYTES + chunks.len() as u64 * CHUNK_BYTES;
        let _lease = budget.lease(TABLES, 2 * bytes)?;
        let counts: Vec<u32> = chunks.iter().map(|chunk| chunk.pieces.len() as u32).collect();
        let words: Vec<u64> = pieces().flat_map(words_of).collect();
        let head = TrianglesHead { triangle_count: chunks.iter().map(|chunk| chunk.triangle_count).sum() };
        append_record(file, &head, &[bytemuck::cast_slice(&counts), bytemuck::cast_slice(&words)]).map(drop)
    }

    /// Reads the record at `place` in `plan`, of so many triangles.
    pub(super) fn read(
        (plan, file): (&Path, &ShardFile<'_>),
        place: Range<u64>,
        triangle_count: u64,
        budget: &Budget,
    ) -> Result<PlannedTriangles> {
        let (end, bytes) = (place.start, place.end - place.start);
        let mut lease = budget.lease(TABLES, bytes.saturating_mul(record::READING))?;
        let (_, record) = file.record::<TrianglesHead>(place)?;
        let (head, [counts, words]) = blobs(record).ok_or_else(|| file.not_whole())?;
        let counts = pod_collect_to_vec::<u8, u32>(&counts);
        let words = pod_collect_to_vec::<u8, u64>(&words);
        let chunks = chunks_of(&counts, &words).ok_or_else(|| file.not_whole())?;
        let found: u64 = chunks.iter().map(|chunk| chunk.triangle_count).sum();
        let is_sound = end >= HEAD_BYTES as u64
            && head.triangle_count == triangle_count
            && found == triangle_count
            && chunks.iter().all(|chunk| chunk.is_sound(end));
        if !is_sound {
            return Err(file.not_whole());
        }
        // A piece takes what its words do, at the most.
        lease.shrink_to((size_of_val(&words[..]) + chunks.len() * size_of::<Chunk>()) as u64);
        Ok(PlannedTriangles { plan: plan.to_path_buf(), end, chunks, _lease: lease })
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
        let scratch = Scratch::in_file(ScratchFile::of_plan(self.plan.clone())?, self.end);
        Ok(Some((scratch, chunks)))
    }
}

fn words_of(piece: &Piece) -> [u64; 3] {
    let pair = |low: u32, high: u32| u64::from(low) | u64::from(high) << 32;
    let Piece { run, skip, take } = piece;
    [run.offset, pair(run.bytes, run.triangle_count), pair(*skip, *take)]
}

fn piece_of(&[offset, run, part]: &[u64; 3]) -> Piece {
    let pair = |word: u64| (word as u32, (word >> 32) as u32);
    let ((bytes, triangle_count), (skip, take)) = (pair(run), pair(part));
    Piece { run: Run { offset, bytes, triangle_count }, skip, take }
}

/// Chunks of so many pieces each; `None` where the words are not those of as many.
fn chunks_of(counts: &[u32], words: &[u64]) -> Option<Vec<Chunk>> {
    let (mut rest, []) = words.as_chunks::<3>() else { return None };
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
