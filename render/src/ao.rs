//! `ao`: ambient occlusion. White light from all sides on white surfaces; what stands nearer than the radius
//! (half of the model's diagonal, see [`crate::world::World::ao_radius`]) takes it away.
//!
//! ```text
//! primary ray -> hit -> n_shadow rays by the cosine, none longer than the radius: the share that meets nothing
//!             -> miss: 1
//! ```
//!
//! Where the file has voxels these rays are G-rays, else they go through the mesh. Materials and lights play no part. S. Zhukov, A. Iones, G. Kronin, "An ambient light illumination model" (1998).

use crate::integrator::{Integrator, Path, ShadowQuery, Stage};
use crate::light::cosine_direction;
use crate::sampler::Decision;
use crate::surface::Surface;
use crate::trace::{Hit, Ray};

impl Integrator<'_> {
    /// The end of a primary ray.
    pub(crate) fn unlit(&self, path: &mut Path, ray: &Ray, hit: Option<Hit>) -> Stage {
        match hit {
            Some(hit) if self.world.n_shadow > 0 => {
                Stage::Shadow { surface: Surface::new(ray, &hit), index: 0 }
            }
            Some(_) => Stage::Done,
            None => {
                path.gain([1.0; 3]);
                Stage::Done
            }
        }
    }

    /// One ray of those that look around.
    pub(crate) fn openness_query(&self, path: &Path, surface: &Surface, index: u32) -> ShadowQuery {
        let count = self.world.n_shadow;
        let u = path.sampler.draw(Decision::Gather { vertex: 0, index, count });
        let direction = cosine_direction(surface.normal, [u[0], u[1]]);
        let light = [1.0 / count as f32; 3];
        ShadowQuery { direction, distance: self.world.ao_radius, front: None, light }
    }
}
