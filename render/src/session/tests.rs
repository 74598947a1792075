//! Tests of the session: events, refusals, passes, memory, demand; and a floor with voxels for others.

use super::*;
use crate::g_stage::{CpuStage, GCall, GNeeds, GTurn};
use crate::integrate::rays_asked;
use crate::photon::kd_tree::PhotonTree;
use crate::scene::camera::Camera;
use crate::scene::method::{Filter, Method};
use crate::scene::settings::{RenderKeys, RenderSettings};
use crate::scene::world::MaterialEdit;
use crate::schedule::pass_bytes;
use crate::shading::light::{Emitters, Light};
use crate::testing::{pool, view};
use crate::trace::{Answer, Hit, NaiveMesh, NaiveTriangle, Pages, PartNeeds, Ray, Tracer};
use crate::voxel::Voxels;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use trex_film::film_bytes;
use trex_store::build::{self, BuildOptions, ExistingOutput, Precision};
use trex_store::import::{ImportOptions, open};
use trex_store::{Aabb, Code, Interrupt, Material, PageFile};

/// A floor, 18 wide, at z = 0.
const FLOOR: &str = "v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\nf 1 2 3 4\n";

/// A mesh that says that so many of 100 frames are in demand; blocked while it is absent.
#[derive(Clone, Debug)]
pub(super) struct DemandMesh {
    mesh: NaiveMesh,
    percent: usize,
    pub(super) is_absent: bool,
    /// The answer to whether anything is met; `None` for the mesh's own.
    pub(super) occluded: Option<Answer<bool>>,
}

impl Tracer for DemandMesh {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        if self.is_absent { Answer::Blocked } else { self.mesh.intersect(ray) }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        self.occluded.unwrap_or_else(|| self.mesh.occluded(ray))
    }
}

impl PagedTracer for DemandMesh {
    fn begin_tile(&mut self) {}

    fn request_missing(&mut self) -> usize {
        0
    }

    fn wait(&mut self, _longest: Duration) {}

    fn demand(&self, pages: &mut Vec<u64>) -> usize {
        pages.resize(2, 0);
        (0..self.percent).for_each(|page| pages[page / 64] |= 1 << (page % 64));
        100
    }
}

/// The processor, as a stage that asks for more room.
#[derive(Debug)]
struct Hungry {
    inner: CpuStage,
    needs: GNeeds,
}

impl GStage for Hungry {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.inner.set_octree(octree)
    }

    fn needs(&self) -> GNeeds {
        self.needs
    }

    fn submit(&self, call: GCall, pages: &mut dyn Pages) -> GTurn {
        self.inner.submit(call, pages)
    }
}

/// Light of `irradiance` from straight above [`FLOOR`].
pub(super) fn sun(irradiance: f32) -> Vec<Light> {
    vec![Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [irradiance; 3] }]
}

/// [`FLOOR`] in voxels, with `keys`.
pub(super) fn floor(keys: RenderKeys) -> Session<impl PagedTracer + Send> {
    floor_demanding(0, keys)
}

pub(super) fn floor_demanding(percent: usize, keys: RenderKeys) -> Session<DemandMesh> {
    floor_on(FLOOR, Box::new(CpuStage::default()), percent, keys).0
}

/// [`FLOOR`] under a roof, 2 wide, that is in the voxels alone.
pub(super) fn roofed_floor(keys: RenderKeys) -> Session<DemandMesh> {
    let obj = format!("{FLOOR}v -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\nf 5 6 7 8\n");
    floor_on(&obj, Box::new(CpuStage::default()), 0, keys).0
}

/// [`FLOOR`] in the voxels of `obj`, whose G-rays are answered by `g_stage`, and the file of these.
fn floor_on(
    obj: &str,
    g_stage: Box<dyn GStage>,
    percent: usize,
    keys: RenderKeys,
) -> (Session<DemandMesh>, PageFile) {
    let folder = tempfile::tempdir().unwrap();
    let (input, path) = (folder.path().join("floor.obj"), folder.path().join("floor.trex"));
    std::fs::write(&input, obj).unwrap();
    let budget = Budget::unlimited();
    let options = BuildOptions {
        precision: Precision::Default,
        voxels: build::Voxels::Resolution(64),
        pool: pool(1),
        budget: budget.clone(),
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt: Interrupt::default(),
    };
    let mut source = open(&input, &ImportOptions::unlimited(folder.path())).unwrap();
    build::build(&mut *source, &path, &options, &|_| {}, &|_| {}).unwrap();
    let file = PageFile::open(&path, &budget).unwrap();
    let voxels = Some(Arc::new(Voxels::open(&file, &budget).unwrap().unwrap()));
    let model = Model {
        bounds: file.superblock().bounds,
        outline: Default::default(),
        materials: file.materials().to_vec(),
        names: file.material_names().clone(),
        emitters: vec![],
        voxels,
    };
    let corners = [[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]];
    let half = |at: [usize; 3]| NaiveTriangle { corners: at.map(|corner| corners[corner]), material: 0 };
    let mesh = NaiveMesh::new(vec![half([0, 1, 2]), half([0, 2, 3])]);
    let view = view([0.0, 0.0, 3.0], 30.0, sun(1.0), keys);
    let tracers = vec![DemandMesh { mesh, percent, is_absent: false, occluded: None }];
    let layers = Layers { filter: keys.filter == Filter::On, ..Layers::default() };
    let setup = SessionSetup { model, view, layers, portion: None, tracers, pool: pool(1).into(), g_stage };
    (Session::new(setup, &budget).unwrap(), file)
}

fn session(budget: &Budget) -> Result<Session<NaiveMesh>> {
    let corners = [[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]];
    let mesh = NaiveMesh::new(vec![NaiveTriangle { corners, material: 0 }]);
    let bounds = Aabb { lo: [-9.0, -9.0, 0.0], hi: [9.0, 9.0, 0.0] };
    let model = Model {
        bounds,
        outline: Default::default(),
        materials: vec![Material::default()],
        names: Default::default(),
        emitters: vec![],
        voxels: None,
    };
    let lights = vec![Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [1.0; 3] }];
    let keys = RenderKeys { resolution: [16, 16], n_shadow: 1, seed: 0, ..RenderKeys::default() };
    let view = view([0.0, 0.0, 3.0], 30.0, lights, keys);
    let setup = SessionSetup {
        model,
        view,
        layers: Layers::default(),
        portion: None,
        tracers: vec![mesh; 2],
        pool: pool(2).into(),
        g_stage: Box::new(CpuStage::default()),
    };
    Session::new(setup, budget)
}

fn mean(session: &mut Session<NaiveMesh>) -> f64 {
    session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    session.film().mean()[0] * std::f64::consts::PI
}

#[test]
fn events_change_the_picture_and_refused_ones_do_not() {
    let mut session = session(&Budget::unlimited()).unwrap();
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-5, "{a} {b}");
    near(mean(&mut session), 0.7);
    let darker = MaterialEdit { kd: Some([0.2; 3]), ..MaterialEdit::default() };
    session.apply(Event::Material { index: 0, edit: darker }).unwrap();
    assert_eq!(session.film().samples(), 0);
    near(mean(&mut session), 0.2);
    let lights = vec![Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [3.0; 3] }];
    session.apply(Event::Lights(lights)).unwrap();
    near(mean(&mut session), 0.6);
    let away = Camera { target: [0.0, 0.0, 9.0], ..session.view().camera };
    session.apply(Event::Camera(away)).unwrap();
    near(mean(&mut session), 0.0);

    let nowhere = Camera { target: away.position, ..away };
    let dark = Light::Sky { radiance: [-1.0; 3] };
    let lamp = MaterialEdit { ke: Some([1.0; 3]), ..MaterialEdit::default() };
    let before = session.view().camera;
    for event in [Event::Camera(nowhere), Event::Lights(vec![dark]), Event::Material { index: 0, edit: lamp }]
    {
        assert_eq!(session.apply(event).unwrap_err().code(), Code::SceneFormat);
    }
    assert_eq!((session.view().camera, session.film().samples()), (before, 1));
    assert_eq!(session.model().materials[0].ke, [0.0; 3]);
}

#[test]
fn passes_grow_and_may_be_ended() {
    let mut session = session(&Budget::unlimited()).unwrap();
    let mut seen = vec![];
    let stats = session.render(13, &|| false, &mut |film, stats| {
        seen.push(film.samples());
        if stats.spp == 8 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert_eq!((seen.as_slice(), stats.complete), (&[1, 2, 4, 8][..], false));
    let stats = session.render(13, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert_eq!((stats.spp, stats.passes, stats.total.samples, stats.complete), (13, 2, 5 * 256, true));
}

#[test]
fn pictures_at_leisure_are_as_exact_as_was_asked_for_whatever_the_demand() {
    let picture = |percent| {
        let keys = RenderKeys { resolution: [16, 16], lod_error: 1.0, ..RenderKeys::default() };
        let mut session = floor_demanding(percent, keys);
        let distance = session.world.lod_distance;
        session.render(4, &|| false, &mut |_, _| ControlFlow::Continue(()));
        assert!(session.world.lod_distance == distance && distance.is_finite());
        (0..256).map(|at| session.film().radiance([at % 16, at / 16])).collect::<Vec<_>>()
    };
    assert_eq!(picture(100), picture(0));
}

/// The light of an open floor under a sky, whoever brings it: gather rays, or light samples where there are none.
#[test]
fn the_sky_lights_pictures_and_previews_without_gather_rays_too() {
    for integrator in [Method::Photon, Method::FullGi, Method::Path, Method::Direct] {
        for n_gather in [0, 2] {
            let keys =
                RenderKeys { integrator, n_gather, n_shadow: 1, photons: 5_000, ..RenderKeys::default() };
            let keys = RenderKeys { resolution: [16, 16], ..keys };
            let mut session = floor(keys);
            session.apply(Event::Lights(vec![Light::Sky { radiance: [1.0; 3] }])).unwrap();
            let mut live = floor(keys).go_live(FrameOptions::default()).unwrap();
            live.apply(Event::Lights(vec![Light::Sky { radiance: [1.0; 3] }])).unwrap();
            session.illuminate(&|| false, &mut |_, _| {}).unwrap();
            session.render(4, &|| false, &mut |_, _| ControlFlow::Continue(()));
            while live.live.display.step() != Some(2) {
                live.frame(1, &|| false);
            }
            let found = [session.film().radiance([8, 8])[1], live.shown([8, 8])[1]];
            let is_right = found.iter().all(|radiance| (radiance - 0.7).abs() < 0.01);
            assert!(
                is_right,
                "{integrator:?}, {n_gather} gather rays: at leisure and in a preview {found:?}"
            );
        }
    }
}

/// Photons that were stopped part-way, and light that is kept in another way, come to all that are asked for.
#[test]
fn light_is_of_all_photons_in_the_end() {
    const PHOTONS: u64 = 40_000;
    fn photons<T: PagedTracer + Send>(session: &Session<T>) -> Option<u64> {
        let tree = session.light.photon_tree().map(PhotonTree::photons);
        tree.or(session.light.photon_map().map(PhotonMap::photons))
    }
    for integrator in [Method::Photon, Method::FullGi] {
        let keys = RenderKeys { integrator, photons: PHOTONS, resolution: [8, 8], ..RenderKeys::default() };
        let stopped = || {
            let mut session = floor(keys);
            let asked = AtomicU32::new(0);
            session.illuminate(&|| asked.fetch_add(1, Ordering::Relaxed) > 2, &mut |_, _| {}).unwrap();
            assert!(photons(&session).is_some_and(|sent| sent < PHOTONS), "{integrator:?}");
            session
        };
        let mut session = stopped();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        assert_eq!(photons(&session), Some(PHOTONS), "{integrator:?} at leisure");
        let mut live = stopped().go_live(FrameOptions::default()).unwrap();
        for caustics in [false, integrator == Method::Photon] {
            let settings = RenderSettings::new(RenderKeys { caustics, ..keys }).unwrap();
            live.apply(Event::Settings(settings)).unwrap();
            while live.frame(2, &|| false).progress != FrameProgress::Done {}
            assert_eq!(
                photons(&live.session),
                Some(PHOTONS),
                "{integrator:?} in frames, caustics {caustics}"
            );
        }
    }
}

#[test]
fn a_film_that_does_not_fit_is_refused() {
    let copies = 6 * size_of::<Material>() as u64 + 2 * Emitters::bytes(0);
    let asked = rays_asked(&RenderKeys { n_shadow: 1, ..RenderKeys::default() });
    let passes = pass_bytes([16, 16], (2, false), asked, &CpuStage::default().needs());
    let bytes = passes + film_bytes([16, 16], Layers::default()) + copies;
    let limit = trex_store::RESERVE_BYTES + bytes;
    assert!(session(&Budget::new(limit)).is_ok());
    let error = session(&Budget::new(limit - 1)).unwrap_err();
    assert_eq!((error.code(), error.smallest_limit_bytes()), (Code::MemoryLimit, Some(limit)));
}

/// The plan once counted what the processor needs, whatever stage the session was made with: one with larger batches
/// took what the plan had given to pages.
#[test]
fn the_plan_counts_the_needs_of_the_stage_that_the_session_is_made_with() {
    const LIMIT: u64 = 1 << 40;
    for (integrator, is_live) in [(Method::Photon, false), (Method::Photon, true), (Method::Ao, false)] {
        let keys = RenderKeys { integrator, resolution: [40, 30], ..RenderKeys::default() };
        let bytes = |needs: GNeeds| {
            let (session, file) =
                floor_on(FLOOR, Box::new(Hungry { inner: CpuStage::default(), needs }), 0, keys);
            let (settings, layers) = (session.view.settings, session.film.layers());
            let picture = PictureNeeds {
                settings,
                layers,
                portion: None,
                workers: 1,
                g_needs: needs,
                is_live,
                copies_bytes: 0,
                parts: PartNeeds::default(),
            };
            let planned = MemoryPlan::new(&file, &picture, LIMIT).unwrap().film_bytes;
            let budget = session.budget.clone();
            if !is_live {
                return (planned, budget.used_bytes());
            }
            let _live = session.go_live(FrameOptions::default()).unwrap();
            (planned, budget.used_bytes())
        };
        let (planned, leased) = bytes(CpuStage::NEEDS);
        for needs in [
            GNeeds { batch_rays: 1 << 20, ..CpuStage::NEEDS },
            GNeeds { ray_bytes: 4096, ..CpuStage::NEEDS },
            GNeeds { calls: 3, ..CpuStage::NEEDS },
            GNeeds { photons: 1 << 20, ..CpuStage::NEEDS },
        ] {
            let (more_planned, more_leased) = bytes(needs);
            let is_asked = integrator == Method::Photon || needs.photons == CpuStage::NEEDS.photons;
            assert_eq!(more_planned > planned, is_asked, "{integrator:?} {needs:?}");
            assert_eq!(more_planned - planned, more_leased - leased, "{integrator:?} {needs:?}");
        }
    }
}
