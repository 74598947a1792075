//! Triangles to records: which leaf voxels a triangle touches, which of their subvoxels, and with how much area.
//!
//! ```text
//! small triangle (most of them)   the few leaves of its box, one after the other
//! large triangle                  down from the root, into children that it touches
//! copies in a row                 the first of them, with the area of all
//! ```
//!
//! A record is what one material brings to one leaf. Records pile up to [`PILE`], are then sorted and those of the same
//! leaf and material summed; what is still many goes to the scratch file as a run, so that memory does not grow with
//! what a triangle covers.
//!
//! Invariants: 1. in a run records are in order of leaf and material, each pair once; 2. sums depend on the order of
//! triangles alone.

use super::divisor::Divisor;
use super::merge::{RunOrder, VoxelRuns};
use super::overlap::{NARROW_REACH, Triangle, Wide, is_narrowest};
use super::record::Record;
use super::{LEAF_SIDE, NODE_SIDE, VoxelGrid, leaf_key};
use crate::error::Result;

/// Records, 4 MB of them, after which the pile is sorted and summed; when half of that is left, it goes out as a run.
const PILE: usize = 9 << 13;
/// Least records of a run, but for the last of a chunk.
pub(crate) const RUN_RECORDS: usize = PILE / 2;
/// Leaves along an axis of a triangle's box up to which they are asked one after the other.
const FEW: i64 = 4;

/// Subvoxels along an axis of a leaf.
const LEAF: i64 = LEAF_SIDE as i64;

/// Makes records of triangles.
pub(crate) struct Voxelizer<'a> {
    grid: VoxelGrid,
    /// Half-steps to subvoxels.
    subvoxels: Divisor,
    runs: &'a VoxelRuns,
    /// Of the next run.
    order: RunOrder,
    pile: Vec<Record>,
    /// The triangle that was added last, its material, and how often it came in a row: a copy brings area alone.
    last: Option<([[i64; 3]; 3], u16, u32)>,
    /// The first error of writing a run.
    outcome: Result<()>,
}

/// A triangle on its way.
struct Job {
    /// Corners in half-steps from the cube's corner.
    corner: [[i64; 3]; 3],
    /// The subvoxels at both ends of its box.
    first: [i64; 3],
    last: [i64; 3],
    unit_normal: [f64; 3],
    material: u16,
    /// Copies of it.
    count: u32,
}

impl<'a> Voxelizer<'a> {
    /// Runs go to `runs`.
    pub(crate) fn new(grid: VoxelGrid, runs: &'a VoxelRuns) -> Voxelizer<'a> {
        let subvoxels = Divisor::new(2 * grid.subvoxel_steps);
        Voxelizer {
            grid,
            subvoxels,
            runs,
            order: RunOrder::default(),
            pile: Vec::new(),
            last: None,
            outcome: Ok(()),
        }
    }

    /// Most bytes that a voxelizer holds: the pile, and what sorting and packing take.
    pub(crate) const BYTES: u64 = 2 * (PILE * size_of::<Record>()) as u64;

    /// Begins the chunk `index`.
    pub(crate) fn begin(&mut self, index: usize) {
        self.order = RunOrder { chunk: index as u32, number: 0 };
    }

    /// Writes what is left of the chunk.
    ///
    /// # Errors
    /// Those of writing the scratch file, also of runs before.
    pub(crate) fn finish(&mut self) -> Result<()> {
        self.flush();
        self.sum();
        self.write();
        std::mem::replace(&mut self.outcome, Ok(()))
    }

    /// Adds a triangle on the lattice.
    pub(crate) fn add(&mut self, q: [[i64; 3]; 3], material: u16) {
        match &mut self.last {
            Some((last, its_material, count)) if *last == q && *its_material == material => *count += 1,
            _ => {
                self.flush();
                self.last = Some((q, material, 1));
            }
        }
    }

    /// Makes the records of the triangle that was added last.
    fn flush(&mut self) {
        let Some((q, material, count)) = self.last.take() else { return };
        let corner = q.map(|q| std::array::from_fn(|a| 2 * (q[a] - self.grid.lo[a]) + 1));
        let lo: [i64; 3] = std::array::from_fn(|a| corner.iter().map(|c| c[a]).min().expect("three"));
        let hi: [i64; 3] = std::array::from_fn(|a| corner.iter().map(|c| c[a]).max().expect("three"));
        let (first, last) = (lo.map(|v| self.subvoxels.of(v)), hi.map(|v| self.subvoxels.of(v)));
        let job = Job { corner, first, last, unit_normal: unit_normal(&corner), material, count };
        let extent = (0..3).map(|a| hi[a] - lo[a]).max().expect("three");
        let reach = extent + 2 * self.grid.leaf_steps();
        if (0..3).all(|a| last[a] / LEAF - first[a] / LEAF < FEW) {
            if is_narrowest(extent, reach) {
                self.few(&job, &Triangle::<i32>::new(corner));
            } else if reach < NARROW_REACH {
                self.few(&job, &Triangle::<i64>::new(corner));
            } else {
                self.few(&job, &Triangle::<i128>::new(corner));
            }
        } else {
            self.descend(&job, &Triangle::<i128>::new(corner), [0; 3], self.grid.depth());
        }
    }

    /// All leaves of the triangle's box.
    fn few<T: Wide>(&mut self, job: &Job, triangle: &Triangle<T>) {
        let (first, last) = (job.first.map(|v| v / LEAF), job.last.map(|v| v / LEAF));
        let is_inside = first == last;
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    self.leaf(job, triangle, [x, y, z], is_inside);
                }
            }
        }
    }

    /// The children of a node `level` levels above the leaves whose least leaf is `at`.
    fn descend(&mut self, job: &Job, triangle: &Triangle<i128>, at: [i64; 3], level: usize) {
        let leaf = 2 * self.grid.leaf_steps();
        let side = 1i64 << (2 * level);
        if !triangle.touches(at.map(|v| v * leaf), side * leaf) {
            return;
        }
        if level == 0 {
            return self.leaf(job, triangle, at, false);
        }
        let below = side / i64::from(NODE_SIDE);
        for child in 0..64 {
            let step = [child & 3, child >> 2 & 3, child >> 4];
            self.descend(job, triangle, std::array::from_fn(|a| at[a] + step[a] * below), level - 1);
        }
    }

    fn leaf<T: Wide>(&mut self, job: &Job, triangle: &Triangle<T>, at: [i64; 3], is_inside: bool) {
        let subvoxel = 2 * self.grid.subvoxel_steps;
        let leaf = subvoxel * LEAF;
        let origin = at.map(|v| v * leaf);
        let bitmap = subvoxels(triangle, job, at, subvoxel);
        if bitmap == 0 {
            return;
        }
        let area = if is_inside { area(&job.corner) } else { area_inside(&job.corner, origin, leaf) };
        let area = f64::from(job.count) * area / (leaf as f64).powi(2);
        let key = leaf_key(at.map(|v| v as u32), self.grid.depth());
        self.pile.push(Record::of_piece(key, job.material, (bitmap, area), job.unit_normal));
        if self.pile.len() >= PILE {
            self.sum();
            if self.pile.len() >= RUN_RECORDS {
                self.write();
            }
        }
    }

    /// Sorts the pile and sums what belongs together.
    fn sum(&mut self) {
        // Stable: records of one leaf and material keep the order of their triangles. On this thread alone: the pool's
        // others have chunks of their own, and a worker must not wait for them (see `build::emit::in_order`).
        self.pile.sort_by_key(|record| record.order);
        self.pile.dedup_by(|next, sum| {
            let is_same = next.order == sum.order;
            if is_same {
                sum.add(next);
            }
            is_same
        });
    }

    fn write(&mut self) {
        if !self.pile.is_empty() && self.outcome.is_ok() {
            self.outcome = self.runs.append(self.order, &self.pile);
        }
        self.order.number += 1;
        self.pile.clear();
    }
}

/// The subvoxels of the leaf `at` that a triangle touches.
fn subvoxels<T: Wide>(triangle: &Triangle<T>, job: &Job, at: [i64; 3], side: i64) -> u64 {
    let origin = at.map(|v| v * LEAF);
    let range: [[usize; 2]; 3] = std::array::from_fn(|a| {
        [job.first[a], job.last[a]].map(|v| (v - origin[a]).clamp(0, LEAF - 1) as usize)
    });
    let mut wide = (0..3).filter(|&a| job.first[a] < job.last[a]);
    let (axis, is_row) = (wide.next().unwrap_or(0), wide.next().is_none());
    if is_row {
        // The triangle reaches both ends, and is nowhere else.
        let mut place = range.map(|[first, _]| first);
        return (range[axis][0]..=range[axis][1]).fold(0, |bitmap, v| {
            place[axis] = v;
            bitmap | 1 << (place[0] + 4 * place[1] + 16 * place[2])
        });
    }
    triangle.touched(origin.map(|v| v * side), side, range)
}

fn cross_sum(corner: &[[i64; 3]; 3]) -> [f64; 3] {
    let edge = |i: usize, a: usize| (corner[i][a] - corner[0][a]) as f64;
    std::array::from_fn(|a| {
        let (b, c) = ((a + 1) % 3, (a + 2) % 3);
        edge(1, b) * edge(2, c) - edge(1, c) * edge(2, b)
    })
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn area(corner: &[[i64; 3]; 3]) -> f64 {
    0.5 * length(cross_sum(corner))
}

fn unit_normal(corner: &[[i64; 3]; 3]) -> [f64; 3] {
    let n = cross_sum(corner);
    let length = length(n);
    n.map(|v| if length > 0.0 { v / length } else { 0.0 })
}

/// Most corners of a triangle cut by six planes.
const CORNERS: usize = 9;

/// Area of the part of a triangle inside a box: cut by the six planes (Sutherland and Hodgman), in f64.
fn area_inside(corner: &[[i64; 3]; 3], lo: [i64; 3], side: i64) -> f64 {
    let rooms = &mut [[[0f64; 3]; CORNERS]; 2];
    let [mut polygon, mut left] = rooms.each_mut();
    let mut count = 3;
    for (p, c) in polygon.iter_mut().zip(corner) {
        *p = std::array::from_fn(|a| (c[a] - lo[a]) as f64);
    }
    for a in 0..3 {
        let (least, most) = corner.iter().fold((i64::MAX, i64::MIN), |(l, m), c| (l.min(c[a]), m.max(c[a])));
        for (sign, bound, cuts) in [(1.0, 0.0, least < lo[a]), (-1.0, side as f64, most > lo[a] + side)] {
            // Most planes have the triangle on one side.
            if !cuts {
                continue;
            }
            let mut inside = [0.0; CORNERS];
            for (d, p) in inside.iter_mut().zip(&polygon[..count]) {
                *d = sign * (p[a] - bound);
            }
            let mut kept = 0;
            for i in 0..count {
                let after = if i + 1 < count { i + 1 } else { 0 };
                let (p, next, d, e) = (polygon[i], polygon[after], inside[i], inside[after]);
                if d >= 0.0 && kept < CORNERS {
                    left[kept] = p;
                    kept += 1;
                }
                if (d > 0.0 && e < 0.0 || d < 0.0 && e > 0.0) && kept < CORNERS {
                    let part = d / (d - e);
                    left[kept] = std::array::from_fn(|k| p[k] + part * (next[k] - p[k]));
                    kept += 1;
                }
            }
            std::mem::swap(&mut polygon, &mut left);
            count = kept;
        }
    }
    let mut sum = [0.0; 3];
    for i in 1..count.saturating_sub(1) {
        let edge = |k: usize| -> [f64; 3] { std::array::from_fn(|a| polygon[k][a] - polygon[0][a]) };
        let (e, f) = (edge(i), edge(i + 1));
        for a in 0..3 {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            sum[a] += e[b] * f[c] - e[c] * f[b];
        }
    }
    0.5 * length(sum)
}

#[cfg(test)]
mod tests {
    use super::super::Refinement;
    use super::super::merge::{RecordBounds, merge};
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn grid(resolution: u32) -> VoxelGrid {
        VoxelGrid::from_bounds([0; 3], [4095; 3], resolution, Refinement::None)
    }

    fn records(grid: VoxelGrid, triangles: &[[[i64; 3]; 3]]) -> Vec<Record> {
        let runs = VoxelRuns::at(crate::scratch::Place::Unnamed(std::env::temp_dir())).unwrap();
        let mut voxelizer = Voxelizer::new(grid, &runs);
        triangles.iter().for_each(|q| voxelizer.add(*q, 0));
        voxelizer.finish().unwrap();
        let mut all = Vec::new();
        merge(vec![runs], &RecordBounds::new(&grid, 1), |leaf| {
            all.push(leaf);
            Ok(())
        })
        .unwrap();
        all
    }

    fn corners() -> impl Strategy<Value = [[i64; 3]; 3]> {
        let small = (
            proptest::array::uniform3(0i64..4000),
            proptest::array::uniform3(proptest::array::uniform3(0i64..90)),
        )
            .prop_map(|(at, c)| c.map(|c| std::array::from_fn(|a| at[a] + c[a])));
        prop_oneof![small, proptest::array::uniform3(proptest::array::uniform3(0i64..4096))]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

        /// Against every subvoxel of the cube, asked by itself.
        #[test]
        fn all_subvoxels_that_a_triangle_touches_are_set(q in corners()) {
            let grid = grid(64);
            let found: BTreeMap<u64, u64> = records(grid, &[q]).iter().map(|r| (r.key(), r.bitmap)).collect();
            let triangle = Triangle::<i128>::new(q.map(|q| q.map(|v| 2 * v + 1)));
            let side = 2 * grid.subvoxel_steps;
            let range: [(i64, i64); 3] = std::array::from_fn(|a| {
                let values = q.map(|q| (2 * q[a] + 1) / side);
                (*values.iter().min().unwrap(), *values.iter().max().unwrap())
            });
            let mut expected = BTreeMap::<u64, u64>::new();
            for z in range[2].0..=range[2].1 {
                for y in range[1].0..=range[1].1 {
                    for x in range[0].0..=range[0].1 {
                        if triangle.touches([x, y, z].map(|v| v * side), side) {
                            let key = leaf_key([x, y, z].map(|v| (v / 4) as u32), grid.depth());
                            *expected.entry(key).or_default() |= 1 << (x % 4 + 4 * (y % 4) + 16 * (z % 4));
                        }
                    }
                }
            }
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn parts_of_the_area_add_up(triangles in proptest::collection::vec(corners(), 1..5)) {
            let grid = grid(256);
            let all = records(grid, &triangles);
            let side = (2 * grid.leaf_steps()) as f64;
            let half_steps = |q: &[[i64; 3]; 3]| q.map(|q| q.map(|v| 2 * v + 1));
            let areas: f64 = triangles.iter().map(|q| area(&half_steps(q))).sum();
            let expected = areas / (side * side);
            let found: f64 = all.iter().map(|r| f64::from(r.area)).sum();
            prop_assert!((found - expected).abs() <= 1e-4 * expected + 1e-6, "{} for {}", found, expected);
            prop_assert!(all.windows(2).all(|pair| pair[0].key() < pair[1].key()));
        }
    }

    /// Copies of a large triangle took half a millisecond each: five million of them the better part of an hour.
    #[test]
    fn copies_bring_area_alone() {
        let wall = |at: i64| [[0, 0, at], [4095, 0, at], [0, 4095, at]];
        let (one, other) = (records(grid(256), &[wall(70)]), records(grid(256), &[wall(900)]));
        // Piece by piece these would be a thousand million records.
        let copies: Vec<_> = [70, 900].iter().flat_map(|&at| vec![wall(at); 30_000]).collect();
        let found = records(grid(256), &copies);
        assert_eq!(found.len(), one.len() + other.len());
        let alone: BTreeMap<u64, Record> = one.iter().chain(&other).map(|r| (r.key(), *r)).collect();
        for record in &found {
            let alone = &alone[&record.key()];
            assert_eq!(record.bitmap, alone.bitmap);
            let expected = 30_000.0 * alone.area;
            assert!((record.area - expected).abs() <= 1e-5 * expected, "{record:?} {alone:?}");
        }
    }

    #[test]
    fn a_wall_on_a_grid_plane_marks_one_layer() {
        let grid = grid(256);
        let at = grid.leaf_steps() * 7;
        let wall =
            [[[0, 0, at], [4095, 0, at], [0, 4095, at]], [[4095, 0, at], [4095, 4095, at], [0, 4095, at]]];
        let all = records(grid, &wall);
        assert_eq!(all.len(), 256 * 256);
        assert!(all.iter().all(|r| r.bitmap == 0xffff));
    }
}
