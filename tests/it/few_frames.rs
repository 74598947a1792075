//! Pictures through the fewest frames that a pool can have: a ray that crosses more pages than there are frames comes
//! to its end, with the hit that it has where all pages are there.

use crate::fixtures::model_with;
use std::ops::ControlFlow;
use std::sync::Arc;
use trex_render::{
    Camera, CpuStage, Layers, Method, Model, RenderKeys, RenderSettings, Session, SessionSetup, View, Voxels,
    pooled_tracers,
};
use trex_store::build;
use trex_store::octree::Refinement;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, PageFile};

const SIDE: u32 = 6;

/// The samples of a picture from inside of the model by `method`, through a pool of `frames_bytes`; the fewest for
/// `None`.
fn picture(spec: &str, voxels: build::Voxels, method: Method, frames_bytes: Option<u64>) -> Vec<[f32; 3]> {
    let built = model_with(spec, voxels);
    let (path, budget) = (built.file.path(), Budget::unlimited());
    let file = Arc::new(PageFile::open(path, &budget).unwrap());
    let defaults = PoolOptions { staging_slots: 2, ..PoolOptions::default() };
    let (overhead, smallest) = PagePool::smallest_bytes(&*file, &defaults).unwrap();
    let frames_bytes = frames_bytes.unwrap_or(smallest - overhead);
    let pool = Arc::new(
        PagePool::open(file.clone(), path, &budget, &PoolOptions { frames_bytes, ..defaults }).unwrap(),
    );
    let (bounds, materials) = (file.superblock().bounds, file.materials().to_vec());
    let voxels = Voxels::open(&file, &budget).unwrap().map(Arc::new);
    let model = Model { bounds, materials, names: file.material_names().clone(), emitters: vec![], voxels };
    let keys = RenderKeys { integrator: method, resolution: [SIDE; 2], n_shadow: 1, ..RenderKeys::default() };
    let settings = RenderSettings::new(keys).unwrap();
    let camera = Camera::framing(&bounds, [SIDE; 2], None, None);
    let threads = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap());
    let setup = SessionSetup {
        model,
        view: View { camera, lights: vec![], settings },
        layers: Layers::default(),
        tracers: pooled_tracers(&file, &pool, 2),
        pool: threads.into(),
        g_stage: Box::new(CpuStage::default()),
    };
    let mut session = Session::new(setup, &budget).unwrap();
    let stats = session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert!(stats.complete);
    let (pages, stats) = (pool.frames(), pool.stats());
    assert!(frames_bytes > smallest || stats.evictions > 0, "{spec}: {pages:?} {stats:?}");
    let pixels = (0..SIDE * SIDE).map(|at| [at % SIDE, at / SIDE]);
    pixels.map(|pixel| session.film().radiance(pixel)).collect()
}

#[test]
fn a_ray_through_more_pages_than_there_are_frames_ends() {
    let units = build::Voxels::Refined { upper: 64, refinement: Refinement::By16 };
    for (spec, voxels, method) in [
        // Large triangles in a heap: a ray crosses the boxes of most pages.
        ("gen:soup:150k:2", build::Voxels::None, Method::Direct),
        ("gen:isosurface:50k:2", units, Method::DebugLower),
    ] {
        let all = picture(spec, voxels, method, Some(1 << 30));
        assert!(all.iter().any(|rgb| *rgb != all[0]), "{spec}: nothing is seen");
        assert!(picture(spec, voxels, method, None) == all, "{spec}");
    }
}
