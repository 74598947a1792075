//! The reference: a binned SAH tree over the triangles alone, with exact boxes, eight children and leaves of up to
//! eight.
//!
//! Plain and slow on purpose: it shares no code with the build that it judges.

use super::tree::{Box3, Level, NOTHING, Part, Tree, area, box_of, join};
use trex_store::layout::{LEAF_TRIANGLES, NODE_WIDTH};

/// Bins, an axis.
const BINS: usize = 32;

/// The reference: triangles by index, and their boxes and centres.
pub(super) struct ReferenceTree {
    tree: Tree,
    boxes: Vec<Box3>,
    order: Vec<u32>,
}

/// A range of the order with its box.
#[derive(Clone, Copy)]
struct Span {
    first: usize,
    count: usize,
    bounds: Box3,
}

impl ReferenceTree {
    /// The tree over `triangles`.
    pub(super) fn tree(triangles: Vec<[[f32; 3]; 3]>) -> Tree {
        let boxes: Vec<Box3> = triangles.iter().map(box_of).collect();
        let bounds = boxes.iter().fold(NOTHING, |all, &b| join(all, b));
        let order = (0..triangles.len() as u32).collect();
        let nowhere = Part { bounds, level: Level::Node, first: 0, count: 0 };
        let tree = Tree { parts: vec![nowhere], triangles };
        let mut reference = ReferenceTree { tree, boxes, order };
        let count = reference.order.len();
        reference.grow(0, Span { first: 0, count, bounds });
        let ReferenceTree { mut tree, order, .. } = reference;
        tree.triangles = order.iter().map(|&i| tree.triangles[i as usize]).collect();
        tree
    }

    /// Fills part `at` with a span: a leaf, or a node whose largest spans are taken apart until there are eight.
    fn grow(&mut self, at: usize, span: Span) {
        if span.count <= LEAF_TRIANGLES {
            self.tree.parts[at] = Part {
                bounds: span.bounds,
                level: Level::Leaf,
                first: span.first as u32,
                count: span.count as u32,
            };
            return;
        }
        let mut open = vec![span];
        while open.len() < NODE_WIDTH {
            let splits = (0..open.len()).filter(|&i| open[i].count > LEAF_TRIANGLES);
            let Some(i) = splits.max_by(|&a, &b| area(open[a].bounds).total_cmp(&area(open[b].bounds)))
            else {
                break;
            };
            let halves = self.split(open[i]);
            open.splice(i..=i, halves);
        }
        let first = self.tree.parts.len();
        self.tree.parts[at] =
            Part { bounds: span.bounds, level: Level::Node, first: first as u32, count: open.len() as u32 };
        let nowhere = Part { bounds: NOTHING, level: Level::Leaf, first: 0, count: 0 };
        self.tree.parts.resize(first + open.len(), nowhere);
        for (i, span) in open.into_iter().enumerate() {
            self.grow(first + i, span);
        }
    }

    /// Cuts a span in two where the surface area heuristic is least; a side costs a visit per eight triangles.
    fn split(&mut self, span: Span) -> [Span; 2] {
        let ReferenceTree { boxes, order, .. } = self;
        let order = &mut order[span.first..][..span.count];
        let centre = |i: u32, a: usize| boxes[i as usize][0][a] + boxes[i as usize][1][a];
        let mut best = (f64::INFINITY, 0, 0.0f32);
        for a in 0..3 {
            let (lo, hi) = order.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), &i| {
                (lo.min(centre(i, a)), hi.max(centre(i, a)))
            });
            if lo >= hi {
                continue;
            }
            let bin = |at: f32| (((at - lo) / (hi - lo) * BINS as f32) as usize).min(BINS - 1);
            let mut bins = [(NOTHING, 0usize); BINS];
            for &i in order.iter() {
                let bin = &mut bins[bin(centre(i, a))];
                *bin = (join(bin.0, boxes[i as usize]), bin.1 + 1);
            }
            let add = |x: (Box3, usize), y: (Box3, usize)| (join(x.0, y.0), x.1 + y.1);
            for cut in 1..BINS {
                let sides =
                    [&bins[..cut], &bins[cut..]].map(|side| side.iter().copied().fold((NOTHING, 0), add));
                let cost = sides.map(|(b, count)| area(b) * count.div_ceil(LEAF_TRIANGLES) as f64);
                if sides.iter().all(|side| side.1 > 0) && cost[0] + cost[1] < best.0 {
                    let last = order.iter().map(|&i| centre(i, a)).filter(|&at| bin(at) < cut);
                    best = (cost[0] + cost[1], a, last.fold(f32::NEG_INFINITY, f32::max));
                }
            }
        }
        let left = if best.0 < f64::INFINITY {
            let mut left = 0;
            for i in 0..order.len() {
                if centre(order[i], best.1) <= best.2 {
                    order.swap(i, left);
                    left += 1;
                }
            }
            left
        } else {
            order.len() / 2
        };
        let bounds = |order: &[u32]| order.iter().fold(NOTHING, |all, &i| join(all, boxes[i as usize]));
        let (a, b) = order.split_at(left);
        [
            Span { first: span.first, count: left, bounds: bounds(a) },
            Span { first: span.first + left, count: span.count - left, bounds: bounds(b) },
        ]
    }
}
