//! One ray against a page file: `cargo run -p trex-render --example trace [-- FILE.trex]`. Without a file it builds a
//! small one for itself.
#![allow(clippy::print_stdout)]

#[path = "../../store/examples/support/tiny.rs"]
mod tiny;

use std::sync::Arc;
use std::time::Duration;
use trex_render::{Answer, Camera, PagedTracer, Tracer, pooled_tracers};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Error, PageFile};

fn main() -> Result<(), Error> {
    let model = tiny::model()?;
    let budget = Budget::new(256 << 20);
    let file = Arc::new(PageFile::open(&model.path, &budget)?);
    let pool = Arc::new(PagePool::open(file.clone(), &model.path, &budget, &PoolOptions::default())?);
    let mut tracer = pooled_tracers(&file, &pool, 1).remove(0);

    let camera = Camera::framing(&file.superblock().bounds, [512, 512], None, None);
    let ray = camera.project([512, 512])?.ray(256.0, 256.0);
    // Tracing never waits for the disk: it tells what it lacks, and is asked again.
    let mut asked = 1;
    let hit = loop {
        match tracer.intersect(&ray) {
            Answer::Exact(hit) => break hit,
            Answer::Blocked => {
                tracer.request_missing();
                tracer.wait(Duration::from_millis(50));
                asked += 1;
            }
        }
    };
    match hit {
        Some(hit) => println!("triangle {} of page {} at distance {}", hit.triangle, hit.page, hit.t),
        None => println!("the ray meets nothing"),
    }
    println!("asked {asked} times, {} pages read of {}", pool.stats().pages_read, pool.page_count());
    Ok(())
}
