//! The figures of a run, and what it fails by.

use super::drag_figures::DragFigures;
use super::errors::ERROR_TIMES_MS;
use super::hold::{LIVELOCK, Log, Switch};
use super::options::{Requirement, Scenario, StressFigure, StressOptions};
use super::references::ErrorFloor;
use crate::median::median;
use serde::Serialize;
use std::collections::BTreeMap;
use trex_model::{RayRates, Times};
use trex_render::{GStats, RayCounts};
use trex_store::pool::PoolStats;

/// Share of a run that warms up before memory is watched.
const WARM_UP: f64 = 0.2;
/// Growth of memory over a run that is noise: what allocators keep.
const GROWTH_BYTES: f64 = 2.0 * (1 << 20) as f64;

/// What a run came to.
#[derive(Debug, Serialize)]
pub struct StressFigures {
    /// The scenario's name.
    pub scenario: &'static str,
    /// Events.
    pub switches: u64,
    /// Event to the first picture of the new state.
    pub first_picture_ms: Times,
    /// Event to a lit C-ray at every fourth pixel, and no pixel of an older state.
    pub rough_ms: Times,
    /// Event to one at every second pixel.
    pub whole_ms: Times,
    /// Events whose picture was whole, by pixels between its samples then.
    pub whole_steps: BTreeMap<u32, u64>,
    /// Event to an exact fetch block.
    pub response_ms: Times,
    /// Share of the picture that a fetch block is.
    pub response_share: f64,
    /// Tiles of the fetch block, on average over responses.
    pub block_tiles: f64,
    /// Event to an exact sample in every pixel, of the views that were held so long.
    pub complete_ms: Times,
    /// Event to the same with all photons in, of events that change light.
    pub converged_ms: Times,
    /// Share of the photons of changed light in the picture at 300 ms, on average; `null` where none has changed.
    pub light_share_at_300: Option<f64>,
    /// relMSE and FLIP against references at times after the event, ms; `null` where none was asked for.
    pub error_at_ms: Option<BTreeMap<u64, ErrorAt>>,
    /// Two references of a state against each other; `null` where none was asked for.
    pub error_floor: Option<ErrorFloor>,
    /// Pictures of a hand that moves; `null` for scenarios without.
    pub drag: Option<DragFigures>,
    /// Those of a flight.
    pub fly: Option<DragFigures>,
    /// Frames.
    pub frame_ms: Times,
    /// Rays by kind.
    pub rays: RayCounts,
    /// The same a second, over the whole run.
    pub rays_per_s: RayRates,
    /// The G-stage, of samples on the film.
    pub g_stage: GStats,
    /// Look-ups of the photons nearest to a place, a second; of `full-gi`.
    pub look_ups_per_s: f64,
    /// Length of the run.
    pub time_ms: u64,
    /// Share of the samples whose ray from the camera met the model: how much of the pictures it fills; `null` where
    /// no sample was taken.
    pub coverage: Option<f64>,
    /// Tiles that showed nothing in a picture.
    pub holes: u64,
    /// Views without a response for a second.
    pub stalls: u64,
    /// Whether a view had none for ten.
    pub livelock: bool,
    /// Samples that had to be taken alone.
    pub narrow_samples: u64,
    /// Pages read again, of all read.
    pub refault_ratio: f64,
    /// Pages demanded that were not there, a switch.
    pub first_touch_misses: f64,
    /// Bytes from the disk.
    pub bytes_read: u64,
    /// Error of the footprint rule.
    pub pixel_error: PixelError,
    /// Growth of memory after the warm-up, bytes a switch.
    pub memory_slope_bytes: Option<f64>,
    /// The pool's counters over the run.
    pub pool: PoolStats,
    /// What the times must not pass.
    pub requirements: Vec<Requirement>,
    /// What failed; empty for a run that passed.
    pub failures: Vec<String>,
    /// A line per event.
    pub per_switch: Vec<Switch>,
}

/// relMSE of the pictures at one time after their events.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ErrorAt {
    /// Pictures.
    pub count: u64,
    /// Of the middle one.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// The greatest.
    pub max: f64,
    /// FLIP of the same pictures, as they are shown.
    pub flip: FlipAt,
}

/// FLIP of the pictures at one time after their events, 0 to 1.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FlipAt {
    /// Of the middle one.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// The greatest.
    pub max: f64,
}

/// Error of the footprint rule, pixels.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PixelError {
    /// What was asked for.
    pub asked: f64,
    /// The most that any frame was made with.
    pub worst: f64,
}

/// A run, as seen from outside.
pub(super) struct Run {
    pub(super) before: PoolStats,
    pub(super) after: PoolStats,
    pub(super) seconds: f64,
    pub(super) asked: f64,
    /// Switch, bytes.
    pub(super) memory: Vec<(f64, f64)>,
}

impl StressFigures {
    pub(super) fn new(log: Log, options: &StressOptions, run: Run) -> StressFigures {
        let Run { before, after, seconds, asked, memory } = run;
        let mut rays = log.pass.rays;
        rays.add(&log.other_rays);
        let share = |part: u64, all: u64| part as f64 / all.max(1) as f64;
        let read = after.pages_read - before.pages_read;
        let slope = (options.scenario == Scenario::Soak).then(|| slope(&memory)).flatten();
        let [first_picture_ms, rough_ms, whole_ms, response_ms, complete_ms, converged_ms, frame_ms] =
            log.times;
        let responses = response_ms.count();
        let mut whole_steps = BTreeMap::new();
        log.switches
            .iter()
            .filter_map(|switch| switch.whole_step)
            .for_each(|step| *whole_steps.entry(step).or_default() += 1);
        let light: Vec<f64> = log.switches.iter().filter_map(|switch| switch.light_share).collect();
        let switches = log.switches.len() as u64;
        let is_flight = options.scenario == Scenario::Fly;
        let (drag, fly) = match log.drags.figures() {
            figures if is_flight => (None, figures),
            figures => (figures, None),
        };
        let mut figures = StressFigures {
            scenario: options.scenario.name(),
            switches,
            first_picture_ms,
            rough_ms,
            whole_ms,
            whole_steps,
            response_ms,
            response_share: log.block_share / responses.max(1) as f64,
            block_tiles: share(log.block_tiles, responses),
            complete_ms,
            converged_ms,
            light_share_at_300: (!light.is_empty()).then(|| light.iter().sum::<f64>() / light.len() as f64),
            error_at_ms: errors_at(&log.switches),
            error_floor: log.error_floor,
            drag,
            fly,
            frame_ms,
            rays,
            rays_per_s: RayRates::new(&rays, seconds, seconds),
            g_stage: log.pass.g_stage,
            look_ups_per_s: log.pass.look_ups as f64 / seconds,
            time_ms: (seconds * 1e3) as u64,
            coverage: (log.pass.samples > 0).then(|| share(log.pass.covered_samples, log.pass.samples)),
            holes: log.holes,
            stalls: log.stalls,
            livelock: log.livelock,
            narrow_samples: log.pass.narrow_samples,
            refault_ratio: share(after.refaults - before.refaults, read),
            first_touch_misses: share(read, switches),
            bytes_read: after.bytes_read - before.bytes_read,
            pixel_error: PixelError { asked, worst: log.error_worst },
            memory_slope_bytes: slope,
            pool: after,
            requirements: options.requirements.clone(),
            failures: vec![],
            per_switch: log.switches,
        };
        figures.failures = figures.find_failures(log.changes_of_light);
        figures
    }

    /// The time that is called so.
    pub fn times(&self, figure: StressFigure) -> &Times {
        match figure {
            StressFigure::First => &self.first_picture_ms,
            StressFigure::Rough => &self.rough_ms,
            StressFigure::Whole => &self.whole_ms,
            StressFigure::Response => &self.response_ms,
            StressFigure::Complete => &self.complete_ms,
            StressFigure::Converged => &self.converged_ms,
            StressFigure::Frame => &self.frame_ms,
        }
    }

    /// What the run fails by.
    fn find_failures(&self, changes_of_light: u64) -> Vec<String> {
        let mut failures = vec![];
        let mut fail = |fails: bool, text: String| failures.extend(fails.then_some(text));
        fail(self.livelock, format!("a view had no response for {} s", LIVELOCK.as_secs()));
        fail(self.holes > 0, format!("{} tiles showed nothing", self.holes));
        fail(self.stalls > 0, format!("{} views had no response for a second", self.stalls));
        if let Some(slope) = self.memory_slope_bytes {
            let growth = slope * self.switches as f64;
            fail(growth > GROWTH_BYTES, format!("memory grew by {growth:.0} bytes over the run"));
        }
        for Requirement { figure, percentile, ms: limit } in &self.requirements {
            let times = self.times(*figure);
            let (ms, name) = (times.percentile(*percentile), figure.name());
            let of = match figure {
                StressFigure::Frame => times.count(),
                StressFigure::Converged => changes_of_light,
                _ => self.switches,
            };
            let (came, wanted) = (times.count() as f64, of as f64 * percentile / 100.0);
            let few =
                format!("{name}: {} of {of} views came to it, {percentile} % are required", times.count());
            fail(came < wanted.max(1.0), few);
            let over = format!("{name}: {percentile} % within {ms:.1} ms, over the {limit} ms allowed");
            fail(ms > *limit, over);
        }
        failures
    }
}

/// The errors of all events by time, where there are any.
fn errors_at(switches: &[Switch]) -> Option<BTreeMap<u64, ErrorAt>> {
    switches.iter().any(|switch| switch.error_at.is_some()).then(|| {
        let at = |(index, &ms): (usize, &u64)| {
            let errors: Vec<f64> = switches.iter().filter_map(|switch| switch.error_at?[index]).collect();
            let flips: Vec<f64> = switches.iter().filter_map(|switch| switch.flip_at?[index]).collect();
            let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
            let most = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
            (!errors.is_empty()).then(|| {
                let flip = FlipAt { median: median(&flips), mean: mean(&flips), max: most(&flips) };
                let [median, mean, max] = [median(&errors), mean(&errors), most(&errors)];
                (ms, ErrorAt { count: errors.len() as u64, median, mean, max, flip })
            })
        };
        ERROR_TIMES_MS.iter().enumerate().filter_map(at).collect()
    })
}

/// Slope of a line through the points after the warm-up, by least squares; `None` for too few.
fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let points = &points[(points.len() as f64 * WARM_UP) as usize..];
    let count = points.len() as f64;
    if count < 10.0 {
        return None;
    }
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let both: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let square: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    Some(both / square)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_that_of_the_line_behind_the_noise() {
        let points: Vec<_> =
            (0..100).map(|i| (f64::from(i), 7.0 * f64::from(i) + f64::from(i % 2))).collect();
        assert!((slope(&points).unwrap() - 7.0).abs() < 0.01);
        assert_eq!(slope(&points[..5]), None);
        // What comes before the warm-up does not count.
        let mut jump = vec![(0.0, 0.0); 1];
        jump.extend((1..100).map(|i| (f64::from(i), 1e9)));
        assert!(slope(&jump).unwrap().abs() < 1e-6);
    }
}
