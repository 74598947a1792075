//! A pool of pages with the frames that the limit has room for, without a session on it.
//!
//! `trex_model::Model` puts file, pool, plan and session together. What is measured here is below it: single tracers,
//! which take their rays one by one, and pools that are filled through a backend of their own. So both workloads take
//! their pool from here.

use crate::model::Surroundings;
use std::sync::Arc;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{PageFile, Result};

/// A pool of `file` with frames of `wanted_bytes`, or of what the limit has room for, or the fewest that a pool can
/// have.
///
/// # Errors
/// Those of [`PagePool::open`].
pub(crate) fn open(
    file: &Arc<PageFile>,
    options: PoolOptions,
    wanted_bytes: u64,
    around: &Surroundings,
) -> Result<PagePool> {
    let (overhead, smallest) = PagePool::smallest_bytes(&**file, &options)?;
    let least = smallest - overhead;
    let room = around.budget.free_bytes().saturating_sub(overhead).max(least);
    let options = PoolOptions { frames_bytes: wanted_bytes.clamp(least, room), ..options };
    PagePool::open(file.clone(), file.path(), &around.budget, &options)
}
