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
use super::open_page::OpenPage;
use super::packed_page::{AttributePacker, PackContext, PackedAttributes, PackedPage};
use crate::cluster::{ClusterMesh, LatticeBox, Node, PageRef};
use crate::layout::NODE_WIDTH;

/// The result of a chunk.
pub(crate) struct ChunkPages {
    pub(crate) pages: Vec<PackedPage>,
    /// Of these pages.
    pub(crate) attributes: PackedAttributes,
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
        attributes: AttributePacker::default(),
        out: ChunkPages {
            pages: Vec::new(),
            attributes: PackedAttributes::default(),
            open: OpenPage::default(),
            roots: Vec::new(),
        },
    };
    packer.place(wide.root_bounds, wide.root);
    ChunkPages { attributes: packer.attributes.finish(), ..packer.out }
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
    attributes: AttributePacker,
    out: ChunkPages,
}

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
                full.pack_attributes(&mut self.attributes);
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
