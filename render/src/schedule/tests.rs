//! Tests of passes with doubles: tracers that hesitate, and one that has hardly any room.

#[path = "tests/g_stage.rs"]
mod g_stage;
#[path = "tests/waiting.rs"]
mod waiting;

use super::*;
use crate::g_stage::CpuStage;
use crate::integrate::{RenderContext, SampleIntegrator};
use crate::scene::camera::Camera;
use crate::scene::method::Method;
use crate::scene::settings::RenderKeys;
use crate::scene::world::{Model, View, World};
use crate::schedule::{Canvas, SampleWork, TileWork, Until, WhenFull};
use crate::shading::light::Light;
use crate::testing::{pool, settings};
use crate::trace::{Answer, Hit, NaiveMesh, NaiveTriangle, Ray, Tracer};
use std::collections::{HashMap, HashSet};
use std::io::Cursor;
use std::time::Duration;
use trex_film::{Film, Layers, mix, write_exr};
use trex_store::{Aabb, Budget, Material};

const RESOLUTION: [u32; 2] = [37, 21];
const LAYERS: Layers = Layers { depth: true, normal: true, albedo: true, id: true, filter: false };

/// Triangles strewn over the unit cube, some of them mirrors.
fn soup() -> Vec<NaiveTriangle> {
    let number = |key: u64| (mix(key) >> 11) as f64 / (1u64 << 53) as f64;
    let corner = |key: u64| std::array::from_fn(|axis| number(3 * key + axis as u64));
    (0..48)
        .map(|index| {
            let first: [f64; 3] = corner(10 * index);
            let near = |key| {
                let other: [f64; 3] = corner(key);
                std::array::from_fn(|axis| first[axis] + 0.5 * (other[axis] - 0.5))
            };
            let corners = [first, near(10 * index + 1), near(10 * index + 2)];
            NaiveTriangle { corners, material: (index % 3 == 0).into() }
        })
        .collect()
}

fn world(method: Method) -> World {
    let mirror = Material { ks: [0.6; 3], kd: [0.2; 3], mirror: true, ..Material::default() };
    let bounds = Aabb { lo: [0.0; 3], hi: [1.0; 3] };
    let model = Model {
        bounds,
        outline: Default::default(),
        materials: vec![Material::default(), mirror],
        names: Default::default(),
        emitters: vec![],
        voxels: None,
    };
    let camera = Camera::framing(&bounds, RESOLUTION, None, None);
    let point = Light::Point { position: [2.0, 3.0, 2.0], intensity: [9.0; 3] };
    let lights = vec![point, Light::Sky { radiance: [0.3; 3] }];
    let keys = RenderKeys { integrator: method, resolution: RESOLUTION, seed: 11, ..RenderKeys::default() };
    World::new(&model, &View { camera, lights, settings: settings(keys), parts: Default::default() }).unwrap()
}

/// Renders to 7 samples in passes to `targets`, and gives the film's bytes.
fn render<T: PagedTracer + Send>(method: Method, tracers: &mut [T], targets: &[u32]) -> (Vec<u8>, PassStats) {
    let world = world(method);
    let integrator = integrator(&world);
    let mut film = Film::new(RESOLUTION, LAYERS, &Budget::unlimited()).unwrap();
    let tiles = Tiles::z_curve(RESOLUTION);
    let mut stats = PassStats::default();
    for &target in targets {
        let work =
            TileWork { samples: SampleWork { integrator, g_stage: &CpuStage::default() }, tiles: &tiles };
        stats.add(&render_pass(&work, &mut film, tracers, target, &|| false));
        assert_eq!(film.samples(), target);
    }
    let mut bytes = Cursor::new(vec![]);
    write_exr(&film, &mut bytes).unwrap();
    (bytes.into_inner(), stats)
}

fn integrator(world: &World) -> SampleIntegrator<'_> {
    SampleIntegrator::new(RenderContext::from_mesh(world).with_layers(LAYERS))
}

/// A whole pass.
fn render_pass<T: PagedTracer + Send>(
    work: &TileWork<'_>,
    film: &mut Film,
    tracers: &mut [T],
    target: u32,
    stop: &(dyn Fn() -> bool + Sync),
) -> PassStats {
    let until = Until { stop, deadline: None, tiles: u32::MAX };
    let pool = pool(tracers.len());
    let (canvas, workers) = (Canvas { film, display: None }, tracers.len());
    Pass::new(target, workers, WhenFull::Wait).run(work, canvas, Workers { tracers, pool: &pool }, &until)
}

fn naive(count: usize) -> Vec<NaiveMesh> {
    vec![NaiveMesh::new(soup()); count]
}

/// Answers Blocked zero to three times, by chance, before it answers; every wait or attempt brings it nearer.
struct Hesitant {
    mesh: NaiveMesh,
    seed: u64,
    refused: HashMap<u64, u64>,
}

impl Hesitant {
    fn refuses(&mut self, ray: &Ray) -> bool {
        let numbers = ray.origin.iter().chain(&ray.direction).chain([&ray.t_max]);
        let key = numbers.fold(self.seed, |key, x| mix(key ^ x.to_bits()));
        let refused = self.refused.entry(key).or_insert(0);
        let refuses = *refused < key % 4;
        *refused += 1;
        refuses
    }
}

impl Tracer for Hesitant {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        if self.refuses(ray) { Answer::Blocked } else { self.mesh.intersect(ray) }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        if self.refuses(ray) { Answer::Blocked } else { self.mesh.occluded(ray) }
    }
}

impl PagedTracer for Hesitant {
    fn begin_tile(&mut self) {}
    fn request_missing(&mut self) -> usize {
        1
    }
    fn wait(&mut self, _longest: Duration) {}
}

/// A mesh in pages of two triangles of which few are resident: a ray needs all pages whose box it meets. Requests
/// are a queue; a wait brings one page, in a frame that is not pinned, if there is one.
struct Scarce {
    mesh: NaiveMesh,
    boxes: Vec<Aabb>,
    frame_count: usize,
    /// The oldest first.
    resident: Vec<usize>,
    pinned: HashSet<usize>,
    missing: Vec<usize>,
    queue: Vec<usize>,
}

const PAGE_TRIANGLES: usize = 2;

impl Scarce {
    fn new(frame_count: usize) -> Scarce {
        let mesh = NaiveMesh::new(soup());
        let boxes = mesh.triangles().chunks(PAGE_TRIANGLES).map(|page| {
            let mut bounds = Aabb::EMPTY;
            page.iter().flat_map(|triangle| triangle.corners).for_each(|corner| bounds.add(corner));
            bounds
        });
        let boxes = boxes.collect();
        let (resident, missing, queue) = (vec![], vec![], vec![]);
        Scarce { mesh, boxes, frame_count, resident, pinned: HashSet::new(), missing, queue }
    }

    /// True when all pages of the ray are here; records those that are not, pins those that are.
    fn touch(&mut self, ray: &Ray) -> bool {
        let mut all = true;
        for page in (0..self.boxes.len()).filter(|&page| meets(&self.boxes[page], ray)) {
            if self.resident.contains(&page) {
                self.pinned.insert(page);
            } else {
                self.missing.push(page);
                all = false;
            }
        }
        all
    }
}

fn meets(bounds: &Aabb, ray: &Ray) -> bool {
    let (mut enter, mut leave) = (0.0f64, ray.t_max);
    for axis in 0..3 {
        let at = |plane: f64| (plane - ray.origin[axis]) / ray.direction[axis];
        let (a, b) = (at(bounds.lo[axis]), at(bounds.hi[axis]));
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter <= leave
}

impl Tracer for Scarce {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        if self.touch(ray) { self.mesh.intersect(ray) } else { Answer::Blocked }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        if self.touch(ray) { self.mesh.occluded(ray) } else { Answer::Blocked }
    }
}

impl PagedTracer for Scarce {
    fn begin_tile(&mut self) {
        self.pinned.clear();
    }

    fn request_missing(&mut self) -> usize {
        // What is asked for last is wanted most.
        for page in self.missing.drain(..) {
            self.queue.retain(|&queued| queued != page);
            self.queue.push(page);
        }
        self.queue.len()
    }

    fn wait(&mut self, _longest: Duration) {
        let Some(page) = self.queue.pop() else { return };
        if self.resident.contains(&page) {
            return;
        }
        if self.resident.len() == self.frame_count {
            let Some(victim) = self.resident.iter().position(|page| !self.pinned.contains(page)) else {
                return;
            };
            self.resident.remove(victim);
        }
        self.resident.push(page);
    }
}

#[test]
fn the_film_does_not_depend_on_threads_passes_or_blocked_rays() {
    for method in [Method::Direct, Method::Path, Method::Ao] {
        check_film(method);
    }
}

fn check_film(method: Method) {
    let (expected, one) = render(method, &mut naive(1), &[1, 2, 4, 7]);
    assert_eq!((one.parked, one.waits, one.not_finite, one.tiles_left), (0, 0, 0, 0));
    assert_eq!(one.samples, 7 * 37 * 21);
    assert_eq!(one.rays.primary, 8 * 37 * 21, "a ray for the layers, and one per sample");
    let mirror_least = if method == Method::Ao { 0 } else { 100 };
    assert!(one.rays.mirror >= mirror_least && one.rays.shadow + one.rays.gather > 1000, "{one:?}");
    for threads in 1..=3 {
        let (bytes, stats) = render(method, &mut naive(threads), &[4, 7]);
        let one_alike = PassStats { tiles_finished: stats.tiles_finished, ..one };
        assert!(bytes == expected && stats == one_alike, "{threads} threads: {stats:?}");
        let hesitant = |seed| Hesitant { mesh: NaiveMesh::new(soup()), seed, refused: HashMap::new() };
        let mut tracers: Vec<_> = (0..threads as u64).map(hesitant).collect();
        let (bytes, stats) = render(method, &mut tracers, &[1, 2, 4, 7]);
        assert!(bytes == expected, "{threads} threads that hesitate");
        assert!(stats.parked > 0 && stats.rays == one.rays, "{stats:?}");
    }
}

#[test]
fn room_for_the_pages_of_one_ray_is_enough() {
    for method in [Method::Direct, Method::Path, Method::Ao] {
        check_room(method);
    }
}

fn check_room(method: Method) {
    let (expected, one) = render(method, &mut naive(1), &[2]);
    // The greatest number of pages that one of these rays wants, found by a mesh with room for all.
    let mut frame_count = 0;
    let mut roomy = Scarce::new(usize::MAX);
    roomy.resident = (0..roomy.boxes.len()).collect();
    let mut counting = TouchCounter { inner: roomy, most: 0 };
    render(method, std::slice::from_mut(&mut counting), &[2]);
    frame_count = frame_count.max(counting.most);
    assert!(frame_count >= 4 && frame_count < counting.inner.boxes.len(), "{frame_count}");

    let mut tracers = [Scarce::new(frame_count), Scarce::new(frame_count)];
    let (bytes, stats) = render(method, &mut tracers, &[2]);
    assert!(bytes == expected && stats.rays == one.rays);
    assert!(stats.narrow_samples > 0, "{stats:?}");
}

/// Counts the pages that single rays touch.
struct TouchCounter {
    inner: Scarce,
    most: usize,
}

impl TouchCounter {
    fn count(&mut self) {
        self.most = self.most.max(self.inner.pinned.len());
        self.inner.pinned.clear();
    }
}

impl Tracer for TouchCounter {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        let answer = self.inner.intersect(ray);
        self.count();
        answer
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        let answer = self.inner.occluded(ray);
        self.count();
        answer
    }
}

impl PagedTracer for TouchCounter {
    fn begin_tile(&mut self) {}
    fn request_missing(&mut self) -> usize {
        0
    }
    fn wait(&mut self, _longest: Duration) {}
}

#[test]
fn a_stopped_pass_leaves_a_film_that_goes_on() {
    let world = world(Method::Direct);
    let tiles = Tiles::z_curve(RESOLUTION);
    let g_stage = CpuStage::default();
    let samples = SampleWork { integrator: integrator(&world), g_stage: &g_stage };
    let work = TileWork { samples, tiles: &tiles };
    let mut film = Film::new(RESOLUTION, LAYERS, &Budget::unlimited()).unwrap();
    let asked = AtomicU32::new(0);
    let stop = || asked.fetch_add(1, Ordering::Relaxed) >= 5;
    let stats = render_pass(&work, &mut film, &mut naive(1), 4, &stop);
    assert_eq!((u64::from(tiles.count()) - stats.tiles_left, film.samples()), (5, 0));
    let rest = render_pass(&work, &mut film, &mut naive(2), 4, &|| false);
    assert_eq!(rest.tiles_left, 0);
    let mut bytes = Cursor::new(vec![]);
    write_exr(&film, &mut bytes).unwrap();
    assert!(bytes.into_inner() == render(Method::Direct, &mut naive(1), &[4]).0);
}
