//! `trex gen`: a generated mesh to a PLY, OBJ or STL file. (`gen` is a keyword of Rust.)

use crate::args::GenArgs;
use crate::context::Context;
use crate::failure::Exit;

/// Runs `trex gen`.
pub fn run(args: &GenArgs, ctx: &Context) -> anyhow::Result<Exit> {
    tracing::debug!(?args, ?ctx);
    anyhow::bail!("trex gen is not connected to its library in this build")
}
