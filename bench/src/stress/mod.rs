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

mod drag;
mod errors;
mod figures;
mod hold;
mod options;
mod scenario;

pub use drag::{DragFigures, Spread};
pub use errors::{ERROR_TIMES_MS, References, ReferencesKey, Snapshots};
pub use figures::{PixelError, StressFigures};
pub use hold::Switch;
pub use options::{Requirement, Scenario, StressFigure, StressOptions};

use hold::{Hold, Log};
use scenario::{DRAG_EVENTS, Script, Step};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use trex_render::{LiveSession, PagedTracer, Session};
use trex_store::pool::PagePool;
use trex_store::{Interrupt, Result};

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

/// Renders each state of a scenario at leisure, `spp` samples a pixel, into `references`.
///
/// # Errors
/// Those of [`Session::apply`], [`Session::illuminate`] and [`References::add`]; an interrupt.
pub fn render_references<T: PagedTracer + Send>(
    session: &mut Session<T>,
    options: &StressOptions,
    spp: u32,
    references: &mut References,
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
    for state in 0..script.state_count() {
        step(session, script.steps_to(state))?;
        session.illuminate(&stop, &mut |_, _| {})?;
        session.render(spp, &stop, &mut |_, _| ControlFlow::Continue(()));
        stand.interrupt.check()?;
        references.add(session.film())?;
        (stand.tell)(u64::from(state) + 1);
    }
    Ok(())
}

/// Runs a scenario on a session that is live; `compared` are the references, and the room for snapshots, where errors
/// are asked for.
///
/// # Errors
/// Those of [`LiveSession::apply`], [`PagePool::set_limit`] and reading the references; an interrupt.
pub fn run<T: PagedTracer + Send>(
    session: &mut LiveSession<T>,
    options: &StressOptions,
    mut compared: Option<(&References, &mut Snapshots)>,
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
            Scenario::Drag => {
                let references = compared.as_ref().map(|(references, _)| *references);
                log.drag(session, &script, &hold, references)?;
                DRAG_EVENTS - 1
            }
            _ => script.first() + switch,
        };
        let event = Instant::now();
        step(session, index)?;
        log.hold(session, event, &hold, compared.as_mut().map(|(_, snapshots)| &mut **snapshots))?;
        if let Some((references, snapshots)) = &mut compared {
            let begin = Instant::now();
            let exposure = session.view().settings.exposure;
            let errors = snapshots.errors(references, script.state(index), exposure)?;
            let held = log.switches.last_mut().expect("a switch was held");
            held.error_at = Some(errors.map(|error| Some(error?.relmse)));
            held.flip_at = Some(errors.map(|error| Some(error?.flip)));
            if options.scenario == Scenario::Drag {
                log.drags.compare(references, exposure)?;
            }
            log.aside += begin.elapsed();
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
