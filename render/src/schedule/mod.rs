//! Tiles scheduled over workers, out of core.

mod job;
mod pass;
mod worker;

pub(crate) use job::PASS_SAMPLES_MAX;
pub(crate) use pass::{Canvas, Pass, Workers, pass_bytes};
pub(crate) use worker::{TileWork, Until};
