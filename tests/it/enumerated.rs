//! Faults one by one, none left to luck: every flip of a superblock, damages of pages by the thousand, and every read
//! of a session that fails in every way through every backend. `TREX_FAULTS=full` runs all of them; a normal run takes
//! one of each so many.

use crate::colours;
use crate::command::{cannot_run, document_in, folder, said};
use crate::fixtures::built_in;
use crate::normals;
use crate::random::Random;
use crate::support::content;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use trex_store::io::{DirectChoice, Fault, FaultPlan, IoChoice, IoOptions, Memory};
use trex_store::layout::{FRAME_BYTES, PageKind, SUPERBLOCK_BYTES};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::verify::{Level, Options, check};
use trex_store::{Budget, Code, PageFile};

/// Flips of the two superblocks: each bit of each alone, and pairs of one in each for the rest.
const FLIPS: usize = 65_536;
const PAGE_DAMAGES: usize = 100_000;
const MISPLACED: usize = 10_000;
/// Most reads of a session of faults.
const READS_MOST: u64 = 200;
/// Within this a session has ended.
const ENDED_WITHIN: Duration = Duration::from_secs(5);

/// Which of a thousand cases run: all, or each `step`.
fn step(normal: usize) -> usize {
    if std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full") { 1 } else { normal }
}

/// A model of some dozens of pages, of every kind.
fn model(inside: &Path) -> PathBuf {
    let (vertices, triangles) = colours::sheet(60);
    std::fs::write(inside.join("sheet.ply"), colours::ply(&vertices, &triangles, "uchar", false)).unwrap();
    std::fs::write(inside.join("waves.ply"), normals::waves(60).0).unwrap();
    document_in(inside, "build gen:pipes:60k sheet.ply waves.ply -o m.trex --voxels 64/256");
    let file = PageFile::open(&inside.join("m.trex"), &Budget::unlimited()).unwrap();
    for kind in [PageKind::Mesh, PageKind::Units, PageKind::Colours, PageKind::Normals] {
        assert!(file.pages().iter().any(|entry| entry.kind == kind), "no page of {kind:?}");
    }
    inside.join("m.trex")
}

#[test]
fn every_flip_of_a_superblock_is_found() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --voxels 64", "m.trex");
    let path = inside.path().join("m.trex");
    let options = Options { level: Level::Quick, bytes_per_s: None };
    let found = || {
        let verdict = check(&path, &options, &Budget::unlimited(), &|_, _| Ok(()));
        verdict.map(|verdict| verdict.damage_count).map_err(|error| error.code())
    };
    assert_eq!(found(), Ok(0));
    let file = File::options().read(true).write(true).open(&path).unwrap();
    let tail = file.metadata().unwrap().len() - SUPERBLOCK_BYTES as u64;
    let flip = |from: u64, bit: usize| {
        let (at, mut byte) = (from + bit as u64 / 8, [0]);
        file.read_exact_at(&mut byte, at).unwrap();
        file.write_all_at(&[byte[0] ^ 1 << (bit % 8)], at).unwrap();
    };
    let (bits, mut random, mut count) = (8 * SUPERBLOCK_BYTES, Random::seeded(3), 0);
    for case in (0..FLIPS).step_by(step(13)) {
        let flips: Vec<(u64, usize)> = match case / bits {
            0 => vec![(0, case)],
            1 => vec![(tail, case - bits)],
            _ => [0, tail].map(|from| (from, random.below(bits as i64) as usize)).to_vec(),
        };
        flips.iter().for_each(|&(from, bit)| flip(from, bit));
        let outcome = found();
        // One is enough to read the rest by; of two that are damaged neither says what there is.
        let is_found = match flips.len() {
            1 => outcome.is_ok_and(|count| count > 0) || outcome == Err(Code::Version),
            _ => outcome != Ok(0),
        };
        assert!(is_found, "{flips:?}: {outcome:?}");
        flips.iter().for_each(|&(from, bit)| flip(from, bit));
        count += 1;
    }
    assert_eq!(found(), Ok(0));
    said(&format!("{count} flips of superblocks, all found"));
}

#[test]
fn every_file_that_ends_at_a_border_is_told() {
    let inside = folder();
    let path = model(inside.path());
    let whole = File::options().read(true).write(true).open(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let length = bytes.len() as u64;
    let borders: std::collections::BTreeSet<u64> = {
        let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
        let pages = file.pages().iter().map(|entry| (entry.offset, u64::from(entry.stored_bytes)));
        let sections = file.superblock().sections.iter().map(|section| (section.offset, section.bytes));
        let superblocks = [0, length - SUPERBLOCK_BYTES as u64].map(|at| (at, SUPERBLOCK_BYTES as u64));
        let parts = pages.chain(sections).chain(superblocks);
        let ends = parts.flat_map(|(at, bytes)| [at, at + bytes]);
        ends.flat_map(|end| [end.saturating_sub(1), end, end + 1]).filter(|&end| end < length).collect()
    };
    let found = |level| {
        let options = Options { level, bytes_per_s: None };
        let verdict = check(&path, &options, &Budget::unlimited(), &|_, _| Ok(()));
        verdict.map(|verdict| verdict.damage_count).map_err(|error| error.code())
    };
    for &end in &borders {
        whole.set_len(end).unwrap();
        for level in [Level::Quick, Level::Hashes] {
            let is_told = match found(level) {
                Ok(damage_count) => damage_count > 0,
                Err(code) => [Code::Damaged, Code::InputFormat].contains(&code),
            };
            assert!(is_told, "{level:?} of the first {end} of {length} bytes");
        }
        whole.write_all_at(&bytes[end as usize..], end).unwrap();
    }
    assert_eq!(found(Level::Hashes), Ok(0));
    said(&format!("{} files that end at a border, all told", borders.len()));
}

#[test]
fn every_damage_of_a_page_is_found() {
    let inside = folder();
    let path = model(inside.path());
    let bytes = std::fs::read(&path).unwrap();
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let stored = |page: usize| {
        let entry = file.pages()[page];
        &bytes[entry.offset as usize..][..entry.stored_bytes as usize]
    };
    let (mut frame, mut scratch, mut random) = (vec![0; FRAME_BYTES], Vec::new(), Random::seeded(5));
    let mut code = |page: usize, bytes: &[u8]| {
        file.install(page as u32, bytes, &mut frame, &mut scratch).map_err(|error| error.code())
    };
    let (page_count, mut damaged) = (file.pages().len(), Vec::new());
    assert!((0..page_count).all(|page| code(page, stored(page)).is_ok()));
    let (mut count, mut unchanged) = (0, 0);
    for case in (0..PAGE_DAMAGES).step_by(step(5)) {
        let page = random.below(page_count as i64) as usize;
        damaged.clear();
        damaged.extend_from_slice(stored(page));
        let (length, at) = (damaged.len(), random.below(damaged.len() as i64) as usize);
        let run = at..(at + 1 + random.below(512) as usize).min(length);
        match case / 5 % 6 {
            0 => damaged[at] ^= 1 << random.below(8),
            1 => damaged[run].fill(0),
            2 => damaged[run].iter_mut().for_each(|byte| *byte = random.bits() as u8),
            3 => damaged[at..].rotate_left(1),
            4 => damaged.truncate(at),
            _ => damaged.push(0),
        }
        if damaged == stored(page) {
            unchanged += 1;
            continue;
        }
        assert_eq!(code(page, &damaged), Err(Code::Damaged), "case {case}, page {page} at {at}");
        count += 1;
    }
    assert!(unchanged < count / 10, "{unchanged} changes changed nothing");

    // Whole pages in the place of others, and of another build of the same mesh.
    built_in(inside.path(), "gen:pipes:60k --voxels 64/256 --grid-bits 20", "stale.trex");
    let stale_bytes = std::fs::read(inside.path().join("stale.trex")).unwrap();
    let stale = PageFile::open(&inside.path().join("stale.trex"), &Budget::unlimited()).unwrap();
    for case in (0..MISPLACED).step_by(step(5)) {
        let page = random.below(page_count as i64) as usize;
        let other = (page + 1 + random.below(page_count as i64 - 1) as usize) % page_count;
        let entry = stale.pages()[page.min(stale.pages().len() - 1)];
        let misplaced = match case / 5 % 2 {
            0 => stored(other),
            _ => &stale_bytes[entry.offset as usize..][..entry.stored_bytes as usize],
        };
        assert_eq!(code(page, misplaced), Err(Code::Damaged), "page {page} for {other} or stale");
        count += 1;
    }
    said(&format!("{count} damages of pages, all found"));
}

/// A backend of a session, by name; `None` where this machine lacks it.
fn backend(name: &str, path: &Path) -> Option<Box<dyn trex_store::io::Backend>> {
    if name == "memory" {
        return Some(Box::new(Memory::new(std::fs::read(path).unwrap().into(), 8, 1)));
    }
    let io: IoChoice = name.parse().unwrap();
    let options = IoOptions { io, direct: DirectChoice::Auto, depth: 8, pread_threads: 2, connections: 0 };
    trex_store::io::open(path, &options).ok()
}

#[test]
fn every_read_that_fails_is_made_again_or_told() {
    let inside = folder();
    let path = model(inside.path());
    let page_count = PageFile::open(&path, &Budget::unlimited()).unwrap().pages().len() as u32;
    // Asks for all pages, one by one; gives what came of each, and how many reads there were.
    let session = |name: &str, failing: Option<(std::ops::Range<u64>, i32)>| {
        let file = Arc::new(PageFile::open(&path, &Budget::unlimited()).unwrap());
        let plan = FaultPlan { failing, ..FaultPlan::default() };
        let fault = Box::new(Fault::new(backend(name, &path)?, plan));
        let options = PoolOptions { frames_bytes: 8 * FRAME_BYTES as u64, ..PoolOptions::default() };
        let pool =
            PagePool::with_backend(file.clone(), fault, &path, &Budget::unlimited(), &options).unwrap();
        let pages: Vec<_> =
            (0..page_count).map(|page| pool.pin_blocking(page).map(|pin| content(&file, &pin))).collect();
        Some((pages, pool.stats().reads))
    };
    let errnos: [i32; 8] = [5, 12, 4, 11, 6, 19, 9, 75];
    let mut count = 0;
    for name in ["uring", "pread", "mmap", "memory"] {
        let Some((whole, reads)) = session(name, None) else {
            cannot_run(&format!("this machine has no {name}"));
            continue;
        };
        assert!(
            whole.iter().all(Result::is_ok) && (10..=READS_MOST).contains(&reads),
            "{name}: {reads} reads"
        );
        for (number, errno) in (0..reads).step_by(step(7)).flat_map(|n| errnos.map(|errno| (n, errno))) {
            let begin = Instant::now();
            // One read that fails is made again.
            let (pages, _) = session(name, Some((number..number + 1, errno))).unwrap();
            let same = pages
                .iter()
                .zip(&whole)
                .all(|(page, whole)| page.as_ref().is_ok_and(|page| page == whole.as_ref().unwrap()));
            assert!(same, "{name}: read {number}, errno {errno}");
            // All from one on: what came before is whole, the rest is told, and nobody waits.
            let (pages, _) = session(name, Some((number..u64::MAX, errno))).unwrap();
            let failed = pages.iter().filter(|page| page.is_err()).count();
            assert!(failed > 0, "{name}: read {number}, errno {errno}");
            for (page, whole) in pages.iter().zip(&whole) {
                match page {
                    Ok(page) => assert!(page == whole.as_ref().unwrap()),
                    Err(error) => assert_eq!(error.code(), Code::Io, "{name}: {error}"),
                }
            }
            assert!(begin.elapsed() < ENDED_WITHIN, "{name}: {:?}", begin.elapsed());
            count += 2;
        }
    }
    said(&format!("{count} sessions with a read that fails, all exact or told"));
}
