//! A picture that gets better while one looks at it: `cargo run -p trex-render --example progressive [-- FILE.trex]`.
//! Without a file it builds a small one for itself.
#![allow(clippy::print_stdout)]

#[path = "../../store/examples/support/tiny.rs"]
mod tiny;

use std::ops::ControlFlow;
use std::sync::Arc;
use trex_render::film::Layers;
use trex_render::integrator::Method;
use trex_render::picture::write_png;
use trex_render::scene::Scene;
use trex_render::session::Session;
use trex_render::trace::tracers;
use trex_render::voxel::Voxels;
use trex_render::world::Model;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Error, PageFile};

fn main() -> Result<(), Error> {
    let found = tiny::model()?;
    let budget = Budget::new(512 << 20);
    let file = Arc::new(PageFile::open(&found.path, &budget)?);
    let pool = PagePool::open(file.clone(), &found.path, &budget, &PoolOptions::default())?;
    let (bounds, materials) = (file.superblock().bounds, file.materials().to_vec());
    let voxels = Voxels::of(&file, &budget)?.map(Arc::new);
    let method = if voxels.is_some() { Method::Photon } else { Method::Direct };
    let mut model = Model { bounds, materials, emitters: vec![], voxels };

    let mut scene = Scene::default();
    scene.render.integrator = method;
    (scene.render.resolution, scene.render.photons) = ([128, 128], 100_000);
    let view = scene.view(&mut model)?;
    let mut session = Session::new(model, view, Layers::default(), &budget, tracers(&file, &pool, 2))?;
    let photons = session.illuminate(&|| false, &mut |_, _| {})?;
    println!("{} photons, {} deposits", photons.photons, photons.deposits);
    // After each pass every pixel has the same number of samples: the film can be shown.
    session.render(8, &|| false, &mut |film, stats| {
        println!("{} samples a pixel, mean {:.4?}", stats.spp, film.mean());
        ControlFlow::Continue(())
    });
    let mut png = vec![];
    write_png(session.film(), 1.0, &mut png).map_err(|error| Error::io("encode", &found.path, &error))?;
    println!("a picture of {} bytes", png.len());
    Ok(())
}
