//! All hits of a ray: where it crosses the surface, each crossing once.
//!
//! A ray through an edge or a corner meets each of the triangles there, and of any of these `intersect` may tell. Here
//! it counts for the triangles that it would meet if it were moved aside by next to nothing, by (e, e^2) in the plane
//! that the shear makes of it: a line then crosses a closed surface an even number of times, wherever it goes.
//!
//! ```text
//! side of an edge (p, q): sign of  p x q;  of  e (p.y - q.y);  of  e^2 (q.x - p.x);  the first that is not 0
//! crossed: all three sides are the same
//! ```
//!
//! H. Edelsbrunner and E. P. Mücke, "Simulation of simplicity", ACM Transactions on Graphics 9(1), 1990.
//!
//! Invariants: 1. a corner's place in that plane is one function of its lattice integers and the ray; the sign of the
//! cross product is that of exact arithmetic on these places; 2. a triangle is tested whenever its boxes are met, which
//! have outward slack in f64; 3. no allocation but in the list of hits.

use super::Ray;
use super::bvh::{Found, LatticeScene, MissingPages, OpenPage};
use super::kernel::Kernel;
use super::lattice_ray::{LatticeRay, Span};
use super::pages::{Page, Pages};
use super::scalar::Scalar;
use super::stack::{Stack, StackEntry, VisitStack};
use glam::DVec2;
use std::cmp::Ordering;
use trex_store::cluster::{ClusterView, FrameRef, FrameView, TopRef, TreeNode};
use trex_store::layout::LEAF_TRIANGLES;

/// The side of a triangle that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// Its corners run counter-clockwise, as seen from where the ray comes.
    Front,
    Back,
}

/// A ray on its way to all that it crosses.
struct CrossingRay<'a, F> {
    kernel: Scalar<f64>,
    span: Span,
    t_max: f32,
    /// What hears of each crossing.
    tell: &'a mut F,
}

/// Tells of all triangles that `ray` crosses, in any order; `None` where it misses the model's box. `missing` is
/// filled: where it is not empty, some may be missing.
pub(super) fn trace_crossings<P: Pages>(
    scene: &LatticeScene,
    pages: &mut P,
    stack: &mut Stack,
    ray: &Ray,
    missing: &mut MissingPages,
    tell: &mut impl FnMut(&Span, &Found, Side),
) -> Option<()> {
    let (span, kernel) = Scalar::<f64>::enter(&scene.frame, ray)?;
    let t_max = super::bvh::t_above(span.t_max);
    let mut crossing = CrossingRay { kernel, span, t_max, tell };
    let mut pending = VisitStack { entries: &mut stack.entries, len: 0 };
    let mut next = Some(StackEntry::new(0.0, scene.file.superblock().root));
    while let Some(at) = next.or_else(|| pending.pop_above(0, t_max)) {
        next = None;
        match TopRef::from_word(at.word()) {
            TopRef::Node(index) => {
                let node = &scene.file.top()[index as usize];
                let met = crossing.kernel.node(node.boxes(), t_max);
                next = pending.push(met.mask, |child| met.entry(child, node.word(child)));
            }
            TopRef::Page { page, slot } => match pages.page(page) {
                Page::Ready(frame) => {
                    let first_triangle = scene.file.pages()[page as usize].first_triangle;
                    let page = OpenPage { frame: FrameView::new(frame), page, first_triangle };
                    let root = StackEntry::new(at.t(), page.frame.root(slot as usize).0);
                    crossing.page(page, root, &mut pending);
                }
                Page::Missing => missing.add(page, at.t().into()),
                Page::Damaged => {}
            },
        }
    }
    Some(())
}

impl<F: FnMut(&Span, &Found, Side)> CrossingRay<'_, F> {
    /// Looks at what is under an entry of a page.
    fn page(&mut self, page: OpenPage<'_>, from: StackEntry, pending: &mut VisitStack<'_>) {
        let floor = pending.len;
        let mut next = Some(from);
        while let Some(at) = next.or_else(|| pending.pop_above(floor, self.t_max)) {
            next = None;
            let at = FrameRef(at.word());
            if at.is_cluster() {
                if let Some(cluster) = page.frame.cluster(at) {
                    self.cluster(&page, &cluster);
                }
                continue;
            }
            let node = page.frame.node(at);
            let met = self.kernel.node(node.boxes(), self.t_max);
            next = pending.push(met.mask, |child| met.entry(child, node.word(child)));
        }
    }

    fn cluster(&mut self, page: &OpenPage<'_>, cluster: &ClusterView<'_>) {
        let mut leaves = self.kernel.leaf_boxes(cluster, self.t_max).mask;
        while leaves != 0 {
            let leaf = leaves.trailing_zeros() as usize;
            leaves &= leaves - 1;
            // Behind the last triangle of a leaf all corners are one: such are not crossed.
            let corners = cluster.leaf_corners(leaf);
            for place in 0..LEAF_TRIANGLES {
                let q = corners.map(|indices| cluster.vertex(usize::from(indices[place])));
                let Some(side) = side_crossed(&self.kernel.ray, q) else { continue };
                let refined = self.kernel.ray.refine(q);
                if self.span.holds(refined.t) {
                    let index = cluster.leaf_first(leaf) + place;
                    let triangle = page.first_triangle + (cluster.first_triangle() + index) as u32;
                    let (page, material) = (page.page, cluster.material(index));
                    (self.tell)(&self.span, &Found { refined, page, triangle, material }, side);
                }
            }
        }
    }
}

/// The side by which the line of a ray, moved aside by next to nothing, goes through a triangle; `None` where it passes
/// by.
fn side_crossed(ray: &LatticeRay, q: [[i64; 3]; 3]) -> Option<Side> {
    let [a, b, c] = q.map(|q| ray.beside(q));
    let first = side(a, b);
    let is_crossed = first.is_ne() && first == side(b, c) && first == side(c, a);
    is_crossed.then_some(if first.is_lt() { Side::Front } else { Side::Back })
}

/// The side of the origin, moved by next to nothing, on which the edge from `p` to `q` passes; equal where
/// both are one.
fn side(p: DVec2, q: DVec2) -> Ordering {
    let (left, right) = (p.x * q.y, p.y * q.x);
    // Rounding keeps the order of what it does not make equal; of what it does, the parts that it took are exact.
    let cross = compare(left, right).then_with(|| {
        let (left_lost, right_lost) = (p.x.mul_add(q.y, -left), p.y.mul_add(q.x, -right));
        compare(left_lost, right_lost)
    });
    cross.then_with(|| compare(p.y, q.y)).then_with(|| compare(q.x, p.x))
}

/// The order of two finite numbers; zeros are equal.
fn compare(a: f64, b: f64) -> Ordering {
    a.partial_cmp(&b).expect("lattice coordinates are finite")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Points of a small grid meet edges and corners all the time. A line crosses a tetrahedron twice or
        /// not at all.
        #[test]
        fn a_closed_surface_is_crossed_an_even_number_of_times(
            points in prop::array::uniform4(prop::array::uniform2(-2i32..3)),
            shift in prop::array::uniform2(-1i32..2),
            scale in prop::sample::select(vec![1.0, 0.1, 1.0 / 3.0, 1e6]),
        ) {
            let at = |i: usize| {
                DVec2::new(f64::from(points[i][0] + shift[0]), f64::from(points[i][1] + shift[1])) * scale
            };
            let crossed = |[a, b, c]: [usize; 3]| {
                let first = side(at(a), at(b));
                first.is_ne() && first == side(at(b), at(c)) && first == side(at(c), at(a))
            };
            let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
            let count = faces.into_iter().filter(|&face| crossed(face)).count();
            prop_assert!(count == 0 || count == 2, "{count} of {points:?} {shift:?}");
        }

        /// The two triangles of an edge see it from opposite sides, exactly, however near the line passes.
        #[test]
        fn sides_are_exact_and_opposite(
            p in prop::array::uniform2(-1i64 << 40..1 << 40),
            q in prop::array::uniform2(-1i64 << 40..1 << 40),
        ) {
            let vector = |v: [i64; 2]| DVec2::new(v[0] as f64, v[1] as f64);
            let exact = i128::from(p[0]) * i128::from(q[1]) - i128::from(p[1]) * i128::from(q[0]);
            let found = side(vector(p), vector(q));
            prop_assert_eq!(found, side(vector(q), vector(p)).reverse());
            if exact != 0 {
                prop_assert_eq!(found, exact.cmp(&0));
            }
        }
    }
}
