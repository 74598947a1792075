//! `debug-upper`, `debug-occluders`, `debug-pages`: what the other integrators work with, drawn. Paper, Fig. 4.
//!
//! ```text
//! debug-upper      the leaves of the octree as cubes     shade by the face that is seen
//! debug-occluders  the subvoxels of their bitmaps
//! debug-pages      the mesh, a colour per page           shade by the cosine to the viewer
//! ```

use crate::integrator::{Integrator, Path, Stage};
use crate::math::{add_rgb, dot, scale_rgb, to_f64};
use crate::sampler::mix;
use crate::trace::{Hit, Ray};
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
            Some(hit) => {
                let material = usize::from(voxels.octree().material(hit.leaf as usize));
                let material = &self.world.materials[material];
                scale_rgb(FACE_SHADE[hit.axis], add_rgb(material.kd, material.ks))
            }
        });
        Stage::Done
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
