//! `photon`: what is seen, lit by the lights, and by what photons brought to the voxels around: gather rays fetch it. Paper,
//! section 5. Perfect mirrors carry the view on, as in `direct`. Directions are drawn here for `full-gi`, too.
//!
//! ```text
//! surface -> gather ray -> leaf: irradiance * (Kd + Ks * albedo of its lobe) / pi     (emitters left out: shadow rays bring their light)
//!                       -> nothing: the sky                                          (left out by the shadow rays)
//! ```
//!
//! Invariant: a gather ray asks the mesh for its beginning at most (`near = exact`), and units for the voxels that it meets, so
//! it can be blocked by few pages.

use crate::full_gi::GatherRay;
use crate::integrator::{Integrator, Path, Stage};
use crate::material::scatter_rough;
use crate::math::{max_rgb, mul_rgb, scale_rgb};
use crate::sampler::Decision;
use crate::surface::Surface;
use crate::trace::{Answer, Tracer};
use crate::voxel::{GScene, Gathered};

impl Integrator<'_> {
    /// One gather ray.
    pub(crate) fn gather_step<T: Tracer>(
        &self,
        path: &mut Path,
        surface: &Surface,
        index: u32,
        tracer: &mut T,
    ) -> Answer<Stage> {
        if let Some((direction, weight)) = self.gather_query(path, surface, index) {
            let Some(voxels) = self.voxels else {
                let (surface, ray) = (*surface, surface.ray_to(direction, f64::INFINITY, None));
                return Answer::Exact(Stage::GatherRay(GatherRay {
                    surface,
                    index,
                    ray,
                    weight,
                    mirrors: 0,
                }));
            };
            let Answer::Exact(found) = self.gathered_along(&voxels, surface, direction, tracer) else {
                return Answer::Blocked;
            };
            path.sample.rays.gather += found.rays;
            path.gain_indirect(mul_rgb(weight, found.radiance));
        }
        Answer::Exact(self.after_gather_ray(*surface, index + 1))
    }

    /// What follows the gather rays before number `index`.
    pub(crate) fn after_gather_ray(&self, surface: Surface, index: u32) -> Stage {
        if index < self.n_gather() { Stage::Gather { surface, index } } else { Stage::Bounce(surface) }
    }

    /// Direction and weight of gather ray `index`; `None` where it could bring nothing.
    pub(crate) fn gather_query(
        &self,
        path: &Path,
        surface: &Surface,
        index: u32,
    ) -> Option<([f64; 3], [f32; 3])> {
        let (world, count) = (self.world, self.world.n_gather);
        let material = &world.materials[surface.material as usize];
        let u = path.sampler.draw(Decision::Gather { vertex: path.vertex, index, count });
        let (normal, to_viewer) = (surface.normal, surface.to_viewer);
        let (direction, _, weight) = scatter_rough(material, normal, to_viewer, [u[0], u[1], u[2]])?;
        let weight = scale_rgb(1.0 / count as f32, weight);
        (max_rgb(weight) > 0.0).then_some((direction, weight))
    }

    /// What arrives at a surface from unit `direction`.
    fn gathered_along<T: Tracer>(
        &self,
        voxels: &GScene<'_>,
        surface: &Surface,
        direction: [f64; 3],
        tracer: &mut T,
    ) -> Answer<Gathered> {
        let world = self.world;
        if let Some(near) = voxels.near_length(surface, direction) {
            let ray = surface.ray_to(direction, near, None);
            match tracer.intersect(&ray) {
                Answer::Blocked => return Answer::Blocked,
                Answer::Exact(None) => {}
                Answer::Exact(Some(hit)) => {
                    let met = Surface::new(&ray, &hit);
                    let material = &world.materials[met.material as usize];
                    let radiance = voxels.leaving_surface(&met, material).unwrap_or([0.0; 3]);
                    return Answer::Exact(Gathered { radiance, rays: 1 });
                }
            }
        }
        match voxels.leave(surface, direction, f64::INFINITY, None) {
            Some(ray) => voxels.gather_finest(ray, (&world.materials, world.lights.sky()), tracer),
            None => Answer::Exact(Gathered { radiance: [0.0; 3], rays: 0 }),
        }
    }
}
