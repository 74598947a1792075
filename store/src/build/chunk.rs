//! One chunk: its triangles are read from scratch, cut into clusters, and packed into pages.
//!
//! Invariant: work memory is bounded by [`worker_bytes`].

use super::cells::{CHUNK_TRIANGLES, Chunk};
use super::clusters::{Clusterer, Clusters};
use super::pages::{self, ChunkPages, PackContext};
use super::sah::Prim;
use super::scratch::{LatticeTriangle, Scratch};
use crate::cluster::LatticeBox;
use crate::error::Result;

/// Memory that one worker takes: triangles (80 B), primitives (36 B) and their ranks (8 B), clusters and tree (about
/// 40 B), the read buffer and the pages that wait for their turn (about 30 B).
pub(super) fn worker_bytes() -> u64 {
    CHUNK_TRIANGLES * (80 + 44 + 40 + 32)
}

/// Memory of a worker, reused from chunk to chunk.
#[derive(Default)]
pub(super) struct Workspace {
    buffer: Vec<u8>,
    run: Vec<LatticeTriangle>,
    triangles: Vec<LatticeTriangle>,
    prims: Vec<Prim>,
    clusterer: Clusterer,
}

impl Workspace {
    /// Reads and builds one chunk.
    pub(super) fn build(
        &mut self,
        chunk: &Chunk,
        scratch: &Scratch,
        context: PackContext<'_>,
    ) -> Result<ChunkPages> {
        self.triangles.clear();
        for piece in &chunk.pieces {
            self.run.clear();
            scratch.read(&piece.run, &mut self.buffer, &mut self.run)?;
            self.triangles.extend_from_slice(&self.run[piece.skip as usize..][..piece.take as usize]);
        }
        let clusters = self.cluster_all();
        Ok(pages::pack(clusters, context))
    }

    /// The triangles of the chunk that was built last.
    pub(super) fn triangles(&self) -> &[LatticeTriangle] {
        &self.triangles
    }

    fn cluster_all(&mut self) -> Clusters {
        let mut all = LatticeBox::EMPTY;
        self.triangles.iter().for_each(|t| t.q.iter().for_each(|&q| all.add(q)));
        self.prims.clear();
        self.prims.extend(self.triangles.iter().enumerate().map(|(index, t)| {
            let mut exact = LatticeBox::EMPTY;
            t.q.iter().for_each(|&q| exact.add(q));
            Prim::new(&exact, all.lo, index as u32)
        }));
        self.clusterer.clusters(&mut self.prims, &self.triangles)
    }
}
