//! `debug-upper`, `debug-lower`, `debug-occluders`, `debug-pages`: what the other integrators work with, drawn. Paper, Fig. 4.
//!
//! ```text
//! debug-upper      the leaves of the octree as cubes     shade by the face that is seen
//! debug-lower      the finest leaves, of its units
//! debug-occluders  the subvoxels of their bitmaps
//! debug-pages      the mesh, a colour per page           shade by the cosine to the viewer
//! ```

use crate::integrator::{Integrator, Path, Stage};
use crate::math::{add_rgb, dot, scale_rgb, to_f64};
use crate::sampler::mix;
use crate::trace::{Answer, Hit, Ray, Tracer, UnitPages};
use crate::voxel::GRay;

/// Light on faces across x, y and z.
const FACE_SHADE: [f32; 3] = [0.6, 1.0, 0.8];
/// Behind the model.
const BACKGROUND: [f32; 3] = [0.05; 3];

impl Integrator<'_> {
    /// A ray from the camera through the voxels.
    pub(crate) fn voxel_shown(&self, path: &mut Path, ray: &Ray) -> Stage {
        let voxels = self.voxels.expect("the debug integrators have voxels").voxels;
        path.sample.rays.gather += 1;
        let Ray { origin, direction, t_max } = *ray;
        path.gain(match voxels.intersect(&GRay { origin, direction, t_max }) {
            None => BACKGROUND,
            Some(hit) => self.face_shown(voxels.octree().material(hit.leaf as usize), hit.axis),
        });
        Stage::Done
    }

    /// The same through units, where there are any.
    pub(crate) fn finest_shown<T: Tracer>(
        &self,
        path: &mut Path,
        ray: &Ray,
        tracer: &mut T,
    ) -> Answer<Stage> {
        let Some(lower) = self.voxels.and_then(|voxels| voxels.lower) else {
            return Answer::Exact(self.voxel_shown(path, ray));
        };
        let Ray { origin, direction, t_max } = *ray;
        let pages = &mut UnitPages(tracer);
        let Answer::Exact(found) = lower.intersect(&GRay { origin, direction, t_max }, pages) else {
            return Answer::Blocked;
        };
        path.sample.rays.gather += 1;
        path.gain(match found {
            None => BACKGROUND,
            Some(hit) => self.face_shown(lower.material(&hit, pages), hit.upper.axis),
        });
        Answer::Exact(Stage::Done)
    }

    fn face_shown(&self, material: u16, axis: usize) -> [f32; 3] {
        let material = &self.world.materials[usize::from(material)];
        scale_rgb(FACE_SHADE[axis], add_rgb(material.kd, material.ks))
    }

    /// The end of a ray from the camera.
    pub(crate) fn page_shown(&self, path: &mut Path, ray: &Ray, hit: Option<Hit>) -> Stage {
        path.gain(hit.map_or(BACKGROUND, |hit| {
            let hash = mix(u64::from(hit.page));
            let colour: [f32; 3] =
                std::array::from_fn(|c| 0.25 + 0.75 * ((hash >> (16 * c)) & 0xffff) as f32 / 65535.0);
            let cos = dot(to_f64(hit.normal), ray.direction).abs() as f32;
            scale_rgb(0.3 + 0.7 * cos, colour)
        }));
        Stage::Done
    }
}
