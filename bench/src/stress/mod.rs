//! Stress: viewpoints, lights and limits that change faster than a model of this size likes, and a verdict.
//!
//! ```text
//! scenario -> steps -> apply -> frames until the response, and on until the view is complete or was held long enough
//!                                 '-- times, holes, stalls, pages -> figures -> verdict
//! ```
//!
//! What is known to fail elsewhere is what is looked for: livelock at the cap, endless requests, loads for views that
//! are gone, all loaded again on turning back, memory that grows. Paper, section 6.2, "Limited main memory".
//!
//! Invariant: a figure of time counts from before the event is applied.

mod options;
mod scenario;
mod times;

pub use options::{Limits, Scenario, StressOptions};
pub use times::Times;

use scenario::{Script, Step};
use serde::Serialize;
use std::time::{Duration, Instant};
use trex_render::{FrameProgress, FrameReport, LiveSession, PagedTracer, PassStats, RayCounts, RayRates};
use trex_store::pool::{PagePool, PoolStats};
use trex_store::{Interrupt, Result};

/// A view without a response for so long is a livelock.
const LIVELOCK: Duration = Duration::from_secs(10);
/// A view without a response for so long is a stall.
const STALL: Duration = Duration::from_secs(1);
/// Share of a run that warms up before memory is watched.
const WARM_UP: f64 = 0.2;
/// Growth of memory over a run that is noise: what allocators keep.
const GROWTH_BYTES: f64 = 2.0 * (1 << 20) as f64;

/// The surroundings of a run.
pub struct Stand<'a> {
    /// The pool that the session's tracers read.
    pub pool: &'a PagePool,
    /// Bytes that the process holds now, where the system tells.
    pub resident_bytes: &'a dyn Fn() -> Option<u64>,
    /// Ends the run.
    pub interrupt: &'a Interrupt,
    /// Hears how many switches are done.
    pub tell: &'a dyn Fn(u64),
}

/// What a run came to.
#[derive(Debug, Serialize)]
pub struct StressFigures {
    /// The scenario's name.
    pub scenario: &'static str,
    /// Events.
    pub switches: u64,
    /// Event to the first picture of any kind.
    pub first_picture_ms: Times,
    /// Event to the first whole fetch block.
    pub response_ms: Times,
    /// Event to the first picture with a sample in every pixel, of the views that were held so long.
    pub complete_ms: Times,
    /// Frames.
    pub frame_ms: Times,
    /// Rays by kind.
    pub rays: RayCounts,
    /// The same a second, over the whole run.
    pub rays_per_s: RayRates,
    /// Look-ups of the photons nearest to a place, a second; of `full-gi`.
    pub look_ups_per_s: f64,
    /// Length of the run.
    pub time_ms: u64,
    /// Tiles of the fetch block, on average over responses.
    pub block_tiles: f64,
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
    /// Guessed pages that were evicted without use, of all guessed.
    pub prefetch_wasted_share: f64,
    /// Bytes from the disk.
    pub bytes_read: u64,
    /// Error of the footprint rule: asked, and the worst in force.
    pub pixel_error: PixelError,
    /// Growth of memory after the warm-up, bytes a switch.
    pub memory_slope_bytes: Option<f64>,
    /// The pool's counters over the run.
    pub pool: PoolStats,
    /// What failed; empty for a run that passed.
    pub failures: Vec<String>,
}

/// Pixels.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PixelError {
    /// What was asked for.
    pub asked: f64,
    /// The most that the governor went to.
    pub worst: f64,
}

/// What is gathered while a run goes on.
#[derive(Default)]
struct Log {
    first: Times,
    response: Times,
    complete: Times,
    frame: Times,
    pass: PassStats,
    photon_rays: u64,
    block_tiles: u64,
    holes: u64,
    stalls: u64,
    livelock: bool,
    error_worst: f64,
    /// Switch, bytes.
    memory: Vec<(f64, f64)>,
}

/// Runs a scenario on a session that is live.
///
/// # Errors
/// Those of [`LiveSession::apply`] and [`PagePool::set_limit`]; an interrupt.
pub fn run<T: PagedTracer + Send>(
    session: &mut LiveSession<T>,
    options: &StressOptions,
    stand: &Stand<'_>,
) -> Result<StressFigures> {
    let script = Script::new(session, options, stand.pool.frames().frames as u64);
    let mut log = Log::default();
    let asked = session.view().settings.lod_error;
    let before = stand.pool.stats();
    let begin = Instant::now();
    for switch in 0..options.switches {
        stand.interrupt.check()?;
        let event = Instant::now();
        for step in script.steps(switch) {
            match step {
                Step::Event(event) => session.apply(*event)?,
                Step::FrameBytes(bytes) => drop(stand.pool.set_limit(bytes)?),
            }
        }
        log.hold(session, event, options.hold, stand.interrupt)?;
        if let Some(bytes) = (stand.resident_bytes)() {
            log.memory.push((f64::from(switch), bytes as f64));
        }
        (stand.tell)(u64::from(switch) + 1);
    }
    let seconds = begin.elapsed().as_secs_f64();
    if let Some(bytes) = script.frame_bytes_at_rest() {
        stand.pool.set_limit(bytes)?;
    }
    Ok(log.figures(options, asked, (&before, &stand.pool.stats()), seconds))
}

impl Log {
    /// Frames of one view.
    fn hold<T: PagedTracer + Send>(
        &mut self,
        session: &mut LiveSession<T>,
        event: Instant,
        hold: Duration,
        interrupt: &Interrupt,
    ) -> Result<()> {
        let (mut has_first, mut has_response) = (false, false);
        loop {
            interrupt.check()?;
            let begin = Instant::now();
            let report = session.frame(u32::MAX, &|| interrupt.is_raised());
            self.frame.add(begin.elapsed());
            self.add(&report);
            let time = event.elapsed();
            if !std::mem::replace(&mut has_first, true) {
                self.first.add(time);
            }
            if report.progress >= FrameProgress::Block && !std::mem::replace(&mut has_response, true) {
                self.response.add(time);
                self.block_tiles += u64::from(report.block_tiles);
                self.stalls += u64::from(time > STALL);
            }
            if report.progress >= FrameProgress::Complete {
                self.complete.add(time);
                return Ok(());
            }
            if !has_response && time > LIVELOCK {
                self.livelock = true;
                return Ok(());
            }
            if has_response && time >= hold {
                return Ok(());
            }
        }
    }

    fn add(&mut self, report: &FrameReport) {
        self.pass.add(&report.pass);
        self.photon_rays += report.photon_rays;
        self.holes += u64::from(report.hole_tiles);
        self.error_worst = self.error_worst.max(report.lod_error);
    }

    fn figures(
        self,
        options: &StressOptions,
        asked: f64,
        (before, after): (&PoolStats, &PoolStats),
        seconds: f64,
    ) -> StressFigures {
        let rays = RayCounts { photon: self.photon_rays, ..self.pass.rays };
        let share = |part: u64, all: u64| part as f64 / all.max(1) as f64;
        let read = after.pages_read - before.pages_read;
        let slope = (options.scenario == Scenario::Soak).then(|| slope(&self.memory)).flatten();
        let mut figures = StressFigures {
            scenario: options.scenario.name(),
            switches: self.first.count(),
            rays,
            rays_per_s: rays.per_s(seconds),
            look_ups_per_s: self.pass.look_ups as f64 / seconds,
            time_ms: (seconds * 1e3) as u64,
            block_tiles: share(self.block_tiles, self.response.count()),
            holes: self.holes,
            stalls: self.stalls,
            livelock: self.livelock,
            narrow_samples: self.pass.narrow_samples,
            refault_ratio: share(after.refaults - before.refaults, read),
            first_touch_misses: share(after.demand_reads - before.demand_reads, self.first.count()),
            prefetch_wasted_share: share(
                after.prefetch_wasted - before.prefetch_wasted,
                after.prefetch_issued - before.prefetch_issued,
            ),
            bytes_read: after.bytes_read - before.bytes_read,
            pixel_error: PixelError { asked, worst: self.error_worst },
            memory_slope_bytes: slope,
            pool: *after,
            failures: vec![],
            first_picture_ms: self.first,
            response_ms: self.response,
            complete_ms: self.complete,
            frame_ms: self.frame,
        };
        figures.failures = failures(&figures, options);
        figures
    }
}

/// What a run fails by.
fn failures(figures: &StressFigures, options: &StressOptions) -> Vec<String> {
    let mut failures = vec![];
    let mut fail = |fails: bool, text: String| failures.extend(fails.then_some(text));
    fail(figures.livelock, format!("a view had no response for {} s", LIVELOCK.as_secs()));
    fail(figures.holes > 0, format!("{} tiles showed nothing", figures.holes));
    fail(figures.stalls > 0, format!("{} views had no response for a second", figures.stalls));
    if let Some(slope) = figures.memory_slope_bytes {
        let growth = slope * f64::from(options.switches);
        fail(growth > GROWTH_BYTES, format!("memory grew by {growth:.0} bytes over the run"));
    }
    if let Some(limits) = options.limits {
        let Limits { p50_ms, p99_ms, frame_max_ms } = limits;
        let response = &figures.response_ms;
        let mut late = |what: &str, ms: f64, limit: f64| {
            fail(ms > limit, format!("{what} {ms:.1} ms, over the {limit} ms allowed"));
        };
        late("median response", response.percentile(50.0), p50_ms);
        late("99th percentile of the response", response.percentile(99.0), p99_ms);
        late("longest frame", figures.frame_ms.max(), frame_max_ms);
    }
    failures
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
