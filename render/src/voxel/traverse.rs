//! One traversal for nodes, leaves and occluder bitmaps: from cell to cell, each as large as the octree allows.
//!
//! ```text
//! go down from the node at hand while the child of the ray's cell is there
//!   a bit of a bitmap is set  -> hit
//!   the child is missing      -> the ray leaves that empty cube; up to the node that holds the next cell too
//! ```
//!
//! Lengths are in subvoxels of the cube, x, y, z from 0 to 4 * resolution. The cell is kept in integers: on leaving a
//! cube the axis of exit moves to the neighbour, the others are what the position says, kept within the cube's side.
//! So each step goes on to a neighbour, whatever the rounding, and no cell between two steps is jumped over but for a
//! corner's width.
//!
//! A ray leaves its own voxels by its start: a cube of side `s` that a plane of unit normal `n` touches lies within
//! `s * (|n.x| + |n.y| + |n.z|)` of the plane, so from beyond that distance a ray that does not come back meets none
//! of the plane's voxels. [`VoxelScene::clearance`] is that distance; it holds at the end of a shadow ray, too.
//!
//! Invariants: 1. no allocation; 2. at most three cubes per unit of the resolution are visited.

use super::g_ray::{GAnswer, GKind, GRay};
use super::steps::Steps;
use crate::trace::Ray;
use glam::{DVec3, Vec3};
use trex_store::Lattice;
use trex_store::octree::{LEAF_SIDE, MAX_DEPTH, UpperOctree, VoxelGrid};

/// The form of leaves for rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Occluders {
    /// Leaves are whole cubes.
    Off,
    /// Leaves are the subvoxels that their bitmaps hold.
    #[default]
    On,
}

impl Occluders {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Occluders::Off => "off",
            Occluders::On => "on",
        }
    }
}

/// The hit of a ray on the voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelHit {
    /// Distance to where the subvoxel (or leaf) is entered, model units.
    pub t: f64,
    /// Index of the leaf.
    pub leaf: u32,
    /// Index of the node above it.
    pub node: u32,
    /// Axis of the face by which it is entered.
    pub axis: usize,
}

/// An octree and where it stands.
#[derive(Clone, Copy, Debug)]
pub struct VoxelScene<'a> {
    octree: &'a UpperOctree,
    /// Model position of the cube's corner.
    corner: [f64; 3],
    /// Side of a subvoxel, model units.
    subvoxel: f64,
    occluders: Occluders,
}

/// The cube of an octree in model space, in cells of some level.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cube {
    pub(super) corner: [f64; 3],
    /// Side of a cell, model units.
    pub(super) cell: f64,
    /// Levels of nodes and leaves above the cells.
    pub(super) levels: u32,
}

/// Least component of a direction: one that would be 0 ends no cell before the cube's end, and divides.
const STEEPEST: f32 = 1e-12;

/// Places of the first 2x2x2 children of a node; shifted by the upper bits of a place, those around it.
pub(super) const EIGHTH: u64 = 0x33_0033;

/// A ray from where it enters the cube, in subvoxels, mirrored to go up along every axis.
pub(super) struct Entry {
    pub(super) origin: [f32; 3],
    pub(super) direction: [f32; 3],
    pub(super) inverse: [f32; 3],
    pub(super) t_max: f32,
    /// Makes places of the mirrored cube those of the octree.
    pub(super) flip: u32,
    /// Axis of the cube's face.
    pub(super) axis: usize,
    /// Distance to the cube, model units.
    pub(super) t_in: f64,
}

/// The voxel at which a walk has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VoxelFound {
    /// Distance from the entry, subvoxels.
    pub(super) t: f32,
    pub(super) node: u32,
    pub(super) leaf: u32,
    /// Axis of the face by which the voxel is entered.
    pub(super) axis: usize,
}

impl Entry {
    /// The walk of a ray of a batch; `None` where that passes the cube by. Its distance to the cube is not known here.
    #[inline(always)]
    pub(super) fn of(ray: &GRay) -> Option<Entry> {
        (ray.t_max >= 0.0).then(|| Entry {
            origin: ray.origin,
            direction: ray.direction,
            inverse: ray.direction.map(|v| 1.0 / v),
            t_max: ray.t_max,
            flip: ray.flip(),
            axis: ray.axis(),
            t_in: 0.0,
        })
    }

    /// Place of the child that holds `cell` in a node whose children have `4^(shift / 2)` cells along an axis.
    #[inline(always)]
    pub(super) fn place(&self, cell: [u32; 3], shift: u32) -> u32 {
        (cell[0] >> shift & 3 | (cell[1] >> shift & 3) << 2 | (cell[2] >> shift & 3) << 4) ^ self.flip
    }

    /// The cells along an axis, less one, of the child around `cell`, which is not there; of the eighth of the node
    /// around it when that is empty, too. `bits` is the node's mask.
    #[inline(always)]
    pub(super) fn within(&self, cell: [u32; 3], shift: u32, bits: u64) -> u32 {
        let place = self.place(cell, shift);
        let is_eighth_empty = bits & EIGHTH << (place & 0b10_1010) == 0;
        (1u32 << (shift + u32::from(is_eighth_empty))) - 1
    }

    /// Leaves the empty cube around a cell, `within + 1` cells along an axis: the next cell, and how many levels
    /// above the cells the node is that holds both. `t` and `axis` go on to its face; `None` behind the ray's end.
    #[inline(always)]
    pub(super) fn leave(
        &self,
        cell: [u32; 3],
        within: u32,
        t: &mut f32,
        axis: &mut usize,
    ) -> Option<([u32; 3], u32)> {
        let end = cell.map(|c| (c | within) + 1);
        let t_axis: [f32; 3] =
            std::array::from_fn(|a| (end[a] as i32 as f32 - self.origin[a]) * self.inverse[a]);
        *axis = usize::from(t_axis[1] < t_axis[0]);
        *axis = if t_axis[2] < t_axis[*axis] { 2 } else { *axis };
        *t = t.max(t_axis[*axis]);
        if *t > self.t_max {
            return None;
        }
        let next: [u32; 3] = std::array::from_fn(|a| {
            let at = (self.origin[a] + *t * self.direction[a]) as i32 as u32;
            if a == *axis { end[a] } else { at.max(cell[a]).min(end[a] - 1) }
        });
        let apart = (next[0] ^ cell[0]) | (next[1] ^ cell[1]) | (next[2] ^ cell[2]);
        Some((next, (31 - apart.leading_zeros()) / 2))
    }

    /// The subvoxel in which the walk begins; `last` is the last one along an axis.
    #[inline(always)]
    pub(super) fn first_cell(&self, last: u32) -> [u32; 3] {
        self.origin.map(|v| (v.max(0.0) as u32).min(last))
    }
}

impl Cube {
    /// Side of the cube, model units.
    pub(super) fn side(&self) -> f64 {
        self.cells() * self.cell
    }

    fn cells(&self) -> f64 {
        f64::from(4u32.pow(self.levels))
    }

    /// The ray from where it enters the cube; `None` where it passes the cube by, or its numbers are not finite.
    #[inline(always)]
    pub(super) fn enter(&self, ray: &Ray) -> Option<Entry> {
        let side = self.cells();
        let (mut t_in, mut t_out, mut axis) = (0.0f64, ray.t_max, 0);
        for a in 0..3 {
            let at = ray.origin[a] - self.corner[a];
            if ray.direction[a] == 0.0 {
                if at < 0.0 || at >= side * self.cell {
                    return None;
                }
                continue;
            }
            let (lo, hi) = (-at / ray.direction[a], (side * self.cell - at) / ray.direction[a]);
            if lo.min(hi) > t_in {
                (t_in, axis) = (lo.min(hi), a);
            }
            t_out = t_out.min(lo.max(hi));
        }
        if t_in > t_out {
            return None;
        }
        // Mirrored so that it goes up along every axis: cell c is then cell `side - 1 - c`.
        let t_max = ((t_out - t_in) / self.cell) as f32;
        let mut entry =
            Entry { origin: [0.0; 3], direction: [0.0; 3], inverse: [0.0; 3], t_max, flip: 0, axis, t_in };
        for a in 0..3 {
            let at = (ray.origin[a] + t_in * ray.direction[a] - self.corner[a]) / self.cell;
            let is_down = ray.direction[a] < 0.0;
            entry.flip |= if is_down { 3 << (2 * a) } else { 0 };
            entry.origin[a] = if is_down { side - at } else { at } as f32;
            entry.direction[a] = (ray.direction[a].abs() as f32).max(STEEPEST);
            entry.inverse[a] = 1.0 / entry.direction[a];
        }
        entry.origin.iter().chain(&entry.direction).all(|v| v.is_finite()).then_some(entry)
    }
}

impl Cube {
    /// The ray as batches take it, and its distance to the cube.
    pub(super) fn g_ray(&self, ray: &Ray, kind: GKind) -> (GRay, f64) {
        let Some(entry) = self.enter(ray) else { return (GRay::outside(kind), 0.0) };
        let Entry { origin, direction, t_max, flip, axis, t_in, .. } = entry;
        let bits = GRay::bits_of(kind, flip, axis);
        (GRay { origin, t_max, direction, bits, width: 0.0, spread: 0.0 }, t_in)
    }
}

impl<'a> VoxelScene<'a> {
    /// An octree on a lattice.
    pub fn new(octree: &'a UpperOctree, lattice: &Lattice, occluders: Occluders) -> VoxelScene<'a> {
        let VoxelGrid { lo, subvoxel_steps, .. } = *octree.grid();
        // Boundaries stand half a step before the lattice points.
        let corner = lattice.position(lo).map(|v| v - 0.5 * lattice.step());
        VoxelScene { octree, corner, subvoxel: subvoxel_steps as f64 * lattice.step(), occluders }
    }

    /// The octree.
    pub(crate) fn octree(&self) -> &'a UpperOctree {
        self.octree
    }

    /// Model position of the cube's corner.
    pub(super) fn corner(&self) -> [f64; 3] {
        self.corner
    }

    /// The form of leaves.
    pub(crate) fn occluders(&self) -> Occluders {
        self.occluders
    }

    /// Side of a subvoxel, model units.
    pub fn subvoxel_side(&self) -> f64 {
        self.subvoxel
    }

    /// Side of a leaf, model units.
    pub fn leaf_side(&self) -> f64 {
        self.subvoxel * f64::from(LEAF_SIDE)
    }

    /// Distance off a surface of unit `normal` at which a ray starts or ends free of that surface's own voxels, model
    /// units.
    pub fn clearance(&self, normal: [f64; 3]) -> f64 {
        let side = match self.occluders {
            Occluders::On => self.subvoxel,
            Occluders::Off => self.leaf_side(),
        };
        side * DVec3::from(normal).abs().element_sum()
    }

    /// The cube in subvoxels.
    pub(super) fn cube(&self) -> Cube {
        Cube { corner: self.corner, cell: self.subvoxel, levels: self.octree.grid().depth() as u32 + 1 }
    }

    /// The first voxel that the ray meets.
    pub fn intersect(&self, ray: &Ray) -> Option<VoxelHit> {
        let entry = self.enter(ray)?;
        Some(self.hit_of(entry.t_in, &self.walk(&entry, &mut ())?))
    }

    /// The ray from where it enters the cube; `None` where it passes the cube by, or its numbers are not finite.
    #[inline(always)]
    pub(super) fn enter(&self, ray: &Ray) -> Option<Entry> {
        self.cube().enter(ray)
    }

    /// The hit of a walk that began at `t_in`.
    pub(super) fn hit_of(&self, t_in: f64, found: &VoxelFound) -> VoxelHit {
        let VoxelFound { t, node, leaf, axis } = *found;
        VoxelHit { t: t_in + f64::from(t) * self.subvoxel, leaf, node, axis }
    }

    /// The ray as batches take it, and its distance to the cube, model units. It is for this scene alone, not for
    /// [`super::LowerScene`], whose subvoxels are finer.
    pub fn g_ray(&self, ray: &Ray, kind: GKind) -> (GRay, f64) {
        self.cube().g_ray(ray, kind)
    }

    /// The answer of one ray of [`VoxelScene::g_ray`]: what batches and devices are compared with.
    ///
    /// # Panics
    /// When the bits of the ray name no kind.
    pub fn answer(&self, ray: &GRay) -> GAnswer {
        let found = Entry::of(ray).and_then(|entry| self.walk(&entry, &mut ()));
        self.answer_of(ray, found.as_ref())
    }

    /// Steps that [`VoxelScene::answer`] takes for a ray: what a device's are compared with.
    pub fn steps(&self, ray: &GRay) -> u64 {
        let mut steps = 0u64;
        Entry::of(ray).map(|entry| self.walk(&entry, &mut steps));
        steps
    }

    /// The answer of a ray that has `found` something, or nothing.
    pub(super) fn answer_of(&self, ray: &GRay, found: Option<&VoxelFound>) -> GAnswer {
        let Some(found) = found else { return GAnswer::bare(GAnswer::NOTHING) };
        if ray.kind() == GKind::Shadow {
            return GAnswer::bare(GAnswer::MET);
        }
        let leaf = self.octree.leaf(found.leaf as usize);
        let normal = ray.facing(&leaf, found.axis);
        self.answer_with(ray, found, normal, leaf.material)
    }

    /// The answer of a ray that has `found` a surface with this unit `normal`, on the side that it came from.
    pub(super) fn answer_with(
        &self,
        ray: &GRay,
        &VoxelFound { t, node, leaf, axis }: &VoxelFound,
        normal: Vec3,
        material: u16,
    ) -> GAnswer {
        let side = if ray.kind().asks_light() { self.side((node, leaf), normal) } else { 0 };
        GAnswer::met((t, axis), side, normal, material)
    }

    /// Walks from the cube's side on.
    #[inline(always)]
    pub(super) fn walk(&self, ray: &Entry, steps: &mut impl Steps) -> Option<VoxelFound> {
        let (nodes, bitmaps) = (self.octree.nodes(), self.octree.bitmaps());
        let depth = self.octree.grid().depth();
        let last = 4u32.pow(depth as u32 + 1) - 1;
        let mut cell = ray.first_cell(last);
        let (mut t, mut axis) = (0.0f32, ray.axis);
        // Node of each level over the cell; at `depth` the leaf.
        let mut path = [0u32; MAX_DEPTH + 1];
        let mut level = 0;
        loop {
            // Down to the leaf, or to a child that is missing. Children of a node of `level` have 4^(depth - level)
            // cells.
            let (shift, bits) = loop {
                let shift = 2 * (depth - level) as u32;
                let place = ray.place(cell, shift);
                if level == depth {
                    let leaf = path[depth];
                    let bits = bitmaps[leaf as usize];
                    if self.occluders == Occluders::Off || bits >> place & 1 == 1 {
                        return Some(VoxelFound { t, node: path[depth - 1], leaf, axis });
                    }
                    break (shift, bits);
                }
                let node = &nodes[path[level] as usize];
                let Some(child) = node.child(place) else { break (shift, node.bits()) };
                level += 1;
                path[level] = child;
            };
            steps.step();
            let (next, apart) = ray.leave(cell, ray.within(cell, shift, bits), &mut t, &mut axis)?;
            if next[axis] > last {
                return None;
            }
            // Up to the node that holds both.
            level = level.min(depth - (apart as usize).min(depth));
            cell = next;
        }
    }
}
