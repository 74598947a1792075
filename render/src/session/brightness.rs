//! Of which methods pictures have an exposure, and how bright what is on show is.

use super::LiveSession;
use crate::scene::method::Method;
use crate::trace::PagedTracer;
use crate::voxel::Occluders;
use trex_film::Brightness;

/// Most rays that ask which pixels of a picture on show are background.
const MASK_RAYS_MAX: u32 = 4096;

impl Method {
    /// True when a picture of it has the light that an exposure is for.
    pub fn has_exposure(self) -> bool {
        self.computes_light() && self != Method::Ao
    }
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// The brightness of what is on show. The voxels say what is background: they are there.
    pub fn brightness(&self) -> Brightness {
        let [width, height] = self.film().resolution();
        let step =
            (f64::from(width) * f64::from(height) / f64::from(MASK_RAYS_MAX)).sqrt().ceil().max(1.0) as u32;
        let scene = self.session.model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On));
        let pixels = (step / 2..height).step_by(step as usize);
        let pixels = pixels.flat_map(|y| (step / 2..width).step_by(step as usize).map(move |x| [x, y]));
        Brightness::new(pixels.map(|[x, y]| {
            let ray = self.session.world.projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let kept = self.session.world.parts.piece(&ray).0;
            let is_surface = scene.as_ref().is_none_or(|scene| scene.intersect(&kept).is_some());
            is_surface.then(|| self.shown([x, y]))
        }))
    }
}
