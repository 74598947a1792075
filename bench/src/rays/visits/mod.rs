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

mod ours;
mod reference;
mod tree;

use super::mesh::decode;
use super::sets::{BenchRay, Query, RaySet};
use glam::DVec3;
use ours::FileTree;
use reference::ReferenceTree;
use serde::Serialize;
use tree::{Box3, Level, Part, Tree, area, common};
use trex_render::AllResident;
use trex_store::PageFile;

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
    let [a, b, c] = corners.map(|corner| DVec3::from(corner.map(f64::from)));
    let (origin, direction) =
        (DVec3::from(ray.origin.map(f64::from)), DVec3::from(ray.direction.map(f64::from)));
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
    let ours = FileTree::tree(file, pages).visits(sets);
    let triangles = decode(file)?.into_iter().map(|corners| corners.map(|q| q.map(|q| q as f32)));
    let reference = ReferenceTree::tree(triangles.collect()).visits(sets);
    Ok(VisitFigures { ours, reference })
}
