//! Batches of triangles, read on a thread of their own while those before them are sorted.
//!
//! Invariants: 1. at most [`BATCHES`] are there, used in turn; 2. the thread has ended when the call returns.

use crate::build::options::BuildOptions;
use crate::error::{Error, Result};
use crate::source::{TriangleBatch, TriangleSource};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

/// Batches on their way from the reader.
pub(super) const BATCHES: u64 = 4;

/// Calls `take` for each batch of `source`, in order; gives the time that it was waited for.
pub(super) fn for_each_batch(
    source: &mut dyn TriangleSource,
    options: &BuildOptions,
    mut take: impl FnMut(&TriangleBatch) -> Result<()>,
) -> Result<Duration> {
    let mut waited = Duration::ZERO;
    std::thread::scope(|scope| -> Result<()> {
        let (full, batches) = sync_channel::<Result<TriangleBatch>>(1);
        let (back, empties) = sync_channel::<TriangleBatch>(BATCHES as usize);
        (0..BATCHES - 1).for_each(|_| back.send(TriangleBatch::default()).expect("the channel has room"));
        let reader = move || {
            while let Ok(mut batch) = empties.recv() {
                let message = match source.next_batch(&mut batch) {
                    Ok(true) => Ok(batch),
                    Ok(false) => return,
                    Err(error) => Err(error),
                };
                if full.send(message).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("trex-read".into()).spawn_scoped(scope, reader);
        thread.map_err(|error| Error::thread_refused("the reader of the input", &error))?;
        loop {
            let before = Instant::now();
            let Ok(message) = batches.recv() else { return Ok(()) };
            waited += before.elapsed();
            let batch = message?;
            options.interrupt.check()?;
            take(&batch)?;
            let _ = back.send(batch);
        }
    })?;
    Ok(waited)
}
