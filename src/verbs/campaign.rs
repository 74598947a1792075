//! What `bench tradeoff` and `bench scale` share, which run the command itself again and again.

use crate::context::Context;
use std::path::{Path, PathBuf};
use trex_bench::tradeoff::Around;
use trex_store::{Error, Progress};

/// Runs a campaign: `run` gets the path of this executable and the surroundings, and tells how many of `unit` are done.
pub fn campaign<F>(
    ctx: &Context,
    phase: &'static str,
    unit: &'static str,
    run: impl FnOnce(PathBuf, &Around<'_>) -> anyhow::Result<F>,
) -> anyhow::Result<F> {
    let program = std::env::current_exe()
        .map_err(|error| Error::io("find the command itself", Path::new("/proc/self/exe"), &error))?;
    let tell = |done, total| {
        let memory_bytes = ctx.budget.used_bytes();
        ctx.report()(Progress { phase, done, total, unit, memory_bytes });
    };
    run(program, &Around { budget: &ctx.budget, interrupt: &ctx.interrupt, tell: &tell })
}
