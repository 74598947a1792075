//! Rays against a page file: `cargo run -p trex-model --example intersect [-- FILE.trex]`. Without a file it builds a
//! small one for itself.
#![allow(clippy::print_stdout)]

#[path = "../../store/examples/support/tiny.rs"]
mod tiny;

use trex_model::{Model, OpenOptions};
use trex_render::{Camera, Ray};
use trex_store::{Error, Interrupt};

/// Rays along a side of the picture that they make.
const SIDE: u32 = 64;

fn main() -> Result<(), Error> {
    let found = tiny::model()?;
    let model = Model::open(&found.path, &OpenOptions::with_limit(256 << 20))?;
    let camera = Camera::framing(&model.info()?.bounds, [SIDE; 2], None, None).project([SIDE; 2])?;
    let pixels = (0..SIDE * SIDE).map(|at| [at % SIDE, at / SIDE].map(|x| f64::from(x) + 0.5));
    let rays: Vec<Ray> = pixels.map(|[x, y]| camera.ray(x, y)).collect();

    let hits = model.intersect(&rays, &Interrupt::default())?;
    let nearest = hits.iter().flatten().min_by(|a, b| a.t.total_cmp(&b.t));
    println!("{} of {} rays meet the model", hits.iter().flatten().count(), rays.len());
    if let Some(hit) = nearest {
        println!("nearest: triangle {} of page {} at distance {}", hit.triangle, hit.page, hit.t);
    }
    let pages_read = model.pool().map_or(0, |pool| pool.stats().pages_read);
    println!("{pages_read} pages read of {}", model.info()?.page_count);
    Ok(())
}
