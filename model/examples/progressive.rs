//! A picture that gets better while one looks at it: `cargo run -p trex-model --example progressive [-- FILE.trex]`.
//! Without a file it builds a small one for itself.
#![allow(clippy::print_stdout)]

#[path = "../../store/examples/support/tiny.rs"]
mod tiny;

use std::ops::ControlFlow;
use trex_model::{Model, OpenOptions};
use trex_render::{Scene, write_png};
use trex_store::Error;

fn main() -> Result<(), Error> {
    let found = tiny::model()?;
    let model = Model::open(&found.path, &OpenOptions::with_limit(512 << 20))?;
    let mut scene = Scene::default();
    (scene.render.resolution, scene.render.photons) = ([128, 128], 100_000);
    let mut session = model.session(&scene)?;
    let photons = session.illuminate(&|| false, &mut |_, _| {})?;
    println!("{} photons, {} deposits", photons.photons, photons.deposits);
    // After each pass every pixel has the same number of samples: the film can be shown.
    session.render(8, &|| false, &mut |film, stats| {
        println!("{} samples a pixel, mean {:.4?}", stats.spp, film.mean());
        ControlFlow::Continue(())
    });
    session.smooth()?;
    let mut png = vec![];
    write_png(session.film(), session.view().settings.exposure.factor(), session.thread_pool(), &mut png)
        .map_err(|error| Error::io("encode", &found.path, &error))?;
    println!("a picture of {} bytes", png.len());
    Ok(())
}
