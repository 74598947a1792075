//! `Foresight`: which view is likely to come next; the pages that its rays miss are asked for behind all that somebody
//! waits for, into frames that nobody wants.
//!
//! ```text
//! the hand moves            the camera goes on as it went from the event before to this one
//! the picture is complete   the view before it, as of who goes back and forth, until none of its pages is missing
//! ```
//!
//! A few rays are asked, others each time: pages that come bring to light those behind them. A view that jumps is not
//! foreseen, and costs nothing but what was read for another while the picture was complete.
//!
//! Invariants: 1. nothing of these rays is on the film or the display, so no picture depends on them; 2. where pages in
//! demand approach those that find room together, nothing is asked for.

use super::{LiveSession, Session};
use crate::scene::camera::{Camera, Projection};
use crate::trace::{PagedTracer, Ray};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Rays of a view to come, across and down.
const COLUMNS: u32 = 48;
const ROWS: u32 = 27;
/// Steps of the hand, each as long as the last one, after which its view is looked at.
const STEPS_AHEAD: f64 = 4.0;
/// From event to event, the longest time after which the hand has not rested in between.
const STEP_LONGEST: Duration = Duration::from_millis(200);

/// What is known of views to come.
#[derive(Debug, Default)]
pub(super) struct Foresight {
    /// When the camera became another, and what it was before.
    last: Option<(Instant, Camera)>,
    /// The hand is on its way, and where it comes to has not been looked at since the last event.
    is_on_its_way: bool,
    /// That of the last picture that was complete before this one.
    before: Option<Camera>,
    /// All of the view before is there, as far as rays told.
    is_done: bool,
    /// Views looked at.
    looked: u32,
}

impl Foresight {
    /// Learns that another camera has taken the place of `from`, whose picture was complete or not.
    pub(super) fn note_camera(&mut self, from: Camera, was_complete: bool) {
        let now = Instant::now();
        self.is_on_its_way = self.last.is_some_and(|(before, _)| now - before <= STEP_LONGEST);
        self.last = Some((now, from));
        self.is_done = false;
        if was_complete {
            self.before = Some(from);
        }
    }

    /// Where the camera `now` comes to, if the hand moves on; once an event.
    fn moved_on(&mut self, now: &Camera) -> Option<Camera> {
        if !std::mem::take(&mut self.is_on_its_way) {
            return None;
        }
        let (_, last) = self.last?;
        let on =
            |from: [f64; 3], to: [f64; 3]| std::array::from_fn(|a| to[a] + STEPS_AHEAD * (to[a] - from[a]));
        Some(Camera {
            position: on(last.position, now.position),
            target: on(last.target, now.target),
            ..*now
        })
    }

    /// Where in its cell each ray of a look goes through, another place each time: the additive recurrence of the plastic
    /// number.
    fn next_place(&mut self) -> [f64; 2] {
        self.looked = self.looked.wrapping_add(1);
        [0.754_877_666_246_692_7, 0.569_840_290_998_053_2].map(|step| (f64::from(self.looked) * step).fract())
    }
}

impl<T: PagedTracer + Send> LiveSession<T> {
    /// Looks at where the hand moves to, once an event. Pages that are missing there are asked for with the next request.
    /// True when it has looked.
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
        if self.live.foresight.is_done || self.session.tracers.iter().any(PagedTracer::awaits_ahead) {
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

    fn camera(x: f64, target_x: f64) -> Camera {
        Camera {
            position: [x, 0.0, 5.0],
            target: [target_x, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
            fov: Fov::X(40.0),
        }
    }

    #[test]
    fn a_hand_goes_on_as_it_went() {
        let mut foresight = Foresight::default();
        assert_eq!(foresight.moved_on(&camera(0.0, 0.0)), None);
        foresight.note_camera(camera(0.5, -0.25), false);
        assert_eq!(foresight.moved_on(&camera(1.0, 0.0)), None, "one step may be a jump");
        foresight.note_camera(camera(1.0, 0.0), false);
        assert_eq!(foresight.moved_on(&camera(1.5, 0.25)), Some(camera(3.5, 1.25)));
        assert_eq!(foresight.moved_on(&camera(1.5, 0.25)), None, "it has been looked at");
        assert_eq!(foresight.before, None);
        foresight.note_camera(camera(2.0, 0.0), true);
        assert_eq!(foresight.before, Some(camera(2.0, 0.0)));
        // A hand that has rested may go anywhere.
        foresight.last.as_mut().unwrap().0 -= 2 * STEP_LONGEST;
        foresight.note_camera(camera(2.5, 0.0), true);
        assert_eq!(foresight.moved_on(&camera(3.0, 0.0)), None);
    }

    /// Each cell of the grid has a ray, and looks that follow each other go through other places.
    #[test]
    fn rays_go_all_over_the_picture() {
        let projection = camera(0.0, 0.0).project([480, 270]).unwrap();
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
