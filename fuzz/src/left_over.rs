//! What a build that was stopped leaves, with a part of it changed and every hash right: a build that is started again
//! goes on from it, begins anew or refuses, and the memory that it was given is enough.
//!
//! ```text
//! journal: number of a part (1 byte), the part    0 journal, 1 head of `chunks`, 2 materials, 3 head of `done`,
//!                                                 4 page table, 5 roots, 6 emitters, 7 places of voxel records;
//!                                                 of a build stopped while it read: 8 head of `sorted`, 9 sketches,
//!                                                 10 cells, 11 runs
//! scratch: number of a file (1 byte), a block     0 first run of cells, 1 first block of voxel records;
//!                                                 2 first run of cells of the build stopped while it read
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use trex_store::build::{self, BuildOptions, ExistingOutput, Precision, Resume, Voxels};
use trex_store::{
    Budget, Code, Interrupt, Material, MaterialList, PageFile, Progress, RESERVE_BYTES, Result, ScanHint,
    SourceStats, TriangleBatch, TriangleSource,
};
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

/// Squares along a side of the sheet that is built: some pages, and the end of a chunk that is in none.
const SIDE: usize = 100;
/// Memory beside what the smallest build takes.
const ROOM: u64 = 8 << 20;
/// Bytes of a hash, and of a length.
const WORD: usize = 8;
const OUTPUT: &str = "out.trex";

/// A sheet with hills and two materials, of which one emits.
pub(super) struct Sheet {
    /// Squares along a side, and rows of them that were delivered.
    side: usize,
    row: usize,
    materials: MaterialList,
}

impl Sheet {
    pub(super) fn new(side: usize) -> Sheet {
        let lamp = Material { ke: [4.0; 3], ..Material::default() };
        let materials = [("default", Material::default()), ("lamp", lamp)];
        Sheet { side, row: 0, materials: materials.into_iter().collect() }
    }
}

impl TriangleSource for Sheet {
    fn name(&self) -> String {
        "sheet".into()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        let point = |x: usize, y: usize| {
            let (x, y) = (x as f64, y as f64);
            [x, y, 4.0 * (0.3 * x).sin() * (0.2 * y).cos()]
        };
        if self.row < self.side {
            let y = self.row;
            for x in 0..self.side {
                let [a, b, c, d] = [point(x, y), point(x + 1, y), point(x + 1, y + 1), point(x, y + 1)];
                batch.push([a, b, c], 0);
                batch.push([a, c, d], u32::from((x + y).is_multiple_of(50)));
            }
            self.row += 1;
        }
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.row = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats::default()
    }
}

/// How sheets are built, in the memory of `budget`.
pub(super) fn options(budget: &Budget) -> BuildOptions {
    static THREADS: LazyLock<Arc<rayon::ThreadPool>> =
        LazyLock::new(|| Arc::new(rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread")));
    BuildOptions {
        precision: Precision::Default,
        voxels: Voxels::Resolution(64),
        pool: Arc::clone(&THREADS),
        budget: budget.clone(),
        temp_dir: None,
        existing: ExistingOutput::Replace,
        interrupt: Interrupt::default(),
        resume: Some(Resume { input: vec![("input".into(), "sheet".into())], every: Duration::ZERO }),
    }
}

/// The memory that a build gets.
pub(super) fn budget() -> Budget {
    Budget::new(RESERVE_BYTES + build::smallest_bytes() + ROOM)
}

/// Builds the sheet in `folder` until a report that `is_end` knows. Gives the triangles that were gone on with.
fn build_in(folder: &Path, is_end: impl Fn(&Progress) -> bool + Sync) -> Result<u64> {
    let budget = budget();
    let options = options(&budget);
    let report = |progress: Progress| {
        if is_end(&progress) {
            options.interrupt.raise();
        }
    };
    let built = build::build(&mut Sheet::new(SIDE), &folder.join(OUTPUT), &options, &|_| {}, &report);
    assert_eq!(budget.used_bytes(), 0, "memory that nobody gave back");
    built.map(|report| report.resumed_triangle_count + report.resumed_sorted_count)
}

/// The file of a build that comes to its end.
pub(super) fn finished() -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    build_in(folder.path(), |_| false).expect("a sheet can be built");
    fs::read(folder.path().join(OUTPUT)).expect("a file")
}

/// Files by their endings: name and bytes.
type Files = BTreeMap<String, (String, Vec<u8>)>;

/// The files that a build leaves which is stopped at its end.
static LEFT: LazyLock<Files> = LazyLock::new(|| left_at(|progress| progress.phase == "check"));

/// And one that is stopped while it reads.
static READING: LazyLock<Files> =
    LazyLock::new(|| left_at(|progress| progress.phase == "partition" && progress.done > 19_000));

fn left_at(is_end: impl Fn(&Progress) -> bool + Sync) -> Files {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let stopped = build_in(folder.path(), is_end);
    assert_eq!(stopped.expect_err("a build that was stopped").code(), Code::Interrupted);
    let entries = fs::read_dir(folder.path()).expect("the folder");
    let files = entries.map(|entry| {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a file").to_str().expect("plain letters").to_owned();
        let ending = name.rsplit('.').next().expect("an ending").to_owned();
        (ending, (name, fs::read(&path).expect("a file")))
    });
    files.collect()
}

fn left(ending: &str) -> Vec<u8> {
    LEFT[ending].1.clone()
}

/// The head and the blobs of a record.
pub(super) fn parts(record: &[u8]) -> Vec<Vec<u8>> {
    let word = |at: usize| {
        let word = record[WORD * at..].first_chunk().expect("a word");
        u64::from_le_bytes(*word) as usize
    };
    let mut at = WORD * (2 + word(1));
    let part = |number: usize| {
        let begin = at;
        at += word(2 + number);
        record[begin..at].to_vec()
    };
    (0..word(1)).map(part).collect()
}

/// The record of such parts, under the right hash.
pub(super) fn record(parts: &[Vec<u8>]) -> Vec<u8> {
    let lengths = parts.iter().map(Vec::len);
    let words = std::iter::once(parts.len()).chain(lengths).flat_map(|word| (word as u64).to_le_bytes());
    let rest: Vec<u8> = words.chain(parts.iter().flatten().copied()).collect();
    [&xxh3_64(&rest).to_le_bytes()[..], &rest].concat()
}

/// A record with another part.
fn with_part(files: &Files, ending: &str, number: usize, part: &[u8]) -> Vec<u8> {
    let mut parts = parts(&files[ending].1);
    parts[number] = part.to_vec();
    record(&parts)
}

/// The journal of a build, and its records. True when a build goes on from them to its end.
pub fn journal(bytes: &[u8]) -> bool {
    let Some((&number, part)) = bytes.split_first() else { return false };
    let (files, ending, first) = match number {
        0 => return go_on(&LEFT, "journal", part),
        1 | 2 => (&LEFT, "chunks", 1),
        3..=7 => (&LEFT, "done", 3),
        8..=12 => (&READING, "sorted", 8),
        _ => return false,
    };
    go_on(files, ending, &with_part(files, ending, usize::from(number - first), part))
}

/// Blocks of scratch files. True when a build goes on from them to its end.
pub fn scratch(bytes: &[u8]) -> bool {
    let Some((&number, block)) = bytes.split_first() else { return false };
    let Some((ending, block_bytes, offset, name)) = block_of(number) else { return false };
    let files = if number == 2 { &READING } else { &LEFT };
    let mut changed = files[ending].1.clone();
    let (hash, content) = changed[offset..][..block_bytes].split_at_mut(WORD);
    content.fill(0);
    let taken = block.len().min(content.len());
    content[..taken].copy_from_slice(&block[..taken]);
    hash.copy_from_slice(&xxh3_64_with_seed(content, name).to_le_bytes());
    go_on(files, ending, &changed)
}

/// The first block of a scratch file: its ending, and the block's bytes, offset and name.
fn block_of(number: u8) -> Option<(&'static str, usize, usize, u64)> {
    if number == 0 {
        let head: serde_json::Value = serde_json::from_slice(&parts(&left("chunks"))[0]).expect("JSON");
        let run = &head["chunks"][0]["pieces"][0]["run"];
        let [bytes, offset] = ["bytes", "offset"].map(|name| run[name].as_u64().expect("a number"));
        return Some(("cells", bytes as usize, offset as usize, offset));
    }
    if number == 2 {
        let words = parts(&READING["sorted"].1)[3].clone();
        let word = |at: usize| u64::from_le_bytes(*words[WORD * at..].first_chunk().expect("a word"));
        return Some(("cells", (word(1) >> 32) as usize, word(0) as usize, word(0)));
    }
    // Its words: the end of all, then of each run its place in the order, its offset, its records and its blocks.
    let words = parts(&left("done"))[4].clone();
    let word = |at: usize| u64::from_le_bytes(*words[WORD * at..].first_chunk().expect("a word"));
    let (chunk, run) = (word(1) >> 32, word(1) & 0xffff_ffff);
    (number == 1).then_some(("voxels", word(4) as usize, word(2) as usize, chunk << 32 | run << 16))
}

/// The parts that [`journal`] and [`scratch`] change, as they are: what seeds are made of.
pub fn sound() -> Vec<(&'static str, String, Vec<u8>)> {
    let sorted = parts(&READING["sorted"].1);
    let all = [vec![left("journal")], parts(&left("chunks")), parts(&left("done")), sorted].concat();
    let journals = all
        .into_iter()
        .enumerate()
        .map(|(number, part)| ("journal", format!("part-{number}"), [&[number as u8][..], &part].concat()));
    let blocks = [(0, &LEFT), (1, &LEFT), (2, &READING)].map(|(number, files)| {
        let (ending, bytes, offset, _) = block_of(number).expect("a block");
        let block = files[ending].1[offset..][..bytes][WORD..].to_vec();
        ("scratch", format!("{ending}-{number}"), [&[number][..], &block].concat())
    });
    journals.chain(blocks).collect()
}

/// Goes on with what was left, one file of which is another.
fn go_on(files: &Files, ending: &str, changed: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (other, (name, bytes)) in files {
        let bytes = if other == ending { changed } else { bytes };
        fs::write(folder.path().join(name), bytes).expect("room for a small file");
    }
    // One that begins anew is a build as any.
    match build_in(folder.path(), |progress| progress.phase == "scan") {
        Ok(resumed) => {
            let output = folder.path().join(OUTPUT);
            PageFile::open(&output, &Budget::unlimited()).expect("what was published is a page file");
            resumed > 0
        }
        Err(error) => {
            let codes = [Code::Io, Code::Usage, Code::Interrupted, Code::MemoryLimit];
            assert!(codes.contains(&error.code()), "{error}");
            false
        }
    }
}
