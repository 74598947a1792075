//! Predictors: which pages will be wanted next, by the tiles whose turn comes, by the camera's motion, and by what lies
//! beside the pages in use.

use super::Session;
use super::governor::DEMAND;
use super::live::{LiveSession, Prefetch};
use crate::schedule::Pass;
use crate::trace::{PagedTracer, Predictor, Ray};

/// Tiles ahead whose pages are guessed.
const TILES_AHEAD: u32 = 64;
/// Rays along each side of the picture through the camera that is guessed.
const CAMERA_RAYS: u32 = 12;

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Asks for the pages that will be wanted.
    pub(super) fn predict(&mut self) {
        let LiveSession { session, live } = self;
        // Its pages are of the ray that a worker narrows down to.
        let is_narrow = live.pass.as_ref().is_some_and(Pass::is_narrow);
        // Where frames are scarce a guess takes the place of what is in use. A state that begins is taken to be as
        // the last.
        let is_scarce = live.demand(&session.tracers).max(live.last_demand) > DEMAND.start;
        if live.options.prefetch == Prefetch::Off || is_narrow || is_scarce {
            return;
        }
        let Session { world, view, tracers, tiles, .. } = session;
        let tracer = &mut tracers[0];
        tracer.begin_tile();
        let cut = world.lod_distance;
        let probe = |tracer: &mut T, mut ray: Ray| {
            ray.t_max = ray.t_max.min(cut);
            if cut > 0.0 {
                let _ = tracer.intersect(&ray);
            }
        };
        if let Some(pass) = &live.pass {
            let turn = pass.turn().min(tiles.count());
            for turn in turn..tiles.count().min(turn + TILES_AHEAD) {
                let [x, y] = tiles.nth(turn).middle().map(f64::from);
                probe(tracer, world.projection.ray(x, y));
            }
        }
        tracer.prefetch(Predictor::Tiles);
        if let Some(projection) = live.motion.guessed_camera(live.options.t_max) {
            for index in 0..CAMERA_RAYS * CAMERA_RAYS {
                let place = [index % CAMERA_RAYS, index / CAMERA_RAYS];
                let at = |a: usize| {
                    (f64::from(place[a]) + 0.5) / f64::from(CAMERA_RAYS)
                        * f64::from(view.settings.resolution[a])
                };
                probe(tracer, projection.ray(at(0), at(1)));
            }
        }
        tracer.prefetch(Predictor::Camera);
        tracer.prefetch(Predictor::Neighbours);
        tracer.begin_tile();
    }
}
