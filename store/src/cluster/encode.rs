//! The disk form of a mesh page: roots, nodes, clusters, one after the other, unaligned, bit-packed.
//!
//! ```text
//! page    = root_count u16 | node_count u16 | cluster_count u16 | roots | nodes | clusters
//! root    = ref u16                                  (bit 15: cluster, else node; low bits: index)
//! node    = origin 3 x i32 | exponent 3 x u8 | child_count u8 | lo 3 x n u8 | hi 3 x n u8 | child n x u16
//! cluster = wide u8 | triangles - 1 u8 | vertices - 1 u8 | palette - 1 u8 | base 3 x u40 | widths 3 x u8
//!         | palette n x u16 | palette indices | leaf indices 21 bytes each | vertices
//! ```
//!
//! Invariants: 1. one page content has one disk form; 2. the disk form is never longer than the frame form.

use super::bits::BitWriter;
use super::{ClusterMesh, LatticeBox, Node, Widths, palette_index_bits};
use crate::layout::{
    CLUSTER_TRIANGLES, CLUSTER_VERTICES, FRAME_BYTES, LEAF_TRIANGLES, NODE_WIDTH, PAGE_ROOTS,
};

/// Bytes of a frame before its roots.
pub(super) const FRAME_HEADER_BYTES: usize = 16;

/// A node or cluster of the same page, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageRef {
    /// Index into [`PageContent::nodes`].
    Node(u16),
    /// Index into [`PageContent::clusters`].
    Cluster(u16),
}

impl PageRef {
    const CLUSTER_FLAG: u16 = 1 << 15;

    pub(super) fn to_word(self) -> u16 {
        match self {
            PageRef::Node(index) => index,
            PageRef::Cluster(index) => index | PageRef::CLUSTER_FLAG,
        }
    }

    pub(super) fn from_word(word: u16) -> PageRef {
        if word & PageRef::CLUSTER_FLAG != 0 {
            PageRef::Cluster(word & !PageRef::CLUSTER_FLAG)
        } else {
            PageRef::Node(word)
        }
    }
}

/// A page while it is built.
#[derive(Clone, Debug, Default)]
pub struct PageContent {
    /// Where the top tree enters, in slot order.
    pub roots: Vec<PageRef>,
    /// Per node: its children's boxes and references; children stand behind their parent.
    pub nodes: Vec<Vec<(LatticeBox, PageRef)>>,
    /// The clusters.
    pub clusters: Vec<ClusterMesh>,
}

impl PageContent {
    /// Triangles in the page.
    pub fn triangle_count(&self) -> usize {
        self.clusters.iter().map(|c| c.triangles.len()).sum()
    }

    /// Bytes that the page takes in a frame, at most.
    pub fn frame_bytes(&self) -> usize {
        let clusters: usize = self.clusters.iter().map(ClusterMesh::frame_bytes).sum();
        frame_bytes(self.roots.len(), self.nodes.len(), clusters)
    }

    /// The disk form, before packing, and the bytes of it that are nodes.
    pub fn encode(&self, node_shift: u32) -> (Vec<u8>, usize) {
        assert!(self.roots.len() <= PAGE_ROOTS && self.frame_bytes() <= FRAME_BYTES, "the page is too full");
        let mut out = Vec::with_capacity(FRAME_BYTES);
        for count in [self.roots.len(), self.nodes.len(), self.clusters.len()] {
            put_u16(&mut out, count as u16);
        }
        self.roots.iter().for_each(|root| put_u16(&mut out, root.to_word()));
        let before_nodes = out.len();
        self.nodes.iter().for_each(|children| encode_node(children, node_shift, &mut out));
        let node_bytes = out.len() - before_nodes;
        self.clusters.iter().for_each(|cluster| encode_cluster(cluster, &mut out));
        (out, node_bytes)
    }
}

/// Frame bytes of a page with so many roots and nodes, and clusters of so many frame bytes in all.
pub(crate) fn frame_bytes(root_count: usize, node_count: usize, cluster_frame_bytes: usize) -> usize {
    let roots = (FRAME_HEADER_BYTES + 4 * root_count).next_multiple_of(8);
    roots + node_count * Node::BYTES + cluster_frame_bytes
}

fn encode_node(children: &[(LatticeBox, PageRef)], node_shift: u32, out: &mut Vec<u8>) {
    let boxes: Vec<_> = children.iter().map(|&(b, r)| (b, u32::from(r.to_word()))).collect();
    let node = Node::over(&boxes, node_shift);
    let n = usize::from(node.child_count);
    debug_assert!(n <= NODE_WIDTH);
    node.origin.iter().for_each(|q| out.extend_from_slice(&q.to_le_bytes()));
    out.extend_from_slice(&node.exponent);
    out.push(node.child_count);
    node.lo.iter().chain(&node.hi).for_each(|planes| out.extend_from_slice(&planes[..n]));
    node.child[..n].iter().for_each(|&word| put_u16(out, word as u16));
}

fn encode_cluster(cluster: &ClusterMesh, out: &mut Vec<u8>) {
    let (triangle_count, vertex_count) = (cluster.triangles.len(), cluster.vertices.len());
    assert!(
        (1..=CLUSTER_TRIANGLES).contains(&triangle_count) && (1..=CLUSTER_VERTICES).contains(&vertex_count)
    );
    let (widths, palette) = (cluster.widths(), cluster.palette());
    out.extend_from_slice(&[
        u8::from(widths.wide),
        (triangle_count - 1) as u8,
        (vertex_count - 1) as u8,
        (palette.len() - 1) as u8,
    ]);
    widths.base.iter().for_each(|base| out.extend_from_slice(&base.to_le_bytes()[..5]));
    out.extend_from_slice(&widths.bits);
    palette.iter().for_each(|&material| put_u16(out, material));
    out.extend(palette_indices(cluster, &palette));
    for leaf in cluster.triangles.chunks(LEAF_TRIANGLES) {
        out.extend(leaf_indices(leaf));
    }
    out.extend(packed_vertices(cluster, &widths));
}

fn palette_indices(cluster: &ClusterMesh, palette: &[u16]) -> Vec<u8> {
    let bits = palette_index_bits(palette.len()) as u32;
    let mut writer = BitWriter::default();
    for material in &cluster.materials {
        let index = palette.binary_search(material).expect("made from the same list");
        writer.put(if bits == 0 { 0 } else { index as u64 }, bits);
    }
    writer.finish()
}

/// Corner by corner, eight 7-bit indices; missing triangles are (0, 0, 0).
fn leaf_indices(leaf: &[[u8; 3]]) -> Vec<u8> {
    let mut writer = BitWriter::default();
    for corner in 0..3 {
        for i in 0..LEAF_TRIANGLES {
            writer.put(leaf.get(i).map_or(0, |t| u64::from(t[corner])), 7);
        }
    }
    writer.finish()
}

fn packed_vertices(cluster: &ClusterMesh, widths: &Widths) -> Vec<u8> {
    let mut writer = BitWriter::default();
    for vertex in &cluster.vertices {
        for axis in 0..3 {
            if widths.wide {
                writer.put(vertex[axis] as u64, 40);
            } else {
                writer.put((vertex[axis] - widths.base[axis]) as u64, u32::from(widths.bits[axis]));
            }
        }
    }
    writer.finish()
}

fn put_u16(out: &mut Vec<u8>, value: u16) {
    out.extend_from_slice(&value.to_le_bytes());
}
