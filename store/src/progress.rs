//! How long work tells what it does and learns that it should stop. The store never prints.

use crate::error::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// One report of progress.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Name of the phase: `scan`, `partition`, `clusters`, `check`, ...
    pub phase: &'static str,
    /// Units done in this phase.
    pub done: u64,
    /// Units in all; 0 while not known.
    pub total: u64,
    /// What a unit is: `triangles`, `bytes`, `pages`, `samples`.
    pub unit: &'static str,
    /// Bytes that the ledger holds now.
    pub memory_bytes: u64,
}

/// Receiver of reports. Called from one thread at a time, at most some tens of times a second.
pub type Report<'a> = &'a (dyn Fn(Progress) + Sync);

/// A switch that the user (or a test) throws to stop the work. Cheap to clone and to ask.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Asks all work that holds this switch to stop.
    pub fn raise(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// What is set once it is raised: for handlers of signals, which may do no more than set it.
    pub fn flag(&self) -> Arc<AtomicBool> {
        self.0.clone()
    }

    /// True once raised.
    pub fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// # Errors
    /// [`Error::interrupted`] once raised.
    pub fn check(&self) -> Result<()> {
        if self.is_raised() { Err(Error::interrupted()) } else { Ok(()) }
    }
}

/// When work is to stop with what it has: once a switch is raised, or at a time. Never, unless it is said. Cheap to
/// clone and to ask.
#[derive(Clone, Debug, Default)]
pub struct StopSignal {
    interrupt: Interrupt,
    deadline: Option<Instant>,
}

impl StopSignal {
    /// Once `interrupt` is raised, or at the `deadline`, where there is one.
    pub fn new(interrupt: &Interrupt, deadline: Option<Instant>) -> StopSignal {
        StopSignal { interrupt: interrupt.clone(), deadline }
    }

    /// True from then on.
    pub fn is_due(&self) -> bool {
        self.interrupt.is_raised() || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }
}
