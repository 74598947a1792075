//! What every verb gets: the limit, the switch that stops it, stderr, stdout, the thread count.
//!
//! Invariant: verbs take everything of the process's surroundings from here, and hand it to the libraries.

use crate::args::Verb;
use crate::failure::Exit;
use crate::host::HostMemory;
use crate::progress::Console;
use crate::report::Output;
use crate::size;
use crate::values::MemoryLimit;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;
use std::fmt::Display;
use std::num::NonZero;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::available_parallelism;
use trex_store::{Budget, Error, Interrupt, Progress, Result};

/// The surroundings of a verb.
#[derive(Debug)]
pub struct Context {
    /// The ledger of `--memory-limit`.
    pub budget: Budget,
    /// Raised by Ctrl-C and SIGTERM.
    pub interrupt: Interrupt,
    /// `--threads`, or one per core.
    pub threads: usize,
    /// Stderr.
    pub console: Console,
    /// Stdout.
    pub output: Output,
    verb: &'static str,
}

impl Context {
    /// The surroundings that `verb`'s flags ask for, on this machine.
    pub fn new(verb: &Verb, console: Console, output: Output) -> Context {
        let common = verb.common();
        let host = HostMemory::detect();
        let limit = common.memory_limit.unwrap_or(verb.default_limit());
        let limit_bytes = limit.resolve(host.ceiling_bytes());
        tracing::info!("memory limit {}, {}; {host}", size::bytes(limit_bytes), origin_of(limit));
        Context {
            budget: Budget::new(limit_bytes),
            interrupt: Interrupt::default(),
            threads: common
                .threads
                .map_or_else(|| available_parallelism().map_or(1, NonZero::get), usize::from),
            console,
            output,
            verb: verb.name(),
        }
    }

    /// The threads that data-parallel work runs on, one for each of `threads`.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn thread_pool(&self) -> Result<Arc<ThreadPool>> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .thread_name(|index| format!("worker-{index}"))
            .build();
        pool.map(Arc::new).map_err(|error| Error::threads_refused(self.threads, &error))
    }

    /// The receiver of progress, for calls that take a `Report`.
    pub fn report(&self) -> impl Fn(Progress) + Sync + '_ {
        |progress| self.console.show(progress)
    }

    /// Shows 100 % and prints the result: the last step of a verb that did what was asked.
    ///
    /// # Errors
    /// Stdout cannot be written.
    pub fn done<T: Serialize + Display>(&self, result: &T) -> anyhow::Result<Exit> {
        self.console.finish();
        self.output.result(self.verb, result)?;
        Ok(Exit::Done)
    }

    /// Ctrl-C and SIGTERM raise the switch; work stops at its next check and cleans up. The second one leaves at
    /// once, whatever is left behind. A file that passes the size that the user may write is an error of that write.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub fn listen_for_signals(&self) -> std::result::Result<(), ctrlc::Error> {
        // The flag is asked by nobody: what counts is that the signal no longer ends the process.
        signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default())
            .map_err(ctrlc::Error::System)?;
        let interrupt = self.interrupt.clone();
        let asked = AtomicBool::new(false);
        ctrlc::set_handler(move || {
            interrupt.raise();
            if asked.swap(true, Ordering::SeqCst) {
                std::process::exit(i32::from(Exit::Interrupted as u8));
            }
        })
    }
}

/// Where a limit comes from, in words.
fn origin_of(limit: MemoryLimit) -> String {
    match limit {
        MemoryLimit::Bytes(_) => "a fixed amount".to_owned(),
        MemoryLimit::Percent(percent) => format!("{percent} % of what the machine grants"),
    }
}
