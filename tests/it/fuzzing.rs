//! The fuzz targets of `fuzz/` on their seeds, and on seeded changes of each: what cargo-fuzz does without end, for a
//! moment, with the stable toolchain.

use crate::command::{document_in, folder, said};
use crate::random::Random;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trex_store::layout::PageKind;
use trex_store::{Budget, PageFile};
use xxhash_rust::xxh3::xxh3_64;

mod seed_files;
#[allow(unreachable_pub, dead_code)]
#[path = "../../fuzz/src/lib.rs"]
mod targets;

/// Changes of each seed, unless the first variable says how many of all seeds of a target together; the second, how
/// many seconds a target may take, whatever is left of them then.
const CHANGES: u64 = 300;
const CHANGES_VARIABLE: &str = "TREX_FUZZ_CHANGES";
const SECONDS_VARIABLE: &str = "TREX_FUZZ_SECONDS";
/// Another number here gives other changes.
const SEED_VARIABLE: &str = "TREX_FUZZ_SEED";
/// Failures after which a target ends: what fails once fails often.
const FAILURES_MOST: usize = 10;
/// What a case is that builds, over one that reads.
const BUILD_WEIGHT: u64 = 10;
/// Most bytes of all seeds together.
const SEED_BYTES: u64 = 100 << 10;

fn seeds() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds")
}

/// The seeds of a target, in the order of their names.
fn seeds_of(target: &str) -> Vec<(String, Vec<u8>)> {
    files_of(&seeds().join(target))
}

/// Names and contents of the files of a folder, in the order of their names.
fn files_of(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names.into_iter().map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect()
}

/// One to eight changes, of the kinds that fuzzers make.
fn changed(seed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(8) {
        if bytes.is_empty() {
            bytes.push(random.bits() as u8);
        }
        let length = bytes.len() as i64;
        let at = random.below(length) as usize;
        let some = 1 + random.below(16.min(length - at as i64)) as usize;
        match random.below(8) {
            0 | 1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at] = random.bits() as u8,
            3 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5) as usize],
            4 => bytes[at..at + some].fill([0, 0xff][random.below(2) as usize]),
            5 => drop(bytes.drain(at..at + some)),
            6 => {
                let from = random.below(length - some as i64 + 1) as usize;
                let copy = bytes[from..from + some].to_vec();
                drop(bytes.splice(at..at, copy));
            }
            _ if random.below(4) == 0 => bytes.truncate(at),
            _ => bytes[at] = bytes[at].wrapping_add(1),
        }
    }
    bytes
}

/// Runs one input. What it panics with is told with the input, which is kept, and so is what takes more memory than it
/// was given.
fn run(target: targets::Target, name: &str, bytes: &[u8]) -> Result<(), String> {
    let (target, body) = target;
    let caught = std::panic::catch_unwind(|| {
        let taken = allocation_counter::measure(|| body(bytes)).bytes_max;
        assert!(taken <= targets::BUDGET_BYTES, "{taken} bytes were taken at once");
    });
    caught.map_err(|panic| {
        let name_hash = xxh3_64(name.as_bytes());
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("crash-{target}-{name_hash:016x}"));
        fs::write(&path, bytes).unwrap();
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let said = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
        format!("{target} on {name} ({}): {said}", path.display())
    })
}

fn check(name: &str) {
    check_some(name, 1);
}

/// A number that the environment may give.
fn number_of(variable: &str) -> Option<u64> {
    std::env::var(variable).ok().map(|number| number.parse().unwrap())
}

/// A target whose cases take as long as so many of others.
fn check_some(name: &str, weight: u64) {
    let target = *targets::TARGETS.iter().find(|(known, _)| *known == name).unwrap();
    let seeds = seeds_of(name);
    assert!(!seeds.is_empty());
    let changes = match number_of(CHANGES_VARIABLE) {
        Some(of_all) => of_all.div_ceil(seeds.len() as u64),
        None => CHANGES.div_ceil(weight),
    };
    let (begin, longest) = (Instant::now(), number_of(SECONDS_VARIABLE).map(Duration::from_secs));
    let (mut count, mut slowest, mut failures) = (0, Duration::ZERO, Vec::new());
    let mut try_case = |case: &str, bytes: &[u8]| {
        let begin = Instant::now();
        failures.extend(run(target, case, bytes).err());
        slowest = slowest.max(begin.elapsed());
        failures.len() < FAILURES_MOST
    };
    let mut is_wanted = seeds.iter().all(|(seed, bytes)| try_case(seed, bytes));
    let first = number_of(SEED_VARIABLE).unwrap_or(0) << 32;
    let mut randoms: Vec<Random> = (0..seeds.len() as u64).map(|at| Random::seeded(first + at)).collect();
    // A change of each seed in turn: where time is short all of them get their share.
    for change in 0..changes {
        if !is_wanted || longest.is_some_and(|longest| begin.elapsed() >= longest) {
            break;
        }
        for ((seed, bytes), random) in seeds.iter().zip(&mut randoms) {
            is_wanted &= try_case(&format!("change {change} of {seed}"), &changed(bytes, random));
            count += 1;
        }
    }
    let took_s = begin.elapsed().as_secs();
    said(&format!(
        "{name}: {count} changes of {} seeds, {} failures, {took_s} s, the slowest case {} ms",
        seeds.len(),
        failures.len(),
        slowest.as_millis()
    ));
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn pages() {
    check("page");
}

#[test]
fn superblocks() {
    check("superblock");
}

#[test]
fn page_files() {
    check("page_file");
}

#[test]
fn tables() {
    check("tables");
}

#[test]
fn trees() {
    check("tree");
}

#[test]
fn clusters() {
    check("cluster");
}

#[test]
fn octrees() {
    check("octree");
}

#[test]
fn units() {
    check("units");
}

#[test]
fn colours() {
    check("colours");
}

#[test]
fn normals() {
    check("normals");
}

#[test]
fn journals() {
    check_some("journal", BUILD_WEIGHT);
}

#[test]
fn scratch_files() {
    check_some("scratch", BUILD_WEIGHT);
}

#[test]
fn plans_and_fragments() {
    check_some("shards", BUILD_WEIGHT);
}

#[test]
fn ply() {
    check("ply");
}

#[test]
fn obj() {
    check("obj");
}

#[test]
fn stl() {
    check("stl");
}

#[test]
fn gltf() {
    check("gltf");
}

#[test]
fn glb() {
    check("glb");
}

#[test]
fn draco() {
    check("draco");
}

#[test]
fn nrrd() {
    check("nrrd");
}

#[test]
fn mhd() {
    check("mhd");
}

#[test]
fn raw() {
    check("raw");
}

#[test]
fn mtl() {
    check("mtl");
}

#[test]
fn scenes() {
    check("scene");
}

#[test]
fn views() {
    check("views");
}

/// Inputs that failed once.
#[test]
fn what_was_found_stays_mended() {
    let found = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/found");
    let mut count = 0;
    for (name, body) in targets::TARGETS.iter().filter(|(name, _)| found.join(name).exists()) {
        for (file, bytes) in files_of(&found.join(name)) {
            run((name, *body), &file, &bytes).unwrap();
            count += 1;
        }
    }
    let targets = fs::read_dir(&found).unwrap().count();
    assert!(count >= targets && targets > 0, "a folder of {} is of no target", found.display());
}

#[test]
fn seeds_are_sound_and_few() {
    let mut sum = 0;
    for (target, _) in targets::TARGETS {
        sum += seeds_of(target).iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>();
    }
    assert!(sum <= SEED_BYTES, "{sum} bytes of seeds, at most {SEED_BYTES}");
    // What the targets do before they read lets a sound file through, or nothing behind the gate would be fuzzed.
    let inside = folder();
    let path = inside.path().join("sealed.trex");
    for (name, bytes) in seeds_of("page_file") {
        assert_eq!(targets::sealed(bytes.clone()), bytes, "{name} is another file once it is sealed");
    }
    for target in ["tables", "tree", "octree"] {
        let whole = seeds_of(target).into_iter().filter(|(name, _)| !["emitters", "page"].contains(&&**name));
        whole.for_each(|(name, bytes)| {
            assert!(targets::parts::is_own_section(target, &bytes), "{target} {name}")
        });
    }
    assert!(seeds_of("journal").iter().all(|(_, bytes)| targets::left_over::journal(bytes)));
    assert!(seeds_of("scratch").iter().all(|(_, bytes)| targets::left_over::scratch(bytes)));
    assert!(seeds_of("shards").iter().all(|(_, bytes)| targets::shards::shards(bytes)));
    let [(_, file), (_, content)] = [&seeds_of("page_file"), &seeds_of("units")]
        .map(|seeds| seeds.iter().find(|(name, _)| name.starts_with("units")).unwrap().clone());
    fs::write(&path, targets::with_page(&file, PageKind::Units, &content)).unwrap();
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let (mut frame, mut buffers) = (vec![0; trex_store::layout::FRAME_BYTES], [Vec::new(), Vec::new()]);
    (0..file.pages().len() as u32).for_each(|page| file.read_page(page, &mut frame, &mut buffers).unwrap());
}

#[test]
#[ignore = "writes fuzz/seeds anew, checks nothing: cargo test --test it -- --ignored fuzz_seeds"]
fn fuzz_seeds() {
    let inside = folder();
    let put = |target: &str, name: &str, bytes: &[u8]| {
        fs::create_dir_all(seeds().join(target)).unwrap();
        fs::write(seeds().join(target).join(name), bytes).unwrap();
    };
    let sliver = "v 0 0 0\nv 9 1 0.3\nv 9 1.05 0.3\nf 1 2 3\n";
    for (name, text, flags) in [
        ("units", sliver.to_owned(), "--voxels 64/256"),
        ("hills", seed_files::hills(9), "--no-asvo"),
        ("fine", seed_files::hills(4), "--no-asvo --grid-bits 36"),
        ("coloured", seed_files::coloured_hills(3), "--no-asvo"),
        ("bent", seed_files::bent_hills(3), "--no-asvo"),
    ] {
        fs::write(inside.path().join("m.obj"), &text).unwrap();
        document_in(inside.path(), &format!("build m.obj -o {name}.trex {flags}"));
        let path = inside.path().join(format!("{name}.trex"));
        let bytes = fs::read(&path).unwrap();
        put("page_file", &format!("{name}.trex"), &bytes);
        put("superblock", name, &bytes[..1016]);
        let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
        let bits = [file.superblock().lattice_bits as u8];
        put("page", name, &[&bits[..], &seed_files::unpacked(&file, &bytes, PageKind::Mesh)].concat());
        if name == "units" {
            put("units", name, &seed_files::unpacked(&file, &bytes, PageKind::Units));
        }
    }
    let text = seed_files::hills(2);
    put("obj", "hills.obj", text.as_bytes());
    put(
        "obj",
        "odd.obj",
        b"v 0 0 0 # c\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl m\nf 1/2/3 2 3 4\nf -1 -2 \\\n -3\n",
    );
    fs::write(inside.path().join("m.obj"), sliver).unwrap();
    let ply = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let ascii = ply("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3\n";
    put("ply", "text.ply", ascii.as_bytes());
    let corners = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0].map(|v| (v as f32).to_bits());
    for (name, four) in [("little", u32::to_le_bytes as fn(u32) -> [u8; 4]), ("big", u32::to_be_bytes)] {
        let mut bytes = ply(&format!("binary_{name}_endian")).into_bytes();
        bytes.extend(corners.iter().flat_map(|&bits| four(bits)));
        for face in [&[0u32, 1, 2][..], &[0, 1, 2, 3]] {
            bytes.push(face.len() as u8);
            bytes.extend(face.iter().flat_map(|&index| four(index)));
        }
        put("ply", &format!("{name}.ply"), &bytes);
    }
    seed_files::put_texts(&put);
    seed_files::put_gltf(&put);
    seed_files::put_draco(&put);
    seed_files::put_volumes(&put);
    targets::left_over::sound().iter().for_each(|(target, name, bytes)| put(target, name, bytes));
    targets::shards::sound().iter().for_each(|(name, bytes)| put("shards", name, bytes));
    let small = fs::read(inside.path().join("fine.trex")).unwrap();
    targets::parts::sound(&small).iter().for_each(|(target, name, bytes)| put(target, name, bytes));
    let facet =
        "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    put("stl", "text.stl", format!("solid a\n{facet}{facet}endsolid a\n").as_bytes());
    let records: Vec<u8> = (0..100u8).map(|i| i.wrapping_mul(37) & 0x3f).collect();
    put("stl", "records.stl", &[&[b'x'; 80][..], &2u32.to_le_bytes(), &records].concat());
}
