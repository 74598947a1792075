//! `GatherLeg`: a gather ray on its way through the voxels, from mirror to mirror: each leg is asked with those of
//! other rays.
//!
//! Invariant: it holds all that the next leg needs, and what those before have brought.

use super::mirrors::Mirrors;
use crate::trace::Ray;
use glam::Vec3;

/// The yield of a gather ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GatherYield {
    /// Radiance; lamps that no mirror shows are left out.
    pub(crate) radiance: Vec3,
    pub(crate) rays: u32,
}

/// A gather ray on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct GatherLeg {
    /// The place of its present leg in the batch; `None` once it has ended.
    pub(super) asked: Option<u32>,
    /// The present leg.
    pub(super) ray: Ray,
    /// Distance of its start to the cube of the octree.
    pub(super) t_in: f64,
    /// How much its cone gains with each subvoxel.
    pub(super) spread: f32,
    /// Factor on the radiance that arrives at the surface.
    pub(super) weight: Vec3,
    pub(super) mirrors: Mirrors,
    /// What it brought from the mesh, before it came to the voxels.
    pub(super) near: GatherYield,
    /// What it has brought from the voxels.
    pub(super) gathered: GatherYield,
}

impl GatherYield {
    /// Of a ray of which nothing is left.
    pub(super) const NOTHING: GatherYield = GatherYield { radiance: Vec3::ZERO, rays: 0 };

    /// Adds radiance that one more ray has brought.
    pub(super) fn add(&mut self, radiance: Vec3) {
        self.radiance += radiance;
        self.rays += 1;
    }
}

impl GatherLeg {
    /// A ray that has brought this much, behind these mirrors, before it comes to the voxels.
    pub(super) fn new(weight: Vec3, mirrors: Mirrors, near: GatherYield) -> GatherLeg {
        let ray = Ray { origin: [0.0; 3], direction: [0.0; 3], t_max: 0.0 };
        GatherLeg {
            asked: None,
            ray,
            t_in: 0.0,
            spread: 0.0,
            weight,
            mirrors,
            near,
            gathered: GatherYield::NOTHING,
        }
    }
}
