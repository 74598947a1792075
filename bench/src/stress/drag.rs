//! `drag` and `fly`: a hand that moves the camera, and then rests.
//!
//! ```text
//! a way of 30 events a second (`camera_way`)  -> rest, which is held as any view is
//! event -> frames until the next is due    -> pictures; the last one of some of the events is written
//! after the rest: these against the references of their views -> relMSE, FLIP
//! ```
//!
//! As in a viewer, an event that is due ends the frame under way, unless that is the first after an event, and a frame
//! that has some tiles of a picture shows nothing.
//!
//! Invariants: 1. each event is applied and has a picture, so slow pictures make the way last longer; 2. nothing is
//! compared while the hand moves, and while a picture is written the clock stands still.

use super::camera_way::{WAY_EVENTS, event_of};
use super::errors::Snapshots;
use super::hold::{Hold, Log};
use super::options::StressFigure;
use super::scenario::Script;
use std::time::{Duration, Instant};
use trex_render::{Event, LiveSession, PagedTracer};
use trex_store::Result;

/// From event to event.
const EVENT_TIME: Duration = Duration::from_nanos(1_000_000_000 / 30);

impl Log {
    /// Moves the camera by all events of a way but the last, which begins the rest. Pictures of the way are written to
    /// `snapshots`.
    ///
    /// # Errors
    /// Those of [`LiveSession::apply`] and of writing pictures; an interrupt.
    pub(super) fn drag<T: PagedTracer + Send>(
        &mut self,
        session: &mut LiveSession<T>,
        script: &Script,
        hold: &Hold<'_>,
        snapshots: Option<&Snapshots>,
    ) -> Result<()> {
        let (begin, mut stopped) = (Instant::now(), Duration::ZERO);
        let mut view = 0;
        for index in 0..WAY_EVENTS - 1 {
            session.apply(Event::Camera(script.way(index)))?;
            let (applied, due) = (begin.elapsed() - stopped, EVENT_TIME * (index + 1));
            let is_written = index == event_of(view);
            let mut has_picture = false;
            while !has_picture || begin.elapsed() - stopped < due {
                hold.interrupt.check()?;
                let is_due = || has_picture && begin.elapsed() - stopped >= due;
                let frame = Instant::now();
                let report = session.frame(u32::MAX, &|| hold.interrupt.is_raised() || is_due());
                self.times[StressFigure::Frame as usize].add(frame.elapsed());
                self.add(&report);
                if !self.drags.add(&report) {
                    continue;
                }
                if !has_picture {
                    self.drags.picture_ms.add(begin.elapsed() - stopped - applied);
                }
                has_picture = true;
                if let Some(snapshots) = snapshots.filter(|_| is_written) {
                    let begun = Instant::now();
                    snapshots.write_on_way(view, session)?;
                    stopped += begun.elapsed();
                }
            }
            self.drags.events += 1;
            view += u32::from(is_written);
        }
        self.aside += stopped;
        self.drags.time += begin.elapsed() - stopped;
        Ok(())
    }
}
