//! Traversal: rays alone and in packets; and the toll of a shadow ray by part. One core.
//!
//! ```text
//! cargo bench -p trex-benches --bench traversal
//! gen:KIND -> build -> all its pages -> rays of a camera, along rows
//!                                                     -> rays from what these meet: each of the three does more
//!   beside   goes away from the model's box          set-up
//!   at once  ends where it begins, on a surface      and the way down to the leaves around it
//!   shadow   goes on until it meets something        and the rest of the walk
//! ```

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;
use trex_bench::model::Model;
use trex_bench::view_rays::{SUN, camera_rays, shadow_rays};
use trex_render::{AllResident, PagedMesh, Ray, Tracer};
use trex_store::build::Voxels;
use trex_store::{Budget, PageFile};

/// More than the nearest caches hold.
const MODELS: [(&str, &str); 3] =
    [("iso", "gen:isosurface:200k"), ("plant", "gen:pipes:200k"), ("scan", "gen:scan:200k")];
/// Pixels along a side of the picture.
const PICTURE_SIDE: u32 = 128;
/// Passes over all tests.
const SAMPLES: usize = 20;

fn built(model: &str) -> Arc<PageFile> {
    let model = Model::for_bench(model, Voxels::None, std::env::temp_dir());
    Arc::new(PageFile::open(&model.path, &Budget::unlimited()).expect("a page file"))
}

/// The three kinds of a shadow ray, from the surfaces that `rays` meet.
fn tolls(file: &PageFile, mesh: &mut impl Tracer, rays: &[Ray]) -> [(&'static str, Vec<Ray>); 3] {
    let size = file.superblock().bounds.diagonal();
    let shadow = shadow_rays(file, mesh, rays);
    let at_once = shadow.iter().map(|ray| Ray { t_max: 1e-9 * size, ..*ray }).collect();
    let aside = |ray: &Ray| Ray { origin: [0, 1, 2].map(|a| ray.origin[a] + 4.0 * size * SUN[a]), ..*ray };
    let beside = shadow.iter().map(aside).collect();
    [("beside", beside), ("at once", at_once), ("shadow", shadow)]
}

fn traversal(criterion: &mut Criterion) {
    for (name, model) in MODELS {
        let file = built(model);
        let (pages, rays) = (AllResident::load(&file), camera_rays(&file, PICTURE_SIDE));
        let mut group = criterion.benchmark_group(format!("traversal/{name}"));
        group.sample_size(SAMPLES).measurement_time(Duration::from_secs(3));

        group.throughput(Throughput::Elements(rays.len() as u64));
        let mut mesh = PagedMesh::new(&file, &pages);
        let mut answers = Vec::with_capacity(rays.len());
        group.bench_function(BenchmarkId::new("closest", "alone"), |bencher| {
            bencher.iter(|| {
                answers.clear();
                answers.extend(rays.iter().map(|ray| mesh.intersect(black_box(ray))));
            });
        });
        group.bench_function(BenchmarkId::new("closest", "packets"), |bencher| {
            bencher.iter(|| {
                answers.clear();
                mesh.intersect_coherent(black_box(&rays), &mut answers);
            });
        });
        for (part, rays) in tolls(&file, &mut mesh, &rays) {
            group.throughput(Throughput::Elements(rays.len() as u64));
            let mut answers = Vec::with_capacity(rays.len());
            group.bench_function(BenchmarkId::new(part, "alone"), |bencher| {
                bencher.iter(|| {
                    answers.clear();
                    answers.extend(rays.iter().map(|ray| mesh.occluded(black_box(ray))));
                });
            });
            group.bench_function(BenchmarkId::new(part, "packets"), |bencher| {
                bencher.iter(|| {
                    answers.clear();
                    mesh.occluded_coherent(black_box(&rays), &mut answers);
                });
            });
        }
        group.finish();
    }
}

criterion_group!(benches, traversal);
criterion_main!(benches);
