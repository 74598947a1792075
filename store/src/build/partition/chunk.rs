//! `Chunk`: the unit of the cluster phase, joined from cells that follow each other.
//!
//! Invariant: a chunk holds at least one triangle and at most [`CHUNK_TRIANGLES`].

use crate::build::scratch::Run;
use serde::{Deserialize, Serialize};

/// Most triangles of a chunk: about 16 pages, and 25 MB of work memory a thread.
pub(crate) const CHUNK_TRIANGLES: u64 = 1 << 17;

/// A stretch of a run: triangles `skip .. skip + take`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Piece {
    pub(crate) run: Run,
    pub(crate) skip: u32,
    pub(crate) take: u32,
}

/// The unit of the cluster phase.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Chunk {
    pub(crate) pieces: Vec<Piece>,
    pub(crate) triangle_count: u64,
}

impl Chunk {
    /// Bytes of memory that it takes.
    pub(crate) fn bytes(&self) -> u64 {
        (size_of::<Chunk>() + self.pieces.capacity() * size_of::<Piece>()) as u64
    }

    /// Whether it can be one of a scratch file of so many bytes, for what a record says.
    pub(crate) fn is_sound(&self, scratch_bytes: u64) -> bool {
        let is_sound = |piece: &Piece| {
            let end = u64::from(piece.skip) + u64::from(piece.take);
            piece.take > 0 && end <= u64::from(piece.run.triangle_count) && piece.run.is_sound(scratch_bytes)
        };
        let taken = self.pieces.iter().map(|piece| u64::from(piece.take)).sum::<u64>();
        self.pieces.iter().all(is_sound)
            && taken == self.triangle_count
            && (1..=CHUNK_TRIANGLES).contains(&taken)
    }
}

/// Joins cells that follow each other while they fit a chunk; cuts what could not be divided by place.
#[derive(Default)]
pub(super) struct ChunkJoiner {
    pub(super) done: Vec<Chunk>,
    open: Chunk,
}

impl ChunkJoiner {
    /// Adds a cell, of so many triangles in these runs.
    pub(super) fn add(&mut self, triangle_count: u64, runs: &[Run]) {
        if self.open.triangle_count + triangle_count > CHUNK_TRIANGLES {
            self.close();
        }
        for &run in runs {
            let mut skip = 0;
            while skip < run.triangle_count {
                let room = CHUNK_TRIANGLES - self.open.triangle_count;
                let take = (run.triangle_count - skip).min(room as u32);
                self.open.pieces.push(Piece { run, skip, take });
                self.open.triangle_count += u64::from(take);
                skip += take;
                if self.open.triangle_count == CHUNK_TRIANGLES {
                    self.close();
                }
            }
        }
    }

    /// Ends the chunk under way: what comes next is not joined to it.
    pub(super) fn close(&mut self) {
        if self.open.triangle_count > 0 {
            self.open.pieces.shrink_to_fit();
            self.done.push(std::mem::take(&mut self.open));
        }
    }
}
