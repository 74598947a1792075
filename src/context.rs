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
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use std::fmt::Display;
use std::io;
use std::num::NonZero;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
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

    /// Ctrl-C, SIGTERM and SIGHUP raise the switch; work stops at its next check and cleans up. The second one leaves
    /// at once, whatever is left behind. Under `nohup` a SIGHUP stays without an effect. A file that passes the size
    /// that the user may write is an error of that write. Handlers set flags and start no thread: one that was refused
    /// would leave signals without an effect.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub fn listen_for_signals(&self) -> io::Result<()> {
        // The flag is asked by nobody: what counts is that the signal no longer ends the process.
        flag::register(SIGXFSZ, Arc::default())?;
        let asked = Arc::new(AtomicBool::new(false));
        let ends = [SIGINT, SIGTERM, SIGHUP];
        for signal in ends.into_iter().filter(|&signal| signal != SIGHUP || !is_ignored(SIGHUP)) {
            // In this order: the first one is not its own second.
            flag::register_conditional_shutdown(signal, Exit::Interrupted as i32, asked.clone())?;
            flag::register(signal, asked.clone())?;
            flag::register(signal, self.interrupt.flag())?;
        }
        Ok(())
    }
}

/// True for a signal that whoever started this process has it ignore, as `nohup` does.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask =
        status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Where a limit comes from, in words.
fn origin_of(limit: MemoryLimit) -> String {
    match limit {
        MemoryLimit::Bytes(_) => "a fixed amount".to_owned(),
        MemoryLimit::Percent(percent) => format!("{percent} % of what the machine grants"),
    }
}
