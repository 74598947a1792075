//! The end of `--time-limit`: every stage of a picture asks the clock, the look at the opening view included, and so
//! does a single ray on its way through a whole model.

use crate::command::{document_in, folder};
use crate::fixtures::{built_in, model};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;
use trex_model::{Model, OpenOptions};
use trex_render::{
    Answer, CpuStage, Hit, Layers, Method, NaiveMesh, NaiveTriangle, Page, PagedTracer, Pages, Ray,
    RenderKeys, Scene, Session, SessionSetup, Tracer, WorkerThreads, pooled_tracers,
};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Aabb, Budget, Interrupt, Material, StopSignal};

/// Look-ups within which a ray ends once it is to stop.
const LOOK_UPS: usize = 64;

/// The look at the opening view went on to its end, however long that took: nobody asked the clock there.
#[test]
fn a_time_that_is_over_ends_every_stage() {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:10k --voxels 64", "m.trex");
    let picture = "render m.trex -o m.exr --overwrite --resolution 64x48 --spp 2 --photons 20k --light auto \
                   --exposure auto";
    for flags in ["photon", "photon --bake", "full-gi", "path", "direct", "ao", "photon --t-max 33"] {
        let line = format!("{picture} --integrator {flags}");
        let ended = document_in(inside.path(), &format!("{line} --time-limit 0.001ms"));
        assert_eq!(
            (&ended["spp"], &ended["exposure"], &ended["light"]),
            (&0.into(), &1.0.into(), &"scene".into())
        );
        assert_eq!(
            (&ended["photons"]["photons"], &ended["complete_ms"]),
            (&0.into(), &serde_json::Value::Null)
        );
        assert_eq!(ended["rays"]["primary"], 0, "{flags}: {ended:#}");
        // Times that no clock tells are no limit, and no panic.
        let whole = document_in(inside.path(), &format!("{line} --time-limit 1e300"));
        assert_eq!(whole["spp"], 2, "{flags}: {whole:#}");
        assert!(whole["exposure"] != 1.0 || flags == "ao", "{flags}: {whole:#}");
    }
}

/// Photons took all of the time, and the picture was black: they have half of it.
#[test]
fn photons_leave_time_for_samples() {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:10k --voxels 64", "m.trex");
    let line = "render m.trex -o m.exr --overwrite --resolution 16x16 --spp 1 --photons 1G --time-limit 2s";
    for flags in ["", "--t-max 33"] {
        let ended = document_in(inside.path(), &format!("{line} {flags}"));
        let photons = ended["photons"]["photons"].as_u64().unwrap();
        assert!(photons > 0 && photons < 1_000_000_000, "{flags}: {photons} photons");
        assert_eq!(ended["spp"], 1, "{flags}: {ended:#}");
    }
}

/// The clock was asked between tiles alone: a ray through five million copies of a triangle takes longer than many
/// tiles of other models, and a tile has hundreds of rays.
#[test]
fn a_ray_on_its_way_ends_when_it_is_to_stop() {
    let built = model("gen:soup:150k:2");
    let path = built.file.path();
    let pool =
        PagePool::open(built.file.clone(), path, &Budget::unlimited(), &PoolOptions::default()).unwrap();
    let pages = built.file.pages().len() as u32;
    assert!(pages as usize > LOOK_UPS / 4, "{pages} pages are too few");
    (0..pages).for_each(|page| drop(pool.pin_blocking(page).unwrap()));
    let mut tracers = pooled_tracers(&built.file, &Arc::new(pool), 1);
    let (tracer, interrupt) = (&mut tracers[0], Interrupt::default());
    tracer.stop_by(&StopSignal::new(&interrupt, None));
    let [lo, hi] = [built.file.superblock().bounds.lo, built.file.superblock().bounds.hi];
    let direction = std::array::from_fn(|axis| hi[axis] - lo[axis]);
    let ray = Ray { origin: lo, direction, t_max: f64::INFINITY };
    for _ in 0..LOOK_UPS {
        assert!(matches!(tracer.intersect(&ray), Answer::Exact(_)), "nobody has said stop");
    }
    interrupt.raise();
    let is_there = |page: Page<'_>| matches!(page, Page::Ready(_));
    let look_ups = (0..LOOK_UPS).take_while(|_| is_there(tracer.pages_mut().page(0))).count();
    assert!(look_ups < LOOK_UPS, "all of {look_ups} look-ups found the page");
    assert!((0..pages).all(|page| !is_there(tracer.pages_mut().page(page))));
    assert_eq!(tracer.intersect(&ray), Answer::Blocked);
    // A tracer that is to work for somebody else goes on.
    tracer.stop_by(&StopSignal::default());
    assert!(matches!(tracer.intersect(&ray), Answer::Exact(_)));
}

/// Within a tile, too: what it has is not on the film, and the film is as it was.
#[test]
fn a_tile_under_way_ends_when_it_is_to_stop() {
    let built = model("gen:soup:150k:2");
    let model = Model::open(built.file.path(), &OpenOptions::with_limit(1 << 30)).unwrap();
    // One tile, and many samples of it.
    let render = RenderKeys { integrator: Method::Path, resolution: [8, 8], ..RenderKeys::default() };
    let mut session = model.session(&Scene { render, ..Scene::default() }).unwrap();
    let interrupt = Interrupt::default();
    let stop = StopSignal::new(&interrupt, None);
    session.stop_by(&stop);
    // The tracers learn of it first: what they block waits, and ends with the next question.
    let asked = AtomicU32::new(0);
    let ask = || {
        let times = asked.fetch_add(1, Ordering::Relaxed);
        if times == 3 {
            interrupt.raise();
        }
        times > 3
    };
    let stats = session.render(64, &ask, &mut |_, _| ControlFlow::Continue(()));
    assert!(!stats.complete && session.film().samples() == stats.spp, "{stats:?}");
    session.stop_by(&StopSignal::default());
    let stats = session.render(4, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert!(stats.complete, "it goes on where it was");
}

/// A mesh that counts the rays that are asked of it.
struct RayCounter {
    mesh: NaiveMesh,
    rays: Arc<AtomicU64>,
}

impl Tracer for RayCounter {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        self.rays.fetch_add(1, Ordering::Relaxed);
        self.mesh.intersect(ray)
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        self.mesh.occluded(ray)
    }
}

impl PagedTracer for RayCounter {
    fn begin_tile(&mut self) {}

    fn request_missing(&mut self) -> usize {
        0
    }

    fn wait(&mut self, _: Duration) {}
}

/// Photons on the mesh were asked between batches of 4,096 alone.
#[test]
fn photons_under_way_end_when_they_are_to_stop() {
    const ENOUGH: u64 = 10;
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let rays = Arc::new(AtomicU64::new(0));
    let mesh = NaiveMesh::new(vec![NaiveTriangle { corners, material: 0 }]);
    let tracers = vec![RayCounter { mesh, rays: rays.clone() }];
    let mut model = trex_render::Model {
        bounds: Aabb { lo: [0.0; 3], hi: [1.0, 1.0, 0.0] },
        outline: Default::default(),
        materials: vec![Material::default()],
        names: Arc::new(["default"].into_iter().collect()),
        emitters: vec![],
        voxels: None,
    };
    let text = "model = 'a.trex'\n[render]\nintegrator = 'full-gi'\nresolution = [8, 8]\nphotons = 100000";
    let view = Scene::parse(text, "a.toml".as_ref()).unwrap().view(&mut model).unwrap();
    let (pool, g_stage) = (WorkerThreads::start(1).unwrap(), Box::new(CpuStage::default()));
    let setup =
        SessionSetup { model, view, layers: Layers::default(), portion: None, tracers, pool, g_stage };
    let mut session = Session::new(setup, &Budget::unlimited()).unwrap();
    let stats = session.illuminate(&|| rays.load(Ordering::Relaxed) >= ENOUGH, &mut |_, _| {}).unwrap();
    let asked = rays.load(Ordering::Relaxed);
    assert!((ENOUGH..100).contains(&asked) && stats.photons == 0, "{asked} rays, {stats:?}");
}
