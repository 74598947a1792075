//! Progress on stderr: a bar, plain lines, JSON lines, or nothing.
//!
//! ```text
//! library -> Progress -> Console::show -> Tracker (phase, rate, ETA) -> bar | line | json | -
//! notes, logs ---------> Console::note ------------------------------^ (the bar steps aside)
//! ```
//!
//! Invariants: 1. stdout is never touched; 2. 100 % is shown only by [`Console::finish`], which a verb calls
//! after its output is published; 3. plain and JSON lines come at most every [`LINE_INTERVAL`], and at every
//! change of phase.

use crate::size;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::{self, IsTerminal, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use trex_store::Progress;
use trex_store::printable::lines;

/// Least time between two lines of one phase.
const LINE_INTERVAL: Duration = Duration::from_secs(2);
/// Redraws of the bar per second.
const BAR_HZ: u8 = 8;
/// Length of the bar, steps: a percent each.
const BAR_STEPS: u64 = 100;
/// A rate is told once it has been measured for so long.
const RATE_AFTER: Duration = Duration::from_millis(500);

/// `--progress`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// A bar on a terminal, plain lines elsewhere
    Auto,
    /// A bar that is redrawn
    Bar,
    /// A line now and then
    Plain,
    /// JSON lines
    Json,
    /// Nothing
    None,
}

/// Stderr, shared by progress, notes and logs. Clones write to the same place.
#[derive(Clone, Debug)]
pub struct Console(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    mode: Mode,
    quiet: bool,
    bar: Option<ProgressBar>,
    tracker: Option<Tracker>,
    started: Instant,
}

impl Console {
    /// A console in `mode`; `quiet` drops notes and progress.
    pub fn new(mode: Mode, quiet: bool) -> Console {
        let mode = match mode {
            _ if quiet => Mode::None,
            Mode::Auto if io::stderr().is_terminal() => Mode::Bar,
            Mode::Auto => Mode::Plain,
            chosen => chosen,
        };
        Console(Arc::new(Mutex::new(State {
            mode,
            quiet,
            bar: None,
            tracker: None,
            started: Instant::now(),
        })))
    }

    /// What is under way, in a line, and its share in percent; also in mode [`Mode::None`]. Nothing before the first
    /// report and after the end.
    pub fn under_way(&self) -> Option<(String, Option<u64>)> {
        let state = self.lock();
        state.tracker.as_ref().map(|tracker| (tracker.line(Instant::now()), tracker.percent()))
    }

    /// Takes one report of a library.
    pub fn show(&self, progress: Progress) {
        self.lock().show(progress, Instant::now());
    }

    /// Shows 100 %: the work is done and published. Does nothing when no progress was shown.
    pub fn finish(&self) {
        self.lock().finish(Instant::now());
    }

    /// Ends progress without 100 %: the work failed or was interrupted.
    pub fn abandon(&self) {
        let mut state = self.lock();
        state.tracker = None;
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
    }

    /// A note for people, unless `--quiet`.
    pub fn note(&self, text: &str) {
        let state = self.lock();
        if !state.quiet {
            state.line(text);
        }
    }

    /// Text that is printed even with `--quiet`: errors.
    pub fn error(&self, text: &str) {
        self.lock().line(text);
    }

    /// A panic while drawing must not hide the message of that panic.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn show(&mut self, progress: Progress, now: Instant) {
        let same_phase = self.tracker.as_ref().is_some_and(|tracker| tracker.last.phase == progress.phase);
        if !same_phase {
            self.close_phase(now);
            self.tracker = Some(Tracker::new(progress, now));
        }
        let Some(tracker) = &mut self.tracker else { return };
        tracker.last = progress;
        let due = !same_phase || now.duration_since(tracker.told) >= LINE_INTERVAL;
        if due {
            tracker.told = now;
        }
        match self.mode {
            Mode::Bar => self.draw(now),
            Mode::Plain if due => self.line(&self.text(now)),
            Mode::Json if due => self.line(&self.json(now, false)),
            _ => {}
        }
    }

    fn finish(&mut self, now: Instant) {
        if self.tracker.is_none() {
            return;
        }
        match self.mode {
            Mode::Json => self.line(&self.json(now, true)),
            _ => self.close_phase(now),
        }
        self.tracker = None;
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        if matches!(self.mode, Mode::Bar | Mode::Plain) {
            self.line(&format!("100 %  done in {}", size::duration(now.duration_since(self.started))));
        }
    }

    /// Leaves one line behind for a phase that took a noticeable time.
    fn close_phase(&self, now: Instant) {
        if let (Mode::Bar | Mode::Plain, Some(tracker)) = (self.mode, &self.tracker)
            && now.duration_since(tracker.began) >= RATE_AFTER
        {
            self.line(&tracker.summary(now));
        }
    }

    fn draw(&mut self, now: Instant) {
        let text = self.text(now);
        let percent = self.tracker.as_ref().and_then(Tracker::percent);
        let bar = self.bar.get_or_insert_with(new_bar);
        bar.set_position(percent.unwrap_or(0));
        bar.set_message(text);
    }

    fn text(&self, now: Instant) -> String {
        self.tracker.as_ref().map(|tracker| tracker.line(now)).unwrap_or_default()
    }

    fn json(&self, now: Instant, finished: bool) -> String {
        let record = self.tracker.as_ref().map(|tracker| tracker.record(now, finished));
        serde_json::to_string(&record).expect("a record is a plain map")
    }

    /// Writes a line to stderr; a bar is lifted off and put back. Stderr that is gone is nobody's error.
    fn line(&self, text: &str) {
        let write = || {
            let _ = writeln!(io::stderr().lock(), "{}", lines(text.trim_end()));
        };
        match &self.bar {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
}

fn new_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("[{bar:24}] {msg}")
        .expect("the template is valid")
        .progress_chars("=> ");
    ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr_with_hz(BAR_HZ))
        .with_style(style)
}

/// One phase under way: what was reported last, and since when.
#[derive(Debug)]
struct Tracker {
    began: Instant,
    began_done: u64,
    told: Instant,
    last: Progress,
}

/// One line of `--progress json`.
#[derive(Serialize)]
struct Record {
    schema: &'static str,
    phase: &'static str,
    done: u64,
    total: Option<u64>,
    unit: &'static str,
    per_s: Option<f64>,
    eta_s: Option<f64>,
    memory_bytes: u64,
    finished: bool,
}

impl Tracker {
    fn new(first: Progress, now: Instant) -> Tracker {
        Tracker { began: now, began_done: first.done, told: now, last: first }
    }

    /// Units per second since the phase began; `None` until that can be said.
    fn rate(&self, now: Instant) -> Option<f64> {
        let elapsed = now.duration_since(self.began);
        let done = self.last.done.saturating_sub(self.began_done);
        (elapsed >= RATE_AFTER && done > 0).then(|| done as f64 / elapsed.as_secs_f64())
    }

    /// Time left in this phase at the rate so far.
    fn eta(&self, now: Instant) -> Option<Duration> {
        let left = self.last.total.checked_sub(self.last.done).filter(|_| self.last.total > 0)?;
        Duration::try_from_secs_f64(left as f64 / self.rate(now)?).ok()
    }

    /// Share of the phase, at most 99: the last percent is `finish`'s.
    fn percent(&self) -> Option<u64> {
        let Progress { done, total, .. } = self.last;
        (total > 0).then(|| (u128::from(done) * 100 / u128::from(total)).min(99) as u64)
    }

    /// `clusters  42 %  8.40M of 20.0M triangles  1.20M triangles/s  ETA 9.67 s  memory 300 MiB`
    fn line(&self, now: Instant) -> String {
        let Progress { phase, done, total, unit, memory_bytes } = self.last;
        let mut parts = vec![format!("{phase:<10}")];
        parts.extend(self.percent().map(|percent| format!("{percent:>2} %")));
        parts.push(match total {
            0 => amount(done, unit),
            _ if unit == "bytes" => format!("{} of {}", size::bytes(done), size::bytes(total)),
            _ => format!("{} of {}", size::count(done), amount(total, unit)),
        });
        parts.extend(self.rate(now).map(|rate| size::rate(rate, unit)));
        parts.extend(self.eta(now).map(|eta| format!("ETA {}", size::duration(eta))));
        parts.push(format!("memory {}", size::bytes(memory_bytes)));
        parts.join("  ")
    }

    /// `clusters    done in 16.7 s  20.0M triangles  1.20M triangles/s`
    fn summary(&self, now: Instant) -> String {
        let Progress { phase, done, unit, .. } = self.last;
        let took = size::duration(now.duration_since(self.began));
        let mut parts = vec![format!("{phase:<10}"), format!("done in {took}"), amount(done, unit)];
        parts.extend(self.rate(now).map(|rate| size::rate(rate, unit)));
        parts.join("  ")
    }

    fn record(&self, now: Instant, finished: bool) -> Record {
        let Progress { phase, done, total, unit, memory_bytes } = self.last;
        Record {
            schema: "trex.progress/1",
            phase,
            done,
            total: (total > 0).then_some(total),
            unit,
            per_s: self.rate(now),
            eta_s: self.eta(now).map(|eta| eta.as_secs_f64()),
            memory_bytes,
            finished,
        }
    }
}

/// `5.00M triangles`, `64.0 MiB`.
fn amount(value: u64, unit: &str) -> String {
    if unit == "bytes" { size::bytes(value) } else { format!("{} {unit}", size::count(value)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(done: u64, total: u64) -> Progress {
        Progress { phase: "clusters", done, total, unit: "triangles", memory_bytes: 300 << 20 }
    }

    fn tracked(done: u64, total: u64) -> (Tracker, Instant) {
        let mut tracker = Tracker::new(at(0, total), Instant::now());
        tracker.last = at(done, total);
        let now = tracker.began + Duration::from_secs(10);
        (tracker, now)
    }

    #[test]
    fn a_line_tells_share_rate_time_left_and_memory() {
        let (tracker, now) = tracked(8_400_000, 20_000_000);
        assert_eq!(
            tracker.line(now),
            "clusters    42 %  8.40M of 20.0M triangles  840k triangles/s  ETA 13.8 s  memory 300 MiB"
        );
    }

    #[test]
    fn an_unknown_total_gives_no_share_and_no_time_left() {
        let (tracker, now) = tracked(1_000, 0);
        assert_eq!(tracker.line(now), "clusters    1.00k triangles  100 triangles/s  memory 300 MiB");
        assert_eq!(tracker.record(now, false).total, None);
    }

    #[test]
    fn a_phase_at_its_end_is_not_the_end_of_the_work() {
        let (tracker, now) = tracked(20, 20);
        assert_eq!(tracker.percent(), Some(99));
        assert!(!tracker.line(now).contains("100 %"));
        let (overshoot, _) = tracked(30, 20);
        assert_eq!((overshoot.percent(), overshoot.eta(now)), (Some(99), None));
    }

    #[test]
    fn no_rate_is_made_up_from_the_first_report() {
        let tracker = Tracker::new(at(5, 20), Instant::now());
        assert_eq!(tracker.rate(tracker.began), None);
        assert_eq!(tracker.rate(tracker.began + Duration::from_secs(1)), None);
    }

    #[test]
    fn json_lines_have_units_in_their_keys() {
        let (tracker, now) = tracked(10_000_000, 20_000_000);
        let line = serde_json::to_value(tracker.record(now, true)).unwrap();
        assert_eq!(line["schema"], "trex.progress/1");
        assert_eq!(line["per_s"], 1_000_000.0);
        assert_eq!(line["eta_s"], 10.0);
        assert_eq!(line["finished"], true);
    }

    #[test]
    fn quiet_means_no_progress_in_any_mode() {
        let console = Console::new(Mode::Bar, true);
        console.show(at(1, 2));
        console.finish();
        assert!(console.lock().tracker.is_none());
    }
}
