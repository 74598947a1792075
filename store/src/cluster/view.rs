//! Reading a cluster in a frame: its header, leaf boxes, corners, vertices, materials.
//!
//! Leaf boxes: plane `lo` of axis `a` lies at `base + lo * 2^shift`, plane `hi` at `base + (hi + 1) * 2^shift - 1`,
//! so that both are 8-bit cells of the cluster's box and the rounding is outward by construction.
//!
//! Invariants: 1. a frame in here was filled by `install`, which checked every count and index; 2. vertices read
//! from different clusters agree (lattice integers).

use super::bits::BYTES_OF_ONE;
use super::{
    CLUSTER_HEAD_BYTES, ClusterMesh, LEAF_PLANES, LeafShape, WIDE_VERTEX_BYTES, bits, palette_index_bits,
};
use crate::layout::LEAF_TRIANGLES;

/// Where the indices of a leaf stand in its cluster, bytes from the cluster's start, and how they lie there.
#[derive(Clone, Copy, Debug)]
pub struct LeafIndices {
    /// The least index; behind it those above it.
    pub at: usize,
    /// Their shape.
    pub shape: LeafShape,
}

/// The first bytes of a cluster in a frame. Numbers of several bytes are little-endian.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct ClusterHead {
    /// Least corner of the vertices, lattice.
    pub base: [[u8; 5]; 3],
    /// Bits per axis.
    pub widths: [u8; 3],
    /// Bits of a packed vertex.
    pub vertex_bits: u8,
    pub(super) triangle_count: u8,
    pub(super) vertex_count: u8,
    pub(super) palette_len: u8,
    /// Triangles before the cluster in its page.
    pub(super) first_triangle: [u8; 2],
    /// Where the palette begins, bytes from the cluster's start.
    pub(super) palette_at: [u8; 2],
    /// Where the packed vertices begin.
    pub(super) vertices_at: [u8; 2],
    pub(super) leaf_count: u8,
}

/// A cluster in a frame.
#[derive(Clone, Copy)]
pub struct ClusterView<'a> {
    head: &'a ClusterHead,
    bytes: &'a [u8],
}

impl<'a> ClusterView<'a> {
    #[inline(always)]
    pub(super) fn new(bytes: &'a [u8]) -> ClusterView<'a> {
        ClusterView { head: bytemuck::from_bytes(&bytes[..CLUSTER_HEAD_BYTES]), bytes }
    }

    /// The first bytes of the cluster.
    #[inline(always)]
    pub fn head(&self) -> &'a ClusterHead {
        self.head
    }

    /// The bytes of the cluster and eight zeros behind them, for readers that do their own addressing.
    #[inline(always)]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Least corner of its vertices, lattice.
    pub fn base(&self) -> [i64; 3] {
        self.head.base.map(|[a, b, c, d, e]| i64::from_le_bytes([a, b, c, d, e, 0, 0, 0]))
    }

    /// Bits per axis.
    pub fn widths(&self) -> [u32; 3] {
        self.head.widths.map(u32::from)
    }

    /// True when vertices are absolute, 40 bits an axis.
    #[inline(always)]
    pub fn is_wide(&self) -> bool {
        self.vertex_bits() == 8 * WIDE_VERTEX_BYTES as u32
    }

    /// Count of triangles, 1 to 128.
    #[inline(always)]
    pub fn triangle_count(&self) -> usize {
        usize::from(self.head.triangle_count)
    }

    /// Count of vertices, 1 to 128.
    pub fn vertex_count(&self) -> usize {
        usize::from(self.head.vertex_count)
    }

    /// Count of leaves, 1 to 16.
    #[inline(always)]
    pub fn leaf_count(&self) -> usize {
        usize::from(self.head.leaf_count)
    }

    /// Leaf planes are multiples of `2^shift` above the base, per axis.
    pub fn leaf_shift(&self) -> [u32; 3] {
        self.widths().map(|bits| bits.saturating_sub(8))
    }

    /// Index of its first triangle within the page.
    pub fn first_triangle(&self) -> usize {
        usize::from(u16::from_le_bytes(self.head.first_triangle))
    }

    /// The planes of the leaf boxes: lo x, y, z, hi x, y, z, a byte per leaf each.
    pub fn leaf_planes(&self) -> [&'a [u8]; LEAF_PLANES] {
        let count = self.leaf_count();
        std::array::from_fn(|plane| &self.bytes[CLUSTER_HEAD_BYTES + plane * count..][..count])
    }

    /// Eight shapes of leaves from `first` on, a byte each; those behind the last are no shapes.
    #[inline(always)]
    fn shapes(&self, first: usize) -> u64 {
        word_at(self.bytes, CLUSTER_HEAD_BYTES + LEAF_PLANES * self.leaf_count() + first)
    }

    /// Sum over the leaves before `leaf` of what `part` keeps of eight shapes, numbers below 8.
    #[inline(always)]
    fn sum_before(&self, leaf: usize, part: impl Fn(u64) -> u64) -> usize {
        let sum = |shapes: u64| (part(shapes).wrapping_mul(BYTES_OF_ONE) >> 56) as usize;
        let before = |count: usize| !(u64::MAX << (8 * count));
        if leaf < 8 {
            return sum(self.shapes(0) & before(leaf));
        }
        sum(self.shapes(0)) + if leaf == 8 { 0 } else { sum(self.shapes(8) & before(leaf - 8)) }
    }

    /// Where the indices of a leaf stand.
    #[inline(always)]
    pub fn leaf_indices(&self, leaf: usize) -> LeafIndices {
        let before = self.sum_before(leaf, |shapes| shapes >> 3 & (7 * BYTES_OF_ONE));
        let shapes_at = CLUSTER_HEAD_BYTES + LEAF_PLANES * self.leaf_count();
        let at = shapes_at + self.leaf_count() + leaf + 3 * before;
        LeafIndices { at, shape: LeafShape(self.bytes[shapes_at + leaf]) }
    }

    /// Index of the first triangle of a leaf.
    #[inline(always)]
    pub fn leaf_first(&self, leaf: usize) -> usize {
        leaf + self.sum_before(leaf, |shapes| shapes & (7 * BYTES_OF_ONE))
    }

    /// The leaf that holds triangle `index` of the cluster.
    #[inline]
    pub fn leaf_with(&self, index: usize) -> usize {
        // A byte a leaf: how many triangles it and those before it have.
        let behind = |first: usize| {
            ((self.shapes(first) & (7 * BYTES_OF_ONE)) + BYTES_OF_ONE).wrapping_mul(BYTES_OF_ONE)
        };
        let (mut first, mut local, mut ends) = (0, index, behind(0));
        let of_eight = (ends >> 56) as usize;
        if self.leaf_count() > 8 && index >= of_eight {
            (first, local, ends) = (8, index - of_eight, behind(8));
        }
        // The high bit of a byte stays where the leaf does not begin behind the triangle: 128 + local - its first.
        let begun =
            (local as u64 | 128).wrapping_mul(BYTES_OF_ONE).wrapping_sub(ends << 8) & (BYTES_OF_ONE << 7);
        let there = (self.leaf_count() - first).min(8) as u32;
        first + (begun & u64::MAX >> (64 - 8 * there)).count_ones() as usize - 1
    }

    /// The corners of a leaf's triangles, `[corner][triangle]`, as vertex indices; the least one behind the last
    /// triangle.
    pub fn leaf_corners(&self, leaf: usize) -> [[u8; LEAF_TRIANGLES]; 3] {
        let LeafIndices { at, shape } = self.leaf_indices(leaf);
        let (least, width) = (self.bytes[at], shape.width());
        std::array::from_fn(|corner| {
            let word = word_at(self.bytes, at + 1 + corner * shape.corner_bytes());
            std::array::from_fn(|i| match i < shape.triangle_count() {
                true => least + (word >> (width * i as u32) & ((1 << width) - 1)) as u8,
                false => least,
            })
        })
    }

    /// Lattice coordinates of a vertex.
    #[inline]
    pub fn vertex(&self, index: usize) -> [i64; 3] {
        if self.is_wide() {
            return self.wide_vertex(index);
        }
        let mut word = self.packed_vertex(index);
        let (mut vertex, widths) = (self.base(), self.widths());
        for a in 0..3 {
            vertex[a] += (word & !(u64::MAX << widths[a])) as i64;
            word >>= widths[a];
        }
        vertex
    }

    /// A vertex of a compact cluster above the base, x in the lowest bits; higher ones mean nothing.
    #[inline(always)]
    pub fn packed_vertex(&self, index: usize) -> u64 {
        let at = index * self.vertex_bits() as usize;
        word_at(self.bytes, self.vertices_offset() + at / 8) >> (at % 8)
    }

    #[inline(never)]
    fn wide_vertex(&self, index: usize) -> [i64; 3] {
        let vertices = &self.bytes[self.vertices_offset() + index * WIDE_VERTEX_BYTES..];
        std::array::from_fn(|a| bits::get(vertices, 40 * a, 40) as i64)
    }

    /// Where the packed vertices begin, bytes from the cluster's start.
    #[inline(always)]
    pub fn vertices_offset(&self) -> usize {
        usize::from(u16::from_le_bytes(self.head.vertices_at))
    }

    /// Bits of one packed vertex.
    #[inline(always)]
    pub fn vertex_bits(&self) -> u32 {
        u32::from(self.head.vertex_bits)
    }

    /// The vertices of triangle `place` of a leaf, by index.
    #[inline(always)]
    pub fn triangle_vertices(&self, leaf: usize, place: usize) -> [usize; 3] {
        let LeafIndices { at, shape } = self.leaf_indices(leaf);
        let (least, width) = (self.bytes[at], shape.width());
        let mut vertices = [0; 3];
        for (i, vertex) in vertices.iter_mut().enumerate() {
            let word = word_at(self.bytes, at + 1 + i * shape.corner_bytes());
            let above = word >> (place * width as usize) & !(u64::MAX << width);
            *vertex = usize::from(least) + above as usize;
        }
        vertices
    }

    /// The three corners of triangle `place` of a leaf, lattice.
    #[inline]
    pub fn triangle(&self, leaf: usize, place: usize) -> [[i64; 3]; 3] {
        self.triangle_vertices(leaf, place).map(|vertex| self.vertex(vertex))
    }

    /// Material of triangle `index`.
    #[inline]
    pub fn material(&self, index: usize) -> u16 {
        u16_at(self.bytes, self.palette_offset() + 2 * self.palette_index(index))
    }

    /// Everything, as plain arrays.
    pub fn decode(&self) -> ClusterMesh {
        let leaves =
            (0..self.leaf_count()).map(|leaf| (self.leaf_corners(leaf), self.leaf_indices(leaf).shape));
        let leaf_sizes: Vec<u8> = leaves.clone().map(|(_, shape)| shape.triangle_count() as u8).collect();
        let triangles = leaves.flat_map(|(corners, shape)| {
            (0..shape.triangle_count()).map(move |i| corners.map(|indices| indices[i]))
        });
        ClusterMesh {
            vertices: (0..self.vertex_count()).map(|i| self.vertex(i)).collect(),
            triangles: triangles.collect(),
            leaf_sizes,
            materials: (0..self.triangle_count()).map(|i| self.material(i)).collect(),
            colours: Vec::new(),
            normals: Vec::new(),
        }
    }

    /// The greatest index of a material in it.
    pub fn greatest_material(&self) -> u16 {
        self.palette().iter().map(|entry| u16::from_le_bytes(*entry)).max().unwrap_or(0)
    }

    /// The materials in it, as stored.
    fn palette(&self) -> &'a [[u8; 2]] {
        let at = self.palette_offset();
        self.bytes[at..at + 2 * self.palette_len()].as_chunks().0
    }

    fn palette_offset(&self) -> usize {
        usize::from(u16::from_le_bytes(self.head.palette_at))
    }

    pub(super) fn palette_len(&self) -> usize {
        usize::from(self.head.palette_len)
    }

    pub(super) fn palette_index(&self, index: usize) -> usize {
        let bits = palette_index_bits(self.palette_len());
        if bits == 0 {
            return 0;
        }
        let at = self.palette_offset() + 2 * self.palette_len();
        bits::get(&self.bytes[at..], index * bits, bits as u32) as usize
    }

    /// Bytes that it takes in a frame.
    #[inline(always)]
    pub(super) fn frame_bytes(&self) -> usize {
        self.vertices_offset() + (self.vertex_count() * self.vertex_bits() as usize).div_ceil(8)
    }
}

/// Eight bytes, of which later ones may belong to something else: eight stand behind the last vertex of a frame.
#[inline(always)]
fn word_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}
