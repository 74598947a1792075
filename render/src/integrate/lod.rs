//! The footprint rule: how far the exact mesh is looked at, and what is seen beyond.
//!
//! ```text
//! camera --- mesh --- cut --- voxels ---        cut: where a leaf voxel covers `lod_error` pixels
//!        --- mirror: the way goes on --- cut ---
//! ```
//!
//! A view then needs pages in proportion to its pixels, not to the model. The voxels of a leaf hold all of its
//! surface, so no crack opens at the cut.
//!
//! Invariants: 1. with `lod_error` 0 voxels are never asked here; 2. a hit says which form answered.

use super::c_ray::{AskedFar, CRayHit, FarRay};
use super::context::RenderContext;
use super::g_batch::GBatches;
use super::g_scene::GScene;
use super::path_state::{Origin, Path};
use crate::scene::world::World;
use crate::trace::{Answer, Ray, ShadedHit, Tracer};
use glam::{DVec3, Vec3};

/// A mirror on the mesh stays on the mesh for so many leaves: beyond, its own voxels are left at all but grazing
/// angles.
const MIRROR_LEAVES: f64 = 16.0;

/// Knowledge of the first thing that a C-ray meets.
pub(super) enum Closest {
    /// A page is missing; a preview has the voxels answer instead, or nothing.
    Blocked,
    /// A hit on the mesh, or that there is nothing.
    Known(Option<CRayHit>),
    /// A hit in the voxels, if this ray, the part behind the cut, meets any.
    Far(FarRay),
}

/// The part of a C-ray that the mesh answers; `None` where that is nothing.
pub(super) fn before(ray: &Ray, cut: f64) -> Option<Ray> {
    (cut > 0.0).then(|| Ray { t_max: ray.t_max.min(cut), ..*ray })
}

/// The first thing that a C-ray meets which has `found` that much on the mesh before the cut.
pub(super) fn behind(ray: &Ray, cut: f64, found: Option<ShadedHit>) -> Closest {
    if found.is_none() && cut < ray.t_max {
        Closest::Far(FarRay::new(ray, cut))
    } else {
        Closest::Known(found.map(CRayHit::from))
    }
}

impl RenderContext<'_> {
    /// The first thing that the C-ray at hand meets: on the mesh before the cut, in the voxels behind.
    pub(super) fn closest<T: Tracer>(&self, ray: &Ray, path: &Path, tracer: &mut T) -> Closest {
        let cut = self.cut(ray, path);
        let found = match before(ray, cut).map(|part| tracer.intersect_shaded(&part)) {
            Some(Answer::Blocked) if self.is_preview && self.voxels.is_none() => return Closest::Known(None),
            Some(Answer::Blocked) if self.is_preview => return Closest::Far(self.far_instead(ray, path)),
            Some(Answer::Blocked) => return Closest::Blocked,
            Some(Answer::Exact(found)) => found,
            None => None,
        };
        behind(ray, cut, found)
    }

    /// The ray that asks the voxels in place of the mesh, whose pages are missing. Off a mirror it leaves that one's
    /// own voxels out.
    fn far_instead(&self, ray: &Ray, path: &Path) -> FarRay {
        let leaf = self.voxels.as_ref().map_or(0.0, |scene| scene.voxels.leaf_side());
        let from = if path.vertex == 0 { 0.0 } else { MIRROR_LEAVES * leaf };
        FarRay::new(ray, from.min(ray.t_max))
    }

    /// Asks for a ray behind the cut.
    pub(super) fn ask_far(&self, far: FarRay, batches: &mut GBatches) -> AskedFar {
        batches.asked.push_far(self.far_scene(), far)
    }

    /// The hit of a ray behind the cut: in the resident octree, so it is never blocked.
    pub(super) fn far_hit(&self, asked: &AskedFar, batches: &GBatches) -> Option<CRayHit> {
        let (voxels, answer) = (&self.far_scene().voxels, batches.answered.answer(asked.place));
        assert!(!answer.is_blocked(), "the upper octree is resident");
        let found = answer.surface(asked.t_in, voxels.subvoxel_side());
        let mut hit = asked.far.hit(voxels, found, self.world)?;
        let World { materials, lights, .. } = self.world;
        if materials[hit.point.material as usize].emits() {
            // A voxel looks to where the ray came from; which side of a lamp that is, its triangles tell.
            let clear = |normal: DVec3| voxels.clearance(normal.into());
            let end = found.map_or(0.0, |surface| surface.t);
            if lights.emitted_in_voxels(&asked.far.ray, end, clear) == Vec3::ZERO {
                hit.point.normal = -hit.point.normal;
                hit.point.shading_normal = hit.point.normal;
            }
        }
        Some(hit)
    }

    fn far_scene(&self) -> &GScene<'_> {
        self.voxels.as_ref().expect("what is far is in voxels")
    }

    /// Parameter from which on voxels answer the C-ray at hand; infinite where the mesh does to its end.
    pub(super) fn cut(&self, ray: &Ray, path: &Path) -> f64 {
        let Some(scene) = &self.voxels else { return f64::INFINITY };
        // Voxels have no caps: where the ray comes through a section the mesh answers.
        let entry = self.world.parts.kept(ray).filter(|kept| kept.entered.is_some());
        let least = entry.map_or(0.0, |kept| kept.from + scene.voxels.leaf_side());
        self.cut_by_footprint(path).max(least)
    }

    fn cut_by_footprint(&self, path: &Path) -> f64 {
        let lod_distance = self.world.lod_distance;
        let Some(scene) = self.voxels.as_ref().filter(|_| lod_distance < f64::INFINITY) else {
            return f64::INFINITY;
        };
        match path.vertex {
            _ if path.is_far => 0.0,
            // No pixel looks along it.
            _ if matches!(path.origin, Origin::Scattered { .. }) => f64::INFINITY,
            0 => lod_distance,
            _ => (lod_distance - path.travelled).max(MIRROR_LEAVES * scene.voxels.leaf_side()),
        }
    }
}
