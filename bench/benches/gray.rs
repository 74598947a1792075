//! Rays through the voxels, one by one and in batches. One core.
//!
//! ```text
//! cargo bench -p trex-benches --bench gray
//! gen:isosurface -> build -> octree -> rays onto it -> gather rays from where they hit, along a Morton curve
//! ```
//!
//! Invariant: all measure the same rays; a batch of 128 is a tile of 8x8 points with two rays each.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::hint::black_box;
use std::time::Duration;
use trex_bench::model::Model;
use trex_render::{Camera, Occluders, Ray, VoxelScene};
use trex_store::build::Voxels;
use trex_store::octree::UpperOctree;
use trex_store::{Budget, PageFile};

const MODEL: &str = "gen:isosurface:200k";
/// Leaves along an axis: megabytes of octree, more than the nearest caches hold.
const RESOLUTION: u32 = 256;
/// Pixels along a side of the picture from which rays start; a power of two.
const PICTURE_SIDE: u32 = 128;
/// Gather rays of a visible point.
const RAYS_PER_POINT: usize = 2;
/// Rays in a call.
const BATCHES: [usize; 2] = [128, 16384];
/// Passes over all rays; each takes some milliseconds.
const SAMPLES: usize = 20;

fn built() -> (PageFile, UpperOctree) {
    let model = Model::for_bench(MODEL, Voxels::Resolution(RESOLUTION), std::env::temp_dir());
    let file = PageFile::open(&model.path, &Budget::unlimited()).expect("a page file");
    let (octree, _) = file.upper(&Budget::unlimited()).expect("a sound file").expect("an octree");
    (file, octree)
}

/// Cosine-distributed rays from the leaves that a camera sees.
fn gather_rays(scene: &VoxelScene<'_>, octree: &UpperOctree, file: &PageFile) -> Vec<Ray> {
    let size = [PICTURE_SIDE; 2];
    let camera = Camera::framing(&file.superblock().bounds, size, None, None);
    let projection = camera.project(size).expect("a picture");
    let mut rng = Pcg64::seed_from_u64(1);
    let mut rays = Vec::new();
    for at in 0..PICTURE_SIDE * PICTURE_SIDE {
        let [x, y] = [at, at >> 1].map(|bits| (0..16).map(|bit| (bits >> (2 * bit) & 1) << bit).sum::<u32>());
        let eye = projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let direction = unit(eye.direction);
        let seen = Ray { origin: eye.origin, direction, t_max: f64::INFINITY };
        let Some(hit) = scene.intersect(&seen) else { continue };
        let normal = octree.leaf(hit.leaf as usize).normal.map(f64::from);
        let facing: f64 = (0..3).map(|a| normal[a] * direction[a]).sum();
        let normal = if facing > 0.0 { normal.map(|n| -n) } else { normal };
        let lift = 2.0 * scene.clearance(normal);
        let origin = std::array::from_fn(|a| eye.origin[a] + hit.t * direction[a] + lift * normal[a]);
        for _ in 0..RAYS_PER_POINT {
            let sphere = on_sphere(&mut rng);
            let direction = unit(std::array::from_fn(|a| normal[a] + sphere[a]));
            rays.push(Ray { origin, direction, t_max: f64::INFINITY });
        }
    }
    rays
}

fn on_sphere(rng: &mut Pcg64) -> [f64; 3] {
    let mut number = || (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let (z, turn) = (2.0 * number() - 1.0, std::f64::consts::TAU * number());
    let radius = (1.0 - z * z).max(0.0).sqrt();
    [radius * turn.cos(), radius * turn.sin(), z]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

fn gray(criterion: &mut Criterion) {
    let (file, octree) = built();
    let scene = VoxelScene::new(&octree, &file.superblock().lattice, Occluders::On);
    let rays = gather_rays(&scene, &octree, &file);
    let mut hits = vec![None; rays.len()];
    let mut group = criterion.benchmark_group("gray/iso");
    group.throughput(Throughput::Elements(rays.len() as u64));
    group.bench_function("intersect/single", |bencher| {
        bencher.iter(|| {
            rays.iter().zip(&mut hits).for_each(|(ray, hit)| *hit = scene.intersect(ray));
            black_box(&hits);
        });
    });
    for batch in BATCHES {
        group.bench_function(BenchmarkId::new("intersect", batch), |bencher| {
            bencher.iter(|| {
                let parts = rays.chunks(batch).zip(hits.chunks_mut(batch));
                parts.for_each(|(rays, hits)| scene.intersect_batch(rays, hits));
                black_box(&hits);
            });
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(SAMPLES).measurement_time(Duration::from_secs(3));
    targets = gray
}
criterion_main!(benches);
