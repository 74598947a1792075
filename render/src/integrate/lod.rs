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

use super::c_ray::{CRayHit, FarRay};
use super::context::RenderContext;
use super::path_state::{Origin, Path, Stage};
use crate::trace::{Answer, Hit, Ray, Tracer};

/// A mirror on the mesh stays on the mesh for so many leaves: beyond, its own voxels are left at all but grazing
/// angles.
const MIRROR_LEAVES: f64 = 16.0;

/// Knowledge of the first thing that a C-ray meets.
pub(super) enum Closest {
    /// A page is missing.
    Blocked,
    /// A hit on the mesh, or that there is nothing.
    Known(Option<CRayHit>),
    /// A hit in the voxels, if this ray, the part behind the cut, meets any.
    Far(FarRay),
}

/// Rays that are traced together, and their answers.
#[derive(Debug, Default)]
pub(crate) struct Together {
    rays: Vec<Ray>,
    answers: Vec<Answer<Option<Hit>>>,
}

impl Together {
    /// Bytes that the rays of so many paths take.
    pub(crate) fn bytes(path_count: usize) -> u64 {
        let asking = size_of::<(&mut Path, &mut bool, Ray, f64)>();
        // Vectors that grow by doubling.
        (2 * path_count * (size_of::<Ray>() + size_of::<Answer<Option<Hit>>>() + asking)) as u64
    }
}

/// The part of a C-ray that the mesh answers; `None` where that is nothing.
fn before(ray: &Ray, cut: f64) -> Option<Ray> {
    (cut > 0.0).then(|| Ray { t_max: ray.t_max.min(cut), ..*ray })
}

/// The first thing that a C-ray meets which has `found` that much on the mesh before the cut.
pub(super) fn behind(ray: &Ray, cut: f64, found: Option<Hit>) -> Closest {
    if found.is_none() && cut < ray.t_max {
        Closest::Far(FarRay::new(ray, cut))
    } else {
        Closest::Known(found.map(CRayHit::from))
    }
}

impl RenderContext<'_> {
    /// The first thing that the C-ray at hand meets: on the mesh before the cut, in the voxels behind.
    pub(super) fn closest<T: Tracer>(&self, ray: &Ray, path: &Path, tracer: &mut T) -> Closest {
        let cut = self.cut(path);
        let found = match before(ray, cut).map(|part| tracer.intersect(&part)) {
            Some(Answer::Blocked) => return Closest::Blocked,
            Some(Answer::Exact(found)) => found,
            None => None,
        };
        behind(ray, cut, found)
    }

    /// The first thing that one C-ray meets, whatever answers it.
    pub(super) fn closest_alone<T: Tracer>(
        &self,
        ray: &Ray,
        path: &Path,
        tracer: &mut T,
    ) -> Answer<Option<CRayHit>> {
        match self.closest(ray, path, tracer) {
            Closest::Blocked => Answer::Blocked,
            Closest::Known(hit) => Answer::Exact(hit),
            Closest::Far(far) => Answer::Exact(self.far_hit(&far)),
        }
    }

    /// The hit of a ray behind the cut.
    pub(super) fn far_hit(&self, far: &FarRay) -> Option<CRayHit> {
        let voxels = &self.voxels.as_ref().expect("what is far is in voxels").voxels;
        far.hit(voxels, voxels.intersect(&far.ray))
    }

    /// Parameter from which on voxels answer the C-ray at hand; infinite where the mesh does to its end.
    fn cut(&self, path: &Path) -> f64 {
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

    /// Traces the rays from the camera of a tile's paths together: neighbours mostly meet the same pages and nodes. A
    /// path whose ray is blocked stays as it is, and is told so.
    pub(super) fn meet_together<'p, T: Tracer>(
        &self,
        paths: impl Iterator<Item = (&'p mut Path, &'p mut bool)>,
        tracer: &mut T,
        together: &mut Together,
    ) {
        let Together { rays, answers } = together;
        rays.clear();
        answers.clear();
        let mut asking = Vec::with_capacity(paths.size_hint().1.unwrap_or(0));
        for (path, is_blocked) in paths {
            let Stage::CRay(ray) = path.stage else { continue };
            let cut = self.cut(path);
            if let Some(part) = before(&ray, cut).filter(|_| matches!(path.origin, Origin::Camera)) {
                rays.push(part);
                asking.push((path, is_blocked, ray, cut));
            }
        }
        tracer.intersect_coherent(rays, answers);
        for ((path, is_blocked, ray, cut), answer) in asking.into_iter().zip(answers) {
            match *answer {
                Answer::Blocked => *is_blocked = true,
                Answer::Exact(found) => path.stage = Stage::Met { ray, cut, found },
            }
        }
    }
}
