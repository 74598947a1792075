//! Install: from the disk form of a page to the frame that rays traverse as it lies.
//!
//! ```text
//! frame   = root_count u16 | node_count u16 | cluster_count u16 | triangle_count u16 | used bytes u32 | 0 u32
//!         | roots u32 (FrameRef) | nodes, 96 bytes each | clusters
//! cluster = 0 base 3 x i64 | 24 widths 3 x u8 | 27 wide u8 | 28 triangles u8 | 29 vertices u8 | 30 leaves u8
//!         | 31 leaf box exponents 3 x u8 | 34 first triangle u16 | 36 palette length u16 | 38 palette at u16
//!         | 40 vertices at u16 | 42 bits per vertex u8 | 43 palette bits u8 | 44 zero
//!         | 48 leaf boxes: lo x, y, z, hi x, y, z, 16 u8 each | 144 indices | palette | vertices | 8 zeros
//! ```
//!
//! Invariants: 1. no byte of the input is believed: counts and indices are compared with their bounds, and a
//! frame that was installed can be traced without checks; 2. leaf boxes are rounded outward; 3. every reference
//! leads behind the node that holds it, and no node has two, so that rays walk a tree: neither cycles nor paths
//! that multiply.

use super::encode::FRAME_HEADER_BYTES;
use super::view::{FrameRef, LeafBoxes};
use super::*;
use crate::layout::{CLUSTER_VERTICES, FRAME_BYTES, NODE_WIDTH, PAGE_ROOTS, TREE_DEPTH};

/// Decodes the disk form `packed` of a page into `frame`. Says in words what is wrong with a damaged one;
/// the frame's content is then not specified.
pub fn install(packed: &[u8], frame: &mut [u8]) -> Result<(), &'static str> {
    assert_eq!(frame.len(), FRAME_BYTES);
    let mut input = Input { bytes: packed };
    let counts = [input.u16()?, input.u16()?, input.u16()?];
    let [root_count, node_count, cluster_count] = counts.map(usize::from);
    if root_count == 0 || root_count > PAGE_ROOTS || cluster_count == 0 {
        return Err("the counts of a page are out of range");
    }
    let nodes_at = (FRAME_HEADER_BYTES + 4 * root_count).next_multiple_of(8);
    let clusters_at = nodes_at + node_count * Node::BYTES;
    if clusters_at + cluster_count * CLUSTER_HEADER_BYTES > FRAME_BYTES {
        return Err("a page does not fit its frame");
    }
    let root_words = input.take(2 * root_count)?;
    let first_nodes = input.bytes;
    for _ in 0..node_count {
        node_record(&mut input)?;
    }
    let mut cluster_offsets = [0u16; FRAME_BYTES / CLUSTER_HEADER_BYTES];
    let (mut at, mut first_triangle) = (clusters_at, 0usize);
    for offset in &mut cluster_offsets[..cluster_count] {
        *offset = (at / CLUSTER_ALIGN) as u16;
        at += install_cluster(&mut input, &mut frame[at..], &mut first_triangle)?;
    }
    if !input.bytes.is_empty() {
        return Err("bytes are left over behind the last cluster");
    }
    let place = |word: u16, after: usize| match PageRef::from_word(word) {
        PageRef::Node(i) if usize::from(i) < node_count && usize::from(i) >= after => {
            Ok(FrameRef::node(nodes_at + usize::from(i) * Node::BYTES))
        }
        PageRef::Cluster(i) if usize::from(i) < cluster_count => {
            Ok(FrameRef::cluster(usize::from(cluster_offsets[usize::from(i)]) * CLUSTER_ALIGN))
        }
        _ => Err("a reference leads out of its page"),
    };
    // Of each node that something leads to: how deep it lies, from 1.
    let mut depth = [0u8; FRAME_BYTES / Node::BYTES];
    for (slot, word) in root_words.as_chunks::<2>().0.iter().enumerate() {
        let word = u16::from_le_bytes(*word);
        enter(&mut depth, word, 0)?;
        let word = place(word, 0)?.0;
        frame[FRAME_HEADER_BYTES + 4 * slot..][..4].copy_from_slice(&word.to_le_bytes());
    }
    let mut input = Input { bytes: first_nodes };
    for index in 0..node_count {
        let (mut node, above) = (node_record(&mut input)?, depth[index]);
        for word in &mut node.child[..usize::from(node.child_count)] {
            enter(&mut depth, *word as u16, above)?;
            *word = place(*word as u16, index + 1)?.0;
        }
        frame[nodes_at + index * Node::BYTES..][..Node::BYTES].copy_from_slice(bytemuck::bytes_of(&node));
    }
    for (at, count) in [(0, counts[0]), (2, counts[1]), (4, counts[2]), (6, first_triangle as u16)] {
        frame[at..at + 2].copy_from_slice(&count.to_le_bytes());
    }
    frame[8..12].copy_from_slice(&(at as u32).to_le_bytes());
    frame[12..16].fill(0);
    Ok(())
}

/// Notes that something `above` levels deep leads to `word`.
fn enter(depth: &mut [u8], word: u16, above: u8) -> Result<(), &'static str> {
    let PageRef::Node(index) = PageRef::from_word(word) else { return Ok(()) };
    match depth.get_mut(usize::from(index)) {
        None => Err("a reference leads out of its page"),
        Some(_) if usize::from(above) >= TREE_DEPTH => Err("the tree of a page is too deep"),
        Some(depth) if *depth != 0 => Err("a node of a page has two parents"),
        Some(depth) => {
            *depth = above + 1;
            Ok(())
        }
    }
}

/// Reads one node; its children's words are still page references.
fn node_record(input: &mut Input<'_>) -> Result<Node, &'static str> {
    let fixed = input.take(16)?;
    let n = usize::from(fixed[15]);
    if !(1..=NODE_WIDTH).contains(&n) || fixed[12..15].iter().any(|&e| e > 32) {
        return Err("a node is out of range");
    }
    let mut node = Node {
        origin: std::array::from_fn(|a| i32::from_le_bytes(fixed[4 * a..4 * a + 4].try_into().expect("4"))),
        exponent: [fixed[12], fixed[13], fixed[14]],
        child_count: fixed[15],
        lo: [[255; NODE_WIDTH]; 3],
        hi: [[0; NODE_WIDTH]; 3],
        child: [0; NODE_WIDTH],
    };
    for planes in node.lo.iter_mut().chain(&mut node.hi) {
        planes[..n].copy_from_slice(input.take(n)?);
    }
    for word in &mut node.child[..n] {
        *word = u32::from(input.u16()?);
    }
    Ok(node)
}

/// Installs one cluster at the start of `frame`; gives the bytes it takes.
fn install_cluster(
    input: &mut Input<'_>,
    frame: &mut [u8],
    first_triangle: &mut usize,
) -> Result<usize, &'static str> {
    let fixed = input.take(22)?;
    let (triangle_count, vertex_count) = (usize::from(fixed[1]) + 1, usize::from(fixed[2]) + 1);
    let palette_len = usize::from(fixed[3]) + 1;
    let widths = Widths {
        base: std::array::from_fn(|a| bits::get(&fixed[4 + 5 * a..9 + 5 * a], 0, 40) as i64),
        bits: [fixed[19], fixed[20], fixed[21]],
        wide: fixed[0] == 1,
    };
    let vertex_bits: u32 = widths.bits.iter().map(|&b| u32::from(b)).sum();
    let packs = vertex_bits <= VERTEX_BITS && widths.bits.iter().all(|&b| u32::from(b) <= AXIS_BITS);
    if fixed[0] > 1
        || triangle_count > 128
        || vertex_count > CLUSTER_VERTICES
        || palette_len > triangle_count
        || widths.bits.iter().any(|&b| b > 40)
        || !(packs || widths.wide)
    {
        return Err("a cluster is out of range");
    }
    let leaf_count = triangle_count.div_ceil(LEAF_TRIANGLES);
    let palette_at = CLUSTER_HEADER_BYTES + leaf_count * LEAF_INDEX_BYTES;
    let palette_bytes = palette_bytes(palette_len, triangle_count);
    let vertices_at = palette_at + palette_bytes;
    let vertex_bytes = vertex_bytes(&widths, vertex_count);
    let end = (vertices_at + vertex_bytes + VERTEX_TAIL_BYTES).next_multiple_of(CLUSTER_ALIGN);
    let Some(frame) = frame.get_mut(..end) else { return Err("a page does not fit its frame") };

    for axis in 0..3 {
        frame[8 * axis..8 * axis + 8].copy_from_slice(&widths.base[axis].to_le_bytes());
    }
    let shift = widths.bits.map(|b| b.saturating_sub(8));
    let head = [
        u8::from(widths.wide),
        triangle_count as u8,
        vertex_count as u8,
        leaf_count as u8,
        shift[0],
        shift[1],
        shift[2],
    ];
    frame[24..27].copy_from_slice(&widths.bits);
    frame[27..34].copy_from_slice(&head);
    let words = [*first_triangle, palette_len, palette_at, vertices_at];
    for (i, word) in words.into_iter().enumerate() {
        let word = u16::try_from(word).map_err(|_| "a page holds too many triangles")?;
        frame[34 + 2 * i..36 + 2 * i].copy_from_slice(&word.to_le_bytes());
    }
    frame[42] = if widths.wide { 120 } else { vertex_bits as u8 };
    frame[43] = palette_index_bits(palette_len) as u8;
    frame[44..48].fill(0);
    frame[palette_at..vertices_at].copy_from_slice(input.take(palette_bytes)?);
    frame[CLUSTER_HEADER_BYTES..palette_at].copy_from_slice(input.take(leaf_count * LEAF_INDEX_BYTES)?);
    frame[vertices_at..vertices_at + vertex_bytes].copy_from_slice(input.take(vertex_bytes)?);
    frame[vertices_at + vertex_bytes..].fill(0);
    *first_triangle += triangle_count;
    install_leaf_boxes(frame, &widths, shift)?;
    Ok(end)
}

/// Recomputes the leaf boxes from indices and vertices; checks both on the way.
fn install_leaf_boxes(frame: &mut [u8], widths: &Widths, shift: [u8; 3]) -> Result<(), &'static str> {
    let cluster = ClusterView::new(frame);
    let (triangle_count, vertex_count) = (cluster.triangle_count(), cluster.vertex_count());
    let mut local = [[0i64; 3]; CLUSTER_VERTICES];
    for (i, vertex) in local[..vertex_count].iter_mut().enumerate() {
        let q = cluster.vertex(i);
        *vertex = std::array::from_fn(|a| q[a] - widths.base[a]);
        if (0..3).any(|a| vertex[a] < 0 || vertex[a] >> widths.bits[a] != 0) {
            return Err("a vertex lies outside of its cluster");
        }
    }
    let palette_len = cluster.palette_len();
    if (0..triangle_count).any(|i| cluster.palette_index(i) >= palette_len) {
        return Err("a material index lies behind its palette");
    }
    let mut boxes: LeafBoxes = [[255; 16], [255; 16], [255; 16], [0; 16], [0; 16], [0; 16]];
    for leaf in 0..cluster.leaf_count() {
        let (mut lo, mut hi) = ([i64::MAX; 3], [i64::MIN; 3]);
        let corners = cluster.leaf_corners(leaf);
        for i in 0..LEAF_TRIANGLES.min(triangle_count - leaf * LEAF_TRIANGLES) {
            for indices in &corners {
                let index = usize::from(indices[i]);
                if index >= vertex_count {
                    return Err("a corner lies behind the vertices");
                }
                for axis in 0..3 {
                    lo[axis] = lo[axis].min(local[index][axis]);
                    hi[axis] = hi[axis].max(local[index][axis]);
                }
            }
        }
        for axis in 0..3 {
            boxes[axis][leaf] = (lo[axis] >> shift[axis]) as u8;
            boxes[3 + axis][leaf] = (hi[axis] >> shift[axis]) as u8;
        }
    }
    frame[48..CLUSTER_HEADER_BYTES].copy_from_slice(boxes.as_flattened());
    Ok(())
}

/// What is left of the disk form.
struct Input<'a> {
    bytes: &'a [u8],
}

impl<'a> Input<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (head, tail) = self.bytes.split_at_checked(count).ok_or("a page ends early")?;
        self.bytes = tail;
        Ok(head)
    }

    fn u16(&mut self) -> Result<u16, &'static str> {
        Ok(u16::from_le_bytes(self.take(2)?.try_into().expect("two bytes")))
    }
}
