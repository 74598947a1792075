//! A tree of boxes over triangles, as both kinds are walked.
//!
//! Invariant: children of a part stand together, behind it.

pub(super) type Box3 = [[f32; 3]; 2];

pub(super) const NOTHING: Box3 = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

pub(super) fn join(a: Box3, b: Box3) -> Box3 {
    [std::array::from_fn(|i| a[0][i].min(b[0][i])), std::array::from_fn(|i| a[1][i].max(b[1][i]))]
}

pub(super) fn area(b: Box3) -> f64 {
    let [x, y, z] = std::array::from_fn(|a| f64::from(b[1][a] - b[0][a]).max(0.0));
    x * y + y * z + z * x
}

/// Area of the intersection of two boxes.
pub(super) fn common(a: Box3, b: Box3) -> f64 {
    let lo: [f32; 3] = std::array::from_fn(|i| a[0][i].max(b[0][i]));
    let hi: [f32; 3] = std::array::from_fn(|i| a[1][i].min(b[1][i]));
    if (0..3).any(|i| lo[i] > hi[i]) { 0.0 } else { area([lo, hi]) }
}

/// What is opened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Level {
    Top,
    Node,
    Cluster,
    Leaf,
}

/// A box and what is in it: children from `first` on, or, of a leaf, triangles.
#[derive(Clone, Copy)]
pub(super) struct Part {
    pub(super) bounds: Box3,
    pub(super) level: Level,
    pub(super) first: u32,
    pub(super) count: u32,
}

/// A tree of boxes; part 0 is the root. Children stand together.
pub(super) struct Tree {
    pub(super) parts: Vec<Part>,
    pub(super) triangles: Vec<[[f32; 3]; 3]>,
}

pub(super) fn corners_of(triangle: [[i64; 3]; 3]) -> [[f32; 3]; 3] {
    triangle.map(|corner| corner.map(|q| q as f32))
}

pub(super) fn box_of(triangle: &[[f32; 3]; 3]) -> Box3 {
    triangle.iter().fold(NOTHING, |all, &corner| join(all, [corner, corner]))
}
