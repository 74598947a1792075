//! The libraries' trace events on stderr: warnings always, more with `-v`, none but errors with `-q`.
//!
//! Invariant: an event is one line, written through the console, so that a progress bar steps aside for it.

use crate::args::CommonArgs;
use crate::progress::Console;
use std::io::{self, Write};
use tracing::Level;
use tracing_subscriber::fmt::MakeWriter;

/// Installs the receiver of trace events. The first call in a process wins.
pub fn install(common: &CommonArgs, console: &Console) {
    let level = match (common.quiet, common.verbose) {
        (true, _) => Level::ERROR,
        (false, 0) => Level::WARN,
        (false, 1) => Level::INFO,
        (false, _) => Level::DEBUG,
    };
    let _ = tracing_subscriber::fmt()
        .with_max_level(level)
        .with_writer(Lines(console.clone()))
        .with_ansi(false)
        .without_time()
        .with_target(common.verbose > 1)
        .try_init();
}

/// Makes a [`Line`] per event.
struct Lines(Console);

/// One event's text, handed to the console when complete.
struct Line {
    console: Console,
    text: Vec<u8>,
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Line;

    fn make_writer(&'a self) -> Line {
        Line { console: self.0.clone(), text: Vec::new() }
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if !self.text.is_empty() {
            self.console.error(&String::from_utf8_lossy(&self.text));
        }
    }
}
