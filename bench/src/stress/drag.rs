//! `drag`: a hand that moves the camera, and then rests.
//!
//! ```text
//! orbit -> pan -> zoom, 30 events a second -> rest, which is held as any view is
//! event -> frames until the next is due    -> the picture on show is copied at some of the events
//! after the rest: copies against the references of their views -> relMSE, FLIP
//! ```
//!
//! Invariants: 1. each event is applied and has a picture: one that is due waits for the frame under way, so a slow
//! picture makes the way last longer; 2. a copy is of what was on show when the next event was due; 3. nothing is
//! compared while the hand moves, and while a picture is copied the clock stands still.

use super::errors::{PictureError, References};
use super::hold::{Hold, Log};
use super::options::StressFigure;
use super::scenario::{DRAG_EVENTS, DRAG_VIEWS, Script, Step};
use crate::median::median;
use serde::Serialize;
use std::time::{Duration, Instant};
use trex_model::Times;
use trex_render::{LiveSession, PagedTracer};
use trex_store::Result;

/// From event to event.
const EVENT_TIME: Duration = Duration::from_nanos(1_000_000_000 / 30);

/// The pictures of all drags of a run, before the hand rests.
#[derive(Debug, Serialize)]
pub struct DragFigures {
    /// Pictures shown.
    pub pictures: u64,
    /// The same a second.
    pub pictures_per_s: f64,
    /// Event to its first picture.
    pub picture_ms: Times,
    /// relMSE of pictures against their own views; `null` without references.
    pub relmse: Option<Spread>,
    /// FLIP of the same.
    pub flip: Option<Spread>,
}

/// Errors of some pictures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    /// Pictures.
    pub count: u64,
    /// Of the middle one.
    pub median: f64,
    /// 95 of 100 are not above it.
    pub p95: f64,
}

/// The sums of all drags.
#[derive(Default)]
pub(super) struct DragLog {
    pictures: u64,
    time: Duration,
    picture_ms: Times,
    errors: Vec<PictureError>,
}

impl Spread {
    /// Of some numbers; `None` for none.
    fn of(numbers: impl Iterator<Item = f64>) -> Option<Spread> {
        let mut sorted: Vec<f64> = numbers.collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        let p95 = sorted[((sorted.len() as f64 * 0.95).ceil() as usize - 1).min(last)];
        Some(Spread { count: sorted.len() as u64, median: median(&sorted), p95 })
    }
}

impl DragLog {
    /// The figures; `None` where no hand moved.
    pub(super) fn figures(self) -> Option<DragFigures> {
        let DragLog { pictures, time, picture_ms, errors } = self;
        (pictures > 0).then(|| DragFigures {
            pictures,
            pictures_per_s: pictures as f64 / time.as_secs_f64(),
            picture_ms,
            relmse: Spread::of(errors.iter().map(|error| error.relmse)),
            flip: Spread::of(errors.iter().map(|error| error.flip)),
        })
    }

    /// Compares the copies of a drag, shown with `exposure`, with their references.
    ///
    /// # Errors
    /// Those of reading both.
    pub(super) fn compare(&mut self, references: &References, exposure: f32) -> Result<()> {
        for view in 0..DRAG_VIEWS - 1 {
            self.errors.extend(references.error_of_copy(view, exposure)?);
        }
        Ok(())
    }
}

impl Log {
    /// Moves the camera by all events of a drag but the last. The picture on show is copied beside those of
    /// `references`.
    ///
    /// # Errors
    /// Those of [`LiveSession::apply`] and of writing copies; an interrupt.
    pub(super) fn drag<T: PagedTracer + Send>(
        &mut self,
        session: &mut LiveSession<T>,
        script: &Script,
        hold: &Hold<'_>,
        references: Option<&References>,
    ) -> Result<()> {
        let (begin, mut stopped) = (Instant::now(), Duration::ZERO);
        let mut view = 0;
        for event in 0..DRAG_EVENTS - 1 {
            for step in script.steps(event) {
                if let Step::Event(event) = step {
                    session.apply(*event)?;
                }
            }
            let (applied, due) = (Instant::now(), EVENT_TIME * (event + 1));
            let mut has_picture = false;
            while !has_picture || begin.elapsed() - stopped < due {
                hold.interrupt.check()?;
                let frame = Instant::now();
                let report = session.frame(u32::MAX, &|| hold.interrupt.is_raised());
                self.times[StressFigure::Frame as usize].add(frame.elapsed());
                self.add(&report);
                self.drags.pictures += 1;
                if !has_picture {
                    self.drags.picture_ms.add(applied.elapsed());
                }
                has_picture = true;
            }
            if event == script.drag_event(view) {
                let copied = Instant::now();
                if let Some(references) = references {
                    references.copy(view, |pixel| session.shown(pixel))?;
                }
                stopped += copied.elapsed();
                view += 1;
            }
        }
        self.aside += stopped;
        self.drags.time += begin.elapsed() - stopped;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_the_middle_and_what_one_in_twenty_passes() {
        let spread = Spread::of((1..=100).rev().map(f64::from)).unwrap();
        assert_eq!((spread.count, spread.median, spread.p95), (100, 50.5, 95.0));
        let one = Spread::of([7.0].into_iter()).unwrap();
        assert_eq!((one.median, one.p95), (7.0, 7.0));
        assert!(Spread::of(std::iter::empty()).is_none());
    }
}
