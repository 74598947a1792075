//! The build against a plain snap of the same triangles: nothing lost, nothing changed, nothing order-dependent.

mod resume;
mod scratch;
mod shards;
mod worker;

use super::emit::writer::make_room;
use super::*;
use crate::budget::Budget;
use crate::cluster::{FrameView, Normal};
use crate::error::Code;
use crate::layout::FRAME_BYTES;
use crate::progress::Interrupt;
use crate::source::SourceStats;
use crate::{CornerAttributes, Lattice, Material, MaterialList, PageFile, ScanHint, TriangleBatch};
use rand_pcg::rand_core::{Rng, SeedableRng};
use rayon::ThreadPoolBuilder;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Triangles in memory.
struct MemoryMesh {
    triangles: Vec<([[f64; 3]; 3], u32)>,
    materials: MaterialList,
    at: usize,
    /// Files that it names.
    named: Vec<PathBuf>,
    /// Whether its corners have colours and normals.
    has_attributes: bool,
}

impl MemoryMesh {
    fn new(triangles: Vec<([[f64; 3]; 3], u32)>) -> MemoryMesh {
        let count = triangles.iter().map(|t| t.1).max().unwrap_or(0) + 1;
        let material = |i| (format!("m{i}"), Material { ke: [f32::from(i == 3); 3], ..Material::default() });
        let materials = (0..count).map(material).collect();
        MemoryMesh { triangles, materials, at: 0, named: Vec::new(), has_attributes: false }
    }
}

impl TriangleSource for MemoryMesh {
    fn name(&self) -> String {
        "mesh in memory".into()
    }
    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        let end = (self.at + 1000).min(self.triangles.len());
        for &(corners, material) in &self.triangles[self.at..end] {
            let colour = |[x, y, _]: [f64; 3]| [x as u8, y as u8, 7];
            let normal =
                |[x, y, z]: [f64; 3]| Normal::from_vector([(x * 0.05).cos(), (y * 0.07).sin(), 3.0 + z]);
            // Some have none.
            let attributes = match self.has_attributes && material != 2 {
                true => CornerAttributes { colours: corners.map(colour), normals: corners.map(normal) },
                false => CornerAttributes::NONE,
            };
            batch.push_with(corners, material, &attributes);
        }
        self.at = end;
        Ok(!batch.is_empty())
    }
    fn rewind(&mut self) -> Result<()> {
        self.at = 0;
        Ok(())
    }
    fn hint(&self) -> Option<ScanHint> {
        None
    }
    fn materials(&self) -> &MaterialList {
        &self.materials
    }
    fn stats(&self) -> SourceStats {
        let named = self.named.iter().map(|path| (path.as_os_str().as_bytes().to_vec(), crate::stamp(path)));
        SourceStats { named_files: named.collect(), ..SourceStats::default() }
    }
}

pub(super) fn options(threads: usize, limit_bytes: u64) -> BuildOptions {
    BuildOptions {
        precision: Precision::Default,
        voxels: Voxels::default(),
        pool: Arc::new(ThreadPoolBuilder::new().num_threads(threads).build().unwrap()),
        budget: Budget::new(limit_bytes),
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt: Interrupt::default(),
    }
}

/// A wavy sheet of `2 n^2` triangles with shared vertices, and `loose` random triangles of all sizes.
fn mesh(n: usize, loose: usize, seed: u64) -> MemoryMesh {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut unit = || rng.next_u32() as f64 / u32::MAX as f64;
    let point = |i: usize, j: usize| {
        let (x, y) = (i as f64, j as f64);
        [x, y, 10.0 * (x * 0.05).sin() * (y * 0.07).cos()]
    };
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..n {
            let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
            triangles.push(([a, b, c], 0));
            triangles.push(([a, c, d], (i % 3) as u32));
        }
    }
    for _ in 0..loose {
        let size = 1e-3 * 10f64.powf(5.0 * unit());
        let center = [unit() * n as f64, unit() * n as f64, unit() * 20.0 - 10.0];
        let corners = std::array::from_fn(|_| center.map(|v| v + size * (unit() - 0.5)));
        triangles.push((corners, (unit() * 40.0) as u32));
    }
    MemoryMesh::new(triangles)
}

fn build_bytes(mesh: &mut MemoryMesh, options: &BuildOptions) -> (Vec<u8>, BuildReport) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.trex");
    mesh.rewind().unwrap();
    let report = build(mesh, &path, options, &|_| {}, &|_| {}).unwrap();
    assert_eq!(options.budget.used_bytes(), 0, "a lease is left over");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "something is left behind");
    (std::fs::read(&path).unwrap(), report)
}

/// Corners and material of a triangle on the lattice.
type SnappedTriangle = ([[i64; 3]; 3], u16);

/// All triangles of a file, snapped, with the first corner rotated to the front; sorted.
fn decoded(bytes: &[u8]) -> (Vec<SnappedTriangle>, Lattice) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("in.trex");
    std::fs::write(&path, bytes).unwrap();
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
    let mut all = Vec::new();
    for page in 0..file.pages().len() as u32 {
        file.read_page(page, &mut frame, &mut buffers).unwrap();
        let view = FrameView::new(&frame);
        assert!(view.used_bytes() <= FRAME_BYTES);
        view.for_each_cluster(|cluster| {
            all.extend((0..cluster.leaf_count()).flat_map(|leaf| {
                let first = cluster.leaf_first(leaf);
                (0..cluster.leaf_indices(leaf).shape.triangle_count()).map(move |place| {
                    (canonical(cluster.triangle(leaf, place)), cluster.material(first + place))
                })
            }));
        });
    }
    all.sort_unstable();
    (all, file.superblock().lattice)
}

/// Rotated so that the least corner comes first; the winding stays.
fn canonical(q: [[i64; 3]; 3]) -> [[i64; 3]; 3] {
    [[q[0], q[1], q[2]], [q[1], q[2], q[0]], [q[2], q[0], q[1]]].into_iter().min().unwrap()
}

fn snapped(mesh: &MemoryMesh, lattice: Lattice) -> Vec<SnappedTriangle> {
    let mut all: Vec<_> = mesh
        .triangles
        .iter()
        .map(|(corners, material)| (corners.map(|c| lattice.snap(c)), *material as u16))
        .filter(|(q, _)| q[0] != q[1] && q[1] != q[2] && q[2] != q[0])
        .map(|(q, material)| (canonical(q), material))
        .collect();
    all.sort_unstable();
    all
}

#[test]
fn every_triangle_is_stored_once_and_none_is_changed() {
    for (n, loose) in [(1, 0), (8, 0), (300, 0), (60, 3000), (1, 20_000), (400, 30_000)] {
        let mut mesh = mesh(n, loose, 7);
        let (bytes, report) = build_bytes(&mut mesh, &options(2, 512 << 20));
        let (stored, lattice) = decoded(&bytes);
        let expected = snapped(&mesh, lattice);
        assert_eq!(stored.len(), expected.len(), "{n} {loose}");
        assert!(stored == expected, "{n} {loose}: other triangles");
        assert_eq!(report.triangle_count + report.rejected_degenerate, report.input_triangle_count);
        assert_eq!(report.output_bytes, bytes.len() as u64);
    }
}

/// One triangle again and again shares no edge that its topology could tell: it takes less in a frame than on disk.
#[test]
fn what_takes_more_on_disk_than_in_a_frame_fits_its_page() {
    let triangle = [[0.0; 3], [1.0, 0.0, 0.25], [0.0, 1.0, 0.5]];
    let mut mesh = MemoryMesh::new(vec![(triangle, 0); 40_000]);
    let options = BuildOptions { voxels: Voxels::None, ..options(1, 1 << 30) };
    let (bytes, _) = build_bytes(&mut mesh, &options);
    let (stored, lattice) = decoded(&bytes);
    assert!(stored == snapped(&mesh, lattice));
}

#[test]
fn the_bytes_depend_on_neither_threads_nor_limit() {
    let mut mesh = mesh(420, 20_000, 1);
    let (one, _) = build_bytes(&mut mesh, &options(1, 128 << 20));
    let (two, _) = build_bytes(&mut mesh, &options(2, 1 << 30));
    let (three, _) = build_bytes(&mut mesh, &options(3, 256 << 20));
    assert!(one == two && two == three);
}

#[test]
fn every_flipped_byte_is_found() {
    let mut mesh = mesh(40, 500, 3);
    let (bytes, _) = build_bytes(&mut mesh, &options(1, 1 << 30));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.trex");
    let step = (bytes.len() / 400).max(1);
    let hashes = crate::verify::Options::default();
    for at in (0..bytes.len()).step_by(step).chain([bytes.len() - 1]) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        std::fs::write(&path, &damaged).unwrap();
        let verdict = crate::verify::check(&path, &hashes, &Budget::unlimited(), &|_, _| Ok(())).unwrap();
        assert!(verdict.damage_count > 0, "byte {at} of {} is not covered", bytes.len());
    }
    for cut in [0, 1, 1023, 1024, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let answer = crate::verify::check(&path, &hashes, &Budget::unlimited(), &|_, _| Ok(()));
        assert!(answer.is_err() || answer.unwrap().damage_count > 0, "cut at {cut}");
    }
}

#[test]
fn garbage_behind_a_right_hash_is_refused_without_a_panic() {
    let mut mesh = mesh(30, 800, 3);
    let (bytes, _) = build_bytes(&mut mesh, &options(1, 1 << 30));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("in.trex");
    std::fs::write(&path, &bytes).unwrap();
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let entry = file.pages()[0];
    let stored = &bytes[entry.offset as usize..][..entry.stored_bytes as usize];
    let raw = match entry.packing {
        crate::layout::Packing::Raw => stored.to_vec(),
        crate::layout::Packing::Lz4 => {
            lz4_flex::block::decompress(stored, entry.unpacked_bytes as usize).unwrap()
        }
    };
    let mut rng = rand_pcg::Pcg64::seed_from_u64(9);
    let mut frame = vec![0; FRAME_BYTES];
    for _ in 0..3000 {
        let mut garbled = raw.clone();
        for _ in 0..1 + rng.next_u32() % 4 {
            let at = rng.next_u32() as usize % garbled.len();
            garbled[at] = rng.next_u32() as u8;
        }
        garbled.truncate(garbled.len() - (rng.next_u32() as usize % 3) * (rng.next_u32() as usize % 50));
        if crate::cluster::install(&garbled, file.superblock().lattice_bits, &mut frame).is_ok() {
            FrameView::new(&frame).for_each_cluster(|cluster| {
                let mesh = cluster.decode();
                assert!(mesh.triangles.as_flattened().iter().all(|&v| usize::from(v) < mesh.vertices.len()));
            });
        }
    }
}

#[test]
fn nothing_is_left_behind_when_a_build_is_interrupted_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.trex");
    let mut options = options(2, 512 << 20);
    let stop = options.interrupt.clone();
    let report = move |p: Progress| {
        if p.phase == "clusters" {
            stop.raise();
        }
    };
    let error = build(&mut mesh(500, 0, 1), &path, &options, &|_| {}, &report).unwrap_err();
    assert_eq!(error.code(), Code::Interrupted);
    options.interrupt = Interrupt::default();
    options.budget = Budget::new(30 << 20);
    let error = build(&mut mesh(5, 0, 1), &path, &options, &|_| {}, &|_| {}).unwrap_err();
    assert_eq!(error.code(), Code::MemoryLimit);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    std::fs::write(&path, b"mine").unwrap();
    options.budget = Budget::unlimited();
    let error = build(&mut mesh(5, 0, 1), &path, &options, &|_| {}, &|_| {}).unwrap_err();
    assert_eq!(error.code(), Code::Usage);
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
}

/// What lists take is leased before they grow, old and new together while they move.
#[test]
fn tables_grow_within_the_limit_or_not_at_all() {
    let budget = Budget::new(crate::RESERVE_BYTES + 100);
    let mut lease = budget.lease("tables", 0).unwrap();
    let mut list: Vec<[u8; 8]> = Vec::new();
    for length in 1..=4 {
        make_room(&mut list, 1, &mut lease).unwrap();
        list.push([0; 8]);
        assert!(lease.bytes() >= 8 * length && lease.bytes() == 8 * list.capacity() as u64);
    }
    // From 4 to 8 items: 96 bytes for a moment.
    make_room(&mut list, 1, &mut lease).unwrap();
    assert_eq!((list.capacity(), lease.bytes(), budget.peak_bytes()), (8, 64, 96));
    list.resize(8, [0; 8]);
    assert_eq!(make_room(&mut list, 1, &mut lease).unwrap_err().code(), Code::MemoryLimit);
    assert_eq!((list.capacity(), budget.used_bytes()), (8, 64));
}
