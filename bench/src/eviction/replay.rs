//! A trace, played to the pool itself: page after page is asked for, waited for, and let go of.
//!
//! Invariant: one caller, who holds one page at a time: the clock alone says which pages stay.

use super::trace::PageTrace;
use crate::full_pool;
use crate::model::Surroundings;
use std::sync::Arc;
use trex_store::PageFile;
use trex_store::pool::PoolOptions;

/// What the pool did.
pub(super) struct Replay {
    /// Bytes for frames that it had.
    pub(super) frames_bytes: u64,
    /// Pages that it held at the end.
    pub(super) held_count: usize,
    /// Pages that it read.
    pub(super) read_count: u64,
}

/// Asks a pool with `frames_bytes` of frames for all pages of `trace`.
pub(super) fn replay(
    file: &Arc<PageFile>,
    trace: &PageTrace,
    frames_bytes: u64,
    around: &Surroundings,
) -> anyhow::Result<Replay> {
    let pool = full_pool::open(file, PoolOptions::default(), frames_bytes, around)?;
    for page in trace.pages() {
        around.interrupt.check()?;
        drop(pool.pin_blocking(page)?);
    }
    let stats = pool.stats();
    let frames_bytes = stats.frames * trex_store::layout::FRAME_BYTES as u64;
    Ok(Replay { frames_bytes, held_count: stats.pages as usize, read_count: stats.pages_read })
}
