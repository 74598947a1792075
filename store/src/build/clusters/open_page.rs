//! `OpenPage`: a page that may take more, and the bytes in which the end of a chunk waits for the chunks behind it.
//!
//! ```text
//! end = bytes of the page | disk form of a page, not packed | colours: cluster ...
//! colours of a cluster = 0, or 1 and three bytes a corner
//! ```
//!
//! Invariants: 1. both forms of a page fit a frame; 2. an end that was read is one that a builder can have written: it
//! passed the decoder of pages, and its bytes in a frame were counted again.

use super::packed_page::{PackContext, PackedPage};
use crate::cluster::{
    ClusterOrder, ColourPacker, FRAME_TAIL_BYTES, FrameRef, FrameView, LatticeBox, Node, PageContent,
    PageRef, install,
};
use crate::layout::{FRAME_BYTES, PAGE_ROOTS};

/// Frame bytes for nodes and clusters; header, all root slots and the tail are set aside.
const PAGE_CAPACITY: usize = FRAME_BYTES - 16 - 4 * PAGE_ROOTS - FRAME_TAIL_BYTES;
/// Bytes of the colours of a triangle.
const COLOUR_BYTES: usize = 9;

/// A page that may take more.
#[derive(Default)]
pub(crate) struct OpenPage {
    pub(super) content: PageContent,
    /// Frame bytes of its nodes and clusters.
    pub(super) bytes: usize,
}

impl OpenPage {
    pub(crate) fn is_empty(&self) -> bool {
        self.content.roots.is_empty()
    }

    /// Count of roots.
    pub(crate) fn root_count(&self) -> usize {
        self.content.roots.len()
    }

    /// Count of triangles.
    pub(crate) fn triangle_count(&self) -> usize {
        self.content.triangle_count()
    }

    /// Whether so many bytes under so many roots fit.
    pub(super) fn has_room(&self, bytes: usize, root_count: usize) -> bool {
        self.bytes + bytes <= PAGE_CAPACITY && self.content.roots.len() + root_count <= PAGE_ROOTS
    }

    /// Whether all of `other` fits.
    pub(crate) fn takes(&self, other: &OpenPage) -> bool {
        self.has_room(other.bytes, other.content.roots.len())
    }

    /// Takes all of `other`; the slot of its first root.
    pub(crate) fn append(&mut self, other: OpenPage) -> u32 {
        let PageContent { roots, nodes, clusters } = &mut self.content;
        let (slot, node_count, cluster_count) =
            (roots.len() as u32, nodes.len() as u16, clusters.len() as u16);
        let moved = |at: PageRef| match at {
            PageRef::Node(index) => PageRef::Node(node_count + index),
            PageRef::Cluster(index) => PageRef::Cluster(cluster_count + index),
        };
        roots.extend(other.content.roots.into_iter().map(moved));
        nodes.extend(other.content.nodes.into_iter().map(|node| node.into_iter().map(moved).collect()));
        clusters.extend(other.content.clusters);
        self.bytes += other.bytes;
        slot
    }

    /// Adds its colours to those of the pages before it.
    pub(crate) fn pack_colours(&self, colours: &mut ColourPacker) {
        colours.add(&self.content.clusters);
    }

    /// Ends it. Panics when it is empty.
    pub(crate) fn pack(self, context: PackContext<'_>) -> PackedPage {
        PackedPage::new(&self.content, context)
    }

    /// Appends the bytes of an end, which is not empty.
    pub(crate) fn write(&self, out: &mut Vec<u8>) {
        let (page, _) = self.content.encode();
        out.extend((page.len() as u32).to_le_bytes());
        out.extend(page);
        for cluster in &self.content.clusters {
            out.push(u8::from(!cluster.colours.is_empty()));
            out.extend(cluster.colours.as_flattened().as_flattened());
        }
    }

    /// The end at the front of `bytes`, of a model on a lattice of so many bits, and what stands behind it; `None`
    /// where no builder can have written it.
    pub(crate) fn read<'a>(
        bytes: &'a [u8],
        lattice_bits: u32,
        context: PackContext<'_>,
    ) -> Option<(OpenPage, &'a [u8])> {
        let (length, rest) = bytes.split_first_chunk()?;
        let (page, mut rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let mut frame = vec![0u64; FRAME_BYTES / size_of::<u64>()];
        let frame: &mut [u8] = bytemuck::cast_slice_mut(&mut frame);
        install(page, lattice_bits, frame).ok()?;
        let mut end = OpenPage::default();
        let view = FrameView::new(frame);
        for slot in 0..view.root_count() {
            let root = end.copy(&view, view.root(slot), context)?;
            end.content.roots.push(root);
        }
        if !OpenPage::default().takes(&end) {
            return None;
        }
        for cluster in &mut end.content.clusters {
            let (&has_colours, behind) = rest.split_first()?;
            rest = behind;
            if has_colours > u8::from(context.has_colours) {
                return None;
            }
            if has_colours == 1 {
                let (colours, behind) = rest.split_at_checked(COLOUR_BYTES * cluster.triangles.len())?;
                rest = behind;
                let corners = colours.as_chunks::<3>().0.as_chunks::<3>().0;
                cluster.colours = corners.to_vec();
            }
        }
        Some((end, rest))
    }

    /// Copies what a frame holds at `at`; nodes and clusters stand in the order in which they are met. How deep it goes
    /// was checked when the frame was filled.
    fn copy(&mut self, view: &FrameView<'_>, at: FrameRef, context: PackContext<'_>) -> Option<PageRef> {
        if at.is_cluster() {
            let ordered = ClusterOrder::decoded(view.cluster(at).decode())?;
            let LatticeBox { lo, hi } = ordered.mesh.bounds();
            let all = LatticeBox { lo, hi }.join(&context.bounds);
            let is_known = |&material: &u16| usize::from(material) < context.emissive.len();
            if all != context.bounds || !ordered.mesh.materials.iter().all(is_known) {
                return None;
            }
            self.bytes += ordered.page_bytes();
            self.content.clusters.push(ordered.mesh);
            return Some(PageRef::Cluster(self.content.clusters.len() as u16 - 1));
        }
        let (node, index) = (view.node(at), self.content.nodes.len());
        self.bytes += Node::BYTES;
        self.content.nodes.push(Vec::new());
        let children = node.child[..usize::from(node.child_count)].iter();
        let children = children.map(|&child| self.copy(view, FrameRef(child), context));
        self.content.nodes[index] = children.collect::<Option<Vec<_>>>()?;
        Some(PageRef::Node(index as u16))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::ClusterMesh;

    fn cluster(at: i64, is_coloured: bool) -> ClusterMesh {
        let colours = if is_coloured { vec![[[1, 2, 3], [4, 5, 6], [255; 3]]; 2] } else { Vec::new() };
        ClusterMesh {
            vertices: vec![[at, 5, 9], [at + 4, 5, 9], [at, 50, 9], [at + 4, 51, 10]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
            leaf_sizes: vec![1, 1],
            materials: vec![0, 3],
            colours,
        }
    }

    fn end() -> OpenPage {
        let clusters = vec![cluster(7, false), cluster(90, true), cluster(1000, true)];
        let bytes: usize =
            clusters.iter().map(|c| ClusterOrder::decoded(c.clone()).unwrap().page_bytes()).sum();
        let (node, root) = (vec![PageRef::Cluster(0), PageRef::Cluster(1)], PageRef::Cluster(2));
        let content = PageContent { roots: vec![PageRef::Node(0), root], nodes: vec![node], clusters };
        OpenPage { content, bytes: bytes + Node::BYTES }
    }

    fn context(emissive: &[bool]) -> PackContext<'_> {
        PackContext { emissive, bounds: LatticeBox { lo: [0; 3], hi: [4000; 3] }, has_colours: true }
    }

    #[test]
    fn an_end_comes_back_as_it_was() {
        let (end, mut bytes) = (end(), Vec::new());
        end.write(&mut bytes);
        bytes.push(77);
        let (back, rest) = OpenPage::read(&bytes, 12, context(&[false; 4])).unwrap();
        assert_eq!(rest, [77]);
        assert_eq!((back.bytes, &back.content.clusters), (end.bytes, &end.content.clusters));
        assert_eq!((&back.content.roots, &back.content.nodes), (&end.content.roots, &end.content.nodes));
    }

    #[test]
    fn what_no_builder_wrote_is_refused_or_can_be_packed() {
        let (mut bytes, emissive) = (Vec::new(), [false, true, false, true]);
        end().write(&mut bytes);
        for length in 0..bytes.len() {
            assert!(OpenPage::read(&bytes[..length], 12, context(&emissive)).is_none(), "{length} bytes");
        }
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            if let Some((end, _)) = OpenPage::read(&flipped, 12, context(&emissive)) {
                end.pack(context(&emissive));
            }
        }
        assert!(
            OpenPage::read(&bytes, 12, context(&emissive[..3])).is_none(),
            "a material that is not there"
        );
        let near = PackContext { bounds: LatticeBox { lo: [0; 3], hi: [900; 3] }, ..context(&emissive) };
        assert!(OpenPage::read(&bytes, 12, near).is_none(), "a vertex outside of the model");
        let plain = PackContext { has_colours: false, ..context(&emissive) };
        assert!(OpenPage::read(&bytes, 12, plain).is_none(), "colours of a model without");
    }
}
