//! Pictures through the fewest frames that a pool can have: a ray that crosses more pages than there are frames comes
//! to its end, with the hit that it has where all pages are there.

use crate::fixtures::model_with;
use std::ops::ControlFlow;
use trex_model::{Model, OpenOptions};
use trex_render::{Method, RenderKeys, Scene};
use trex_store::build;
use trex_store::layout::FRAME_BYTES;
use trex_store::octree::Refinement;
use trex_store::pool::FRAMES_MIN;

const SIDE: u32 = 6;

/// The frames of a picture.
#[derive(Clone, Copy, PartialEq)]
enum Frames {
    /// One for every page.
    All,
    /// The fewest that a pool can have.
    Fewest,
}

/// The samples of a picture from inside of the model by `method`.
fn picture(spec: &str, voxels: build::Voxels, method: Method, frames: Frames) -> Vec<[f32; 3]> {
    let built = model_with(spec, voxels);
    let model = Model::open(built.file.path(), &OpenOptions::with_limit(2 << 30)).unwrap();
    let render =
        RenderKeys { integrator: method, resolution: [SIDE; 2], n_shadow: 1, ..RenderKeys::default() };
    let mut session = model.session(&Scene { render, ..Scene::default() }).unwrap();
    let pool = model.pool().unwrap();
    if frames == Frames::Fewest {
        // No limit of a model leaves so few: the room is taken from the pool itself.
        pool.set_limit((FRAMES_MIN * FRAME_BYTES) as u64).unwrap();
    }
    let stats = session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert!(stats.complete);
    let (pages, stats) = (pool.frames(), pool.stats());
    assert!(frames == Frames::All || stats.evictions > 0, "{spec}: {pages:?} {stats:?}");
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
        let all = picture(spec, voxels, method, Frames::All);
        assert!(all.iter().any(|rgb| *rgb != all[0]), "{spec}: nothing is seen");
        assert!(picture(spec, voxels, method, Frames::Fewest) == all, "{spec}");
    }
}
