//! One chunk: its triangles are read from scratch, cut into clusters, and packed into pages.
//!
//! Invariant: work memory is bounded by [`worker_bytes`].

use super::clusterer::{Clusterer, Clusters};
use super::pages::{self, ChunkPages, PackContext};
use super::sah::Prim;
use crate::build::partition::chunk::{CHUNK_TRIANGLES, Chunk};
use crate::build::scratch::{LatticeTriangle, Scratch};
use crate::cluster::LatticeBox;
use crate::error::Result;

/// Memory that one worker takes: triangles (88 B), primitives (36 B) and their ranks (8 B), clusters and tree (20 B in
/// a sheet, up to 82 where no corner is shared, 9 more where there are colours), the pages that wait for their turn.
/// Counted by the allocator (`store/src/build/tests/worker.rs`), without colours.
///
/// Lost: triangles of 48 B and primitives of 32 B, 33 B less a triangle: builds took 14 % longer on an iso-surface.
pub(crate) fn worker_bytes() -> u64 {
    CHUNK_TRIANGLES * (88 + 36 + 8 + 91 + 10)
}

/// Memory of a worker, reused from chunk to chunk.
#[derive(Default)]
pub(crate) struct Workspace {
    buffer: Vec<u8>,
    run: Vec<LatticeTriangle>,
    triangles: Vec<LatticeTriangle>,
    prims: Vec<Prim>,
    clusterer: Clusterer,
}

impl Workspace {
    /// Reads and builds one chunk.
    pub(crate) fn build(
        &mut self,
        chunk: &Chunk,
        scratch: &Scratch,
        context: PackContext<'_>,
    ) -> Result<ChunkPages> {
        self.triangles.clear();
        self.triangles.reserve_exact(chunk.triangle_count as usize);
        for piece in &chunk.pieces {
            self.run.clear();
            scratch.read(&piece.run, &mut self.buffer, &mut self.run)?;
            self.triangles.extend_from_slice(&self.run[piece.skip as usize..][..piece.take as usize]);
        }
        // Not needed any more; clusters are.
        (self.buffer, self.run) = (Vec::new(), Vec::new());
        let all = self.bounds();
        // A left-over that was sealed by somebody else.
        let is_known = |t: &LatticeTriangle| usize::from(t.material) < context.emissive.len();
        if all.join(&context.bounds) != context.bounds || !self.triangles.iter().all(is_known) {
            return Err(scratch.damaged(chunk.pieces.first().map_or(0, |piece| piece.run.offset)));
        }
        Ok(pages::pack(self.cluster_all(&all), context))
    }

    /// The triangles of the chunk that was built last.
    pub(crate) fn triangles(&self) -> &[LatticeTriangle] {
        &self.triangles
    }

    fn bounds(&self) -> LatticeBox {
        let mut all = LatticeBox::EMPTY;
        self.triangles.iter().for_each(|t| t.q.iter().for_each(|&q| all.add(q)));
        all
    }

    fn cluster_all(&mut self, all: &LatticeBox) -> Clusters {
        self.prims.clear();
        self.prims.reserve_exact(self.triangles.len());
        self.prims.extend(self.triangles.iter().enumerate().map(|(index, t)| {
            let mut exact = LatticeBox::EMPTY;
            t.q.iter().for_each(|&q| exact.add(q));
            Prim::new(&exact, all.lo, index as u32)
        }));
        self.clusterer.clusters(&mut self.prims, &self.triangles)
    }
}
