//! `trex render`: a page file or a scene to a picture.

use crate::args::RenderArgs;
use crate::context::Context;
use crate::failure::Exit;

/// Runs `trex render`.
pub fn run(args: &RenderArgs, ctx: &Context) -> anyhow::Result<Exit> {
    tracing::debug!(?args, ?ctx);
    anyhow::bail!("trex render is not connected to its library in this build")
}
