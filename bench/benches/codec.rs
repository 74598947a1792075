//! Pages in memory: encoded, installed, and taken in as the pool does it. One core, no disk.
//!
//! ```text
//! cargo bench -p trex-benches --bench codec
//! gen:KIND:COUNT -> build -> all its pages -> encode | install | arrival (hash, head, nodes) | page (all of it)
//! ```
//!
//! Invariant: the unit is bytes of frames in use, whatever the pages are on disk: these are what rays wait for.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;
use trex_bench::model::Model;
use trex_store::build::Voxels;
use trex_store::cluster::{FrameRef, FrameView, PageContent, PageRef, install};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{FrameRoom, PageStore};
use trex_store::{Budget, PageFile};

/// A surface, a scan, and a model of small parts with several materials; more pages than the caches hold.
const MODELS: [(&str, &str); 3] =
    [("iso", "gen:isosurface:1M"), ("scan", "gen:scan:1M"), ("plant", "gen:pipes:1M")];
/// Passes over all pages of a model; each takes tens of milliseconds.
const SAMPLES: usize = 20;

/// All pages of a model.
struct Pages {
    file: PageFile,
    /// As they lie in the file.
    stored: Vec<Vec<u8>>,
    /// Unpacked.
    packed: Vec<Vec<u8>>,
    contents: Vec<PageContent>,
    used_bytes: u64,
}

impl Pages {
    fn of(model: &str) -> Pages {
        let model = Model::for_bench(model, Voxels::None, std::env::temp_dir());
        let bytes = std::fs::read(&model.path).expect("the file");
        let file = PageFile::open(&model.path, &Budget::unlimited()).expect("a page file");
        let mut pages =
            Pages { stored: Vec::new(), packed: Vec::new(), contents: Vec::new(), used_bytes: 0, file };
        let (mut frame, mut scratch) = (vec![0; FRAME_BYTES], Vec::new());
        for page in 0..pages.file.page_count() {
            let extent = pages.file.extent(page);
            let stored = bytes[extent.offset as usize..][..extent.stored_bytes as usize].to_vec();
            pages.file.install(page, &stored, &mut frame, &mut scratch).expect("a sound page");
            let view = FrameView::new(&frame);
            let content = content(&view);
            let (packed, _) = content.encode();
            assert_eq!(packed.len(), pages.file.pages()[page as usize].unpacked_bytes as usize);
            pages.used_bytes += view.used_bytes() as u64;
            pages.stored.push(stored);
            pages.packed.push(packed);
            pages.contents.push(content);
        }
        pages
    }
}

/// What was encoded: nodes and clusters stand in the order of the walk.
fn content(view: &FrameView<'_>) -> PageContent {
    let mut content = PageContent::default();
    view.for_each_cluster(|cluster| content.clusters.push(cluster.decode()));
    let mut clusters_met = 0;
    for slot in 0..view.root_count() {
        let root = walk(view, view.root(slot), &mut content, &mut clusters_met);
        content.roots.push(root);
    }
    content
}

fn walk(view: &FrameView<'_>, at: FrameRef, content: &mut PageContent, clusters_met: &mut u16) -> PageRef {
    if at.is_cluster() {
        *clusters_met += 1;
        return PageRef::Cluster(*clusters_met - 1);
    }
    let index = content.nodes.len();
    content.nodes.push(Vec::new());
    let node = view.node(at);
    for word in node.words() {
        let child = walk(view, FrameRef(word), content, clusters_met);
        content.nodes[index].push(child);
    }
    PageRef::Node(index as u16)
}

fn codec(criterion: &mut Criterion) {
    for (name, model) in MODELS {
        let mut group = criterion.benchmark_group(format!("codec/{name}"));
        group.sample_size(SAMPLES).measurement_time(Duration::from_secs(4));
        let pages = Pages::of(model);
        let lattice_bits = pages.file.superblock().lattice_bits;
        let (mut frame, mut scratch) = (vec![0; FRAME_BYTES], Vec::new());
        group.throughput(Throughput::Bytes(pages.used_bytes));
        group.bench_function("install", |bencher| {
            bencher.iter(|| {
                for packed in &pages.packed {
                    install(black_box(packed), lattice_bits, &mut frame).expect("a sound page");
                }
            });
        });
        group.bench_function("arrival", |bencher| {
            bencher.iter(|| {
                for (page, stored) in pages.stored.iter().enumerate() {
                    let (stored, mut room) = (black_box(stored), FrameRoom::from(&mut frame[..]));
                    let result =
                        PageStore::install(&pages.file, page as u32, stored, &mut room, &mut scratch);
                    result.expect("a sound page");
                }
            });
        });
        group.bench_function("page", |bencher| {
            bencher.iter(|| {
                for (page, stored) in pages.stored.iter().enumerate() {
                    let result = pages.file.install(page as u32, black_box(stored), &mut frame, &mut scratch);
                    result.expect("a sound page");
                }
            });
        });
        group.bench_function("encode", |bencher| {
            bencher.iter(|| pages.contents.iter().map(|content| content.encode().0.len()).sum::<usize>());
        });
        group.finish();
    }
}

criterion_group!(benches, codec);
criterion_main!(benches);
