//! From a chunk's binary tree to 8-wide nodes, and from these to pages.
//!
//! ```text
//! place(subtree): fits what is left of the open page?  -> a root of that page
//!                 one cluster?                         -> a root of a new page
//!                 else                                 -> place its children
//! ```
//!
//! So pages fill up, each with a few neighbouring subtrees. What is above these is made once more, of the roots of
//! all pages of all chunks (`writer.rs`): a chunk's own tree knows nothing of chunks that lie in the same place. The
//! last page of a chunk stays open: the writer lets the ends of chunks that follow each other share one, where they
//! fit.
//!
//! Invariants: 1. a page refers to nothing outside of itself; 2. both its forms fit a frame; 3. within a page a
//! node stands before its children.

use super::clusterer::{BinaryNode, Clusters};
use crate::cluster::{
    ClusterMesh, ColourPacker, FRAME_TAIL_BYTES, LatticeBox, Node, PackedColours, PageContent, PageRef,
};
use crate::layout::{FRAME_BYTES, NODE_WIDTH, PAGE_ROOTS, Packing};

/// A page ready to be written.
pub(crate) struct PackedPage {
    /// As it will stand on disk.
    pub(crate) stored: Vec<u8>,
    pub(crate) packing: Packing,
    pub(crate) unpacked_bytes: usize,
    pub(crate) tree_bytes: usize,
    pub(crate) frame_bytes: usize,
    pub(crate) triangle_count: usize,
    pub(crate) vertex_count: usize,
    pub(crate) cluster_count: usize,
    pub(crate) wide_cluster_count: usize,
    pub(crate) emitters: Vec<PageEmitter>,
}

/// An emissive triangle of a page.
pub(crate) struct PageEmitter {
    /// Index within the page.
    pub(crate) triangle: u32,
    pub(crate) corners: [[i64; 3]; 3],
    pub(crate) material: u16,
}

/// What the pages of all chunks share.
#[derive(Clone, Copy)]
pub(crate) struct PackContext<'a> {
    /// Per material: does it emit?
    pub(crate) emissive: &'a [bool],
    /// Holds all of them.
    pub(crate) bounds: LatticeBox,
    /// Whether any of them has colours.
    pub(crate) has_colours: bool,
}

/// A page that may take more.
#[derive(Default)]
pub(crate) struct OpenPage {
    content: PageContent,
    /// Frame bytes of its nodes and clusters.
    bytes: usize,
}

impl OpenPage {
    pub(crate) fn is_empty(&self) -> bool {
        self.content.roots.is_empty()
    }

    /// Whether so many bytes under so many roots fit.
    fn has_room(&self, bytes: usize, root_count: usize) -> bool {
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
        let page = self.content;
        assert!(!page.clusters.is_empty(), "a page has a cluster");
        let (raw, spent) = page.encode();
        let unpacked_bytes = raw.len();
        let (stored, packing) = packed(raw);
        PackedPage {
            stored,
            packing,
            unpacked_bytes,
            tree_bytes: spent.tree as usize / 8,
            frame_bytes: page.frame_bytes(),
            triangle_count: page.triangle_count(),
            vertex_count: page.clusters.iter().map(|c| c.vertices.len()).sum(),
            cluster_count: page.clusters.len(),
            wide_cluster_count: page.clusters.iter().filter(|c| c.widths().wide).count(),
            emitters: emitters_of(&page.clusters, context.emissive),
        }
    }
}

/// The result of a chunk.
pub(crate) struct ChunkPages {
    pub(crate) pages: Vec<PackedPage>,
    /// Of these pages.
    pub(crate) colours: PackedColours,
    /// The page behind these.
    pub(crate) open: OpenPage,
    /// Where rays enter its pages.
    pub(crate) roots: Vec<ChunkRoot>,
}

/// A root of a page.
pub(crate) struct ChunkRoot {
    pub(crate) bounds: LatticeBox,
    /// From the chunk's first page on; one more than there are for the open one.
    pub(crate) page: u32,
    pub(crate) slot: u32,
}

/// What LZ4 must save, in percent of the raw bytes, to be worth its decode.
const LZ4_GAIN_PERCENT: usize = 3;

/// Cuts the tree into pages and encodes them.
pub(crate) fn pack(clusters: Clusters, context: PackContext<'_>) -> ChunkPages {
    let wide = WideTree::new(&clusters.tree);
    let sizes = clusters.page_bytes;
    let mut clusters: Vec<Option<ClusterMesh>> = clusters.clusters.into_iter().map(Some).collect();
    let mut packer = Packer {
        subtree_bytes: wide.subtree_bytes(&sizes),
        wide: &wide,
        sizes,
        clusters: &mut clusters,
        context,
        colours: ColourPacker::default(),
        out: ChunkPages {
            pages: Vec::new(),
            colours: PackedColours::default(),
            open: OpenPage::default(),
            roots: Vec::new(),
        },
    };
    packer.place(wide.root_bounds, wide.root);
    ChunkPages { colours: packer.colours.finish(), ..packer.out }
}

/// A subtree of the wide tree.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum WideRef {
    Leaf(u32),
    Node(u32),
}

/// The 8-wide tree over leaves 0, 1, ..; children stand before parents.
pub(crate) struct WideTree {
    pub(crate) nodes: Vec<Vec<(LatticeBox, WideRef)>>,
    pub(crate) root: WideRef,
    root_bounds: LatticeBox,
}

impl WideTree {
    /// Collapses a binary tree: a node takes the largest of its subtrees apart until it has eight children.
    pub(crate) fn new(tree: &[(LatticeBox, BinaryNode)]) -> WideTree {
        let (bounds, _) = tree[tree.len() - 1];
        let mut wide = WideTree { nodes: Vec::new(), root: WideRef::Leaf(0), root_bounds: bounds };
        wide.root = wide.collapse(tree, tree.len() as u32 - 1);
        wide
    }

    fn collapse(&mut self, tree: &[(LatticeBox, BinaryNode)], at: u32) -> WideRef {
        let (left, right) = match tree[at as usize].1 {
            BinaryNode::Cluster(index) => return WideRef::Leaf(index),
            BinaryNode::Split(left, right) => (left, right),
        };
        let mut open = vec![left, right];
        while open.len() < NODE_WIDTH {
            let largest = (0..open.len())
                .filter(|&i| matches!(tree[open[i] as usize].1, BinaryNode::Split(..)))
                .max_by(|&a, &b| {
                    let area = |i: usize| tree[open[i] as usize].0.half_area();
                    area(a).total_cmp(&area(b)).then(b.cmp(&a))
                });
            let Some(i) = largest else { break };
            let BinaryNode::Split(left, right) = tree[open[i] as usize].1 else { unreachable!("filtered") };
            open.splice(i..=i, [left, right]);
        }
        let children =
            open.into_iter().map(|child| (tree[child as usize].0, self.collapse(tree, child))).collect();
        self.nodes.push(children);
        WideRef::Node(self.nodes.len() as u32 - 1)
    }

    /// Frame bytes of the subtree under each node.
    fn subtree_bytes(&self, leaf_bytes: &[usize]) -> Vec<usize> {
        let mut bytes: Vec<usize> = Vec::with_capacity(self.nodes.len());
        for children in &self.nodes {
            let below: usize = children
                .iter()
                .map(|&(_, child)| match child {
                    WideRef::Leaf(i) => leaf_bytes[i as usize],
                    WideRef::Node(i) => bytes[i as usize],
                })
                .sum();
            bytes.push(Node::BYTES + below);
        }
        bytes
    }
}

/// Fills one page after the other.
struct Packer<'a> {
    wide: &'a WideTree,
    sizes: Vec<usize>,
    subtree_bytes: Vec<usize>,
    clusters: &'a mut [Option<ClusterMesh>],
    context: PackContext<'a>,
    colours: ColourPacker,
    out: ChunkPages,
}

/// Frame bytes for nodes and clusters; header, all root slots and the tail are set aside.
const PAGE_CAPACITY: usize = FRAME_BYTES - 16 - 4 * PAGE_ROOTS - FRAME_TAIL_BYTES;

impl Packer<'_> {
    fn place(&mut self, bounds: LatticeBox, at: WideRef) {
        let bytes = match at {
            WideRef::Leaf(i) => self.sizes[i as usize],
            WideRef::Node(i) => self.subtree_bytes[i as usize],
        };
        let fits = self.out.open.has_room(bytes, 1);
        match at {
            WideRef::Node(i) if !fits => {
                let wide = self.wide;
                return wide.nodes[i as usize].iter().for_each(|&(bounds, child)| self.place(bounds, child));
            }
            WideRef::Leaf(_) if !fits => {
                let full = std::mem::take(&mut self.out.open);
                full.pack_colours(&mut self.colours);
                self.out.pages.push(full.pack(self.context));
            }
            _ => {}
        }
        self.out.open.bytes += bytes;
        let root = self.copy(at);
        let roots = &mut self.out.open.content.roots;
        roots.push(root);
        let (page, slot) = (self.out.pages.len() as u32, roots.len() as u32 - 1);
        self.out.roots.push(ChunkRoot { bounds, page, slot });
    }

    /// Copies a subtree into the open page.
    fn copy(&mut self, at: WideRef) -> PageRef {
        match at {
            WideRef::Leaf(i) => {
                self.out
                    .open
                    .content
                    .clusters
                    .push(self.clusters[i as usize].take().expect("a cluster is placed once"));
                PageRef::Cluster(self.out.open.content.clusters.len() as u16 - 1)
            }
            WideRef::Node(i) => {
                let index = self.out.open.content.nodes.len();
                self.out.open.content.nodes.push(Vec::new());
                let children =
                    self.wide.nodes[i as usize].iter().map(|&(_, child)| self.copy(child)).collect();
                self.out.open.content.nodes[index] = children;
                PageRef::Node(index as u16)
            }
        }
    }
}

/// A page as it is stored.
pub(crate) fn packed(raw: Vec<u8>) -> (Vec<u8>, Packing) {
    let packed = lz4_flex::block::compress(&raw);
    let gains = packed.len() * 100 <= raw.len() * (100 - LZ4_GAIN_PERCENT);
    if gains { (packed, Packing::Lz4) } else { (raw, Packing::Raw) }
}

fn emitters_of(clusters: &[ClusterMesh], emissive: &[bool]) -> Vec<PageEmitter> {
    let materials = clusters.iter().flat_map(|cluster| &cluster.materials);
    let count = materials.filter(|&&material| emissive[usize::from(material)]).count();
    let mut emitters = Vec::with_capacity(count);
    let mut first = 0;
    for cluster in clusters {
        for (i, (corners, &material)) in cluster.triangles.iter().zip(&cluster.materials).enumerate() {
            if emissive.get(usize::from(material)).is_some_and(|&e| e) {
                let corners = corners.map(|index| cluster.vertices[usize::from(index)]);
                emitters.push(PageEmitter { triangle: first + i as u32, corners, material });
            }
        }
        first += cluster.triangles.len() as u32;
    }
    emitters
}
