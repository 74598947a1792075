//! Traversal: rays alone and in packets. One core.
//!
//! ```text
//! cargo bench -p trex-benches --bench traversal
//! gen:isosurface -> build -> all its pages -> rays of a camera, along rows
//! ```

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;
use trex_bench::model::Model;
use trex_render::{AllResident, Camera, PagedMesh, Ray, Tracer};
use trex_store::build::Voxels;
use trex_store::{Budget, PageFile};

/// More than the nearest caches hold.
const MODEL: &str = "gen:isosurface:200k";
/// Pixels along a side of the picture.
const PICTURE_SIDE: u32 = 128;
/// Passes over all tests.
const SAMPLES: usize = 20;

fn built() -> Arc<PageFile> {
    let model = Model::for_bench(MODEL, Voxels::None, std::env::temp_dir());
    Arc::new(PageFile::open(&model.path, &Budget::unlimited()).expect("a page file"))
}

/// A ray through each pixel of a picture of the whole model, along rows.
fn rays(file: &PageFile) -> Vec<Ray> {
    let size = [PICTURE_SIDE; 2];
    let camera = Camera::framing(&file.superblock().bounds, size, None, None);
    let projection = camera.project(size).expect("a picture");
    let pixels = (0..PICTURE_SIDE).flat_map(|y| (0..PICTURE_SIDE).map(move |x| [x, y]));
    pixels.map(|[x, y]| projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)).collect()
}

fn traversal(criterion: &mut Criterion) {
    let file = built();
    let (pages, rays) = (AllResident::load(&file), rays(&file));
    let mut group = criterion.benchmark_group("traversal");
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
    group.finish();
}

criterion_group!(benches, traversal);
criterion_main!(benches);
