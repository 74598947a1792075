//! One chunk: its triangles are read from scratch, cut into clusters, and packed into pages.
//!
//! Invariant: work memory is bounded by [`worker_bytes`].

use super::clusterer::{Clusterer, Clusters};
use super::packed_page::PackContext;
use super::pages::{self, ChunkPages};
use super::sah::Prim;
use crate::attributes::AttributeSet;
use crate::build::partition::chunk::{CHUNK_TRIANGLES, Chunk};
use crate::build::scratch::{LatticeTriangle, Scratch, TriangleList};
use crate::cluster::LatticeBox;
use crate::error::Result;

/// Memory that one worker takes: triangles (80 B), primitives (36 B) and their ranks (8 B), clusters and tree (20 B in
/// a sheet, up to 82 where no corner is shared), the pages that wait for their turn. Counted by the allocator
/// (`store/src/build/tests/worker.rs`): 143 B a triangle of a sheet, 213 where no corner is shared. Colours and normals
/// are there twice, with the triangles and with the clusters, and then in pages.
///
/// Lost: triangles of 48 B and primitives of 32 B, 33 B less a triangle: builds took 14 % longer on an iso-surface.
pub(crate) fn worker_bytes(attributes: AttributeSet) -> u64 {
    let page_bytes = VALUE_PAGE_BYTES * (u64::from(attributes.colours) + u64::from(attributes.normals));
    CHUNK_TRIANGLES * (80 + 36 + 8 + 82 + 10 + 2 * attributes.row_bytes() + page_bytes)
}

/// Bytes of a triangle's colours, or of its normals, while its page is packed, and packed, at most.
const VALUE_PAGE_BYTES: u64 = 12;

/// Memory of a worker, reused from chunk to chunk.
#[derive(Default)]
pub(crate) struct Workspace {
    buffer: Vec<u8>,
    run: TriangleList,
    list: TriangleList,
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
        self.list.clear();
        self.list.reserve_exact(chunk.triangle_count as usize);
        for piece in &chunk.pieces {
            self.run.clear();
            scratch.read(&piece.run, &mut self.buffer, &mut self.run)?;
            let (skip, take) = (piece.skip as usize, piece.take as usize);
            self.list.extend(&self.run, skip..skip + take);
        }
        // Not needed any more; clusters are.
        (self.buffer, self.run) = (Vec::new(), TriangleList::default());
        let all = self.bounds();
        // A left-over that was sealed by somebody else.
        let is_known = |t: &LatticeTriangle| usize::from(t.material) < context.emissive.len();
        let is_ours = all.join(&context.bounds) == context.bounds
            && self.list.triangles.iter().all(is_known)
            && context.attributes.holds(self.list.attributes());
        if !is_ours {
            return Err(scratch.damaged(chunk.pieces.first().map_or(0, |piece| piece.run.offset)));
        }
        Ok(pages::pack(self.cluster_all(&all), context))
    }

    /// The triangles of the chunk that was built last.
    pub(crate) fn triangles(&self) -> &[LatticeTriangle] {
        &self.list.triangles
    }

    fn bounds(&self) -> LatticeBox {
        let mut all = LatticeBox::EMPTY;
        self.list.triangles.iter().for_each(|t| t.q.iter().for_each(|&q| all.add(q)));
        all
    }

    fn cluster_all(&mut self, all: &LatticeBox) -> Clusters {
        self.prims.clear();
        self.prims.reserve_exact(self.list.len());
        self.prims.extend(self.list.triangles.iter().enumerate().map(|(index, t)| {
            let mut exact = LatticeBox::EMPTY;
            t.q.iter().for_each(|&q| exact.add(q));
            Prim::new(&exact, all.lo, index as u32)
        }));
        self.clusterer.clusters(&mut self.prims, &self.list)
    }
}
