//! Stress: viewpoints, lights and limits that change faster than a model of this size likes, and a verdict.
//!
//! ```text
//! references: each state of the scenario at leisure -> a file              (where errors are asked for)
//! scenario -> steps -> apply -> hold: frames until the picture is exact or was held long enough
//!                                '-- times, errors, holes, stalls, pages -> figures -> verdict
//! ```
//!
//! What is known to fail elsewhere is what is looked for: livelock at the cap, endless requests, loads for views that
//! are gone, all loaded again on turning back, memory that grows. Paper, section 6.2, "Limited main memory".
//!
//! Invariant: a figure of time counts from before the event is applied.

mod camera_way;
mod drag;
mod drag_figures;
mod errors;
mod figures;
mod filling;
mod hold;
mod options;
mod picture_error;
mod picture_store;
mod references;
mod scenario;
mod vector;

pub use drag_figures::{DragFigures, ErrorSpread};
pub use errors::{ERROR_TIMES_MS, Snapshots};
pub use figures::{PixelError, StressFigures};
pub use hold::Switch;
pub use options::{Requirement, Scenario, StressFigure, StressOptions};
pub use references::{ErrorFloor, References, ReferencesKey};

use camera_way::WAY_EVENTS;
use hold::{Hold, Log};
use scenario::{Script, Step};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use trex_render::{Event, LiveSession, PagedTracer, RenderKeys, RenderSettings, Session};
use trex_store::pool::PagePool;
use trex_store::{Interrupt, Result};

/// Bits in which the seeds of two pictures of a state differ.
const SEED_BITS: u64 = 0x5a5a_a5a5;

/// The surroundings of a run.
pub struct Stand<'a> {
    /// The pool that the session's tracers read.
    pub pool: &'a PagePool,
    /// Bytes that the process holds now, where the system tells.
    pub resident_bytes: &'a dyn Fn() -> Option<u64>,
    /// Ends the run.
    pub interrupt: &'a Interrupt,
    /// Hears how many switches, or references, are done.
    pub tell: &'a dyn Fn(u64),
    /// The longest frame.
    pub t_max: Duration,
}

/// Count of states that a scenario comes to, for which there can be references; 0 for one whose states do not come
/// again.
pub fn state_count<T: PagedTracer + Send>(session: &Session<T>, options: &StressOptions) -> u32 {
    Script::new(session, options, 0).state_count()
}

/// Renders each state of a scenario at leisure, `spp` samples a pixel, into `references`; some of them again with other
/// samples.
///
/// # Errors
/// Those of [`Session::apply`], [`Session::illuminate`] and of writing the file; an interrupt.
pub fn render_references<T: PagedTracer + Send>(
    session: &mut Session<T>,
    options: &StressOptions,
    spp: u32,
    references: &References,
    stand: &Stand<'_>,
) -> Result<()> {
    let script = Script::new(session, options, 0);
    let stop = || stand.interrupt.is_raised();
    let step = |session: &mut Session<T>, steps: Vec<Step>| {
        steps.into_iter().try_for_each(|step| match step {
            Step::Event(event) => session.apply(*event),
            Step::FrameBytes(_) => Ok(()),
        })
    };
    for switch in 0..script.first() {
        step(session, script.steps(switch))?;
    }
    let keys = *session.view().settings;
    let other_keys = RenderKeys { seed: other_seed(keys.seed), ..keys };
    for state in 0..script.state_count() {
        step(session, script.steps_to(state))?;
        for (is_second, keys) in [(false, keys), (true, other_keys)] {
            if is_second && !References::has_second(state) {
                continue;
            }
            session.apply(Event::Settings(RenderSettings::new(keys)?))?;
            session.illuminate(&stop, &mut |_, _| {})?;
            session.render(spp, &stop, &mut |_, _| ControlFlow::Continue(()));
            stand.interrupt.check()?;
            references.write(state, is_second, session.film())?;
        }
        (stand.tell)(u64::from(state) + 1);
    }
    references.finish()
}

/// A seed whose samples have nothing to do with those of `seed`, in the range of seeds.
pub fn other_seed(seed: u64) -> u64 {
    seed ^ SEED_BITS
}

/// Runs a scenario on a session that is live, with `snapshots` where errors are asked for.
///
/// # Errors
/// Those of [`LiveSession::apply`], [`PagePool::set_limit`], and of writing and reading pictures; an interrupt.
pub fn run<T: PagedTracer + Send>(
    session: &mut LiveSession<T>,
    options: &StressOptions,
    mut snapshots: Option<&mut Snapshots>,
    stand: &Stand<'_>,
) -> Result<StressFigures> {
    let script = Script::new(session, options, stand.pool.frames().frames as u64);
    let (mut log, mut memory) = (Log::default(), vec![]);
    let hold = Hold { longest: options.hold, t_max: stand.t_max, interrupt: stand.interrupt };
    let asked = session.view().settings.lod_error;
    let step = |session: &mut LiveSession<T>, switch| -> Result<()> {
        for step in script.steps(switch) {
            match step {
                Step::Event(event) => session.apply(*event)?,
                Step::FrameBytes(bytes) => drop(stand.pool.set_limit(bytes)?),
            }
        }
        Ok(())
    };
    (0..script.first()).try_for_each(|switch| step(session, switch))?;
    let before = stand.pool.stats();
    let begin = Instant::now();
    for switch in 0..options.switches {
        stand.interrupt.check()?;
        let index = match options.scenario {
            Scenario::Drag | Scenario::Fly => {
                log.drag(session, &script, &hold, snapshots.as_deref())?;
                WAY_EVENTS - 1
            }
            _ => script.first() + switch,
        };
        let event = Instant::now();
        step(session, index)?;
        log.hold(session, event, &hold, snapshots.as_deref_mut())?;
        if let Some(snapshots) = &mut snapshots {
            log.compare(snapshots, script.state(index), session.view().settings.exposure.factor())?;
        }
        if let Some(bytes) = (stand.resident_bytes)() {
            memory.push((f64::from(switch), bytes as f64));
        }
        (stand.tell)(u64::from(switch) + 1);
    }
    let seconds = (begin.elapsed() - log.aside).as_secs_f64();
    if let Some(bytes) = script.frame_bytes_at_rest() {
        stand.pool.set_limit(bytes)?;
    }
    let run = figures::Run { before, after: stand.pool.stats(), seconds, asked, memory };
    Ok(StressFigures::new(log, options, run))
}
