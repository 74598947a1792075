//! Tests of passes whose G-rays go through a stage, against samples whose rays are asked one by one.

use crate::g_stage::{CpuStage, GAnswer, GKind, GRays, GStage};
use crate::image::film::{Film, Layers};
use crate::image::tile::Tiles;
use crate::integrate::{RenderContext, SampleIntegrator};
use crate::photon::irradiance::{Irradiance, PhotonMap};
use crate::photon::voxel::VoxelPhotons;
use crate::sampler::mix;
use crate::scene::camera::Camera;
use crate::scene::method::Method;
use crate::scene::settings::RenderKeys;
use crate::scene::world::{Model, View, World};
use crate::schedule::{Pass, SampleWork, TileWork, Until, WhenFull, Workers};
use crate::shading::light::Light;
use crate::stats::GStats;
use crate::testing::{pool, settings};
use crate::trace::{Answer, NaiveMesh, NaiveTriangle, Page, Pages, Ray};
use crate::voxel::{Occluders, VoxelScene, Voxels};
use glam::DVec3;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use trex_store::build::{BuildOptions, build};
use trex_store::import::{self, ImportOptions};
use trex_store::{Aabb, Budget, PageFile};

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
        materials: file.materials().to_vec(),
        names: Arc::default(),
        emitters: vec![],
        voxels,
    };
    (triangles, model, file)
}

/// Asks rays one by one; a batch is as large as it is told.
#[derive(Debug)]
struct Naive<'a> {
    voxels: VoxelScene<'a>,
    batch_samples: usize,
    batches: AtomicU64,
}

impl GStage for Naive<'_> {
    fn batch_samples(&self) -> usize {
        self.batch_samples
    }

    fn answer(&self, tiles: &mut [&mut GRays], _pages: &mut dyn Pages) -> GStats {
        self.batches.fetch_add(1, Ordering::Relaxed);
        for tile in tiles {
            let answer = |(ray, kind): (&Ray, &GKind)| match (self.voxels.intersect(ray), kind) {
                (None, _) => GAnswer::Nothing,
                (Some(_), GKind::Shadow) => GAnswer::Occluded,
                (Some(hit), GKind::Far) => GAnswer::Surface(self.voxels.unlit_surface(&hit)),
                (Some(hit), _) => GAnswer::Surface(self.voxels.surface(&hit)),
            };
            let answers: Vec<GAnswer> = tile.rays().iter().zip(tile.kinds()).map(answer).collect();
            tile.answer(answers.into_iter());
        }
        GStats::default()
    }
}

/// No units are asked for.
struct NoPages;

impl Pages for NoPages {
    fn page(&mut self, page: u32) -> Page<'_> {
        panic!("page {page} of a file without units")
    }
}

fn world(model: &Model, method: Method, lod_error: f64) -> World {
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
        seed: 5,
        ..RenderKeys::default()
    };
    World::new(model, &View { camera, lights, settings: settings(keys) }).unwrap()
}

/// What some photons bring to the voxels.
fn light(world: &World, model: &Model) -> PhotonMap {
    let (voxels, pool, budget) = (model.voxels.as_ref().unwrap(), pool(1), Budget::unlimited());
    let mut map = PhotonMap::new(voxels.facet_count(), &budget).unwrap();
    let voxels = voxels.scene(Occluders::On);
    let photons = VoxelPhotons { world, bounds: &model.bounds, voxels, pool: &pool, budget: &budget };
    photons.trace((&mut photons.begin().unwrap(), &mut map), 10_000, &|| false, &mut |_| {});
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
    pass.run(&work, &mut film, Workers { tracers: &mut tracers, pool: &pool(workers) }, &until);
    (0..RESOLUTION[1])
        .flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]))
        .map(|at| film.radiance(at))
        .collect()
}

#[test]
fn every_stage_and_batch_gives_the_samples_of_rays_asked_alone() {
    let (triangles, model, _file) = heap();
    for (method, lod_error) in [(Method::Photon, 0.0), (Method::Photon, 8.0), (Method::Ao, 0.0)] {
        let world = world(&model, method, lod_error);
        let light = light(&world, &model);
        let irradiance = Irradiance::new(&light, None);
        let integrator = SampleIntegrator::new(RenderContext::new(&world, &model, irradiance));
        let mut mesh = NaiveMesh::new(triangles.clone());
        let mut alone = |at: [u32; 2]| match integrator.advance(&mut integrator.start(at, 0), &mut mesh) {
            Answer::Exact(sample) => sample.radiance.to_array(),
            Answer::Blocked => panic!("the naive mesh has all its pages"),
        };
        let pixels = (0..RESOLUTION[1]).flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]));
        let expected: Vec<[f32; 3]> = pixels.map(&mut alone).collect();
        let lit = expected.iter().filter(|radiance| radiance[0] > 0.0).count();
        assert!(lit > expected.len() / 8, "{lit} pixels see anything");

        let cpu = integrator.cpu_stage().unwrap();
        assert!(
            film(SampleWork { integrator, g_stage: Some(Arc::new(cpu)) }, &triangles, 2) == expected,
            "{method:?}"
        );
        let voxels = model.voxels.as_ref().unwrap().scene(Occluders::On);
        for (batch_samples, workers, most) in [(1, 1, u64::MAX), (100, 3, u64::MAX), (usize::MAX, 1, 12)] {
            let naive = Arc::new(Naive { voxels, batch_samples, batches: AtomicU64::new(0) });
            let found = film(SampleWork { integrator, g_stage: Some(naive.clone()) }, &triangles, workers);
            assert!(found == expected, "{method:?}, {batch_samples} samples a batch, {workers} workers");
            // A batch that takes all there is needs one for each bounce at most.
            let batches = naive.batches.load(Ordering::Relaxed);
            assert!(batches > 0 && batches <= most, "{batches} batches");
        }
    }
}

#[test]
fn the_processor_answers_a_batch_as_it_answers_its_rays_alone() {
    let (_, model, _file) = heap();
    let voxels = model.voxels.as_ref().unwrap().scene(Occluders::On);
    let number = |key: u64| (mix(key) >> 11) as f64 / (1u64 << 53) as f64;
    let mut tiles: Vec<GRays> = (0..7).map(|_| GRays::default()).collect();
    for key in 0..3000u64 {
        let place =
            |at: u64| DVec3::from_array(std::array::from_fn(|a| 2.0 * number(9 * key + at + a as u64) - 0.5));
        let direction = (place(3) - place(0)).normalize();
        let kind = [GKind::Shadow, GKind::Gather, GKind::Far][key as usize % 3];
        tiles[(key % 6) as usize].push(Ray::new(place(0), direction, 1.5), kind);
    }
    let stats = CpuStage::new(voxels, None).answer(&mut tiles.iter_mut().collect::<Vec<_>>(), &mut NoPages);
    assert_eq!((stats.batches, stats.shadow, stats.gather, stats.far), (1, 1000, 1000, 1000));
    let mut met = 0;
    for tile in &tiles {
        for (place, (ray, kind)) in (0..).zip(tile.rays().iter().zip(tile.kinds())) {
            let expected = match (voxels.intersect(ray), kind) {
                (None, _) => GAnswer::Nothing,
                (Some(_), GKind::Shadow) => GAnswer::Occluded,
                (Some(hit), GKind::Far) => GAnswer::Surface(voxels.unlit_surface(&hit)),
                (Some(hit), _) => GAnswer::Surface(voxels.surface(&hit)),
            };
            assert_eq!(*tile.answered(place).1, expected);
            met += u32::from(expected != GAnswer::Nothing);
        }
    }
    assert!((300..2700).contains(&met), "{met} rays met anything");
}
