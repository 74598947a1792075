//! Looks at the view that is likely to come next: the pages that its rays miss are asked for behind all that somebody
//! waits for, into frames that nobody wants.
//!
//! ```text
//! foresight -> a few rays, others each time -> pages that are missing -> the request that follows
//!           <- pages that have come bring to light those behind them
//! ```
//!
//! Off unless it is asked for: rays wait for fewer pages, and what is shown is no nearer to the truth, since voxels
//! stand in for those that are missing, and mostly no sooner complete (`docs/measurements.md`).
//!
//! Invariants: 1. nothing of these rays is on the film or the display, so no picture depends on them; 2. where pages in
//! demand approach those that find room together, nothing is asked for.

use super::live::Live;
use super::{LiveSession, Session};
use crate::scene::camera::{Camera, Projection};
use crate::trace::{PagedTracer, Ray};
use std::sync::atomic::{AtomicU32, Ordering};

/// Rays of a view to come, across and down.
const COLUMNS: u32 = 48;
const ROWS: u32 = 27;

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Looks at where the hand moves to, once an event. Pages that are missing there are asked for with the next
    /// request. True when it has looked.
    pub(super) fn look_where_it_moves(&mut self) -> bool {
        let camera = self.live.foresight.moved_on(&self.session.view.camera);
        let camera = camera.filter(|_| self.may_look_ahead());
        if let Some(camera) = &camera {
            self.look(camera);
        }
        camera.is_some()
    }

    /// Looks at the view before, once what was missing there has come, and asks for what is missing still.
    pub(super) fn look_back(&mut self) {
        let Live { options, foresight, .. } = &self.live;
        let awaits = self.session.tracers.iter().any(PagedTracer::awaits_ahead);
        if !options.looks_ahead || foresight.is_done || awaits {
            return;
        }
        let camera = self.live.foresight.before.filter(|_| self.may_look_ahead());
        if let Some(camera) = camera {
            self.look(&camera);
        }
        self.live.foresight.is_done = !self.session.tracers.iter().any(PagedTracer::awaits_ahead);
        for tracer in &mut self.session.tracers {
            tracer.request_missing();
        }
    }

    /// Learns that another camera has taken the place of `from`: what was foreseen before a jump is nothing that comes.
    pub(super) fn note_camera(&mut self, from: Camera) {
        let LiveSession { session, live } = self;
        live.foresight.note_camera(from, live.event.is_complete());
        if !live.foresight.is_on_its_way {
            session.tracers.iter_mut().for_each(PagedTracer::forget_ahead);
        }
    }

    fn may_look_ahead(&mut self) -> bool {
        self.live.options.looks_ahead && !self.live.tiles.is_scarce(&self.session.tracers)
    }

    /// Asks rays of `camera`, a row at a time, by all workers.
    fn look(&mut self, camera: &Camera) {
        let resolution = self.session.view.settings.resolution;
        let Ok(projection) = camera.project(resolution) else { return };
        let [x, y] = self.live.foresight.next_place();
        let Session { world, model, pool, tracers, .. } = &mut self.session;
        // Behind that voxels answer.
        let end = if model.voxels.is_some() { world.lod_distance } else { f64::INFINITY };
        let row_of = |row: u32| row_rays(&projection, [x, y], row).map(|ray| Ray { t_max: end, ..ray });
        let next = AtomicU32::new(0);
        pool.scope(|scope| {
            for tracer in tracers {
                let (next, row_of) = (&next, &row_of);
                scope.spawn(move |_| {
                    tracer.begin_tile();
                    tracer.forget_ahead();
                    tracer.look_ahead(true);
                    let (mut rays, mut answers) = (Vec::new(), Vec::new());
                    loop {
                        let row = next.fetch_add(1, Ordering::Relaxed);
                        if row >= ROWS {
                            break;
                        }
                        rays.clear();
                        rays.extend(row_of(row));
                        answers.clear();
                        tracer.intersect_coherent(&rays, &mut answers);
                        for answer in &answers {
                            tracer.shade_answer(*answer);
                        }
                    }
                    tracer.look_ahead(false);
                    tracer.begin_tile();
                });
            }
        });
    }
}

/// The rays of a row of cells, each through the same place of its cell.
fn row_rays(projection: &Projection, [x, y]: [f64; 2], row: u32) -> impl Iterator<Item = Ray> + '_ {
    let [width, height] = projection.resolution().map(f64::from);
    let y = (f64::from(row) + y) * height / f64::from(ROWS);
    (0..COLUMNS).map(move |column| projection.ray((f64::from(column) + x) * width / f64::from(COLUMNS), y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Fov;
    use crate::session::foresight::Foresight;

    /// Each cell of the grid has a ray, and looks that follow each other go through other places.
    #[test]
    fn rays_go_all_over_the_picture() {
        let (position, target, up) = ([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0]);
        let projection = Camera { position, target, up, fov: Fov::X(40.0) }.project([480, 270]).unwrap();
        let mut foresight = Foresight::default();
        let places: Vec<_> = (0..4).map(|_| foresight.next_place()).collect();
        for (index, [x, y]) in places.iter().enumerate() {
            assert!((0.0..1.0).contains(x) && (0.0..1.0).contains(y));
            assert!(places[..index].iter().all(|other| (other[0] - x).abs() + (other[1] - y).abs() > 0.1));
            let first = row_rays(&projection, [*x, *y], 0).next().unwrap();
            let expected = projection.ray(10.0 * x, 10.0 * y);
            assert!((0..3).all(|a| (first.direction[a] - expected.direction[a]).abs() < 1e-12));
            let rays = (0..ROWS).flat_map(|row| row_rays(&projection, [*x, *y], row));
            assert_eq!(rays.count(), 48 * 27);
        }
    }
}
