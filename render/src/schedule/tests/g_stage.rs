//! Tests of passes whose G-rays go through a stage, against samples whose rays are asked one by one.

use crate::g_stage::{CpuStage, GCall, GEnd, GNeeds, GStage, GTurn};
use crate::integrate::{RenderContext, SampleIntegrator};
use crate::photon::irradiance::{Irradiance, MapForm, PhotonMap};
use crate::photon::voxel::VoxelPhotons;
use crate::scene::camera::Camera;
use crate::scene::method::{Method, Near};
use crate::scene::settings::RenderKeys;
use crate::scene::world::{Model, View, World};
use crate::schedule::{Canvas, Pass, SampleWork, TileWork, Until, WhenFull, Workers};
use crate::shading::light::Light;
use crate::testing::{pool, settings};
use crate::trace::{Answer, NaiveMesh, NaiveTriangle, NoPages, Pages};
use crate::voxel::{Occluders, Voxels};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use trex_film::{Film, Layers, Tiles, mix};
use trex_store::build::{BuildOptions, build};
use trex_store::import::{self, ImportOptions};
use trex_store::{Aabb, Budget, PageFile, Result};

const RESOLUTION: [u32; 2] = [33, 18];

/// A heap of triangles, every third a mirror: as a mesh, and as a file with voxels.
fn heap() -> (Vec<NaiveTriangle>, Model, PageFile) {
    let number = |key: u64| (mix(key) >> 11) as f64 / (1u64 << 53) as f64;
    let place = |key: u64| -> [f64; 3] { std::array::from_fn(|axis| number(3 * key + axis as u64)) };
    let triangle = |index: u64| {
        let first = place(10 * index);
        let near =
            |key| std::array::from_fn(|axis| (first[axis] + 0.6 * (place(key)[axis] - 0.5)).clamp(0.0, 1.0));
        NaiveTriangle {
            corners: [first, near(10 * index + 1), near(10 * index + 2)],
            material: index.is_multiple_of(3).into(),
        }
    };
    let triangles: Vec<_> = (0..40).map(triangle).collect();

    let folder = tempfile::tempdir().unwrap();
    let (obj, mtl, output) =
        (folder.path().join("heap.obj"), folder.path().join("heap.mtl"), folder.path().join("heap.trex"));
    std::fs::write(mtl, "newmtl grey\nKd 0.6 0.5 0.4\nnewmtl mirror\nKd 0 0 0\nKs 0.8 0.8 0.8\nillum 3\n")
        .unwrap();
    let mut text = String::from("mtllib heap.mtl\n");
    for (index, triangle) in triangles.iter().enumerate() {
        for [x, y, z] in triangle.corners {
            text += &format!("v {x} {y} {z}\n");
        }
        let first = 3 * index + 1;
        let name = if triangle.material == 0 { "grey" } else { "mirror" };
        text += &format!("usemtl {name}\nf {first} {} {}\n", first + 1, first + 2);
    }
    std::fs::write(&obj, text).unwrap();
    let mut source = import::open(&obj, &ImportOptions::unlimited(folder.path())).unwrap();
    let options = BuildOptions {
        precision: trex_store::build::Precision::Default,
        voxels: trex_store::build::Voxels::Resolution(64),
        pool: pool(1),
        budget: Budget::unlimited(),
        temp_dir: None,
        existing: Default::default(),
        interrupt: Default::default(),
        resume: None,
    };
    build(&mut *source, &output, &options, &|_| {}, &|_| {}).unwrap();
    let file = PageFile::open(&output, &Budget::unlimited()).unwrap();
    let voxels = Voxels::open(&file, &Budget::unlimited()).unwrap().map(Arc::new);
    let bounds = Aabb { lo: [0.0; 3], hi: [1.0; 3] };
    let model = Model {
        bounds,
        outline: Default::default(),
        materials: file.materials().to_vec(),
        names: Arc::default(),
        emitters: vec![],
        voxels,
    };
    (triangles, model, file)
}

/// Asks rays one by one; a batch is as large as it is told.
#[derive(Debug)]
struct Naive {
    voxels: Arc<Voxels>,
    needs: GNeeds,
    batches: AtomicU64,
    /// Rays of the largest call.
    largest: AtomicU64,
}

impl Naive {
    fn new(model: &Model, batch_samples: usize) -> Naive {
        let needs = GNeeds { batch_rays: 8 * batch_samples, ray_bytes: 0, calls: 1, photons: 512 };
        let (batches, largest) = (AtomicU64::new(0), AtomicU64::new(0));
        Naive { voxels: model.voxels.clone().unwrap(), needs, batches, largest }
    }
}

impl GStage for Naive {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.voxels = octree.clone();
        Ok(())
    }

    fn needs(&self) -> GNeeds {
        self.needs
    }

    fn submit(&self, mut call: GCall, _pages: &mut dyn Pages) -> GTurn {
        self.batches.fetch_add(1, Ordering::Relaxed);
        let rays: usize = call.parts.iter().map(|part| part.rays().len()).sum();
        self.largest.fetch_max(rays as u64, Ordering::Relaxed);
        let voxels = self.voxels.scene(call.view.occluders);
        for part in &mut call.parts {
            let (rays, answers) = part.parts_mut();
            rays.iter().zip(answers).for_each(|(ray, answer)| *answer = voxels.answer(ray));
        }
        GTurn::Answered(call)
    }
}

/// A call, and where its answers are waited for.
type PendingCall = (GCall, Sender<GEnd>);

/// Answers on a thread of its own, which keeps calls until two or more wait, or none has come for a while, and answers
/// the latest first: late, and out of order.
#[derive(Debug)]
struct Late {
    needs: GNeeds,
    calls: Option<Sender<PendingCall>>,
    /// Gives how many calls were answered before an earlier one.
    thread: Option<JoinHandle<u64>>,
}

impl Late {
    fn new(model: &Model, calls: usize) -> Late {
        let needs = GNeeds { batch_rays: 8 * 40, ray_bytes: 0, calls, photons: 512 };
        let (naive, (sender, asked)) = (Naive::new(model, 40), channel::<PendingCall>());
        let answer_all = move || {
            let (mut waiting, mut overtaken) = (Vec::new(), 0);
            loop {
                match asked.recv_timeout(Duration::from_millis(5)) {
                    Ok(call) => {
                        waiting.push(call);
                        if waiting.len() < calls.max(2) {
                            continue;
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return overtaken,
                }
                let Some((call, answered)) = waiting.pop() else { continue };
                overtaken += u64::from(!waiting.is_empty());
                let call = naive.submit(call, &mut NoPages).wait();
                answered.send(Box::new(|| call)).unwrap();
            }
        };
        Late { needs, calls: Some(sender), thread: Some(std::thread::spawn(answer_all)) }
    }

    /// Ends. How many calls were answered before an earlier one.
    fn overtaken(mut self) -> u64 {
        self.calls = None;
        self.thread.take().unwrap().join().unwrap()
    }
}

impl GStage for Late {
    fn set_octree(&mut self, _octree: &Arc<Voxels>) -> Result<()> {
        unreachable!("it has one")
    }

    fn needs(&self) -> GNeeds {
        self.needs
    }

    fn submit(&self, call: GCall, _pages: &mut dyn Pages) -> GTurn {
        let (to, answered) = channel();
        self.calls.as_ref().unwrap().send((call, to)).unwrap();
        GTurn::UnderWay(answered)
    }
}

fn world(model: &Model, (method, near): (Method, Near), lod_error: f64) -> World {
    let camera = Camera::framing(&model.bounds, RESOLUTION, None, None);
    let point = Light::Point { position: [2.0, 3.0, 2.0], intensity: [9.0; 3] };
    let lights = vec![point, Light::Sky { radiance: [0.3; 3] }];
    // More rays than are asked for at a time.
    let keys = RenderKeys {
        integrator: method,
        resolution: RESOLUTION,
        n_shadow: 3,
        n_gather: 11,
        lod_error,
        near,
        seed: 5,
        ..RenderKeys::default()
    };
    World::new(model, &View { camera, lights, settings: settings(keys), parts: Default::default() }).unwrap()
}

/// Count of photons that are sent.
const PHOTONS: u64 = 10_000;

/// What photons bring to the voxels, through a stage.
fn light(world: &World, model: &Model, g_stage: &dyn GStage) -> PhotonMap {
    let (voxels, pool, budget) = (model.voxels.as_ref().unwrap(), pool(1), Budget::unlimited());
    let mut map = PhotonMap::new(MapForm { facets: voxels.facet_count(), caustics: false }, &budget).unwrap();
    let voxels = voxels.scene(Occluders::On);
    let photons =
        VoxelPhotons { world, bounds: &model.bounds, voxels, g_stage, pool: &pool, budget: &budget };
    photons.trace((&mut photons.begin(map.form()).unwrap(), &mut map), PHOTONS, &|| false, &mut |_| {});
    map
}

/// The film of one sample a pixel.
fn film(work: SampleWork<'_>, triangles: &[NaiveTriangle], workers: usize) -> Vec<[f32; 3]> {
    let (mut film, tiles) =
        (Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap(), Tiles::z_curve(RESOLUTION));
    let mut tracers = vec![NaiveMesh::new(triangles.to_vec()); workers];
    let until = Until { stop: &|| false, deadline: None, tiles: u32::MAX };
    let mut pass = Pass::new(1, workers, WhenFull::Wait);
    let work = TileWork { samples: work, tiles: &tiles };
    let canvas = Canvas { film: &mut film, display: None };
    pass.run(&work, canvas, Workers { tracers: &mut tracers, pool: &pool(workers) }, &until);
    (0..RESOLUTION[1])
        .flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]))
        .map(|at| film.radiance(at))
        .collect()
}

#[test]
fn every_stage_and_batch_gives_the_samples_of_rays_asked_alone() {
    let (triangles, model, _file) = heap();
    let mut overtaken = 0;
    for (method, near, lod_error) in [
        (Method::Photon, Near::Voxel, 0.0),
        (Method::Photon, Near::Voxel, 8.0),
        (Method::Photon, Near::Contact, 0.0),
        (Method::Photon, Near::Exact, 0.0),
        (Method::Ao, Near::Voxel, 0.0),
        (Method::Ao, Near::Contact, 0.0),
        (Method::Ao, Near::Exact, 8.0),
        (Method::Direct, Near::Voxel, 8.0),
        (Method::DebugOccluders, Near::Voxel, 0.0),
    ] {
        let world = world(&model, (method, near), lod_error);
        let light = light(&world, &model, &Naive::new(&model, 1));
        let irradiance = Irradiance::new(&light, None);
        let integrator = SampleIntegrator::new(RenderContext::new(&world, &model, irradiance));
        let mut mesh = NaiveMesh::new(triangles.clone());
        let naive = Naive::new(&model, 1);
        let mut alone = |at: [u32; 2]| {
            let Answer::Exact(sample) = integrator.advance(&mut integrator.start(at, 0), &mut mesh, &naive)
            else {
                panic!("the naive mesh has all its pages");
            };
            sample.radiance.to_array()
        };
        let pixels = (0..RESOLUTION[1]).flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]));
        let expected: Vec<[f32; 3]> = pixels.map(&mut alone).collect();
        let lit = expected.iter().filter(|radiance| radiance[0] > 0.0).count();
        assert!(lit > expected.len() / 8, "{lit} pixels see anything");

        let mut cpu = CpuStage::default();
        cpu.set_octree(model.voxels.as_ref().unwrap()).unwrap();
        let case = format!("{method:?} {near:?} {lod_error}");
        assert!(film(SampleWork { integrator, g_stage: &cpu }, &triangles, 2) == expected, "{case}");
        for (batch_samples, workers) in [(1, 1), (100, 3), (1 << 40, 1)] {
            let naive = Naive::new(&model, batch_samples);
            let found = film(SampleWork { integrator, g_stage: &naive }, &triangles, workers);
            assert!(found == expected, "{case}, {batch_samples} samples a batch, {workers} workers");
            // A batch that takes all there is needs one for each group of rays on a path's way, mirrors included.
            let batches = naive.batches.load(Ordering::Relaxed);
            assert!(batches > 0 && (batch_samples < 1 << 40 || batches <= 100), "{case}: {batches} batches");
        }
        for (calls, workers) in [(1, 2), (3, 1), (3, 2)] {
            let late = Late::new(&model, calls);
            let found = film(SampleWork { integrator, g_stage: &late }, &triangles, workers);
            assert!(found == expected, "{case}, {workers} workers with {calls} calls under way each");
            overtaken += late.overtaken();
        }
    }
    assert!(overtaken > 0, "no call was answered before an earlier one");
}

/// Photons came 512 at a time, whatever the stage: too few for a device that answers a million rays at once.
#[test]
fn photons_come_in_batches_that_the_stage_asks_for_and_bring_the_same_light() {
    let (_, model, _file) = heap();
    let world = world(&model, (Method::Photon, Near::Voxel), 0.0);
    let mut cpu = CpuStage::default();
    cpu.set_octree(model.voxels.as_ref().unwrap()).unwrap();
    assert_eq!(cpu.needs().photons, 512);
    let expected = light(&world, &model, &cpu);
    assert!(expected.irradiance().any(|rgb| rgb[0] > 0.0));
    for photons in [1, 512, 7000, 1 << 40] {
        let mut stage = Naive::new(&model, 1);
        stage.needs.photons = photons;
        let found = light(&world, &model, &stage);
        assert_eq!(stage.largest.load(Ordering::Relaxed), PHOTONS.min(photons as u64), "{photons}");
        assert!(found.irradiance().eq(expected.irradiance()), "{photons}");
    }
}
