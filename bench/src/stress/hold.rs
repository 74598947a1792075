//! The hold of a view: frames from an event on, and when the picture was what.
//!
//! ```text
//! event -> frame -> rough? whole? response? complete? converged? -> frame -> ... until the picture is exact and all
//!                                                                                light is in, or was held long enough
//! ```
//!
//! Invariants: 1. a time counts from before the event is applied; 2. a time is that of the end of the frame that shows
//! it; 3. while a picture is copied for its error the clock stands still.

use super::drag_figures::DragLog;
use super::errors::{ERROR_TIMES_MS, Snapshots};
use super::options::StressFigure;
use super::references::ErrorFloor;
use serde::Serialize;
use std::time::{Duration, Instant};
use trex_model::Times;
use trex_render::{FrameProgress, FrameReport, LiveSession, PagedTracer, PassStats, RayCounts};
use trex_store::{Interrupt, Result};

/// A view without a response for so long is a livelock.
pub(super) const LIVELOCK: Duration = Duration::from_secs(10);
/// A view without a response for so long is a stall.
pub(super) const STALL: Duration = Duration::from_secs(1);
/// Pixels between samples of a picture that is rough, and of one that is whole.
const ROUGH_STEP: u32 = 4;
const WHOLE_STEP: u32 = 2;
/// When the share of changed light that is shown is noted.
const LIGHT_NOTED: Duration = Duration::from_millis(300);

/// One event, and when the picture was what after it, ms; `null` for what was not reached while the view was held.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Switch {
    /// Event to the first picture of the new state.
    pub first_ms: Option<f64>,
    /// Event to a lit C-ray at every fourth pixel.
    pub rough_ms: Option<f64>,
    /// Event to one at every second pixel.
    pub whole_ms: Option<f64>,
    /// Event to an exact fetch block.
    pub response_ms: Option<f64>,
    /// Event to an exact sample in every pixel.
    pub complete_ms: Option<f64>,
    /// Event to the same with all photons in; of events that change light.
    pub converged_ms: Option<f64>,
    /// Pixels between samples when the picture was whole.
    pub whole_step: Option<u32>,
    /// Share of the photons of changed light in the picture at 300 ms; of events that change light.
    pub light_share: Option<f64>,
    /// relMSE against the reference of the state at the times of `error_at_ms`, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_at: Option<[Option<f64>; ERROR_TIMES_MS.len()]>,
    /// FLIP of the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flip_at: Option<[Option<f64>; ERROR_TIMES_MS.len()]>,
}

/// The sums of a run.
#[derive(Default)]
pub(super) struct Log {
    pub(super) switches: Vec<Switch>,
    pub(super) drags: DragLog,
    pub(super) error_floor: Option<ErrorFloor>,
    pub(super) times: [Times; StressFigure::NAMED.len()],
    /// Events that changed light.
    pub(super) changes_of_light: u64,
    /// Time in which clocks stood still.
    pub(super) aside: Duration,
    pub(super) pass: PassStats,
    pub(super) other_rays: RayCounts,
    pub(super) block_share: f64,
    pub(super) block_tiles: u64,
    pub(super) holes: u64,
    pub(super) stalls: u64,
    pub(super) livelock: bool,
    pub(super) error_worst: f64,
}

/// How a view is held.
pub(super) struct Hold<'a> {
    /// The longest.
    pub(super) longest: Duration,
    /// The longest frame.
    pub(super) t_max: Duration,
    pub(super) interrupt: &'a Interrupt,
}

/// The time since an event, less that in which it was stopped.
struct Stopwatch {
    event: Instant,
    stopped: Duration,
}

impl Stopwatch {
    fn elapsed(&self) -> Duration {
        self.event.elapsed() - self.stopped
    }

    /// Does `work` while the clock stands still.
    fn stop<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let begin = Instant::now();
        let result = work();
        self.stopped += begin.elapsed();
        result
    }
}

impl Log {
    /// Frames of one view, from its event on; `snapshots` of its pictures where errors are asked for.
    pub(super) fn hold<T: PagedTracer + Send>(
        &mut self,
        session: &mut LiveSession<T>,
        event: Instant,
        hold: &Hold<'_>,
        mut snapshots: Option<&mut Snapshots>,
    ) -> Result<()> {
        let mut clock = Stopwatch { event, stopped: Duration::ZERO };
        let mut switch = Switch::default();
        let mut changes_light = false;
        loop {
            hold.interrupt.check()?;
            if let Some(snapshots) = &mut snapshots {
                let now = clock.elapsed();
                clock.stop(|| snapshots.before_frame(session, now, hold.t_max));
            }
            let begin = Instant::now();
            let report = session.frame(u32::MAX, &|| hold.interrupt.is_raised());
            self.times[StressFigure::Frame as usize].add(begin.elapsed());
            let time = clock.elapsed();
            if let Some(snapshots) = &mut snapshots {
                clock.stop(|| snapshots.after_frame(time))?;
            }
            changes_light |= report.light_share < 1.0;
            self.add(&report);
            self.note(&mut switch, &report, time);
            if changes_light && time >= LIGHT_NOTED {
                switch.light_share.get_or_insert(report.light_share);
            }
            let is_complete = report.progress >= FrameProgress::Complete;
            let is_converged = is_complete && report.light_share == 1.0 && session.film().samples() > 0;
            if is_converged && changes_light {
                switch.light_share.get_or_insert(1.0);
                self.reached(StressFigure::Converged, &mut switch.converged_ms, time);
            }
            self.livelock |= switch.response_ms.is_none() && time > LIVELOCK;
            let is_over = match switch.response_ms {
                None => time > LIVELOCK,
                Some(_) => time >= hold.longest,
            };
            let is_compared = snapshots.as_ref().is_none_or(|snapshots| snapshots.are_taken());
            if is_over || is_complete && is_compared && (is_converged || !changes_light) {
                self.changes_of_light += u64::from(changes_light);
                self.switches.push(switch);
                self.aside += clock.stopped;
                return Ok(());
            }
        }
    }

    /// Compares the pictures of the last hold, and of a way to it, shown with `exposure`, with the references of
    /// `state` and of the way.
    ///
    /// # Errors
    /// Those of reading both.
    pub(super) fn compare(&mut self, snapshots: &mut Snapshots, state: u32, exposure: f32) -> Result<()> {
        let begin = Instant::now();
        let errors = snapshots.errors(state, exposure)?;
        let held = self.switches.last_mut().expect("a switch was held");
        held.error_at = Some(errors.map(|error| Some(error?.relmse)));
        held.flip_at = Some(errors.map(|error| Some(error?.flip)));
        if self.drags.has_moved() {
            self.drags.errors.extend(snapshots.errors_of_way(exposure)?);
        }
        if self.error_floor.is_none() {
            self.error_floor = snapshots.floor(exposure)?;
        }
        self.aside += begin.elapsed();
        Ok(())
    }

    /// Notes what the picture of a frame that ended `time` after the event is for the first time.
    fn note(&mut self, switch: &mut Switch, report: &FrameReport, time: Duration) {
        let is_finer = |step: u32| report.sample_step.is_some_and(|shown| shown <= step);
        if report.sample_step.is_some() {
            self.reached(StressFigure::First, &mut switch.first_ms, time);
        }
        if is_finer(ROUGH_STEP) {
            self.reached(StressFigure::Rough, &mut switch.rough_ms, time);
        }
        if is_finer(WHOLE_STEP) && self.reached(StressFigure::Whole, &mut switch.whole_ms, time) {
            switch.whole_step = report.sample_step;
        }
        if report.progress >= FrameProgress::Block
            && self.reached(StressFigure::Response, &mut switch.response_ms, time)
        {
            self.block_tiles += u64::from(report.block_tiles);
            self.block_share += report.block_share;
            self.stalls += u64::from(time > STALL);
        }
        if report.progress >= FrameProgress::Complete
            && self.reached(StressFigure::Complete, &mut switch.complete_ms, time)
        {}
    }

    /// Sets a time that has no value yet: true when it did.
    fn reached(&mut self, figure: StressFigure, place: &mut Option<f64>, time: Duration) -> bool {
        let is_new = place.is_none();
        if is_new {
            *place = Some((time.as_secs_f64() * 1e6).round() / 1e3);
            self.times[figure as usize].add(time);
        }
        is_new
    }

    /// Adds what a frame did.
    pub(super) fn add(&mut self, report: &FrameReport) {
        self.pass.add(&report.pass);
        self.other_rays.add(&report.preview_rays);
        self.other_rays.photon += report.photon_rays;
        self.holes += u64::from(report.hole_tiles);
        self.error_worst = self.error_worst.max(report.lod_error);
    }
}
