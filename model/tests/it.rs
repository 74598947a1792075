//! A model as a library's user has it: opened, asked for rays and pictures from several threads, under a limit that is
//! tight.

#[path = "it/all_hits.rs"]
mod all_hits;
#[path = "it/built.rs"]
mod built;
#[path = "it/opening.rs"]
mod opening;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;
use tempfile::TempDir;
use trex_model::{DamagePolicy, LiveSession, Model, OpenOptions, Pace, SessionOptions};
use trex_render::{
    AllResident, Answer, Event, Filter, FrameOptions, FrameProgress, Hit, Method, PagedMesh, PictureNeeds,
    Ray, RenderKeys, RenderSettings, Scene, Tracer,
};
use trex_store::{Budget, Code, Error, Interrupt, PageFile, RESERVE_BYTES};

struct Files {
    folder: TempDir,
    path: PathBuf,
}

/// A small iso-surface with voxels, built once.
fn files() -> &'static Files {
    static FILES: OnceLock<Files> = OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = built::build(folder.path());
        Files { folder, path }
    })
}

fn options(limit_mib: u64) -> OpenOptions {
    OpenOptions {
        threads: trex_model::ThreadSource::Start(2.try_into().unwrap()),
        ..OpenOptions::with_limit(limit_mib << 20)
    }
}

fn open(limit_mib: u64) -> Model {
    Model::open(&files().path, &options(limit_mib)).unwrap()
}

/// Rays through the model in all directions, from around it.
fn rays(count: usize) -> Vec<Ray> {
    let file = PageFile::open(&files().path, &Budget::unlimited()).unwrap();
    let (center, reach) = (file.superblock().bounds.center(), file.superblock().bounds.diagonal());
    let ray = |i: usize| {
        let turn = |step: f64| (i as f64 * step).fract() * 2.0 - 1.0;
        let from = [turn(0.618_034), turn(0.754_878), turn(0.569_840)];
        let to = [turn(0.819_173), turn(0.671_044), turn(0.549_700)];
        let origin = std::array::from_fn(|axis| center[axis] + reach * from[axis]);
        let target: [f64; 3] = std::array::from_fn(|axis| center[axis] + 0.4 * reach * to[axis]);
        let t_max = if i.is_multiple_of(3) { f64::INFINITY } else { 0.9 };
        Ray { origin, direction: std::array::from_fn(|axis| target[axis] - origin[axis]), t_max }
    };
    (0..count).map(ray).collect()
}

/// The answers of a tracer that has all pages, one ray at a time.
fn expected(rays: &[Ray]) -> Vec<Option<Hit>> {
    let file = std::sync::Arc::new(PageFile::open(&files().path, &Budget::unlimited()).unwrap());
    let resident = AllResident::load(&file);
    let mut tracer = PagedMesh::new(&file, &resident);
    let answer = |ray| match tracer.intersect(ray) {
        Answer::Exact(hit) => hit,
        Answer::Blocked => panic!("all pages are there"),
    };
    rays.iter().map(answer).collect()
}

fn scene() -> Scene {
    let mut scene = Scene::default();
    (scene.render.resolution, scene.render.spp, scene.render.photons) = ([40, 30], 2, 20_000);
    scene
}

fn png(model: &Model) -> Vec<u8> {
    let mut png = vec![];
    model.render(&scene(), &Interrupt::default(), &|_| {}).unwrap().write_png(&mut png).unwrap();
    png
}

#[test]
fn rays_of_several_threads_are_answered_exactly() {
    let model = open(96);
    let rays = rays(10_000);
    let expected = expected(&rays);
    assert!(expected.iter().flatten().count() > 1000 && expected.iter().any(Option::is_none));
    thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                let interrupt = Interrupt::default();
                assert!(model.intersect(&rays, &interrupt).unwrap() == expected);
                let are_hit: Vec<bool> = expected.iter().map(Option::is_some).collect();
                assert!(model.occluded(&rays, &interrupt).unwrap() == are_hit);
                assert!(model.intersect(&rays[7..8], &interrupt).unwrap() == expected[7..8]);
                assert!(model.intersect(&[], &interrupt).unwrap().is_empty());
            });
        }
    });
    let bytes = model.budget().used_bytes();
    assert_eq!(model.intersect(&rays, &Interrupt::default()).unwrap().len(), rays.len());
    assert_eq!(model.budget().used_bytes(), bytes, "a call keeps nothing");
}

#[test]
fn what_is_no_ray_is_refused_and_an_interrupt_ends_a_call() {
    let model = open(96);
    let good = rays(1)[0];
    for bad in [
        Ray { origin: [f64::NAN, 0.0, 0.0], ..good },
        Ray { direction: [0.0; 3], ..good },
        Ray { direction: [f64::INFINITY, 0.0, 0.0], ..good },
        Ray { t_max: f64::NAN, ..good },
        Ray { t_max: -1.0, ..good },
    ] {
        let error = model.intersect(&[good, bad], &Interrupt::default()).unwrap_err();
        assert_eq!((error.code(), error.place()), (Code::Usage, "ray 1 of 2"), "{bad:?}");
    }
    let interrupt = Interrupt::default();
    interrupt.raise();
    assert_eq!(model.intersect(&rays(5000), &interrupt).unwrap_err().code(), Code::Interrupted);
    assert_eq!(model.render(&scene(), &interrupt, &|_| {}).err().unwrap().code(), Code::Interrupted);
}

/// A picture is that of a session alone, whatever else the model is asked for meanwhile.
#[test]
fn pictures_and_rays_at_a_time_do_not_change_each_other() {
    let alone = png(&open(256));
    let model = open(256);
    let rays = rays(3000);
    let expected = expected(&rays);
    thread::scope(|scope| {
        let pictures = [(); 2].map(|()| scope.spawn(|| png(&model)));
        assert!(model.intersect(&rays, &Interrupt::default()).unwrap() == expected);
        for picture in pictures {
            assert!(picture.join().unwrap() == alone);
        }
    });
    assert!(model.budget().peak_bytes() <= model.budget().ledger_bytes());
}

/// The pool has all that the session leaves; rays take what they need from its frames.
#[test]
fn rays_find_room_beside_a_session_under_its_smallest_limit() {
    let tight = |mib| {
        Model::open(&files().path, &options(mib))
            .and_then(|model| model.session(&scene()).map(|s| (model, s)))
    };
    let smallest = tight(30).err().unwrap().smallest_limit_bytes().unwrap();
    let mut options = options(0);
    options.budget = Budget::new(smallest);
    let model = Model::open(&files().path, &options).unwrap();
    let mut session = model.session(&scene()).unwrap();
    session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    let rays = rays(500);
    assert!(model.intersect(&rays, &Interrupt::default()).unwrap() == expected(&rays));
    assert!(model.budget().peak_bytes() <= smallest - RESERVE_BYTES);
}

#[test]
fn a_live_session_has_the_defaults_of_what_is_looked_at_and_outlives_its_model() {
    let model = open(256);
    let mut asked = scene();
    asked.given.photons = Some(20_000);
    let mut live = model.live(&asked, FrameOptions::default()).unwrap();
    drop(model);
    let settings = live.view().settings;
    assert_eq!((settings.lod_error, settings.filter, settings.photons), (1.0, Filter::Off, 20_000));
    let frames = (0..10_000).find(|_| live.frame(1, &|| false).progress == FrameProgress::Done);
    assert!(frames.is_some() && live.film().mean()[0] > 0.0);
    let settings = RenderSettings::new(RenderKeys { seed: 9, ..*settings }).unwrap();
    live.apply(Event::Settings(settings)).unwrap();
}

#[test]
fn a_file_without_voxels_is_shown_in_direct_light() {
    let path = files().folder.path().join("plain.trex");
    built::build_with(&path, "gen:isosurface:20k", trex_store::build::Voxels::None);
    let model = Model::open(&path, &options(128)).unwrap();
    assert_eq!(model.info().unwrap().voxel_resolution, None);
    let session = model.session(&scene()).unwrap();
    assert_eq!(session.view().settings.integrator, Method::Direct);
    let mut photon = scene();
    photon.given.integrator = Some(Method::Photon);
    assert_eq!(model.session(&photon).err().unwrap().code(), Code::SceneFormat);
    drop(session);
    let live = model.live(&scene(), FrameOptions::default()).unwrap();
    assert_eq!(live.view().settings.integrator, Method::Direct);
}

#[test]
fn a_limit_that_is_named_works() {
    for live in [false, true] {
        let mut limit = 25 << 20;
        let mut refusals = 0;
        loop {
            let mut options = options(0);
            options.budget = Budget::new(limit);
            let opened = Model::open(&files().path, &options).and_then(|model| match live {
                true => model.live(&scene(), FrameOptions::default()).map(drop),
                false => model.render(&scene(), &Interrupt::default(), &|_| {}).map(drop),
            });
            let Err(error) = opened else { break };
            assert_eq!(error.code(), Code::MemoryLimit);
            (limit, refusals) = (error.smallest_limit_bytes().unwrap(), refusals + 1);
        }
        assert_eq!(refusals, 1, "live: {live}");
    }
}

/// A live picture under a limit that has no room for all pages beside it, nor beside the one that takes its place.
struct Swap {
    limit_bytes: u64,
    model: Model,
    live: LiveSession,
    to_small: PictureNeeds,
    to_large: PictureNeeds,
}

const SMALL: [u32; 2] = [40, 30];
const LARGE: [u32; 2] = [240, 180];

impl Swap {
    fn new() -> Swap {
        let (small, large) = (SMALL, LARGE);
        let limit_bytes = Swap::open(30 << 20, large).err().unwrap().smallest_limit_bytes().unwrap();
        let (model, live) = Swap::open(limit_bytes, small).unwrap();
        let needs = |resolution| {
            let settings = RenderSettings::new(RenderKeys { resolution, ..*live.view().settings }).unwrap();
            let options = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
            options.needs_of(settings, 1)
        };
        let (to_small, to_large) = (needs(small), needs(large));
        Swap { limit_bytes, model, live, to_small, to_large }
    }

    fn open(limit_bytes: u64, resolution: [u32; 2]) -> Result<(Model, LiveSession), Error> {
        static PATH: OnceLock<PathBuf> = OnceLock::new();
        let path = PATH.get_or_init(|| {
            let path = files().folder.path().join("large.trex");
            built::build_with(&path, "gen:isosurface:600k", trex_store::build::Voxels::Resolution(64));
            path
        });
        let mut scene = scene();
        scene.render.resolution = resolution;
        let threads = trex_model::ThreadSource::Start(1.try_into().unwrap());
        let options = OpenOptions { threads, ..OpenOptions::with_limit(limit_bytes) };
        let model = Model::open(path, &options)?;
        let live = model.live(&scene, FrameOptions::default())?;
        Ok((model, live))
    }

    fn frames(&self) -> usize {
        self.model.pool().unwrap().frames().frames
    }
}

#[test]
fn a_picture_takes_the_place_of_another_or_leaves_all_as_it_was() {
    let mut swap = Swap::new();
    let (to_large, to_small, model) = (swap.to_large, swap.to_small, swap.model.clone());
    let before = swap.frames();
    let refused = model.exchange(&to_large, || Err(Error::interrupted())).unwrap_err();
    assert_eq!((refused.code(), swap.frames()), (Code::Interrupted, before));
    model.exchange(&to_large, || swap.live.apply(Event::Settings(to_large.settings))).unwrap();
    assert!(swap.frames() < before && swap.live.film().resolution() == LARGE, "{} {before}", swap.frames());
    model.exchange(&to_small, || swap.live.apply(Event::Settings(to_small.settings))).unwrap();
    assert_eq!((swap.frames(), swap.live.film().resolution()), (before, SMALL));
    assert!(model.budget().peak_bytes() <= swap.limit_bytes - RESERVE_BYTES);
}

/// A viewer ended when frames that a screenshot had taken were to come back while somebody else held their memory.
#[test]
fn frames_that_find_no_room_come_later() {
    let swap = Swap::new();
    let (large, small, model) = (swap.to_large, swap.to_small, &swap.model);
    let before = swap.frames();
    model.make_room(&[large]).unwrap();
    let fewer = swap.frames();
    assert!(fewer < before, "{fewer} of {before} frames");
    let others = model.budget().lease("others", model.budget().free_bytes()).unwrap();
    model.make_room(&[small]).unwrap();
    assert_eq!(swap.frames(), fewer);
    drop(others);
    model.make_room(&[small]).unwrap();
    assert_eq!(swap.frames(), before);
}

/// `exchange` had taken frames away for the larger picture; before that was leased, `make_room` of another thread
/// gave its bytes to frames again, and the larger picture was refused under a limit that has room for it. Sessions
/// took turns, the others did not.
#[test]
fn nobody_takes_the_room_that_was_made_for_another() {
    let mut swap = Swap::new();
    let (to_large, to_small, model) = (swap.to_large, swap.to_small, swap.model.clone());
    let limit_bytes = swap.limit_bytes;
    let makers: [&(dyn Fn() -> Result<(), Error> + Sync); 3] =
        [&|| model.make_room(&[to_small]), &|| model.set_limit(limit_bytes, &to_small), &|| {
            model.exchange(&to_small, || Ok(()))
        }];
    for (which, make) in makers.into_iter().enumerate() {
        let (sender, receiver) = channel();
        thread::scope(|scope| {
            let exchanged = model.exchange(&to_large, || {
                scope.spawn(move || sender.send(make()));
                // Long enough for the other to make its room, if nothing held it up.
                let _ = receiver.recv_timeout(Duration::from_millis(300));
                swap.live.apply(Event::Settings(to_large.settings))
            });
            exchanged.unwrap_or_else(|error| panic!("beside maker {which}: {error}"));
        });
        model.exchange(&to_small, || swap.live.apply(Event::Settings(to_small.settings))).unwrap();
    }
}

/// They were gone for good: one large call left all calls after it with few frames.
#[test]
fn frames_that_a_large_call_takes_come_back() {
    let swap = Swap::new();
    let asked = |count: usize| {
        swap.model.intersect(&rays(count), &Interrupt::default()).unwrap();
        swap.frames()
    };
    let before = asked(16);
    let meanwhile = asked(20_000);
    assert!(meanwhile < before, "{meanwhile} of {before} frames");
    assert_eq!(asked(16), before);
}

/// The answer is exact, or an error says that it may not be.
#[test]
fn damage_is_told_or_left_out_as_asked() {
    let path = files().folder.path().join("damaged.trex");
    let mut bytes = std::fs::read(&files().path).unwrap();
    let file = PageFile::open(&files().path, &Budget::unlimited()).unwrap();
    let rays = rays(3000);
    let page = expected(&rays).iter().flatten().next().unwrap().page;
    bytes[file.pages()[page as usize].offset as usize + 9] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let model = Model::open(&path, &options(96)).unwrap();
    assert_eq!(model.intersect(&rays, &Interrupt::default()).unwrap_err().code(), Code::Damaged);
    assert_eq!(model.damage()[0].0, page);
    let mut scene = Scene::default();
    (scene.render.resolution, scene.render.spp) = ([32, 32], 1);
    let rendered = |model: &Model| model.render(&scene, &Interrupt::default(), &|_| {}).map(drop);
    assert_eq!(rendered(&model).unwrap_err().code(), Code::Damaged);
    let left_out = OpenOptions { damage: DamagePolicy::LeaveOut, ..options(96) };
    let model = Model::open(&path, &left_out).unwrap();
    let hits = model.intersect(&rays, &Interrupt::default()).unwrap();
    assert!(hits.iter().flatten().all(|hit| hit.page != page) && hits.iter().flatten().count() > 100);
    rendered(&model).unwrap();
}
