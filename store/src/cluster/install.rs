//! Install: from the disk form of a page to the frame that rays traverse as it lies, either whole or with its clusters
//! packed, each to be unpacked when a ray first asks for it. `frame.rs` draws the frame.
//!
//! ```text
//! cluster = 0 base 3 x u40 | 15 widths 3 x u8 | 18 bits per vertex u8 | 19 triangles u8 | 20 vertices u8
//!         | 21 palette length u8 | 22 first triangle u16 | 24 palette at u16 | 26 vertices at u16 | 28 leaves u8
//!         | 29 leaf boxes: lo x, y, z, hi x, y, z, a u8 per leaf each | shapes, a u8 per leaf
//!         | leaf ... | palette | vertices
//! shape   = triangles - 1, 3 bits | bytes of a corner's indices, 3 bits
//! leaf    = least index u8 | corner 0 of its triangles, above it | corner 1 | corner 2
//! ```
//!
//! Why a shape for each leaf: splits are free to end a leaf where an object ends, and 44 % of the leaves of
//! `gen:isosurface:20M` had their corners within 16 numbers, 29 % within 32, since vertices are numbered in the order
//! of first use. Lost: strips in frames, too, 11 bytes where a leaf is one (52 / 71 / 56 % of iso-surface / scan /
//! pipes in the order of version 2) and 22 elsewhere: as many bytes a leaf of those that are full, and each has to be
//! unrolled by every ray.
//!
//! Invariants: 1. no byte of the input is believed: counts and indices are compared with their bounds, and a
//! frame that was installed can be traced without checks; 2. boxes of clusters are read, and hold what is unpacked;
//! those of nodes and leaves are made, rounded outward; 3. nodes and clusters are met in the order in which
//! they stand, so that rays walk a tree: neither cycles nor paths that multiply; 4. no vertex lies behind the lattice.

use super::disk_page::DiskPage;
use super::fields::Machine;
use super::frame::{FRAME_HEADER_BYTES, FrameParts, NODE_WORDS_AT, NOTE_BYTES, SharedFrame};
use super::frame_ref::FrameRef;
use super::unpack::Unpacker;
use super::{LatticeBox, Node};
use crate::io::ALIGN_BYTES;
use crate::layout::{FRAME_BYTES, NODE_WIDTH, TREE_DEPTH, node_shift};

/// Decodes the disk form `packed` of a page into `frame`; `lattice_bits` are the superblock's, at most 40. Says in
/// words what is wrong with a damaged one; the frame's content is then not specified.
pub fn install(packed: &[u8], lattice_bits: u32, frame: &mut [u8]) -> Result<(), &'static str> {
    install_on(Machine::best(), packed, lattice_bits, frame)
}

/// [`install`], done with what `machine` has.
pub(super) fn install_on(
    machine: Machine,
    packed: &[u8],
    lattice_bits: u32,
    frame: &mut [u8],
) -> Result<(), &'static str> {
    prepare(&DiskPage::read(packed)?, lattice_bits, [FRAME_BYTES; 2], frame)?;
    Unpacker::new(machine, SharedFrame::new(frame), packed, usize::MAX)?.unpack_rest()
}

/// A page to be installed without its clusters, which are unpacked on demand. One that has no room for both forms is
/// unpacked at once.
pub(crate) struct ArrivingPage<'a> {
    page: DiskPage<'a>,
    /// Where the heap is to begin.
    heap: usize,
}

impl<'a> ArrivingPage<'a> {
    /// The disk form `packed` of a page.
    pub(crate) fn read(packed: &'a [u8]) -> Result<ArrivingPage<'a>, &'static str> {
        let page = DiskPage::read(packed)?;
        let heap = FrameParts::new(page.root_count, page.node_kinds.len(), page.cluster_count).heap;
        Ok(ArrivingPage { page, heap })
    }

    /// Bytes that it takes at the begin of a frame, and at its end.
    pub(crate) fn ends(&self) -> [usize; 2] {
        let packed = self.page.bytes.len();
        if self.heap + packed <= FRAME_BYTES { [self.heap, packed] } else { [FRAME_BYTES, 0] }
    }

    /// Writes it to the ends of `frame`: a page of a model with so many materials.
    pub(crate) fn install(
        &self,
        (lattice_bits, material_count): (u32, usize),
        frame: &mut [u8],
    ) -> Result<(), &'static str> {
        let [head_bytes, packed_bytes] = self.ends();
        let packed_at = FRAME_BYTES - packed_bytes;
        let heap_room = head_bytes.next_multiple_of(ALIGN_BYTES);
        prepare(&self.page, lattice_bits, [heap_room, packed_at], frame)?;
        if packed_bytes > 0 {
            frame[packed_at..].copy_from_slice(self.page.bytes);
            return Ok(());
        }
        let packed = self.page.bytes;
        Unpacker::new(Machine::best(), SharedFrame::new(frame), packed, material_count)?.unpack_rest()
    }
}

/// Writes all of a frame but clusters, of a page for whose heap there is memory so far, and of which the packed form
/// begins there.
fn prepare(
    page: &DiskPage<'_>,
    lattice_bits: u32,
    [heap_room, packed_at]: [usize; 2],
    frame: &mut [u8],
) -> Result<(), &'static str> {
    assert_eq!(frame.len(), FRAME_BYTES);
    let (root_count, node_count) = (page.root_count, page.node_kinds.len());
    let parts = FrameParts::new(root_count, node_count, page.cluster_count);
    if parts.heap > FRAME_BYTES {
        return Err("a page does not fit its frame");
    }
    if !page.is_padded_with_zeros() {
        return Err("bits are left over in the head of a page");
    }
    frame[..parts.nodes].fill(0);
    let (mut bounds, mut triangle_count, mut at) =
        (Vec::with_capacity(page.cluster_count), 0, page.clusters_at);
    for (index, note) in frame[parts.notes..parts.heap].chunks_exact_mut(NOTE_BYTES).enumerate() {
        let entry = page.entry(index, lattice_bits)?;
        if at > page.bytes.len() || triangle_count > usize::from(u16::MAX) {
            return Err("a cluster is out of range");
        }
        note[..2].copy_from_slice(&(at as u16).to_le_bytes());
        note[2..4].copy_from_slice(&(triangle_count as u16).to_le_bytes());
        bounds.push(entry.bounds(lattice_bits));
        triangle_count += entry.triangle_count;
        at += entry.size;
    }
    if at != page.bytes.len() || triangle_count > usize::from(u16::MAX) {
        return Err("the clusters of a page are more or fewer than its head says");
    }
    let mut tree =
        TreeInstaller { page, lattice_bits, parts: &parts, next_node: 0, next_cluster: 0, bounds, frame };
    for slot in 0..root_count {
        let is_node = page.root_kinds[slot / 8] >> (slot % 8) & 1 == 1;
        let (_, root) = tree.install(is_node, 0)?;
        let at = FRAME_HEADER_BYTES + 4 * slot;
        tree.frame[at..][..4].copy_from_slice(&root.0.to_le_bytes());
        tree.note_word(root, at);
    }
    if tree.next_node != node_count || tree.next_cluster != page.cluster_count {
        return Err("nothing leads to a part of the page");
    }
    let counts = [root_count, node_count, page.cluster_count, triangle_count];
    for (slot, count) in counts.into_iter().enumerate() {
        frame[2 * slot..2 * slot + 2].copy_from_slice(&(count as u16).to_le_bytes());
    }
    let shared = SharedFrame::new(frame);
    shared.begin(parts.heap..heap_room, packed_at, lattice_bits);
    Ok(())
}

/// Puts nodes above clusters.
struct TreeInstaller<'a> {
    page: &'a DiskPage<'a>,
    lattice_bits: u32,
    parts: &'a FrameParts,
    next_node: usize,
    next_cluster: usize,
    /// Boxes of the clusters.
    bounds: Vec<LatticeBox>,
    frame: &'a mut [u8],
}

impl TreeInstaller<'_> {
    /// Installs what the walk meets next, `depth` nodes below a root; gives its box and the word that leads to it.
    fn install(&mut self, is_node: bool, depth: usize) -> Result<(LatticeBox, FrameRef), &'static str> {
        if !is_node {
            let index = self.next_cluster;
            let &bounds = self.bounds.get(index).ok_or("a page has fewer clusters than its tree")?;
            self.next_cluster += 1;
            return Ok((bounds, FrameRef::packed(index)));
        }
        let index = self.next_node;
        let &[count, kinds] =
            self.page.node_kinds.get(index).ok_or("a page has fewer nodes than its tree")?;
        let count = usize::from(count);
        if !(1..=NODE_WIDTH).contains(&count) || usize::from(kinds) >> count != 0 {
            return Err("a node is out of range");
        }
        if depth >= TREE_DEPTH {
            return Err("the tree of a page is too deep");
        }
        self.next_node += 1;
        let at = self.parts.nodes + index * Node::BYTES;
        let mut children = [(LatticeBox::EMPTY, 0); NODE_WIDTH];
        for (i, child) in children[..count].iter_mut().enumerate() {
            let (bounds, place) = self.install(kinds >> i & 1 == 1, depth + 1)?;
            self.note_word(place, at + NODE_WORDS_AT + 4 * i);
            *child = (bounds, place.0);
        }
        let children = &children[..count];
        let bounds = children.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let node = Node::from_children(children, node_shift(self.lattice_bits));
        self.frame[at..at + Node::BYTES].copy_from_slice(bytemuck::bytes_of(&node));
        Ok((bounds, FrameRef::node(at)))
    }

    /// Notes that the word at `at` leads to `child`, where that is a cluster.
    fn note_word(&mut self, child: FrameRef, at: usize) {
        if child.is_cluster() {
            let note = self.parts.notes + NOTE_BYTES * child.offset();
            self.frame[note + 4..note + 6].copy_from_slice(&((at / 4) as u16).to_le_bytes());
        }
    }
}
