//! What a leaf of the octree says of the surface in it: to rays that met it, and to places on the mesh.
//!
//! The surface in a leaf is its mean normal and its material of most area; where the normals cancel each other, it faces
//! the ray.
//!
//! Invariant: the normal of a [`LeafHit`] is unit, and on the side that the ray came from.

use super::traverse::{VoxelHit, VoxelScene};
use crate::math::arrays::{along, dot, scale, to_f64};
use crate::trace::Ray;
use trex_store::Material;
use trex_store::octree::LeafVoxel;

/// Where a photon or a gather ray met the voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeafHit<'a> {
    pub(crate) facet: u32,
    pub(crate) point: [f64; 3],
    /// Unit, on the side that the ray came from.
    pub(crate) normal: [f64; 3],
    pub(crate) material: &'a Material,
}

impl<'a> VoxelScene<'a> {
    /// The surface in the leaf that `ray` has met.
    pub(crate) fn leaf_hit(&self, ray: &Ray, hit: &VoxelHit, materials: &'a [Material]) -> LeafHit<'a> {
        self.surface_of(&self.octree().leaf(hit.leaf as usize), ray, hit, materials)
    }

    /// The surface in `voxel`, which `ray` has met, and which is `hit.leaf` or in it.
    pub(crate) fn surface_of(
        &self,
        voxel: &LeafVoxel,
        ray: &Ray,
        hit: &VoxelHit,
        materials: &'a [Material],
    ) -> LeafHit<'a> {
        let normal = to_f64(voxel.normal);
        let facing = dot(normal, ray.direction);
        let normal = if facing == 0.0 { scale(-1.0, ray.direction) } else { scale(-facing.signum(), normal) };
        let point = along(ray.origin, hit.t, ray.direction);
        let facet = self.octree().facet(hit.node, hit.leaf);
        LeafHit { facet, point, normal, material: &materials[usize::from(voxel.material)] }
    }

    /// A ray that leaves a leaf: it starts where no voxel of the plane through any point of the subvoxel can be.
    pub(crate) fn ray_from_leaf(&self, hit: &LeafHit<'_>, direction: [f64; 3]) -> Ray {
        let origin = along(hit.point, 2.0 * self.clearance(hit.normal), hit.normal);
        Ray { origin, direction, t_max: f64::INFINITY }
    }

    /// The leaf that holds `point`, after the node above it.
    fn leaf_at(&self, point: [f64; 3]) -> Option<(u32, u32)> {
        let depth = self.octree().grid().depth();
        let side = f64::from(4u32.pow(depth as u32));
        let at: [f64; 3] = std::array::from_fn(|a| (point[a] - self.corner()[a]) / self.leaf_side());
        if !at.iter().all(|&v| v >= 0.0 && v < side) {
            return None;
        }
        let at = at.map(|v| v as u32);
        (0..depth).rev().try_fold((0, 0), |(_, index), level| {
            let part = |axis: usize| at[axis] >> (2 * level) & 3;
            let place = part(0) | part(1) << 2 | part(2) << 4;
            Some((index, self.octree().nodes()[index as usize].child(place)?))
        })
    }

    /// The facet of the leaf at a place on the exact mesh with unit `normal`; `None` where no leaf is near.
    pub(crate) fn facet_at(&self, point: [f64; 3], normal: [f64; 3]) -> Option<u32> {
        let step = 0.5 * self.clearance(normal);
        let (node, leaf) =
            [0.0, -step, step].into_iter().find_map(|offset| self.leaf_at(along(point, offset, normal)))?;
        Some(self.octree().facet(node, leaf))
    }
}
