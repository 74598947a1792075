//! `trex demo`: generate, build and render under a memory limit; the other verbs in a row.

use crate::args::DemoArgs;
use crate::context::Context;
use crate::failure::Exit;

/// Runs `trex demo`.
pub fn run(args: &DemoArgs, ctx: &Context) -> anyhow::Result<Exit> {
    tracing::debug!(?args, ?ctx);
    anyhow::bail!("trex demo is not connected to its library in this build")
}
