//! `BoxTree`: which of many boxes a ray may meet, and one of them by chance, those that weigh more and are nearer more
//! often. Halved at the median of their centres along the longest axis.
//!
//! ```text
//! nodes in depth-first order, each with where to go on when it is missed: no stack
//! drawn: from the root on to the child that brings more, by weight over squared distance; then one of the leaf's boxes
//! ```
//!
//! A. Conty Estevez and C. Kulla, "Importance sampling of many lights with adaptive tree splitting" (2018).
//!
//! Invariants: 1. every box that the ray meets is named; 2. the chances of all boxes add up to 1, or to less where
//! none of a leaf's brings anything.

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
    /// The place of each box in `order`.
    places: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    lo: DVec3,
    hi: DVec3,
    /// The node after all that are below this one.
    next: u32,
    /// Its part of `order`.
    first: u32,
    count: u32,
    /// Sum of the weights of its boxes.
    weight: f64,
}

impl BoxTree {
    /// A tree over `boxes` with `weights`.
    pub(super) fn new(boxes: &[Aabb], weights: &[f64]) -> BoxTree {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len());
        if !boxes.is_empty() {
            add_node(&mut nodes, (boxes, weights), &mut order, 0);
        }
        let mut places = vec![0; order.len()];
        (0..).zip(&order).for_each(|(place, &index)| places[index as usize] = place);
        BoxTree { nodes, order, places }
    }

    /// Bytes on the heap for `count` boxes: a leaf has two or more, so there are no more nodes than boxes.
    pub(super) const fn bytes(count: usize) -> u64 {
        (count * (size_of::<Node>() + 2 * size_of::<u32>())) as u64
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
            if node.is_leaf() {
                self.boxes(node).for_each(&mut each);
            }
            at += 1;
        }
    }

    /// A box drawn for `point` with `pick`, in [0, 1), and its chance; `brings`: what each brings there, of which those
    /// of a leaf are weighed. `None` where they bring nothing.
    pub(super) fn draw(
        &self,
        point: DVec3,
        mut pick: f64,
        brings: impl Fn(usize) -> f64,
    ) -> Option<(usize, f64)> {
        let mut is_below = |share: f64| {
            let is_below = pick < share;
            pick = if is_below { pick / share } else { (pick - share) / (1.0 - share) };
            is_below
        };
        let (leaf, chance) = self.descend(point, |share, _| is_below(share))?;
        let mut left: f64 = self.boxes(leaf).map(&brings).sum();
        let total = left;
        for index in self.boxes(leaf).filter(|&index| brings(index) > 0.0) {
            let own = brings(index);
            // Whatever rounding leaves goes to the last.
            if is_below(own / left) || own >= left {
                return Some((index, chance * own / total));
            }
            left -= own;
        }
        None
    }

    /// The chance with which [`BoxTree::draw`] gives box `index`.
    pub(super) fn chance(&self, point: DVec3, index: usize, brings: impl Fn(usize) -> f64) -> f64 {
        let place = self.places[index];
        self.descend(point, |_, right| place < right).map_or(0.0, |(leaf, chance)| {
            let total: f64 = self.boxes(leaf).map(&brings).sum();
            if total > 0.0 { chance * brings(index) / total } else { 0.0 }
        })
    }

    /// The leaf to which `goes_left` leads and the chance that it is drawn; it hears the share of the left child, and
    /// where the boxes of the right one begin.
    fn descend(&self, point: DVec3, mut goes_left: impl FnMut(f64, u32) -> bool) -> Option<(&Node, f64)> {
        let (mut node, mut at, mut chance) = (self.nodes.first()?, 0, 1.0);
        while !node.is_leaf() {
            let children = [at + 1, self.nodes[at + 1].next as usize];
            let [left, right] = children.map(|child| self.nodes[child].brings(point));
            let share = left / (left + right);
            let is_left = goes_left(share, self.nodes[children[1]].first);
            chance *= if is_left { share } else { 1.0 - share };
            at = children[usize::from(!is_left)];
            node = &self.nodes[at];
        }
        Some((node, chance))
    }

    /// The indices of the boxes below `node`.
    fn boxes(&self, node: &Node) -> impl Iterator<Item = usize> {
        self.order[node.first as usize..][..node.count as usize].iter().map(|&index| index as usize)
    }
}

/// Weight over squared distance, as far as a box of half `diagonal` around `centre` tells it.
pub(super) fn falloff(weight: f64, to_centre: DVec3, half_diagonal: f64) -> f64 {
    weight / to_centre.length_squared().max(half_diagonal * half_diagonal).max(f64::MIN_POSITIVE)
}

impl Node {
    fn is_leaf(&self) -> bool {
        self.count as usize <= LEAF_MAX
    }

    /// About what all of it brings to `point`.
    fn brings(&self, point: DVec3) -> f64 {
        falloff(self.weight, 0.5 * (self.lo + self.hi) - point, 0.5 * (self.hi - self.lo).length())
    }

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
fn add_node(nodes: &mut Vec<Node>, all: (&[Aabb], &[f64]), order: &mut [u32], first: usize) {
    let (boxes, weights) = all;
    let mut bounds = Aabb::EMPTY;
    order.iter().for_each(|&index| bounds.join(&boxes[index as usize]));
    let (lo, hi) = (DVec3::from(bounds.lo), DVec3::from(bounds.hi));
    // Rounding may take a box's own plane from the ray by some ulps.
    let margin = DVec3::splat(1e-12 * (lo.abs().max(hi.abs()).max_element()));
    let at = nodes.len();
    let (count, weight) = (order.len() as u32, order.iter().map(|&index| weights[index as usize]).sum());
    nodes.push(Node { lo: lo - margin, hi: hi + margin, next: 0, first: first as u32, count, weight });
    if !nodes[at].is_leaf() {
        let axis = (hi - lo).max_position();
        let middle = order.len() / 2;
        let centre = |index: u32| boxes[index as usize].center()[axis];
        order.select_nth_unstable_by(middle, |&a, &b| centre(a).total_cmp(&centre(b)));
        let (left, right) = order.split_at_mut(middle);
        add_node(nodes, all, left, first);
        add_node(nodes, all, right, first + middle);
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
            let tree = BoxTree::new(&boxes, &vec![1.0; boxes.len()]);
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

    /// A draw at each of many even places of [0, 1) gives each box as often as its chance says, and all chances add up.
    #[test]
    fn boxes_are_drawn_as_often_as_their_chances_say() {
        const DRAWS: u32 = 40_000;
        let numbers = |i: u32| Sampler::new(5, [i, 0], 0).draw(Decision::Pixel).map(f64::from);
        for count in [1, 4, 5, 100] {
            let corner = |i| DVec3::from_slice(&numbers(i)[..3]);
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| Aabb { lo: corner(i).to_array(), hi: (corner(i) + DVec3::splat(0.02)).to_array() })
                .collect();
            let weights: Vec<f64> = (0..count).map(|i| 0.1 + numbers(i)[3]).collect();
            let tree = BoxTree::new(&boxes, &weights);
            let point = DVec3::new(0.3, 0.4, 0.5);
            // Some bring nothing, which a tree cannot know before its leaves.
            let squared = |index: usize| (corner(index as u32) - point).length_squared();
            let brings = |index: usize| if index % 7 == 3 { 0.0 } else { weights[index] / squared(index) };
            let mut drawn = vec![0; count as usize];
            for i in 0..DRAWS {
                if let Some((index, chance)) =
                    tree.draw(point, (f64::from(i) + 0.5) / f64::from(DRAWS), brings)
                {
                    assert!((chance / tree.chance(point, index, brings) - 1.0).abs() < 1e-9);
                    drawn[index] += 1;
                }
            }
            let chances: Vec<f64> =
                (0..count as usize).map(|index| tree.chance(point, index, brings)).collect();
            assert!(chances.iter().sum::<f64>() < 1.0 + 1e-9);
            for (index, (&drawn, chance)) in drawn.iter().zip(&chances).enumerate() {
                let expected = chance * f64::from(DRAWS);
                assert!((f64::from(drawn) - expected).abs() < 2.0, "{index} of {count}: {drawn}, {expected}");
                assert_eq!(*chance == 0.0, index % 7 == 3);
            }
            // The nearest has a greater share than its weight's.
            let lit = (0..count as usize).filter(|index| index % 7 != 3);
            let near = lit.min_by(|&a, &b| squared(a).total_cmp(&squared(b))).unwrap();
            assert!(count < 100 || chances[near] > 3.0 * weights[near] / weights.iter().sum::<f64>());
        }
    }
}
