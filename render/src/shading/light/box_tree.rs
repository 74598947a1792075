//! `BoxTree`: which of many boxes a ray may meet. Halved at the median of their centres along the longest axis.
//!
//! ```text
//! nodes in depth-first order, each with where to go on when it is missed: no stack
//! ```
//!
//! Invariant: every box that the ray meets is named.

use crate::trace::Ray;
use glam::DVec3;
use trex_store::Aabb;

/// Boxes of a leaf: below this, a test more costs no more than a node.
const LEAF_MAX: usize = 4;

/// A tree over boxes.
#[derive(Clone, Debug, Default)]
pub(super) struct BoxTree {
    nodes: Vec<Node>,
    /// Indices of the boxes, leaf by leaf.
    order: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    lo: DVec3,
    hi: DVec3,
    /// The node after all that are below this one.
    next: u32,
    /// Its part of `order`, where it is a leaf; else no part.
    first: u32,
    count: u32,
}

impl BoxTree {
    /// A tree over `boxes`.
    pub(super) fn new(boxes: &[Aabb]) -> BoxTree {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len());
        if !boxes.is_empty() {
            add_node(&mut nodes, boxes, &mut order, 0);
        }
        BoxTree { nodes, order }
    }

    /// Bytes on the heap for `count` boxes: a leaf has two or more, so there are no more nodes than boxes.
    pub(super) const fn bytes(count: usize) -> u64 {
        (count * (size_of::<Node>() + size_of::<u32>())) as u64
    }

    /// Calls `each` with the boxes that `ray` may meet.
    pub(super) fn met(&self, ray: &Ray, mut each: impl FnMut(usize)) {
        let (origin, inverse) = (DVec3::from(ray.origin), 1.0 / DVec3::from(ray.direction));
        let mut at = 0;
        while let Some(node) = self.nodes.get(at) {
            if !node.is_met(origin, inverse) {
                at = node.next as usize;
                continue;
            }
            let (first, count) = (node.first as usize, node.count as usize);
            self.order[first..first + count].iter().for_each(|&index| each(index as usize));
            at += 1;
        }
    }
}

impl Node {
    fn is_met(&self, origin: DVec3, inverse: DVec3) -> bool {
        let (a, b) = ((self.lo - origin) * inverse, (self.hi - origin) * inverse);
        // A ray within a plane of the box gives NaN there, which leaves the axis out of minimum and maximum.
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            enter = enter.max(a[axis].min(b[axis]));
            leave = leave.min(a[axis].max(b[axis]));
        }
        enter <= leave
    }
}

/// Adds the node over a part of the order, which begins at `first`, and all below it.
fn add_node(nodes: &mut Vec<Node>, boxes: &[Aabb], order: &mut [u32], first: usize) {
    let mut bounds = Aabb::EMPTY;
    order.iter().for_each(|&index| bounds.join(&boxes[index as usize]));
    let (lo, hi) = (DVec3::from(bounds.lo), DVec3::from(bounds.hi));
    // Rounding may take a box's own plane from the ray by some ulps.
    let margin = DVec3::splat(1e-12 * (lo.abs().max(hi.abs()).max_element()));
    let at = nodes.len();
    let is_leaf = order.len() <= LEAF_MAX;
    let count = if is_leaf { order.len() as u32 } else { 0 };
    nodes.push(Node { lo: lo - margin, hi: hi + margin, next: 0, first: first as u32, count });
    if !is_leaf {
        let axis = (hi - lo).max_position();
        let middle = order.len() / 2;
        let centre = |index: u32| boxes[index as usize].center()[axis];
        order.select_nth_unstable_by(middle, |&a, &b| centre(a).total_cmp(&centre(b)));
        let (left, right) = order.split_at_mut(middle);
        add_node(nodes, boxes, left, first);
        add_node(nodes, boxes, right, first + middle);
    }
    nodes[at].next = nodes.len() as u32;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Decision, Sampler};
    use crate::sampling::sphere_direction;

    #[test]
    fn every_box_around_a_place_on_the_ray_is_named() {
        let numbers = |i: u32| Sampler::new(3, [i, 0], 0).draw(Decision::Pixel);
        for count in [0, 1, 4, 5, 9, 1000] {
            // Boxes around places on rays through one point; those of other rays are the rest.
            let place = |i: u32| {
                let [u, v, far, _] = numbers(i);
                (sphere_direction([u, v]), 1.0 + 9.0 * f64::from(far))
            };
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| {
                    let (direction, far) = place(i);
                    let mut bounds = Aabb::EMPTY;
                    bounds.add((far * direction).to_array());
                    bounds.add((far * direction + DVec3::splat(0.01)).to_array());
                    bounds
                })
                .collect();
            let tree = BoxTree::new(&boxes);
            assert!(tree.nodes.len() <= boxes.len());
            let mut named = 0;
            for i in 0..count {
                let mut is_named = false;
                tree.met(&Ray::new(DVec3::ZERO, place(i).0, f64::INFINITY), |index| {
                    is_named |= index == i as usize;
                    named += 1;
                });
                assert!(is_named, "{i} of {count}");
            }
            assert!(named <= 40 * count, "{named} of {count} boxes");
        }
    }
}
