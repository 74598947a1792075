//! Work with the interpreter detached: on a thread of its own, while the caller waits in slices.
//!
//! ```text
//! caller: detach -> wait a slice -> attach: signals? progress? -> detach -> .. -> the answer, or a signal's exception
//! thread: work, which asks an `Interrupt` often, and leaves its latest report for the caller
//! ```
//!
//! Invariants: 1. Python's code runs on the caller's thread alone; 2. when a call has raised, its work has ended.

use crate::errors::raised;
use pyo3::prelude::*;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use trex_store::{Error, Interrupt, Progress, Result};

/// Longest time between two looks for signals: work then has three quarters of the 0.2 s that Ctrl-C may take.
const SLICE: Duration = Duration::from_millis(50);

/// What work learns from its caller, and tells it.
pub(crate) struct Work {
    /// Raised by a signal, or by an exception of the receiver of progress.
    pub(crate) interrupt: Interrupt,
    latest: Mutex<Option<Progress>>,
}

impl Work {
    /// Leaves a report for the caller; one that it has not seen yet is forgotten.
    pub(crate) fn report(&self, progress: Progress) {
        *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(progress);
    }

    fn take_report(&self) -> Option<Progress> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// What Python's side does between two slices.
    fn attend(&self, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        Python::attach(|py| {
            py.check_signals()?;
            match (progress, self.take_report()) {
                (Some(receiver), Some(Progress { phase, done, total, unit, .. })) => {
                    receiver.call1(py, (phase, done, total, unit)).map(drop)
                }
                _ => Ok(()),
            }
        })
    }
}

/// Does `work` while signals are answered and reports handed on to `progress(phase, done, total, unit)`.
///
/// # Errors
/// The exception of a signal or of `progress`, which end the work; those of `work`.
pub(crate) fn run<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Work) -> Result<T> + Send,
) -> PyResult<T> {
    let answer = py.detach(|| attended(progress, work))?;
    raised(py, answer)
}

fn attended<T: Send>(
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Work) -> Result<T> + Send,
) -> PyResult<Result<T>> {
    let shared = Work { interrupt: Interrupt::default(), latest: Mutex::default() };
    thread::scope(|scope| {
        let (sender, receiver) = channel::<()>();
        let worker = thread::Builder::new().name("trex-call".to_owned()).spawn_scoped(scope, || {
            // Dropped when the work ends, however it does.
            let _ended = sender;
            work(&shared)
        });
        let worker = match worker {
            Ok(worker) => worker,
            Err(error) => return Ok(Err(Error::thread_refused("the thread of a call", &error))),
        };
        let mut raised = Ok(());
        while let Err(RecvTimeoutError::Timeout) = receiver.recv_timeout(SLICE) {
            if raised.is_ok() {
                raised = shared.attend(progress);
                if raised.is_err() {
                    shared.interrupt.raise();
                }
            }
        }
        let answer = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        raised?;
        // What happened since the last slice: the last report, and a signal that no slice has seen.
        shared.attend(progress)?;
        Ok(answer)
    })
}
