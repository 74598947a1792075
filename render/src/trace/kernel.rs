//! What traversal asks of arithmetic: the node test, the leaf-box test, the triangle test. Traversal itself
//! (`bvh.rs`) knows no lanes and no precision.
//!
//! | kernel | lattice | arithmetic | where |
//! |---|---|---|---|
//! | `Avx2` | up to 24 bits | f32, 8 lanes | `avx2.rs`, chosen at run time |
//! | `Scalar<f32>` | up to 24 bits | f32 | `scalar.rs`, the oracle: same operations, same bits |
//! | `Scalar<f64>` | up to 40 bits | f64 | `scalar.rs` |
//!
//! Invariants: 1. a vertex's place relative to the ray is one function of its lattice integers and the ray, whatever
//! the cluster: tests are watertight across clusters; 2. edge functions are two products and their difference, never
//! fused: a shared edge gives exactly opposite values to its two triangles, and a sign that is not zero is right; 3.
//! zero counts as inside on both sides; where all three are zero, they are made again from what the products lost, so
//! that a needle is only a line when it is one; 4. boxes are tested with outward slack; 5. a kernel says which
//! triangles a ray meets, not where, before they are refined: along a needle its weights can be off by any share; that
//! a triangle is met at all in the ray's range is sure where the volume's error is next to nothing.

use super::Ray;
use super::lattice_ray::{LatticeFrame, RefinedHit, Span};
use trex_store::cluster::{ChildBoxes, ClusterView};
use trex_store::layout::{CLUSTER_LEAVES, NODE_WIDTH};

/// Answers of up to `N` boxes: a bit per lane, and the entry t of each: at least 0, not above the exact one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes<const N: usize> {
    pub(super) mask: u32,
    pub(super) t: [f32; N],
}

/// Triangles of a leaf that a ray meets, a bit each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrianglesMet {
    pub(super) met: u32,
    /// Those of them that need not be refined to say so.
    pub(super) sure: u32,
}

/// Arithmetic for one ray. What it is told and what it tells of t are f32, rounded to the safe side.
pub(super) trait Kernel: Sized {
    /// Moves a ray to the lattice and sets it up: see [`LatticeFrame::enter`].
    fn enter(frame: &LatticeFrame, ray: &Ray) -> Option<(Span, Self)>;

    /// Children of a node whose box meets the ray before `t_max`.
    fn node(&self, node: &ChildBoxes, t_max: f32) -> Lanes<NODE_WIDTH>;

    /// Leaves of a cluster whose box meets the ray before `t_max`.
    fn leaf_boxes(&self, cluster: &ClusterView<'_>, t_max: f32) -> Lanes<CLUSTER_LEAVES>;

    /// Hints that `lines` cache lines from byte `at` on will be read.
    #[inline(always)]
    fn prefetch(_bytes: &[u8], _at: usize, _lines: usize) {}

    /// Triangles of a leaf that the ray's line meets and that reach into `0 <= t <= t_max`; and those of them that it
    /// surely meets in `0 <= t <= t_sure`.
    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, t: (f32, f32)) -> TrianglesMet;

    /// One of these, in f64: the same bits from every kernel.
    fn refine(&self, cluster: &ClusterView<'_>, leaf: usize, place: usize) -> RefinedHit;
}
