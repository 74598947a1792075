//! `trex info`: what a mesh or a page file holds, without loading it.

use crate::args::InfoArgs;
use crate::context::Context;
use crate::failure::Exit;

/// Runs `trex info`.
pub fn run(args: &InfoArgs, ctx: &Context) -> anyhow::Result<Exit> {
    tracing::debug!(?args, ?ctx);
    anyhow::bail!("trex info is not connected to its library in this build")
}
