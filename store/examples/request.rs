//! Pages through a pool of few frames: `cargo run -p trex-store --example request [-- FILE.trex]`. Without a file it
//! builds a small one for itself.
#![allow(clippy::print_stdout)]

#[path = "support/tiny.rs"]
mod tiny;

use std::sync::Arc;
use std::time::Duration;
use trex_store::cluster::FrameView;
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, PoolOptions, Want};
use trex_store::{Budget, Error, PageFile};

fn main() -> Result<(), Error> {
    let model = tiny::model()?;
    let budget = Budget::new(256 << 20);
    let file = Arc::new(PageFile::open(&model.path, &budget)?);
    // Fewer frames than pages: what nobody pins gives way to what is wanted.
    let options = PoolOptions { frames_bytes: 4 * FRAME_BYTES as u64, ..PoolOptions::default() };
    let pool = PagePool::open(file.clone(), &model.path, &budget, &options)?;
    let (mut clusters, mut triangles) = (0, 0);
    let mut missing: Vec<u32> = (0..pool.page_count()).collect();
    while !missing.is_empty() {
        let epoch = pool.epoch();
        // Who wants pages says so once a round; what has come is pinned while it is looked at.
        let next = missing.iter().take(2).map(|&page| Want { page, weight: 1 });
        pool.submit(0, &next.collect::<Vec<_>>());
        missing.retain(|&page| {
            let Some(pin) = pool.try_pin(page) else { return !pool.is_damaged(page) };
            FrameView::new(pool.frame(&pin)).for_each_cluster(|cluster| {
                clusters += 1;
                triangles += cluster.triangle_count();
            });
            pool.unpin(pin);
            false
        });
        pool.wait_for_progress(epoch, Duration::from_millis(50));
    }
    println!("{triangles} triangles in {clusters} clusters, {} frames", pool.frames().frames);
    let stats = pool.stats();
    println!("{} pages read, {} bytes, {} evicted", stats.pages_read, stats.bytes_read, stats.evictions);
    Ok(())
}
