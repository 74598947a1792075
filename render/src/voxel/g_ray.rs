//! `GRay` and `GAnswer`: a ray through the octree and its answer as arrays of words hold them, for lanes and devices
//! alike.
//!
//! ```text
//! Ray (model space, f64) -> enter the cube (f64) -> GRay: subvoxels from there, f32 -> walk -> GAnswer: t in subvoxels
//!                           t_in stays behind                                         t_in + t * subvoxel: model units
//! ```
//!
//! World coordinates in f32 would cost small voxels of large models all of their bits; from where a ray enters the
//! cube they cost none, and what walks gets the very numbers that one ray alone has.
//!
//! Invariants: 1. every field is a word of 32 bits, at a multiple of four bytes; 2. a ray with `t_max` below 0 passes
//! the cube by, and meets nothing.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use trex_store::octree::LeafVoxel;

/// Places of the fields of [`GRay::bits`].
const AXIS_SHIFT: u32 = 6;
const KIND_SHIFT: u32 = 8;

const _: () = assert!(size_of::<GRay>() == 40 && size_of::<GAnswer>() == 32);

/// What a ray asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum GKind {
    /// Whether it meets anything, in the finest voxels.
    Shadow,
    /// The surface that it meets first, in the finest voxels, and where its light is kept.
    Gather,
    /// The surface that it meets first, in the upper octree: a C-ray behind the cut of the footprint rule.
    Far,
    /// The surface that it meets first, in the upper octree, and where its light is kept: a photon.
    Photon,
}

impl GKind {
    /// The kinds, by their numbers.
    pub const ALL: [GKind; 4] = [GKind::Shadow, GKind::Gather, GKind::Far, GKind::Photon];

    /// True for rays that go on into units, where there are any.
    pub fn asks_units(self) -> bool {
        matches!(self, GKind::Shadow | GKind::Gather)
    }

    /// True for rays that are told where the light of the surface is kept: to find that costs a look far away in
    /// memory.
    pub fn asks_light(self) -> bool {
        matches!(self, GKind::Gather | GKind::Photon)
    }
}

/// A ray from where it enters the cube of the octree, in the octree's own space: in subvoxels of the finest voxels that
/// it asks, mirrored so that it goes up along every axis. Made by [`super::VoxelScene::g_ray`] and
/// [`super::LowerScene::g_ray`].
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GRay {
    /// Start, subvoxels of the mirrored cube.
    pub origin: [f32; 3],
    /// End of the ray, subvoxels from its start; below 0 for one that passes the cube by.
    pub t_max: f32,
    /// Direction of the mirrored ray, of unit length; no component is below 10^-12.
    pub direction: [f32; 3],
    /// From the lowest bit: two for each axis, both set where it is mirrored, which makes places of the mirrored cube
    /// those of the octree; two of the axis of the face by which the cube is entered; from bit 8 on the kind.
    pub bits: u32,
    /// Width of the ray's cone at its start, subvoxels; 0 for a line.
    pub width: f32,
    /// Width that the cone gains with each subvoxel; 0 for a line.
    pub spread: f32,
}

/// The answer for one ray.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GAnswer {
    /// [`GAnswer::BLOCKED`], [`GAnswer::NOTHING`] or [`GAnswer::MET`]; the other fields speak of what was met, and
    /// are 0 where nothing was.
    pub outcome: u32,
    /// Distance from the ray's start to where the voxel is entered, subvoxels.
    pub t: f32,
    /// The side of a facet that keeps the light of the surface: twice the facet, and 1 more where its back is met; of
    /// rays that ask for it.
    pub side: u32,
    /// Index into the materials.
    pub material: u32,
    /// Axis of the face by which the voxel is entered.
    pub axis: u32,
    /// Unit normal of the surface, on the side that the ray came from.
    pub normal: [f32; 3],
}

/// Flatness from which the mean normal of a leaf tells which side a ray comes from; below it the face does by which its
/// voxel is entered.
const FLAT: f32 = 0.85;
/// Least component of a direction that goes along an axis: above that by which components of 0 are replaced.
const ALONG_LEAST: f32 = 1e-9;

impl GRay {
    /// A ray that passes the cube by.
    pub(super) fn outside(kind: GKind) -> GRay {
        let (origin, direction, bits) = ([1.0; 3], [1.0; 3], (kind as u32) << KIND_SHIFT);
        GRay { origin, t_max: -1.0, direction, bits, width: 0.0, spread: 0.0 }
    }

    /// The bits of a ray that is mirrored by `flip` and enters the cube across `axis`.
    pub(super) fn bits_of(kind: GKind, flip: u32, axis: usize) -> u32 {
        flip | (axis as u32) << AXIS_SHIFT | (kind as u32) << KIND_SHIFT
    }

    /// What it asks.
    ///
    /// # Panics
    /// When its bits name no kind.
    pub fn kind(&self) -> GKind {
        GKind::ALL[(self.bits >> KIND_SHIFT) as usize]
    }

    /// The bits that mirror places.
    pub fn flip(&self) -> u32 {
        self.bits & 0x3f
    }

    /// The axis of the face by which the cube is entered.
    pub fn axis(&self) -> usize {
        (self.bits >> AXIS_SHIFT & 3) as usize
    }

    /// The ray with the cone that it stands for: its width at the start, subvoxels, and what that gains with each.
    pub fn with_cone(self, width: f32, spread: f32) -> GRay {
        GRay { width, spread, ..self }
    }

    /// Distance at which its cone is as wide as `side`, subvoxels: from there on voxels of that side are not divided.
    pub fn reach(&self, side: f32) -> f32 {
        match side - self.width {
            left if left <= 0.0 => 0.0,
            left if self.spread > 0.0 => left / self.spread,
            _ => f32::INFINITY,
        }
    }

    /// The part of the ray between two distances, in subvoxels `side` times as large.
    pub(super) fn part(&self, from: f32, to: f32, side: f32) -> GRay {
        let scale = 1.0 / side;
        let origin = std::array::from_fn(|a| scale * (self.origin[a] + from * self.direction[a]));
        let t_max = scale * (to.min(self.t_max) - from);
        let longest =
            (0..3).fold(0, |axis, a| if self.direction[a] > self.direction[axis] { a } else { axis });
        // Within the cube, where it has no face by which it came.
        let axis = if from > 0.0 { longest } else { self.axis() };
        GRay { origin, t_max, bits: GRay::bits_of(self.kind(), self.flip(), axis), ..*self }
    }

    /// Unit direction, not mirrored.
    fn direction_in_model(&self) -> Vec3 {
        let flip = self.flip();
        let sign = |axis: usize| if flip >> (2 * axis) & 1 == 1 { -1.0 } else { 1.0 };
        Vec3::from_array(std::array::from_fn(|axis| sign(axis) * self.direction[axis]))
    }

    /// Unit normal of the surface in `leaf`, whose voxel is entered across `axis`, on the side that the ray comes from.
    ///
    /// Where a leaf holds a corner its mean normal looks between the walls, and a ray that meets one of them from the
    /// front may go along with it. So, where that and the face of the voxel disagree, the face is the surface.
    pub(super) fn facing(&self, leaf: &LeafVoxel, axis: usize) -> Vec3 {
        let (way, normal) = (self.direction_in_model(), Vec3::from(leaf.normal));
        let mut face = Vec3::ZERO;
        // A ray that starts in the voxel may not go along its axis at all.
        face[axis] = if way[axis].abs() > ALONG_LEAST { -way[axis].signum() } else { 0.0 };
        let (ahead, across) = (-way.dot(normal), face.dot(normal));
        if leaf.flatness < FLAT && ahead * across < 0.0 {
            return face;
        }
        let facing = if ahead == 0.0 { across } else { ahead };
        if facing == 0.0 { -way } else { facing.signum() * normal }
    }
}

impl GAnswer {
    /// The outcome of a ray that needs a page which is missing: it is to be asked again.
    pub const BLOCKED: u32 = 0;
    /// The outcome of a ray that meets nothing.
    pub const NOTHING: u32 = 1;
    /// The outcome of a ray that meets a voxel.
    pub const MET: u32 = 2;

    /// An answer that says no more than its outcome.
    pub fn bare(outcome: u32) -> GAnswer {
        GAnswer { outcome, ..GAnswer::zeroed() }
    }

    /// The answer of a ray that has met a surface with this `normal` and material at `t`, across `axis`.
    pub(super) fn met((t, axis): (f32, usize), side: u32, normal: Vec3, material: u16) -> GAnswer {
        let (material, axis) = (material.into(), axis as u32);
        GAnswer { outcome: GAnswer::MET, t, side, material, axis, normal: normal.into() }
    }

    /// True when a page is missing.
    pub fn is_blocked(&self) -> bool {
        self.outcome == GAnswer::BLOCKED
    }
}
