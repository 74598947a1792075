//! A picture that gets better while one looks at it: `cargo run -p trex-render --example progressive [-- FILE.trex]`.
//! Without a file it builds a small one for itself.
#![allow(clippy::print_stdout)]

#[path = "../../store/examples/support/tiny.rs"]
mod tiny;

use rayon::ThreadPoolBuilder;
use std::ops::ControlFlow;
use std::sync::Arc;
use trex_render::{
    CpuStage, Layers, Method, Model, Scene, Session, SessionSetup, Voxels, pooled_tracers, write_png,
};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Error, PageFile};

fn main() -> Result<(), Error> {
    let found = tiny::model()?;
    let budget = Budget::new(512 << 20);
    let file = Arc::new(PageFile::open(&found.path, &budget)?);
    let pool = PagePool::open(file.clone(), &found.path, &budget, &PoolOptions::default())?;
    let (bounds, materials) = (file.superblock().bounds, file.materials().to_vec());
    let voxels = Voxels::open(&file, &budget)?.map(Arc::new);
    let method = if voxels.is_some() { Method::Photon } else { Method::Direct };
    let mut model = Model { bounds, materials, emitters: vec![], voxels };

    let mut scene = Scene::default();
    scene.render.integrator = method;
    (scene.render.resolution, scene.render.photons) = ([128, 128], 100_000);
    let view = scene.view(&mut model)?;
    let threads = Arc::new(ThreadPoolBuilder::new().num_threads(2).build().expect("two threads"));
    let tracers = pooled_tracers(&file, &pool, 2);
    let g_stage = Box::new(CpuStage::default());
    let setup = SessionSetup { model, view, layers: Layers::default(), tracers, pool: threads, g_stage };
    let mut session = Session::new(setup, &budget)?;
    let photons = session.illuminate(&|| false, &mut |_, _| {})?;
    println!("{} photons, {} deposits", photons.photons, photons.deposits);
    // After each pass every pixel has the same number of samples: the film can be shown.
    session.render(8, &|| false, &mut |film, stats| {
        println!("{} samples a pixel, mean {:.4?}", stats.spp, film.mean());
        ControlFlow::Continue(())
    });
    let mut png = vec![];
    write_png(session.film(), 1.0, session.thread_pool(), &mut png)
        .map_err(|error| Error::io("encode", &found.path, &error))?;
    println!("a picture of {} bytes", png.len());
    Ok(())
}
