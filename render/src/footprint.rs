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
use crate::integrator::{Integrator, Path};
use crate::material::bsdf;
use crate::math::{add_rgb, dot, mul_rgb, scale_rgb, to_f64};
use crate::surface::{OFFSET_ERRORS, Surface};
use crate::trace::{Answer, Hit, Ray, Tracer};
use crate::voxel::{GRay, VoxelScene};

/// A mirror on the mesh stays on the mesh for so many leaves: beyond, its own voxels are left at all but grazing angles.
const MIRROR_LEAVES: f64 = 16.0;
/// Clearances that a ray leaves a voxel by: the point of the hit is within one of the surface.
const CLEARANCES: f64 = 2.0;
/// The sample of the lights that stands for all of them, its middle.
const MIDDLE: [f32; 4] = [0.5; 4];

impl Integrator<'_> {
    /// What the C-ray at hand meets first: on the mesh before the cut, in the voxels beyond.
    pub(crate) fn closest<T: Tracer>(&self, ray: &Ray, path: &Path, tracer: &mut T) -> Answer<Option<Hit>> {
        let Some(far) = self.stand_in.filter(|_| self.world.voxels_from < f64::INFINITY) else {
            return tracer.intersect(ray);
        };
        let cut = match path.vertex {
            _ if path.is_far => 0.0,
            0 => self.world.voxels_from,
            _ => (self.world.voxels_from - path.travelled).max(MIRROR_LEAVES * far.voxels.leaf_side()),
        };
        if cut > 0.0 {
            match tracer.intersect(&Ray { t_max: ray.t_max.min(cut), ..*ray }) {
                Answer::Exact(None) if cut < ray.t_max => {}
                answer => return answer,
            }
        }
        Answer::Exact(voxel_hit(&far.voxels, ray, cut))
    }

    /// What the first ray of `path` sees, without pages and shadows; `None` without voxels.
    pub(crate) fn preview(&self, path: &Path) -> Option<[f32; 3]> {
        let scene = self.stand_in?;
        let ray = self.primary_ray(path);
        let (lights, materials) = (&self.world.lights, &self.world.materials);
        let hit = voxel_hit(&scene.voxels, &ray, 0.0);
        if let Some(light) = lights.seen(&ray, hit.map_or(f64::INFINITY, |hit| hit.t)) {
            return Some(light);
        }
        let Some(hit) = hit else { return Some(lights.sky()) };
        let surface = Surface::new(&ray, &hit);
        let material = &materials[surface.material as usize];
        let is_front = dot(to_f64(hit.normal), ray.direction) < 0.0;
        let own = if is_front { material.ke } else { [0.0; 3] };
        if !scene.irradiance.is_none() {
            let Ray { origin, direction, t_max } = ray;
            let found = scene.gather(GRay { origin, direction, t_max }, materials, lights.sky());
            return Some(add_rgb(own, found.radiance));
        }
        let direct = lights.sample(&surface.receiver(materials), MIDDLE).map_or([0.0; 3], |sample| {
            let returned = bsdf(material, surface.normal, surface.to_viewer, sample.direction);
            scale_rgb(dot(surface.normal, sample.direction) as f32, mul_rgb(returned, sample.weight))
        });
        Some(add_rgb(own, direct))
    }
}

/// The first voxel that `ray` meets from `t` on, as a hit.
fn voxel_hit(voxels: &VoxelScene<'_>, ray: &Ray, t: f64) -> Option<Hit> {
    let origin = crate::math::along(ray.origin, t, ray.direction);
    let hit = voxels.intersect(&GRay { origin, direction: ray.direction, t_max: ray.t_max - t })?;
    let leaf = voxels.octree().leaf(hit.leaf as usize);
    let clearance = voxels.clearance(to_f64(leaf.normal));
    Some(Hit {
        t: t + hit.t,
        triangle: NO_ID,
        page: u32::MAX,
        material: leaf.material.into(),
        normal: leaf.normal,
        error: CLEARANCES * clearance / OFFSET_ERRORS,
    })
}
