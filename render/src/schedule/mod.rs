//! Tiles scheduled over workers, out of core.

mod g_queue;
mod job;
mod pass;
mod preview;
mod samples;
mod worker;

pub(crate) use job::PASS_SAMPLES_MAX;
pub(crate) use pass::{Pass, Workers, pass_bytes};
pub(crate) use preview::{Grid, PreviewStats};
pub(crate) use samples::SampleWork;
pub(crate) use worker::{Canvas, TileWork, Until, WhenFull};
