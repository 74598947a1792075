//! Previews: what rays from the camera see in the voxels alone, without pages and shadows. What a frame shows first,
//! and what stands in for tiles that wait.

use super::c_ray::FarRay;
use super::context::RenderContext;
use super::g_scene::GScene;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;
use crate::voxel::VoxelHit;
use glam::{DVec3, Vec3};

/// The sample of the lights that stands for all of them, its middle.
const MIDDLE: [f32; 4] = [0.5; 4];

impl RenderContext<'_> {
    /// Radiance that some rays from the camera see, linear RGB; `None` without voxels.
    pub(super) fn previews(&self, rays: impl Iterator<Item = Ray>) -> Option<Vec<[f32; 3]>> {
        let scene = self.voxels.as_ref()?;
        let far: Vec<_> = rays.map(|ray| FarRay::new(&ray, 0.0)).collect();
        let rays: Vec<_> = far.iter().map(|far| far.ray).collect();
        let mut found = vec![None; rays.len()];
        scene.voxels.intersect_batch(&rays, &mut found);
        Some(far.iter().zip(found).map(|(far, found)| self.preview(scene, far, found).to_array()).collect())
    }

    fn preview(&self, scene: &GScene<'_>, far: &FarRay, found: Option<VoxelHit>) -> Vec3 {
        let ray = far.ray;
        let (lights, materials) = (&self.world.lights, &self.world.materials);
        let hit = far.hit(&scene.voxels, found).map(|hit| hit.point);
        if let Some(light) = lights.seen(&ray, hit.map_or(f64::INFINITY, |hit| hit.t)) {
            return light;
        }
        let Some(hit) = hit else { return lights.sky() };
        let surface = SurfaceInteraction::new(&ray, &hit);
        let is_front = hit.normal.as_dvec3().dot(DVec3::from(ray.direction)) < 0.0;
        let own = if is_front { Vec3::from(self.material(&surface).ke) } else { Vec3::ZERO };
        if !scene.irradiance.is_none() {
            return own + scene.gather_from(ray, found, self.world).radiance;
        }
        let point = surface.shading_point(materials);
        let direct = lights.sample(&point, MIDDLE).map_or(Vec3::ZERO, |sample| {
            let returned = point.bsdf.eval(sample.wi) * sample.weight;
            surface.normal.dot(sample.wi) as f32 * returned
        });
        own + direct
    }
}
