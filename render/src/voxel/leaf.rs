//! What a leaf of the octree says of the surface in it: to rays that met it, and to places on the mesh.
//!
//! The surface in a leaf is a plane with two sides, and its material of most area. Light is kept by the sides of facets
//! (see `trex_store::octree::Facets`): what falls on a roof is not on the ceiling below it. Which side a ray meets,
//! [`super::GRay`] says (`facing`).
//!
//! Invariant: the normal of a [`LeafHit`] is unit, and on the side that the ray came from.

use super::g_ray::GAnswer;
use super::traverse::{Occluders, VoxelScene};
use crate::trace::Ray;
use glam::{DVec3, Vec3};
use trex_store::Material;
use trex_store::octree::LEAF_SIDE;

/// The surface in the leaf that a ray has met: all that light asks of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct VoxelSurface {
    /// Distance to where the voxel is entered, model units.
    pub(crate) t: f64,
    /// The side of a facet that keeps its light; 0 of a ray that does not ask for it.
    pub(crate) side: u32,
    /// Unit, on the side that the ray came from.
    pub(crate) normal: Vec3,
    /// Index into the materials.
    pub(crate) material: u32,
}

/// The hit of a photon or a gather ray on the voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeafHit<'a> {
    /// The side of a facet that keeps its light.
    pub(crate) side: u32,
    pub(crate) point: DVec3,
    /// Unit, on the side that the ray came from.
    pub(crate) normal: DVec3,
    pub(crate) material: &'a Material,
    /// What the material's `kd` is multiplied by, linear: the mean of the mesh's colours on it.
    pub(crate) colour: Vec3,
}

impl GAnswer {
    /// The surface that was met, if one was, by a ray that has entered the cube at `t_in`; `subvoxel` is the side of
    /// its subvoxels.
    pub(crate) fn surface(&self, t_in: f64, subvoxel: f64) -> Option<VoxelSurface> {
        let &GAnswer { outcome, t, side, material, normal, .. } = self;
        let t = t_in + f64::from(t) * subvoxel;
        (outcome == GAnswer::MET).then(|| VoxelSurface { t, side, normal: normal.into(), material })
    }
}

impl VoxelSurface {
    /// The surface as `ray`, which has met it, finds it; of its material, and the mean colour on that.
    pub(crate) fn face<'a>(&self, ray: &Ray, (material, colour): (&'a Material, Vec3)) -> LeafHit<'a> {
        let normal = self.normal.as_dvec3();
        LeafHit { side: self.side, point: ray.at(self.t), normal, material, colour }
    }
}

impl VoxelScene<'_> {
    /// A ray that leaves a leaf: it starts where no voxel of the plane through any point of the subvoxel can be.
    pub(crate) fn ray_from_leaf(&self, hit: &LeafHit<'_>, direction: DVec3) -> Ray {
        let origin = hit.point + 2.0 * self.clearance(hit.normal.into()) * hit.normal;
        Ray::new(origin, direction, f64::INFINITY)
    }

    /// The leaf that holds `point`, after the node above it.
    fn leaf_at(&self, point: DVec3) -> Option<(u32, u32)> {
        let depth = self.octree().grid().depth();
        let side = f64::from(4u32.pow(depth as u32));
        let at = (point - DVec3::from(self.corner())) / self.leaf_side();
        if !(at.cmpge(DVec3::ZERO) & at.cmplt(DVec3::splat(side))).all() {
            return None;
        }
        let at = at.as_uvec3();
        (0..depth).rev().try_fold((0, 0), |(_, index), level| {
            let part = |axis: usize| at[axis] >> (2 * level) & 3;
            let place = part(0) | part(1) << 2 | part(2) << 4;
            Some((index, self.octree().nodes()[index as usize].child(place)?))
        })
    }

    /// True when `point` is within a voxel that a surface touches.
    pub(crate) fn is_occupied(&self, point: DVec3) -> bool {
        let Some((_, leaf)) = self.leaf_at(point) else { return false };
        let at = ((point - DVec3::from(self.corner())) / self.subvoxel_side()).as_uvec3() % LEAF_SIDE;
        let place = at.x | at.y << 2 | at.z << 4;
        self.occluders() == Occluders::Off || self.octree().bitmaps()[leaf as usize] >> place & 1 == 1
    }

    /// The side of a facet that the surface in `leaf` under `node` shows to where `normal` looks.
    pub(super) fn side(&self, (node, leaf): (u32, u32), normal: Vec3) -> u32 {
        let is_back = normal.dot(self.octree().leaf(leaf as usize).normal.into()) < 0.0;
        2 * self.octree().facet(node, leaf) + u32::from(is_back)
    }

    /// The side of a facet at a place on the exact mesh, where unit `normal` looks; `None` where no leaf is near.
    pub(crate) fn side_at(&self, point: DVec3, normal: DVec3) -> Option<u32> {
        let step = 0.5 * self.clearance(normal.into());
        let found =
            [0.0, -step, step].into_iter().find_map(|offset| self.leaf_at(point + offset * normal))?;
        Some(self.side(found, normal.as_vec3()))
    }
}
