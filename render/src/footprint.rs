//! The footprint rule: how far the exact mesh is looked at, and what is seen beyond; and stand-ins for what is missing.
//!
//! ```text
//! camera --- mesh --- cut --- voxels ---        cut: where a leaf voxel covers `lod_error` pixels
//!        --- mirror: the way goes on --- cut ---
//! ```
//!
//! A view then needs pages in proportion to its pixels, not to the model. The voxels of a leaf hold all of its surface, so
//! no crack opens at the cut.
//!
//! Invariants: 1. with `lod_error` 0 voxels are never asked here; 2. a hit of a voxel is told by [`NO_ID`]; 3. a stand-in
//! needs no page.

use crate::film::NO_ID;
use crate::integrator::{Integrator, Origin, Path, Stage};
use crate::material::bsdf;
use crate::math::{add_rgb, along, dot, mul_rgb, scale_rgb, to_f64};
use crate::surface::{OFFSET_ERRORS, Surface};
use crate::trace::{Answer, Hit, Ray, Tracer};
use crate::voxel::{GRay, GScene, VoxelHit, VoxelScene};

/// A mirror on the mesh stays on the mesh for so many leaves: beyond, its own voxels are left at all but grazing angles.
const MIRROR_LEAVES: f64 = 16.0;
/// Clearances that a ray leaves a voxel by: the point of the hit is within one of the surface.
const CLEARANCES: f64 = 2.0;
/// The sample of the lights that stands for all of them, its middle.
const MIDDLE: [f32; 4] = [0.5; 4];

/// What is known of the first thing that a C-ray meets.
pub(crate) enum Closest {
    /// A page is missing.
    Blocked,
    /// It is on the mesh, or there is nothing.
    Known(Option<Hit>),
    /// It is what this ray, the part behind the cut, meets in the voxels.
    Far(FarRay),
}

/// The part of a C-ray behind the cut.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FarRay {
    pub(crate) ray: GRay,
    /// Where it begins on the C-ray.
    cut: f64,
}

impl FarRay {
    fn new(ray: &Ray, cut: f64) -> FarRay {
        let origin = along(ray.origin, cut, ray.direction);
        FarRay { ray: GRay { origin, direction: ray.direction, t_max: ray.t_max - cut }, cut }
    }

    /// What it met, as a hit of the C-ray.
    pub(crate) fn hit(&self, voxels: &VoxelScene<'_>, found: Option<VoxelHit>) -> Option<Hit> {
        let found = found?;
        let leaf = voxels.octree().leaf(found.leaf as usize);
        let clearance = voxels.clearance(to_f64(leaf.normal));
        Some(Hit {
            t: self.cut + found.t,
            triangle: NO_ID,
            page: u32::MAX,
            material: leaf.material.into(),
            normal: leaf.normal,
            error: CLEARANCES * clearance / OFFSET_ERRORS,
        })
    }
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

/// What a C-ray meets that has `found` so much on the mesh before the cut.
pub(crate) fn behind(ray: &Ray, cut: f64, found: Option<Hit>) -> Closest {
    if found.is_none() && cut < ray.t_max {
        Closest::Far(FarRay::new(ray, cut))
    } else {
        Closest::Known(found)
    }
}

impl Integrator<'_> {
    /// What the C-ray at hand meets first: on the mesh before the cut, in the voxels behind.
    pub(crate) fn closest<T: Tracer>(&self, ray: &Ray, path: &Path, tracer: &mut T) -> Closest {
        let cut = self.cut(path);
        let found = match before(ray, cut).map(|part| tracer.intersect(&part)) {
            Some(Answer::Blocked) => return Closest::Blocked,
            Some(Answer::Exact(found)) => found,
            None => None,
        };
        behind(ray, cut, found)
    }

    /// Where voxels begin to answer the C-ray at hand; infinite where the mesh does to its end.
    fn cut(&self, path: &Path) -> f64 {
        let Some(far) = self.stand_in.filter(|_| self.world.voxels_from < f64::INFINITY) else {
            return f64::INFINITY;
        };
        match path.vertex {
            _ if path.is_far => 0.0,
            // No pixel looks along it.
            _ if matches!(path.origin, Origin::Scattered { .. }) => f64::INFINITY,
            0 => self.world.voxels_from,
            _ => (self.world.voxels_from - path.travelled).max(MIRROR_LEAVES * far.voxels.leaf_side()),
        }
    }

    /// Traces the rays from the camera of a tile's paths together: neighbours mostly meet the same pages and nodes. A path
    /// whose ray is blocked stays as it is, and is told so.
    pub(crate) fn meet_together<'p, T: Tracer>(
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

    /// The same for one ray, whatever answers it.
    pub(crate) fn closest_alone<T: Tracer>(
        &self,
        ray: &Ray,
        path: &Path,
        tracer: &mut T,
    ) -> Answer<Option<Hit>> {
        match self.closest(ray, path, tracer) {
            Closest::Blocked => Answer::Blocked,
            Closest::Known(hit) => Answer::Exact(hit),
            Closest::Far(far) => Answer::Exact(self.far_hit(&far)),
        }
    }

    /// What a ray behind the cut meets.
    pub(crate) fn far_hit(&self, far: &FarRay) -> Option<Hit> {
        let voxels = &self.stand_in.expect("what is far is in voxels").voxels;
        far.hit(voxels, voxels.intersect(&far.ray))
    }

    /// What the first rays of some paths see, without pages and shadows; `None` without voxels.
    pub(crate) fn previews<'p>(&self, paths: impl Iterator<Item = &'p Path>) -> Option<Vec<[f32; 3]>> {
        let scene = self.stand_in?;
        let far: Vec<_> = paths.map(|path| FarRay::new(&self.primary_ray(path), 0.0)).collect();
        let rays: Vec<_> = far.iter().map(|far| far.ray).collect();
        let mut found = vec![None; rays.len()];
        scene.voxels.intersect_batch(&rays, &mut found);
        Some(far.iter().zip(found).map(|(far, found)| self.preview(&scene, far, found)).collect())
    }

    fn preview(&self, scene: &GScene<'_>, far: &FarRay, found: Option<VoxelHit>) -> [f32; 3] {
        let GRay { origin, direction, t_max } = far.ray;
        let ray = Ray { origin, direction, t_max };
        let (lights, materials) = (&self.world.lights, &self.world.materials);
        let hit = far.hit(&scene.voxels, found);
        if let Some(light) = lights.seen(&ray, hit.map_or(f64::INFINITY, |hit| hit.t)) {
            return light;
        }
        let Some(hit) = hit else { return lights.sky() };
        let surface = Surface::new(&ray, &hit);
        let material = &materials[surface.material as usize];
        let is_front = dot(to_f64(hit.normal), ray.direction) < 0.0;
        let own = if is_front { material.ke } else { [0.0; 3] };
        if !scene.irradiance.is_none() {
            return add_rgb(own, scene.gather_from((far.ray, found), materials, lights.sky()).radiance);
        }
        let direct = lights.sample(&surface.receiver(materials), MIDDLE).map_or([0.0; 3], |sample| {
            let returned = bsdf(material, surface.normal, surface.to_viewer, sample.direction);
            scale_rgb(dot(surface.normal, sample.direction) as f32, mul_rgb(returned, sample.weight))
        });
        add_rgb(own, direct)
    }
}
