//! `OpenPage`: a page that may take more, and the bytes in which the end of a chunk waits for the chunks behind it.
//!
//! ```text
//! end = bytes of the page | disk form of a page, not packed | attributes: cluster ...
//! attributes of a cluster = 1 for colours, 2 for normals, together | colours, 3 bytes a corner | normals, 4 a corner
//! ```
//!
//! Invariants: 1. both forms of a page fit a frame; 2. an end that was read is one that a builder can have written: it
//! passed the decoder of pages, and its bytes in a frame were counted again.

use super::packed_page::{AttributePacker, PackContext, PackedPage};
use crate::attributes::AttributeSet;
use crate::cluster::{
    ClusterMesh, ClusterOrder, FRAME_HEADER_BYTES, FrameRef, FrameView, LatticeBox, Node, Normal,
    PageContent, PageRef, install,
};
use crate::layout::{FRAME_BYTES, PAGE_ROOTS};

/// Frame bytes for nodes and clusters; header and all root slots are set aside.
const PAGE_CAPACITY: usize = FRAME_BYTES - FRAME_HEADER_BYTES - 4 * PAGE_ROOTS;
/// Bytes of the colours, and of the normals, of a triangle.
const COLOUR_BYTES: usize = 9;
const NORMAL_BYTES: usize = 12;
/// Bits of what a cluster has.
const HAS_COLOURS: u8 = 1;
const HAS_NORMALS: u8 = 2;

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

    /// Adds its attributes to those of the pages before it.
    pub(crate) fn pack_attributes(&self, packer: &mut AttributePacker) {
        packer.add(&self.content);
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
            let colours = if cluster.colours.is_empty() { 0 } else { HAS_COLOURS };
            let normals = if cluster.normals.is_empty() { 0 } else { HAS_NORMALS };
            out.push(colours | normals);
            out.extend(cluster.colours.as_flattened().as_flattened());
            let normals = cluster.normals.as_flattened();
            normals.iter().for_each(|normal| out.extend(normal.code().to_le_bytes()));
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
        let view = FrameView::new(&*frame);
        for slot in 0..view.root_count() {
            let root = end.copy(&view, view.root(slot), context)?;
            end.content.roots.push(root);
        }
        if !OpenPage::default().takes(&end) {
            return None;
        }
        for cluster in &mut end.content.clusters {
            rest = read_attributes(cluster, rest, context.attributes)?;
        }
        Some((end, rest))
    }

    /// Copies what a frame holds at `at`; nodes and clusters stand in the order in which they are met. How deep it goes
    /// was checked when the frame was filled.
    fn copy(&mut self, view: &FrameView<'_>, at: FrameRef, context: PackContext<'_>) -> Option<PageRef> {
        if at.is_cluster() {
            let ordered = ClusterOrder::decoded(view.cluster(at)?.decode())?;
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
        let children = node.words().map(|child| self.copy(view, FrameRef(child), context));
        self.content.nodes[index] = children.collect::<Option<Vec<_>>>()?;
        Some(PageRef::Node(index as u16))
    }
}

/// Reads the attributes of a cluster, of a model that has these; gives what stands behind them.
fn read_attributes<'a>(cluster: &mut ClusterMesh, bytes: &'a [u8], known: AttributeSet) -> Option<&'a [u8]> {
    let (&has, rest) = bytes.split_first()?;
    let found = AttributeSet { colours: has & HAS_COLOURS != 0, normals: has & HAS_NORMALS != 0 };
    if has > HAS_COLOURS | HAS_NORMALS || !known.holds(found) {
        return None;
    }
    let rows = |bytes: usize, is_there: bool| if is_there { bytes * cluster.triangles.len() } else { 0 };
    let (colours, rest) = rest.split_at_checked(rows(COLOUR_BYTES, found.colours))?;
    let (normals, rest) = rest.split_at_checked(rows(NORMAL_BYTES, found.normals))?;
    let normal = |code: &[u8; 4]| Normal::from_code(u32::from_le_bytes(*code));
    cluster.colours = colours.as_chunks::<3>().0.as_chunks::<3>().0.to_vec();
    let corners = normals.as_chunks::<4>().0.as_chunks::<3>().0.iter();
    cluster.normals = corners.map(|corners| corners.each_ref().map(normal)).collect();
    Some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::ClusterMesh;

    fn cluster(at: i64, has: AttributeSet) -> ClusterMesh {
        let colours = if has.colours { vec![[[1, 2, 3], [4, 5, 6], [255; 3]]; 2] } else { Vec::new() };
        let bent = [[1.0, 2.0, 3.0], [0.0, -1.0, 0.5], [0.0; 3]].map(Normal::from_vector);
        let normals = if has.normals { vec![bent; 2] } else { Vec::new() };
        ClusterMesh {
            vertices: vec![[at, 5, 9], [at + 4, 5, 9], [at, 50, 9], [at + 4, 51, 10]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
            leaf_sizes: vec![1, 1],
            materials: vec![0, 3],
            colours,
            normals,
        }
    }

    fn end() -> OpenPage {
        let clusters = vec![
            cluster(7, AttributeSet::default()),
            cluster(90, AttributeSet { normals: false, ..AttributeSet::ALL }),
            cluster(1000, AttributeSet::ALL),
        ];
        let bytes: usize =
            clusters.iter().map(|c| ClusterOrder::decoded(c.clone()).unwrap().page_bytes()).sum();
        let (node, root) = (vec![PageRef::Cluster(0), PageRef::Cluster(1)], PageRef::Cluster(2));
        let content = PageContent { roots: vec![PageRef::Node(0), root], nodes: vec![node], clusters };
        OpenPage { content, bytes: bytes + Node::BYTES }
    }

    fn context(emissive: &[bool]) -> PackContext<'_> {
        PackContext {
            emissive,
            bounds: LatticeBox { lo: [0; 3], hi: [4000; 3] },
            attributes: AttributeSet::ALL,
        }
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
        for missing in
            [AttributeSet { colours: false, normals: true }, AttributeSet { colours: true, normals: false }]
        {
            let plain = PackContext { attributes: missing, ..context(&emissive) };
            assert!(OpenPage::read(&bytes, 12, plain).is_none(), "attributes of a model without");
        }
    }
}
