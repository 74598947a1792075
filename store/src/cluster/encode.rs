//! The disk form of a mesh page: a head, the tree's shape, clusters; bit-packed.
//!
//! ```text
//! page    = clusters u16 | nodes u16 | roots u8 | offset widths 3 x u8 | material bits u8 | anchor 3 x u40
//!         | bits of a cluster's bytes u8 | kinds of roots, a bit each | node ... | entry ... | cluster ...
//! node    = children u8 | kinds of children u8                           (bit i: child i is a node)
//! entry   = of a cluster, as `entry.rs` draws it                         (behind the last, zeros to the next byte)
//! cluster = bits of: vertices - 1, 7 | wide, 1 | palette, 1 | leaves differ, 1
//!         | leaves - 1, 4 (differ) | their triangles - 1, 3 each (differ)
//!         | class widths 3 x 5 (compact) | materials - 1, 7 (palette) | materials | palette indices
//!         | topology | vertices | zeros to the next byte
//! ```
//!
//! Leaves that do not differ hold eight triangles, but the last.
//!
//! The box of a cluster stands in its entry, so that a page can be traced before its clusters are unpacked. Those of
//! leaves follow from the vertices, those of nodes from the entries. References are not stored: nodes and clusters
//! stand in the order in which a walk from the first root on meets them.
//!
//! Invariants: 1. one page content has one disk form; 2. neither that nor the frame form is longer than a frame,
//! where the builder set [`disk_bytes_most`] aside; 3. the decoder is the judge: `encode` has nothing to say that
//! `install` does not read back.

use super::bits::{BitWriter, bits_of};
use super::entry::{COUNT_BITS, ClusterEntry, ENTRY_BITS_MOST, EntryWidths};
use super::frame::{FrameParts, NOTE_BYTES};
use super::leaves::{self, LEAF_COUNT_BITS, LEAF_SIZE_BITS};
use super::strips;
use super::vertices::{self, CLASS_WIDTH_BITS, CLASSES, TAG_BITS, VertexEncoder};
use super::{ClusterMesh, FRAME_TAIL_BYTES, palette_index_bits, vertex_bytes};
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES, FRAME_BYTES, NODE_WIDTH, PAGE_ROOTS};

/// Bytes of the disk form before the tree.
pub(super) const DISK_HEADER_BYTES: usize = 25;
/// Bytes in a frame that a cluster takes beside itself: what is told of it, and zeros behind it.
pub(super) const CLUSTER_ASIDE_BYTES: usize = NOTE_BYTES + FRAME_TAIL_BYTES;

/// A node or cluster of the same page, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageRef {
    /// Index into [`PageContent::nodes`].
    Node(u16),
    /// Index into [`PageContent::clusters`].
    Cluster(u16),
}

/// A page while it is built. Nodes and clusters stand in the order in which a walk from the roots on meets them.
#[derive(Clone, Debug, Default)]
pub struct PageContent {
    /// Where the top tree enters, in slot order.
    pub roots: Vec<PageRef>,
    /// Per node: its children.
    pub nodes: Vec<Vec<PageRef>>,
    /// The clusters; vertices in the order of first use.
    pub clusters: Vec<ClusterMesh>,
}

/// Bits of a disk form by what they are spent on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DiskBits {
    /// The shape of the tree.
    pub tree: u64,
    /// Heads of the page and its clusters, with materials.
    pub heads: u64,
    /// Corners of triangles.
    pub topology: u64,
    /// Vertices.
    pub vertices: u64,
}

impl PageContent {
    /// Triangles in the page.
    pub fn triangle_count(&self) -> usize {
        self.clusters.iter().map(|c| c.triangles.len()).sum()
    }

    /// Bytes that the page takes in a frame, at most.
    pub fn frame_bytes(&self) -> usize {
        let clusters: usize = self.clusters.iter().map(ClusterMesh::frame_bytes).sum();
        let aside = self.clusters.len() * CLUSTER_ASIDE_BYTES;
        frame_bytes(self.roots.len(), self.nodes.len(), clusters + aside)
    }

    /// The disk form, before packing, and what its bits are spent on.
    pub fn encode(&self) -> (Vec<u8>, DiskBits) {
        assert!(self.roots.len() <= PAGE_ROOTS && self.frame_bytes() <= FRAME_BYTES, "the page is too full");
        let mut out = BitWriter::default();
        let head = Head::new(&self.clusters);
        for (count, bits) in [(self.clusters.len(), 16), (self.nodes.len(), 16), (self.roots.len(), 8)] {
            out.put(count as u64, bits);
        }
        head.offset_bits.iter().for_each(|&bits| out.put(u64::from(bits), 8));
        out.put(u64::from(head.material_bits), 8);
        head.anchor.iter().for_each(|&q| out.put(q as u64, 40));
        let spent = DiskBits { heads: 8 * DISK_HEADER_BYTES as u64, ..DiskBits::default() };
        let mut encoder = ClusterEncoder { head, out: BitWriter::default(), spent };
        let sizes: Vec<usize> = self.clusters.iter().map(|cluster| encoder.encode(cluster)).collect();
        let ClusterEncoder { head, out: clusters, mut spent } = encoder;
        let longest = sizes.iter().max().copied().unwrap_or(0);
        let widths = EntryWidths { offset: head.offset_bits, size: bits_of(longest as u64) };
        out.put(u64::from(widths.size), 8);
        debug_assert_eq!(out.bytes.len(), DISK_HEADER_BYTES);
        self.encode_tree(&mut out);
        spent.tree = 8 * (out.bytes.len() - DISK_HEADER_BYTES) as u64;
        let before = out.bit_count();
        for (cluster, &size) in self.clusters.iter().zip(&sizes) {
            ClusterEntry::new(cluster, size).write(&widths, head.anchor, &mut out);
        }
        out.align();
        spent.heads += (out.bit_count() - before) as u64;
        out.append(clusters);
        let bytes = out.finish();
        assert!(bytes.len() <= FRAME_BYTES, "the disk form is longer than a frame");
        (bytes, spent)
    }

    /// Kinds of roots and nodes; checks that all stands in the order of the walk.
    fn encode_tree(&self, out: &mut BitWriter) {
        let mut reached = (0, 0);
        self.roots.iter().for_each(|root| self.check_order(*root, &mut reached));
        assert_eq!(
            reached,
            (self.nodes.len(), self.clusters.len()),
            "the walk does not meet all of the page"
        );
        for roots in self.roots.chunks(8) {
            out.put(kinds(roots), 8);
        }
        for children in &self.nodes {
            assert!((1..=NODE_WIDTH).contains(&children.len()), "{} children", children.len());
            out.put(children.len() as u64, 8);
            out.put(kinds(children), 8);
        }
    }

    fn check_order(&self, at: PageRef, reached: &mut (usize, usize)) {
        match at {
            PageRef::Cluster(index) => {
                assert_eq!(usize::from(index), reached.1, "clusters do not stand in the order of the walk");
                reached.1 += 1;
            }
            PageRef::Node(index) => {
                assert_eq!(usize::from(index), reached.0, "nodes do not stand in the order of the walk");
                reached.0 += 1;
                self.nodes[usize::from(index)].iter().for_each(|child| self.check_order(*child, reached));
            }
        }
    }
}

/// Bit i: the i-th one is a node.
fn kinds(refs: &[PageRef]) -> u64 {
    refs.iter().enumerate().map(|(i, r)| u64::from(matches!(r, PageRef::Node(_))) << i).sum()
}

/// Frame bytes of a page with so many roots and nodes, and clusters that take so many in all.
pub(crate) fn frame_bytes(root_count: usize, node_count: usize, cluster_frame_bytes: usize) -> usize {
    FrameParts::new(root_count, node_count, 0).heap + cluster_frame_bytes
}

/// Bytes of a cluster on disk, at most: its topology is known, each vertex plain, behind a tag.
pub(super) fn disk_bytes_most(cluster: &ClusterMesh, topology_bits: u32) -> usize {
    let (triangles, vertices) = (cluster.triangles.len(), cluster.vertices.len());
    let palette = cluster.palette().len();
    let leaves = LEAF_COUNT_BITS + cluster.leaf_sizes.len() as u32 * LEAF_SIZE_BITS;
    let head = ENTRY_BITS_MOST + 2 * COUNT_BITS + 3 + leaves + CLASSES as u32 * CLASS_WIDTH_BITS;
    let materials = palette * 16 + triangles * palette_index_bits(palette);
    let plain = 8 * vertex_bytes(&cluster.widths(), vertices) + vertices * TAG_BITS as usize;
    (head as usize + materials + topology_bits as usize + plain).div_ceil(8)
}

/// What all clusters of a page share.
pub(super) struct Head {
    /// Least corner of all.
    pub(super) anchor: [i64; 3],
    /// Bits of a cluster's base above the anchor, per axis.
    pub(super) offset_bits: [u8; 3],
    /// Bits of a material's index.
    pub(super) material_bits: u8,
}

impl Head {
    fn new(clusters: &[ClusterMesh]) -> Head {
        let bases = clusters.iter().map(|cluster| cluster.widths().base);
        let (lo, hi) = bases.fold(([i64::MAX; 3], [0; 3]), |(lo, hi), base| {
            (std::array::from_fn(|a| base[a].min(lo[a])), std::array::from_fn(|a| base[a].max(hi[a])))
        });
        let greatest = clusters.iter().flat_map(|c| &c.materials).max().copied().unwrap_or(0);
        Head {
            anchor: lo,
            offset_bits: std::array::from_fn(|a| bits_of((hi[a] - lo[a]) as u64)),
            material_bits: bits_of(u64::from(greatest)),
        }
    }
}

/// Writes clusters, one behind the other.
struct ClusterEncoder {
    head: Head,
    out: BitWriter,
    spent: DiskBits,
}

impl ClusterEncoder {
    /// Gives how many bytes the cluster takes.
    fn encode(&mut self, cluster: &ClusterMesh) -> usize {
        let (triangle_count, vertex_count) = (cluster.triangles.len(), cluster.vertices.len());
        assert!((1..=CLUSTER_TRIANGLES).contains(&triangle_count), "{triangle_count} triangles");
        assert!((1..=CLUSTER_VERTICES).contains(&vertex_count), "{vertex_count} vertices");
        let before = self.out.bit_count();
        // The topology goes behind the widths of the classes, which follow from the guides that it makes.
        let mut topology_out = BitWriter::default();
        let (guides, used) = strips::encode(&cluster.triangles, &mut topology_out);
        assert_eq!(used, vertex_count, "a vertex that no triangle uses");
        let (widths, palette) = (cluster.widths(), cluster.palette());
        let guided = VertexEncoder { cluster, widths: &widths, guides: &guides };
        let out = &mut self.out;
        out.put(vertex_count as u64 - 1, COUNT_BITS);
        out.put(u64::from(widths.wide), 1);
        out.put(u64::from(palette.len() > 1), 1);
        leaves::encode_sizes(cluster, out);
        let classes = if widths.wide { [0; 3] } else { guided.class_widths() };
        if !widths.wide {
            classes.iter().for_each(|&width| out.put(u64::from(width), CLASS_WIDTH_BITS));
        }
        encode_materials(cluster, &palette, &self.head, out);
        let before_topology = out.bit_count();
        out.append(topology_out);
        let before_vertices = out.bit_count();
        if widths.wide {
            vertices::encode_wide(cluster, &widths, out);
        } else {
            guided.encode(classes, out);
        }
        out.align();
        self.spent.heads += (before_topology - before) as u64;
        self.spent.topology += (before_vertices - before_topology) as u64;
        self.spent.vertices += (out.bit_count() - before_vertices) as u64;
        (out.bit_count() - before) / 8
    }
}

fn encode_materials(cluster: &ClusterMesh, palette: &[u16], head: &Head, out: &mut BitWriter) {
    if palette.len() > 1 {
        out.put(palette.len() as u64 - 1, COUNT_BITS);
    }
    palette.iter().for_each(|&material| out.put(u64::from(material), u32::from(head.material_bits)));
    let bits = palette_index_bits(palette.len()) as u32;
    if bits > 0 {
        for material in &cluster.materials {
            out.put(palette.binary_search(material).expect("made from the same list") as u64, bits);
        }
    }
}
