//! `trex build`: meshes to a page file.

use crate::args::BuildArgs;
use crate::context::Context;
use crate::failure::Exit;

/// Runs `trex build`.
pub fn run(args: &BuildArgs, ctx: &Context) -> anyhow::Result<Exit> {
    tracing::debug!(?args, ?ctx);
    anyhow::bail!("trex build is not connected to its library in this build")
}
