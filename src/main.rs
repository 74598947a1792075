//! The `trex` command: arguments in, verbs out. It reads `/proc`, `/sys` and the terminal, so that the libraries
//! need not; it has no logic of its own.
//!
//! ```text
//! args ---- what may be typed          context -- what a verb gets
//! values -- typed values               verbs ---- one file per verb
//! host, memory -- the machine          report --- stdout
//! progress, log -- stderr              failure -- errors, exit status, panics
//! ```

// A binary has no public items: `pub` here means "for the other modules", as it would in a library.
#![allow(unreachable_pub)]

mod args;
mod context;
mod failure;
mod host;
mod log;
mod memory;
mod next_step;
mod progress;
mod report;
mod size;
mod values;
mod verbs;

use args::Cli;
use clap::Parser;
use context::Context;
use failure::Exit;
use progress::Console;
use report::Output;
use std::io::IsTerminal;
use std::process::ExitCode;

fn main() -> ExitCode {
    run().into()
}

fn run() -> Exit {
    let command = report::command_line(std::env::args_os());
    let words = args::with_verb(std::env::args_os().collect(), std::io::stdout().is_terminal());
    let cli = match Cli::try_parse_from(words) {
        Ok(cli) => cli,
        Err(error) => {
            // What could not be parsed may still have asked for a document.
            let json = std::env::args_os().any(|argument| argument == "--json");
            return failure::tell_usage(&error, &Output::new(json, command));
        }
    };
    let common = cli.verb.common();
    let console = Console::new(common.progress, common.quiet);
    let output = Output::new(common.json, command);
    failure::install_panic_hook(output.clone());
    log::install(common, &console);

    trex_store::io::set_network_options(cli.verb.network());
    let context = Context::new(&cli.verb, console.clone(), output.clone());
    if let Err(error) = context.listen_for_signals() {
        tracing::warn!("Ctrl-C may end trex at once, without cleaning up: {error}");
    }
    // A panic, of whatever thread, has already been told by the hook; what remains is its exit status.
    let verb = std::panic::AssertUnwindSafe(|| verbs::run(&cli.verb, &context));
    match std::panic::catch_unwind(verb) {
        _ if failure::has_panicked() => Exit::Bug,
        Ok(Ok(exit)) => exit,
        Ok(Err(error)) => failure::tell(&error, &console, &output),
        Err(_) => Exit::Bug,
    }
}
