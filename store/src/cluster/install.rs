//! Install: from the disk form of a page to the frame that rays traverse as it lies.
//!
//! ```text
//! frame   = root_count u16 | node_count u16 | cluster_count u16 | triangle_count u16 | used bytes u32 | 0 u32
//!         | roots u32 (FrameRef) | nodes, 144 bytes each | clusters
//!         | 8 zeros
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
//! frame that was installed can be traced without checks; 2. boxes are made from the vertices, never read: those of
//! clusters are exact, those of nodes and leaves rounded outward; 3. nodes and clusters are met in the order in which
//! they stand, so that rays walk a tree: neither cycles nor paths that multiply; 4. no vertex lies behind the lattice.

use super::bits::Windows;
use super::encode::{DISK_HEADER_BYTES, FRAME_HEADER_BYTES, Head};
use super::fields::Machine;
use super::install_cluster::ClusterInstaller;
use super::install_leaves::ROOM_BYTES;
use super::view::FrameRef;
use super::{CLUSTER_HEAD_BYTES, FRAME_TAIL_BYTES, LatticeBox, Node, bits};
use crate::layout::{FRAME_BYTES, NODE_WIDTH, PAGE_ROOTS, TREE_DEPTH, node_shift};

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
    assert_eq!(frame.len(), FRAME_BYTES);
    let (fixed, packed) = packed.split_at_checked(DISK_HEADER_BYTES).ok_or(ENDS_EARLY)?;
    let number = |at: usize, bits: u32| bits::get(fixed, 8 * at, bits);
    let counts = [number(0, 16), number(2, 16), number(4, 8)];
    let [cluster_count, node_count, root_count] = counts.map(|count| count as usize);
    let head = Head {
        anchor: std::array::from_fn(|a| number(9 + 5 * a, 40) as i64),
        offset_bits: [fixed[5], fixed[6], fixed[7]],
        material_bits: fixed[8],
    };
    if root_count == 0 || root_count > PAGE_ROOTS || cluster_count == 0 {
        return Err("the counts of a page are out of range");
    }
    if head.offset_bits.iter().any(|&bits| bits > 40) || head.material_bits > 16 {
        return Err("a width of a page is out of range");
    }
    let nodes_at = (FRAME_HEADER_BYTES + 4 * root_count).next_multiple_of(8);
    let clusters_at = nodes_at + node_count * Node::BYTES;
    if clusters_at + cluster_count * CLUSTER_HEAD_BYTES > FRAME_BYTES {
        return Err("a page does not fit its frame");
    }
    let (root_kinds, packed) = packed.split_at_checked(root_count.div_ceil(8)).ok_or(ENDS_EARLY)?;
    if root_count % 8 != 0 && root_kinds[root_count / 8] >> (root_count % 8) != 0 {
        return Err("bits are left over behind the roots of a page");
    }
    let (node_kinds, packed) = packed.split_at_checked(2 * node_count).ok_or(ENDS_EARLY)?;

    let mut installer = ClusterInstaller::new(machine, head, lattice_bits);
    let mut end = clusters_at;
    let mut clusters = Vec::with_capacity(cluster_count);
    let mut windows = Windows::new(packed);
    // For those that stand near the frame's end.
    let mut room = [0; ROOM_BYTES];
    for _ in 0..cluster_count {
        let (window, left) = windows.front();
        let installed = match frame[end..].first_chunk_mut() {
            Some(room) => installer.install((window, left), room)?,
            None => {
                let installed = installer.install((window, left), &mut room)?;
                let written = installed.frame_bytes + FRAME_TAIL_BYTES;
                let there = frame[end..].get_mut(..written).ok_or("a page does not fit its frame")?;
                there.copy_from_slice(&room[..written]);
                installed
            }
        };
        clusters.push((installed.bounds, FrameRef::cluster(end)));
        end += installed.frame_bytes;
        windows.skip(installed.packed_bytes);
    }
    if !windows.is_empty() {
        return Err("bytes are left over behind the last cluster");
    }

    frame[FRAME_HEADER_BYTES..nodes_at].fill(0);
    let kinds = node_kinds.as_chunks::<2>().0;
    let mut tree =
        TreeInstaller { kinds, lattice_bits, nodes_at, next_node: 0, clusters: clusters.iter(), frame };
    for slot in 0..root_count {
        let is_node = root_kinds[slot / 8] >> (slot % 8) & 1 == 1;
        let (_, root) = tree.install(is_node, 0)?;
        tree.frame[FRAME_HEADER_BYTES + 4 * slot..][..4].copy_from_slice(&root.0.to_le_bytes());
    }
    if tree.next_node != node_count || tree.clusters.len() > 0 {
        return Err("nothing leads to a part of the page");
    }
    let counts = [root_count, node_count, cluster_count, installer.triangle_count()];
    for (slot, count) in counts.into_iter().enumerate() {
        frame[2 * slot..2 * slot + 2].copy_from_slice(&(count as u16).to_le_bytes());
    }
    frame[8..12].copy_from_slice(&((end + FRAME_TAIL_BYTES) as u32).to_le_bytes());
    frame[12..16].fill(0);
    Ok(())
}

const ENDS_EARLY: &str = "a page ends early";

/// Puts nodes above clusters that are installed.
struct TreeInstaller<'a> {
    /// Per node: count of children, which of them are nodes.
    kinds: &'a [[u8; 2]],
    lattice_bits: u32,
    nodes_at: usize,
    next_node: usize,
    /// Boxes and places of the clusters that the walk is to meet.
    clusters: std::slice::Iter<'a, (LatticeBox, FrameRef)>,
    frame: &'a mut [u8],
}

impl TreeInstaller<'_> {
    /// Installs what the walk meets next, `depth` nodes below a root; gives its box and place.
    fn install(&mut self, is_node: bool, depth: usize) -> Result<(LatticeBox, FrameRef), &'static str> {
        if !is_node {
            return self.clusters.next().copied().ok_or("a page has fewer clusters than its tree");
        }
        let index = self.next_node;
        let &[count, kinds] = self.kinds.get(index).ok_or("a page has fewer nodes than its tree")?;
        let count = usize::from(count);
        if !(1..=NODE_WIDTH).contains(&count) || usize::from(kinds) >> count != 0 {
            return Err("a node is out of range");
        }
        if depth >= TREE_DEPTH {
            return Err("the tree of a page is too deep");
        }
        self.next_node += 1;
        let mut children = [(LatticeBox::EMPTY, 0); NODE_WIDTH];
        for (i, child) in children[..count].iter_mut().enumerate() {
            let (bounds, place) = self.install(kinds >> i & 1 == 1, depth + 1)?;
            *child = (bounds, place.0);
        }
        let children = &children[..count];
        let bounds = children.iter().fold(LatticeBox::EMPTY, |all, (b, _)| all.join(b));
        let node = Node::from_children(children, node_shift(self.lattice_bits));
        let at = self.nodes_at + index * Node::BYTES;
        self.frame[at..at + Node::BYTES].copy_from_slice(bytemuck::bytes_of(&node));
        Ok((bounds, FrameRef::node(at)))
    }
}
