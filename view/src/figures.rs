//! `Figures`: when the picture was what after the last event, and rays a second.
//!
//! Invariant: times count from when the event reached the mailbox.

use crate::state::{PixelError, RaysText, Times};
use std::time::{Duration, Instant};
use trex_render::{FrameProgress, FrameReport, RayCounts};

/// Pixels between samples of a picture that counts as whole.
const WHOLE_STEP: u32 = 4;
/// Statistics go at most so often.
const STATS_EVERY: Duration = Duration::from_millis(250);

/// See the module's description.
#[derive(Debug)]
pub(crate) struct Figures {
    event_at: Instant,
    pub(crate) times: Times,
    pub(crate) light_share: f64,
    pub(crate) error: PixelError,
    pub(crate) progress: FrameProgress,
    rays: RayCounts,
    far: u64,
    told_at: Instant,
    /// Events that were applied.
    pub(crate) events: u64,
}

impl Figures {
    /// None yet.
    pub(crate) fn new() -> Figures {
        let now = Instant::now();
        Figures {
            event_at: now,
            times: Times::default(),
            light_share: 1.0,
            error: PixelError::default(),
            progress: FrameProgress::Preview,
            rays: RayCounts::default(),
            far: 0,
            told_at: now,
            events: 0,
        }
    }

    /// An event that came at `since` begins another picture.
    pub(crate) fn event(&mut self, since: Option<Instant>) {
        (self.event_at, self.times) = (since.unwrap_or_else(Instant::now), Times::default());
        self.events += 1;
    }

    /// Learns of a frame.
    pub(crate) fn learn(&mut self, report: &FrameReport, asked: f64) {
        let now_ms = self.event_at.elapsed().as_secs_f64() * 1e3;
        let note = |time: &mut Option<f64>, is_there: bool| {
            if is_there {
                time.get_or_insert(now_ms);
            }
        };
        let Times { first, whole, response, complete } = &mut self.times;
        note(first, report.sample_step.is_some());
        note(whole, report.sample_step.is_some_and(|step| step <= WHOLE_STEP));
        note(response, report.progress >= FrameProgress::Block);
        note(complete, report.progress >= FrameProgress::Complete);
        (self.light_share, self.progress) = (report.light_share, report.progress);
        self.error = PixelError { asked, in_force: report.lod_error };
        self.rays.add(&report.pass.rays);
        self.rays.add(&report.preview_rays);
        self.rays.photon += report.photon_rays;
        self.far += report.pass.g_stage.far;
    }

    /// True when it is time for statistics.
    pub(crate) fn is_due(&self) -> bool {
        self.told_at.elapsed() >= STATS_EVERY
    }

    /// Rays a second since the last time.
    pub(crate) fn rays_per_s(&mut self) -> RaysText {
        let seconds = self.told_at.elapsed().as_secs_f64().max(1e-3);
        let (rays, far) = (std::mem::take(&mut self.rays), std::mem::take(&mut self.far));
        self.told_at = Instant::now();
        RaysText::new(&rays, far, seconds)
    }
}
