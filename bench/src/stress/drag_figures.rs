//! What hands that moved were shown: sums over the drags of a run, and their figures.

use super::picture_error::PictureError;
use crate::median::median;
use serde::Serialize;
use std::time::Duration;
use trex_model::Times;
use trex_render::{FrameProgress, FrameReport};

/// The pictures of all drags of a run, before the hand rests.
#[derive(Debug, Serialize)]
pub struct DragFigures {
    /// Events.
    pub events: u64,
    /// Pictures shown.
    pub pictures: u64,
    /// Pictures a second.
    pub pictures_per_s: f64,
    /// Event to its first picture.
    pub picture_ms: Times,
    /// Share of the rays of these pictures from the camera that met the model; `null` where there were none.
    pub coverage: Option<f64>,
    /// relMSE of pictures against their own views; `null` without references.
    pub relmse: Option<ErrorSpread>,
    /// FLIP of the same, as they are shown.
    pub flip: Option<ErrorSpread>,
}

/// Errors of some pictures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ErrorSpread {
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
    /// Events.
    pub(super) events: u64,
    pictures: u64,
    pub(super) time: Duration,
    pub(super) picture_ms: Times,
    /// Rays from the camera: those that met the model, all.
    covered: [u64; 2],
    pub(super) errors: Vec<PictureError>,
}

impl ErrorSpread {
    /// Of some numbers; `None` for none.
    fn of(numbers: impl Iterator<Item = f64>) -> Option<ErrorSpread> {
        let mut sorted: Vec<f64> = numbers.collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        let p95 = sorted[((sorted.len() as f64 * 0.95).ceil() as usize - 1).min(last)];
        Some(ErrorSpread { count: sorted.len() as u64, median: median(&sorted), p95 })
    }
}

impl DragLog {
    /// True once a hand has moved.
    pub(super) fn has_moved(&self) -> bool {
        self.events > 0
    }

    /// Adds what a frame did. True when it has a picture to show.
    pub(super) fn add(&mut self, report: &FrameReport) -> bool {
        let [covered, rays] = &mut self.covered;
        *covered += report.preview_covered + report.pass.covered_samples;
        *rays += report.preview_samples + report.pass.samples;
        let is_whole =
            report.progress == FrameProgress::Preview || report.progress >= FrameProgress::Complete;
        let is_shown = is_whole && report.sample_step.is_some();
        self.pictures += u64::from(is_shown);
        is_shown
    }

    /// The figures; `None` where no hand moved.
    pub(super) fn figures(self) -> Option<DragFigures> {
        let DragLog { events, pictures, time, picture_ms, covered: [covered, rays], errors } = self;
        (pictures > 0).then(|| DragFigures {
            events,
            pictures,
            pictures_per_s: pictures as f64 / time.as_secs_f64(),
            picture_ms,
            coverage: (rays > 0).then(|| covered as f64 / rays as f64),
            relmse: ErrorSpread::of(errors.iter().map(|error| error.relmse)),
            flip: ErrorSpread::of(errors.iter().map(|error| error.flip)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_the_middle_and_what_one_in_twenty_passes() {
        let spread = ErrorSpread::of((1..=100).rev().map(f64::from)).unwrap();
        assert_eq!((spread.count, spread.median, spread.p95), (100, 50.5, 95.0));
        let one = ErrorSpread::of([7.0].into_iter()).unwrap();
        assert_eq!((one.median, one.p95), (7.0, 7.0));
        assert!(ErrorSpread::of(std::iter::empty()).is_none());
    }
}
