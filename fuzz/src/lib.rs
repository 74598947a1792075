//! What is fuzzed: functions of any bytes, which may be refused with an error, and never panic, hang, or take more
//! memory than they were given. cargo-fuzz runs them without end; `tests/it/fuzzing.rs` runs them on `seeds/` and on
//! some changes of each.
//!
//! Hashes would stop every change at the gate, so page files are sealed again before they are read.

pub mod left_over;
pub mod parts;
mod sealed;
pub mod shards;

pub use sealed::{sealed, with_page, with_section};

use std::path::Path;
use std::sync::Arc;
use trex_render::{Camera, Model, Scene, parse_views};
use trex_store::cluster::{self, Colour, CornerValue, FrameView, Normal, ValueView};
use trex_store::import::{self, ByteOrder, ImportOptions, RawVolume, SampleType, VolumeOptions};
use trex_store::layout::{FRAME_BYTES, PageKind, SUPERBLOCK_BYTES, Superblock};
use trex_store::{Aabb, Budget, Code, Error, Material, PageFile, RESERVE_BYTES, Result, TriangleBatch};
use xxhash_rust::xxh3::xxh3_64;

/// A target: what `seeds/NAME` and `cargo fuzz run NAME` call it, and its body.
pub type Target = (&'static str, fn(&[u8]));

/// All of them.
pub const TARGETS: [Target; 25] = [
    ("page", page),
    ("superblock", superblock),
    ("page_file", page_file),
    ("tables", parts::tables),
    ("tree", parts::tree),
    ("cluster", parts::cluster),
    ("octree", parts::octree),
    ("units", parts::units),
    ("colours", parts::colours),
    ("normals", parts::normals),
    ("journal", journal),
    ("scratch", scratch),
    ("shards", plans_and_fragments),
    ("ply", ply),
    ("obj", obj),
    ("stl", stl),
    ("gltf", gltf),
    ("glb", glb),
    ("draco", draco),
    ("nrrd", nrrd),
    ("mhd", mhd),
    ("raw", raw),
    ("mtl", mtl),
    ("scene", scene),
    ("views", views),
];

/// The memory that reading gets.
pub const BUDGET_BYTES: u64 = RESERVE_BYTES + (8 << 20);
/// Most bits of a lattice coordinate.
const LATTICE_BITS_MAX: u32 = 40;
/// Triangles of a page whose colours or normals are asked for: more than a page has.
const FRAME_TRIANGLES_ASKED: usize = 70_000;

/// A page of the mesh, unpacked, behind a byte that chooses the lattice's bits.
pub fn page(bytes: &[u8]) {
    let Some((&bits, packed)) = bytes.split_first() else { return };
    let bits = u32::from(bits) % (LATTICE_BITS_MAX + 1);
    let mut frame = vec![0; FRAME_BYTES];
    if cluster::install(packed, bits, &mut frame).is_ok() {
        walk(&frame, bits);
    }
}

/// Looks at all that an installed page says.
fn walk(frame: &[u8], lattice_bits: u32) {
    let view = FrameView::new(frame);
    let mut triangle_count = 0;
    view.for_each_cluster(|cluster| {
        let mesh = cluster.decode();
        for vertex in &mesh.vertices {
            assert!(
                vertex.iter().all(|q| (0..1 << lattice_bits).contains(q)),
                "{vertex:?} is off the lattice"
            );
        }
        triangle_count += mesh.triangles.len();
        for leaf in 0..cluster.leaf_count() {
            cluster.leaf_corners(leaf);
        }
    });
    assert_eq!(view.triangle_count(), triangle_count);
    assert!(view.used_bytes() <= frame.len());
}

/// Asks an installed page of colours or normals for those of triangles that it has, and of some that it has not.
fn ask_values<V: CornerValue>(frame: &[u8]) {
    let view = ValueView::<V>::new(frame);
    for triangle in (0..FRAME_TRIANGLES_ASKED).step_by(7) {
        view.values(triangle, [triangle % 128, 0, 127]);
    }
}

/// A superblock: short ones are filled up with zeros. What is taken is written and taken again as the same.
pub fn superblock(bytes: &[u8]) {
    let mut head = [0; SUPERBLOCK_BYTES];
    let length = bytes.len().min(SUPERBLOCK_BYTES - 8);
    head[..length].copy_from_slice(&bytes[..length]);
    sealed::seal_head(&mut head);
    if let Ok(block) = Superblock::parse(&head, Path::new("fuzzed.trex")) {
        let again = Superblock::parse(&block.to_bytes(), Path::new("again.trex")).expect("our own bytes");
        assert_eq!(format!("{again:?}"), format!("{block:?}"));
    }
}

/// A whole page file: opened, its octree and all of its pages read.
pub fn page_file(bytes: &[u8]) {
    read_page_file(&sealed(bytes.to_vec()));
}

fn read_page_file(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("fuzzed.trex");
    std::fs::write(&path, bytes).expect("room for a small file");
    let budget = Budget::new(BUDGET_BYTES);
    let read = || -> Result<()> {
        let file = PageFile::open(&path, &budget)?;
        if let Some((octree, _lease)) = file.upper(&budget)? {
            file.lower(&octree, &budget)?;
        }
        let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
        for page in 0..file.pages().len() as u32 {
            // A page is damaged by itself: the others are read.
            let is_read = file.read_page(page, &mut frame, &mut buffers);
            match is_read {
                Ok(()) if file.has_mesh(page) => walk(&frame, file.superblock().lattice_bits),
                Ok(()) if file.pages()[page as usize].kind == PageKind::Colours => {
                    ask_values::<Colour>(&frame)
                }
                Ok(()) if file.pages()[page as usize].kind == PageKind::Normals => {
                    ask_values::<Normal>(&frame)
                }
                Ok(()) => {}
                Err(error) => check(&error),
            }
        }
        Ok(())
    };
    if let Err(error) = read() {
        check(&error);
    }
    assert_eq!(budget.used_bytes(), 0, "memory that nobody gave back");
}

/// What a reader may answer: what is wrong, where, and what to do.
fn check(error: &Error) {
    let codes = [
        Code::InputFormat,
        Code::InputTruncated,
        Code::InputRange,
        Code::InputEmpty,
        Code::InputUnreadable,
        Code::Damaged,
        Code::Version,
        Code::MemoryLimit,
        Code::SceneFormat,
    ];
    assert!(codes.contains(&error.code()), "{error}");
    let parts = [error.what(), error.place(), error.next_step()];
    assert!(parts.iter().all(|part| !part.is_empty()), "{error}");
}

/// The journal of a build that was stopped, and its records.
pub fn journal(bytes: &[u8]) {
    left_over::journal(bytes);
}

/// Blocks of the scratch files of a build that was stopped.
pub fn scratch(bytes: &[u8]) {
    left_over::scratch(bytes);
}

/// The plan of a build in shards, and a fragment.
pub fn plans_and_fragments(bytes: &[u8]) {
    shards::shards(bytes);
}

/// A PLY file.
pub fn ply(bytes: &[u8]) {
    import("fuzzed.ply", bytes);
}

/// An OBJ file.
pub fn obj(bytes: &[u8]) {
    import("fuzzed.obj", bytes);
}

/// An STL file, text or records.
pub fn stl(bytes: &[u8]) {
    import("fuzzed.stl", bytes);
}

/// A glTF file, whose buffers are in it.
pub fn gltf(bytes: &[u8]) {
    import("fuzzed.gltf", bytes);
}

/// A glTF container.
pub fn glb(bytes: &[u8]) {
    import("fuzzed.glb", bytes);
}

/// A primitive that is compressed with Draco, behind the counts of its vertices and triangles, two bytes each.
pub fn draco(bytes: &[u8]) {
    let Some((counts, stream)) = bytes.split_first_chunk::<4>() else { return };
    let [vertices, triangles] = [0, 2].map(|at| u16::from_le_bytes([counts[at], counts[at + 1]]));
    let rows = |kind: &str, count: u32| format!("{{\"componentType\":{kind},\"count\":{count}}}");
    let accessors = [
        rows("5126,\"type\":\"VEC3\"", vertices.into()),
        rows("5121,\"normalized\":true,\"type\":\"VEC4\"", vertices.into()),
        rows("5125,\"type\":\"SCALAR\"", 3 * u32::from(triangles)),
    ];
    let attributes = "\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2,\"COLOR_0\":3";
    let text = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"mesh\":0}}],\
         \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0,\"NORMAL\":0,\"COLOR_0\":1}},\"indices\":2,\
         \"extensions\":{{\"KHR_draco_mesh_compression\":{{\"bufferView\":0,\"attributes\":{{{attributes}}}}}}}}}]}}],\
         \"accessors\":[{}],\"bufferViews\":[{{\"buffer\":0,\"byteLength\":{length}}}],\
         \"buffers\":[{{\"byteLength\":{length}}}]}}",
        accessors.join(","),
        length = stream.len()
    );
    let padded = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), b' ');
        bytes
    };
    let chunks = [(b"JSON", padded(text.as_bytes())), (b"BIN\0", padded(stream))];
    let length: usize = 12 + chunks.iter().map(|(_, chunk)| 8 + chunk.len()).sum::<usize>();
    let mut file = [&b"glTF"[..], &2u32.to_le_bytes(), &(length as u32).to_le_bytes()].concat();
    for (kind, chunk) in chunks {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    import("fuzzed.glb", &file);
}

/// A volume as NRRD, whose samples are in it.
pub fn nrrd(bytes: &[u8]) {
    import("fuzzed.nrrd", bytes);
}

/// A volume as MetaImage.
pub fn mhd(bytes: &[u8]) {
    import("fuzzed.mhd", bytes);
}

/// Samples of a volume, behind three bytes that choose the size.
pub fn raw(bytes: &[u8]) {
    let Some((size, samples)) = bytes.split_first_chunk::<3>() else { return };
    let size = size.map(|side| u64::from(side) % 16);
    let sample = SampleType::Float32;
    let raw = RawVolume { size, sample, order: ByteOrder::Little, spacing: [1.0; 3] };
    let folder = tempfile::tempdir().expect("a temporary folder");
    import_in(folder.path(), "fuzzed.raw", samples, Some(raw));
}

/// The materials of an OBJ file.
pub fn mtl(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("fuzzed.mtl"), bytes).expect("room for a small file");
    let mesh = "mtllib fuzzed.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 2\n";
    import_in(folder.path(), "mesh.obj", mesh.as_bytes(), None);
}

/// A scene, and the view of a model that it makes.
pub fn scene(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let mut model = Model {
        bounds: Aabb { lo: [0.0; 3], hi: [1.0, 2.0, 3.0] },
        outline: Default::default(),
        materials: vec![Material::default()],
        names: Arc::new(["floor"].into_iter().collect()),
        emitters: Vec::new(),
        voxels: None,
    };
    let viewed = Scene::parse(text, Path::new("fuzzed.toml")).and_then(|scene| scene.view(&mut model));
    if let Err(error) = viewed {
        check(&error);
    }
}

/// A list of viewpoints.
pub fn views(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let camera = Camera::framing(&Aabb { lo: [0.0; 3], hi: [1.0; 3] }, [64, 64], None, None);
    match parse_views(text, &camera) {
        Ok(list) => assert!(!list.is_empty()),
        // Who reads the file knows its place.
        Err(error) => check(&error.at_place("fuzzed.toml")),
    }
}

fn import(name: &str, bytes: &[u8]) {
    import_in(tempfile::tempdir().expect("a temporary folder").path(), name, bytes, None);
}

fn import_in(folder: &Path, name: &str, bytes: &[u8], raw: Option<RawVolume>) {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("room for a small file");
    let mut options = ImportOptions::new(Budget::new(BUDGET_BYTES), folder);
    options.volumes = VolumeOptions { iso_values: vec![0.5, 60.0], raw };
    let read = || -> Result<()> {
        let mut source = import::open(&path, &options)?;
        let mut batch = TriangleBatch::default();
        while source.next_batch(&mut batch)? {
            assert_eq!(batch.corners.len(), batch.material.len());
        }
        let materials = source.materials().len();
        assert!(batch.material.iter().all(|&material| (material as usize) < materials));
        Ok(())
    };
    if let Err(error) = read() {
        check(&error);
    }
    assert_eq!(options.budget.used_bytes(), 0, "memory that nobody gave back");
}

/// The hash of a superblock, over all of it but the hash itself.
fn head_hash(head: &[u8; SUPERBLOCK_BYTES]) -> u64 {
    xxh3_64(&head[..SUPERBLOCK_BYTES - 8])
}
