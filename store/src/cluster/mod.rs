//! A cluster: up to 128 triangles and 128 vertices on the lattice, and its three forms.
//!
//! ```text
//! ClusterMesh (build)  --encode-->  disk form  --install-->  frame form, traced as it lies (view)
//! ```
//!
//! Invariants: 1. a vertex has the same lattice coordinates in every cluster that holds it; 2. triangles stand in
//! leaves of one to eight; 3. a *compact* cluster packs a vertex into
//! at most 57 bits relative to its base, at most 24 per axis; what does not fit is *wide*: 40 bits per axis.

mod bits;
mod cells;
mod corner_value;
mod disk_page;
mod edges;
mod encode;
mod entry;
mod fields;
mod finish;
mod frame;
mod frame_ref;
mod install;
mod install_cluster;
mod install_leaves;
mod leaves;
mod node;
mod normal;
mod order;
mod packing;
mod strips;
#[cfg(test)]
mod tests;
mod unpack;
mod value_codec;
mod value_guess;
mod value_packer;
mod vertices;
mod view;

pub use corner_value::{Colour, CornerValue, WHITE};
pub use encode::{DiskBits, PageContent, PageRef};
pub(crate) use frame::FRAME_HEADER_BYTES;
pub use frame::{Frame, FrameView, SharedFrame, Unpack};
pub use frame_ref::FrameRef;
pub(crate) use install::ArrivingPage;
pub use install::install;
pub use leaves::LeafShape;
pub use node::{ChildBoxes, FrameNode, LatticeBox, Node, ROOT_SLOT_BITS, TopRef, TreeNode};
pub use normal::Normal;
pub(crate) use order::{ClusterOrder, Orderer};
#[cfg(all(test, loom))]
pub(crate) use unpack::{AtomicWord, make_once};
pub(crate) use unpack::{UnpackError, unpack};
pub use value_codec::ValueView;
pub(crate) use value_codec::install_values;
pub(crate) use value_packer::{PackedValues, ValuePacker, ValuePage};
pub use view::{ClusterHead, ClusterView, LeafIndices};

use crate::layout::{AXIS_BITS, VERTEX_BITS};

/// Bytes of a frame cluster before what it holds by leaf.
pub const CLUSTER_HEAD_BYTES: usize = size_of::<ClusterHead>();
/// Planes of a leaf box.
pub const LEAF_PLANES: usize = 6;
/// Bytes of a leaf before its indices: its box and its shape.
const LEAF_HEAD_BYTES: usize = LEAF_PLANES + 1;
/// Bytes of one vertex of a wide cluster: 3 x 40 bits.
pub const WIDE_VERTEX_BYTES: usize = 15;
/// Zeros behind each cluster in a frame, so that 64-bit loads of its last vertices meet no other.
pub const FRAME_TAIL_BYTES: usize = 8;

/// A cluster while it is built, and after decoding: plain arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterMesh {
    /// Lattice coordinates.
    pub vertices: Vec<[i64; 3]>,
    /// Corners as indices into `vertices`, in leaf order.
    pub triangles: Vec<[u8; 3]>,
    /// Triangles of each leaf, 1 to 8; all together those there are.
    pub leaf_sizes: Vec<u8>,
    /// Material index per triangle.
    pub materials: Vec<u16>,
    /// Colours of the corners per triangle; empty where all are white, and after decoding.
    pub colours: Vec<[Colour; 3]>,
    /// Normals of the corners per triangle; empty where none has one, and after decoding.
    pub normals: Vec<[Normal; 3]>,
}

/// How the vertices of a cluster are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Widths {
    /// Least corner of the vertices.
    pub base: [i64; 3],
    /// Bits per axis above the base.
    pub bits: [u8; 3],
    /// True when they do not fit the compact form.
    pub wide: bool,
}

impl ClusterMesh {
    /// The box of the vertices.
    pub fn bounds(&self) -> LatticeBox {
        let mut bounds = LatticeBox::EMPTY;
        self.vertices.iter().for_each(|&v| bounds.add(v));
        bounds
    }

    /// Bit widths of the vertices.
    pub fn widths(&self) -> Widths {
        let bounds = self.bounds();
        let bits = std::array::from_fn(|a| bits::bits_of((bounds.hi[a] - bounds.lo[a]) as u64));
        let wide = bits.iter().any(|&b| u32::from(b) > AXIS_BITS)
            || bits.iter().map(|&b| u32::from(b)).sum::<u32>() > VERTEX_BITS;
        Widths { base: bounds.lo, bits, wide }
    }

    /// The distinct materials, ascending.
    pub fn palette(&self) -> Vec<u16> {
        let mut palette = self.materials.clone();
        palette.sort_unstable();
        palette.dedup();
        palette
    }

    /// The triangles of each leaf.
    pub fn leaves(&self) -> impl Iterator<Item = &[[u8; 3]]> {
        let mut rest = &self.triangles[..];
        self.leaf_sizes.iter().map(move |&size| {
            let (leaf, behind) = rest.split_at(usize::from(size));
            rest = behind;
            leaf
        })
    }

    /// Bytes that the cluster takes in a frame.
    pub fn frame_bytes(&self) -> usize {
        let vertices = vertex_bytes(&self.widths(), self.vertices.len());
        let leaves = self.leaves().map(|leaf| {
            let indices = leaf.as_flattened().iter();
            let span = indices.clone().max().expect("a leaf is not empty") - indices.min().expect("as well");
            LEAF_HEAD_BYTES + LeafShape::new(leaf.len(), span).bytes()
        });
        let palette = palette_bytes(self.palette().len(), self.triangles.len());
        CLUSTER_HEAD_BYTES + leaves.sum::<usize>() + palette + vertices
    }
}

/// Bytes of the packed vertices.
fn vertex_bytes(widths: &Widths, count: usize) -> usize {
    if widths.wide {
        return count * WIDE_VERTEX_BYTES;
    }
    (widths.bits.iter().map(|&b| usize::from(b)).sum::<usize>() * count).div_ceil(8)
}

/// Bits of a palette index: 0 for one material, then 2, 4 or 8.
fn palette_index_bits(palette_len: usize) -> usize {
    match palette_len {
        0 | 1 => 0,
        2..=4 => 2,
        5..=16 => 4,
        _ => 8,
    }
}

/// Bytes of a palette of `len` materials and of the triangles' indices into it.
fn palette_bytes(len: usize, triangle_count: usize) -> usize {
    2 * len + (palette_index_bits(len) * triangle_count).div_ceil(8)
}
