//! Visits: what each ray opens on its way, by level, in our tree and in a reference tree over the same triangles.
//!
//! ```text
//! frames of a file     -> Tree: top nodes, page nodes, clusters, leaves, with the boxes that rays are tested against
//! triangles of a file  -> Tree: binned SAH, 32 bins, leaves of up to 8, collapsed to 8 children (the reference)
//! ray set              -> one walk in f64, nearest first, through either
//! ```
//!
//! The walk is not the tracer's: it has no slack, and counts what is in the tree, not what arithmetic adds. A leaf is a
//! visit, as is a node. `sah_cost` is the surface area heuristic over all of it: areas of what can be visited over that
//! of the root. `overlap` is the area of the intersections of siblings over that of the root.
//!
//! Invariants: counts depend on the tree and the rays alone: not on time, threads or the machine.

use super::mesh::decode;
use super::sets::{BenchRay, Query, RaySet};
use serde::Serialize;
use trex_render::AllResident;
use trex_store::PageFile;
use trex_store::cluster::{FrameRef, FrameView, Node, TopRef};
use trex_store::layout::{LEAF_TRIANGLES, NODE_WIDTH};

/// Bins of the reference build, an axis.
const BINS: usize = 32;
/// Rays of a set that are walked, at most; every so many of more.
const RAYS_MOST: usize = 1 << 18;

/// Visits of both trees.
#[derive(Clone, Debug, Serialize)]
pub struct VisitFigures {
    /// Ours.
    pub ours: TreeVisits,
    /// The reference.
    pub reference: TreeVisits,
}

/// Visits of a tree.
#[derive(Clone, Debug, Serialize)]
pub struct TreeVisits {
    /// Surface area heuristic: areas of nodes, clusters and leaves over the root's.
    pub sah_cost: f64,
    /// Areas of the intersections of siblings over the root's.
    pub overlap: f64,
    /// Mean triangles of a leaf.
    pub leaf_triangles: f64,
    /// Mean leaves of a cluster; 0 where there are none.
    pub cluster_leaves: f64,
    /// Of primary rays.
    pub primary: SetVisits,
    /// Of shadow rays.
    pub shadow: SetVisits,
    /// Of incoherent rays.
    pub incoherent: SetVisits,
}

/// Visits per ray of a set.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct SetVisits {
    /// Nodes of the top tree.
    pub top: f64,
    /// Nodes of pages; of the reference all nodes.
    pub node: f64,
    /// Clusters.
    pub cluster: f64,
    /// Leaves.
    pub leaf: f64,
    /// All of it.
    pub total: f64,
}

type Box3 = [[f32; 3]; 2];

const NOTHING: Box3 = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

fn join(a: Box3, b: Box3) -> Box3 {
    [std::array::from_fn(|i| a[0][i].min(b[0][i])), std::array::from_fn(|i| a[1][i].max(b[1][i]))]
}

fn area(b: Box3) -> f64 {
    let [x, y, z] = std::array::from_fn(|a| f64::from(b[1][a] - b[0][a]).max(0.0));
    x * y + y * z + z * x
}

/// Area of the intersection of two boxes.
fn common(a: Box3, b: Box3) -> f64 {
    let lo: [f32; 3] = std::array::from_fn(|i| a[0][i].max(b[0][i]));
    let hi: [f32; 3] = std::array::from_fn(|i| a[1][i].min(b[1][i]));
    if (0..3).any(|i| lo[i] > hi[i]) { 0.0 } else { area([lo, hi]) }
}

/// What is opened.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Level {
    Top,
    Node,
    Cluster,
    Leaf,
}

/// A box and what is in it: children from `first` on, or, of a leaf, triangles.
#[derive(Clone, Copy)]
struct Part {
    bounds: Box3,
    level: Level,
    first: u32,
    count: u32,
}

/// A tree of boxes; part 0 is the root. Children stand together.
struct Tree {
    parts: Vec<Part>,
    triangles: Vec<[[f32; 3]; 3]>,
}

fn corners_of(triangle: [[i64; 3]; 3]) -> [[f32; 3]; 3] {
    triangle.map(|corner| corner.map(|q| q as f32))
}

fn box_of(triangle: &[[f32; 3]; 3]) -> Box3 {
    triangle.iter().fold(NOTHING, |all, &corner| join(all, [corner, corner]))
}

/// Our tree, as rays meet it.
struct Ours<'a> {
    file: &'a PageFile,
    pages: &'a AllResident,
    tree: Tree,
}

impl Ours<'_> {
    fn tree(file: &PageFile, pages: &AllResident) -> Tree {
        let nowhere = Part { bounds: NOTHING, level: Level::Top, first: 0, count: 0 };
        let tree = Tree { parts: vec![nowhere], triangles: Vec::new() };
        let mut ours = Ours { file, pages, tree };
        let bounds = file.superblock().lattice_bounds.map(|corner| corner.map(|q| q as f32));
        ours.top(0, bounds, file.superblock().root);
        ours.tree
    }

    /// Fills part `at` with what a word of the top tree leads to.
    fn top(&mut self, at: usize, bounds: Box3, word: u32) {
        match TopRef::from_word(word) {
            TopRef::Node(index) => {
                let node = self.file.top()[index as usize];
                self.node((at, bounds, Level::Top), &node, Ours::top);
            }
            TopRef::Page { page, slot } => {
                let frame = FrameView::new(self.pages.frame(page));
                let root = frame.root(slot as usize);
                self.in_page((frame, at), bounds, root);
            }
        }
    }

    fn in_page(&mut self, (frame, at): (FrameView<'_>, usize), bounds: Box3, word: FrameRef) {
        if word.is_cluster() {
            return self.cluster(frame, at, bounds, word);
        }
        let below = |ours: &mut Self, at, bounds, word| ours.in_page((frame, at), bounds, FrameRef(word));
        self.node((at, bounds, Level::Node), frame.node(word), below);
    }

    fn node(
        &mut self,
        (at, bounds, level): (usize, Box3, Level),
        node: &Node,
        mut below: impl FnMut(&mut Self, usize, Box3, u32),
    ) {
        let first = self.reserve((at, bounds, level), usize::from(node.child_count));
        let shift = self.file.superblock().node_shift;
        for i in 0..usize::from(node.child_count) {
            let child = node.child_box(i, shift);
            below(
                self,
                first + i,
                [child.lo, child.hi].map(|corner| corner.map(|q| q as f32)),
                node.child[i],
            );
        }
    }

    /// Sets part `at`, with room for so many children; gives the first of these.
    fn reserve(&mut self, (at, bounds, level): (usize, Box3, Level), count: usize) -> usize {
        let first = self.tree.parts.len();
        self.tree.parts[at] = Part { bounds, level, first: first as u32, count: count as u32 };
        let nowhere = Part { bounds: NOTHING, level: Level::Leaf, first: 0, count: 0 };
        self.tree.parts.resize(first + count, nowhere);
        first
    }

    fn cluster(&mut self, frame: FrameView<'_>, at: usize, bounds: Box3, word: FrameRef) {
        let cluster = frame.cluster(word);
        let first = self.reserve((at, bounds, Level::Cluster), cluster.leaf_count());
        let (base, shift, planes) = (cluster.base(), cluster.leaf_shift(), cluster.leaf_planes());
        for leaf in 0..cluster.leaf_count() {
            let lo = std::array::from_fn(|a| (base[a] + (i64::from(planes[a][leaf]) << shift[a])) as f32);
            let end = |a: usize| base[a] + ((i64::from(planes[3 + a][leaf]) + 1) << shift[a]) - 1;
            let bounds = [lo, std::array::from_fn(|a| end(a) as f32)];
            let (count, triangles) =
                (cluster.leaf_indices(leaf).shape.triangle_count(), self.tree.triangles.len() as u32);
            self.tree.parts[first + leaf] =
                Part { bounds, level: Level::Leaf, first: triangles, count: count as u32 };
            let corners = (0..count).map(|place| corners_of(cluster.triangle(leaf, place)));
            self.tree.triangles.extend(corners);
        }
    }
}

/// The reference: triangles by index, and their boxes and centres.
struct Reference {
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

impl Reference {
    fn tree(triangles: Vec<[[f32; 3]; 3]>) -> Tree {
        let boxes: Vec<Box3> = triangles.iter().map(box_of).collect();
        let bounds = boxes.iter().fold(NOTHING, |all, &b| join(all, b));
        let order = (0..triangles.len() as u32).collect();
        let nowhere = Part { bounds, level: Level::Node, first: 0, count: 0 };
        let tree = Tree { parts: vec![nowhere], triangles };
        let mut reference = Reference { tree, boxes, order };
        let count = reference.order.len();
        reference.grow(0, Span { first: 0, count, bounds });
        let Reference { mut tree, order, .. } = reference;
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
        let Reference { boxes, order, .. } = self;
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

/// The visits of one ray.
#[derive(Default)]
struct Walk {
    counts: [u64; 4],
    waiting: Vec<(f64, u32)>,
}

impl Walk {
    fn ray(&mut self, tree: &Tree, ray: &BenchRay, query: Query) {
        let origin = ray.origin.map(f64::from);
        let inverse = ray.direction.map(|d| 1.0 / f64::from(d));
        let meets = |b: &Box3, t_max: f64| {
            let (mut near, mut far) = (0.0f64, t_max);
            for a in 0..3 {
                let t = [b[0][a], b[1][a]].map(|plane| (f64::from(plane) - origin[a]) * inverse[a]);
                // A ray in the plane of a side: 0 / 0 says nothing.
                if t[0].is_nan() || t[1].is_nan() {
                    continue;
                }
                near = near.max(t[0].min(t[1]));
                far = far.min(t[0].max(t[1]));
            }
            (near <= far).then_some(near)
        };
        let mut t_max = f64::from(ray.t_max);
        self.waiting.clear();
        self.waiting.extend(meets(&tree.parts[0].bounds, t_max).map(|t| (t, 0)));
        while let Some((t, at)) = self.waiting.pop() {
            let part = tree.parts[at as usize];
            if t > t_max {
                continue;
            }
            self.counts[part.level as usize] += 1;
            let range = part.first as usize..(part.first + part.count) as usize;
            if part.level == Level::Leaf {
                let hits = tree.triangles[range].iter().filter_map(|corners| hit(corners, ray));
                t_max = hits.fold(t_max, f64::min);
                if query == Query::Any && t_max < f64::from(ray.t_max) {
                    return;
                }
                continue;
            }
            let first = self.waiting.len();
            for child in range {
                self.waiting.extend(meets(&tree.parts[child].bounds, t_max).map(|t| (t, child as u32)));
            }
            self.waiting[first..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        }
    }
}

/// Where a ray meets a triangle (Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997).
fn hit(corners: &[[f32; 3]; 3], ray: &BenchRay) -> Option<f64> {
    let [a, b, c] = corners.map(|corner| glam::DVec3::from(corner.map(f64::from)));
    let (origin, direction) =
        (glam::DVec3::from(ray.origin.map(f64::from)), glam::DVec3::from(ray.direction.map(f64::from)));
    let (e, f, from) = (b - a, c - a, origin - a);
    let p = direction.cross(f);
    let scale = 1.0 / e.dot(p);
    let (u, q) = (from.dot(p) * scale, from.cross(e));
    let (v, t) = (direction.dot(q) * scale, f.dot(q) * scale);
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some(t)
}

impl Tree {
    fn visits(&self, sets: [&RaySet; 3]) -> TreeVisits {
        let root = area(self.parts[0].bounds);
        let children = |part: &Part| match part.level {
            Level::Leaf => &self.parts[..0],
            _ => &self.parts[part.first as usize..][..part.count as usize],
        };
        let pairs = |parts: &[Part]| -> f64 {
            let with_later = |(i, a): (usize, &Part)| -> f64 {
                parts[i + 1..].iter().map(|b| common(a.bounds, b.bounds)).sum()
            };
            parts.iter().enumerate().map(with_later).sum()
        };
        let of = |level: Level| self.parts.iter().filter(move |part| part.level == level);
        let mean = |level: Level| {
            let (count, sum) = of(level).fold((0, 0), |(n, sum), part| (n + 1, sum + u64::from(part.count)));
            if count == 0 { 0.0 } else { sum as f64 / f64::from(count) }
        };
        let [primary, shadow, incoherent] = sets.map(|set| self.walk(set));
        TreeVisits {
            sah_cost: self.parts.iter().map(|part| area(part.bounds)).sum::<f64>() / root,
            overlap: self.parts.iter().map(|part| pairs(children(part))).sum::<f64>() / root,
            leaf_triangles: mean(Level::Leaf),
            cluster_leaves: mean(Level::Cluster),
            primary,
            shadow,
            incoherent,
        }
    }

    fn walk(&self, set: &RaySet) -> SetVisits {
        let every = set.rays.len().div_ceil(RAYS_MOST).max(1);
        let (mut walk, mut rays) = (Walk::default(), 0u32);
        for ray in set.rays.iter().step_by(every) {
            walk.ray(self, ray, set.query);
            rays += 1;
        }
        let per_ray = |count: u64| count as f64 / f64::from(rays.max(1));
        let [top, node, cluster, leaf] = walk.counts.map(per_ray);
        SetVisits { top, node, cluster, leaf, total: top + node + cluster + leaf }
    }
}

/// Bytes that both trees of a file take together, at most.
pub(super) fn bytes(triangle_count: u64) -> u64 {
    let part = size_of::<Part>() as u64;
    triangle_count * (2 * size_of::<[[f32; 3]; 3]>() as u64 + size_of::<Box3>() as u64 + 4 + 2 * part)
}

/// Visits of both trees by the rays of three sets: primary, shadow, incoherent.
pub(super) fn visits(
    file: &PageFile,
    pages: &AllResident,
    sets: [&RaySet; 3],
) -> trex_store::Result<VisitFigures> {
    let ours = Ours::tree(file, pages).visits(sets);
    let triangles = decode(file)?.into_iter().map(|corners| corners.map(|q| q.map(|q| q as f32)));
    let reference = Reference::tree(triangles.collect()).visits(sets);
    Ok(VisitFigures { ours, reference })
}
