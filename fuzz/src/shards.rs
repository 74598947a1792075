//! The plan of a build in shards, and a fragment of it, with a part changed and every hash right: a shard that is
//! built by the plan, and a merge of the fragment, come to their end or refuse, in the memory that they were given.
//!
//! ```text
//! number of a part (1 byte), the part    0 head of the plan, 1 its materials, 2 its cells; 3 head of the fragment,
//!                                        4 its materials, 5 bytes of its chunks, 6 places of its voxel runs;
//!                                        7 its chunk, of any length; 8 head of the triangles of a plan,
//!                                        9 pieces of their chunks, 10 places of these
//! ```

use super::left_over::{Sheet, budget, options, parts, record};
use std::fs;
use std::path::Path;
use std::sync::LazyLock;
use trex_store::build::shards::{self, MergeWork, ScanWork, ShardPlan, ShardWork};
use trex_store::{Budget, Code, PageFile, Result, TriangleSource};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// Squares along a side of the sheet.
const SIDE: usize = 7;
/// Bytes before the record of a plan, and before the chunks of a fragment.
const HEAD: usize = 16;
/// Bytes behind a record.
const END: usize = 16;
const WORD: usize = 8;

/// The files of a build in one shard.
struct ShardFiles {
    plan: Vec<u8>,
    /// The plan with its triangles.
    full_plan: Vec<u8>,
    fragment: Vec<u8>,
}

/// A fragment in pieces.
struct FragmentPieces {
    chunk: Vec<u8>,
    voxels: Vec<u8>,
    record: Vec<Vec<u8>>,
}

static SOUND: LazyLock<ShardFiles> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let budget = budget();
    let [plan, full_plan] = [("plan", false), ("full plan", true)].map(|(name, keeps_triangles)| {
        let output = folder.path().join(name);
        let work = ScanWork { output: &output, facts: &[], keeps_triangles, options: &options(&budget) };
        shards::scan(&mut Sheet::new(SIDE), &work, &|_| {}).expect("a sheet can be scanned");
        fs::read(output).expect("a plan")
    });
    build(folder.path(), &plan, &budget).expect("a sheet can be built");
    let fragment = fs::read(folder.path().join("fragment")).expect("a fragment");
    ShardFiles { plan, full_plan, fragment }
});

fn build(folder: &Path, plan: &[u8], budget: &Budget) -> Result<()> {
    let (plan_path, output) = (folder.join("plan"), folder.join("fragment"));
    fs::write(&plan_path, plan).expect("room for a small file");
    let plan = ShardPlan::read(&plan_path, budget)?;
    let work = ShardWork {
        plan: &plan,
        plan_path: &plan_path,
        share: (1, 1),
        facts: None,
        output: &output,
        options: &options(budget),
        on_plan: &|_| {},
    };
    let sheet: Option<&mut dyn TriangleSource> = match plan.has_triangles() {
        true => None,
        false => Some(&mut Sheet::new(SIDE)),
    };
    shards::build(sheet, &work, &|_| {}).map(drop)
}

fn merge(folder: &Path, fragment: &[u8], budget: &Budget) -> Result<()> {
    let (path, output) = (folder.join("fragment"), folder.join("out.trex"));
    fs::write(&path, fragment).expect("room for a small file");
    let work = MergeWork { fragments: &[path], output: &output, options: &options(budget) };
    shards::merge(&work, &|_| {})?;
    PageFile::open(&output, &Budget::unlimited()).expect("what was published is a page file");
    Ok(())
}

/// The record behind which a file ends, and where it begins.
fn last_record(bytes: &[u8]) -> (usize, &[u8]) {
    let end = bytes.len() - END;
    let at = u64::from_le_bytes(*bytes[end..].first_chunk().expect("a word")) as usize;
    (at, &bytes[at..end])
}

/// Bytes, a record behind them, and where that is.
fn with_record(mut bytes: Vec<u8>, parts: &[Vec<u8>]) -> Vec<u8> {
    let (at, record) = (bytes.len() as u64, record(parts));
    bytes.extend(&record);
    bytes.extend(at.to_le_bytes());
    bytes.extend((record.len() as u64).to_le_bytes());
    bytes
}

/// The pieces of the fragment, which has one chunk.
fn pieces() -> FragmentPieces {
    let (bytes, (record_at, record)) = (&SOUND.fragment, last_record(&SOUND.fragment));
    let record = parts(record);
    let chunk_bytes = u32::from_le_bytes(*record[2].first_chunk().expect("a chunk")) as usize;
    let voxels_at = HEAD + chunk_bytes;
    FragmentPieces {
        chunk: bytes[HEAD + WORD..voxels_at].to_vec(),
        voxels: bytes[voxels_at..record_at].to_vec(),
        record,
    }
}

/// The fragment of such pieces, under the right hashes.
fn joined(pieces: &FragmentPieces) -> Vec<u8> {
    let mut bytes = SOUND.fragment[..HEAD].to_vec();
    bytes.extend(xxh3_64_with_seed(&pieces.chunk, HEAD as u64).to_le_bytes());
    bytes.extend(&pieces.chunk);
    bytes.extend(&pieces.voxels);
    with_record(bytes, &pieces.record)
}

/// The fragment with another chunk, whose length its record tells.
fn with_chunk(content: &[u8]) -> Vec<u8> {
    let mut pieces = pieces();
    pieces.chunk = content.to_vec();
    let chunk_bytes = (WORD + content.len()) as u32;
    pieces.record[2] = chunk_bytes.to_le_bytes().to_vec();
    let mut head: serde_json::Value = serde_json::from_slice(&pieces.record[0]).expect("JSON");
    head["voxels_at"] = (HEAD as u64 + u64::from(chunk_bytes)).into();
    pieces.record[0] = serde_json::to_vec(&head).expect("plain data");
    joined(&pieces)
}

/// True when the shard or the merge comes to its end.
pub fn shards(bytes: &[u8]) -> bool {
    let Some((&number, part)) = bytes.split_first() else { return false };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let budget = budget();
    let outcome = match number {
        0..=2 => {
            let mut parts = parts(last_record(&SOUND.plan).1);
            parts[usize::from(number)] = part.to_vec();
            build(folder.path(), &with_record(SOUND.plan[..HEAD].to_vec(), &parts), &budget)
        }
        3..=6 => {
            let mut pieces = pieces();
            pieces.record[usize::from(number) - 3] = part.to_vec();
            merge(folder.path(), &joined(&pieces), &budget)
        }
        7 => merge(folder.path(), &with_chunk(part), &budget),
        8..=10 => {
            let (plan_at, plan) = last_record(&SOUND.full_plan);
            let (at, triangles) = last_record(&SOUND.full_plan[..plan_at]);
            let mut triangles = parts(triangles);
            triangles[usize::from(number) - 8] = part.to_vec();
            let bytes = with_record(SOUND.full_plan[..at].to_vec(), &triangles);
            build(folder.path(), &with_record(bytes, &parts(plan)), &budget)
        }
        _ => return false,
    };
    assert_eq!(budget.used_bytes(), 0, "memory that nobody gave back");
    match outcome {
        Ok(()) => true,
        Err(error) => {
            let codes = [
                Code::Damaged,
                Code::InputFormat,
                Code::InputMismatch,
                Code::InputRange,
                Code::Io,
                Code::MemoryLimit,
                Code::Usage,
            ];
            assert!(codes.contains(&error.code()), "{error}");
            false
        }
    }
}

/// The parts that [`shards`] changes, as they are: what seeds are made of.
pub fn sound() -> Vec<(String, Vec<u8>)> {
    let pieces = pieces();
    let triangles = last_record(&SOUND.full_plan[..last_record(&SOUND.full_plan).0]).1;
    let plan = parts(last_record(&SOUND.plan).1);
    let all = [plan, pieces.record, vec![pieces.chunk], parts(triangles)].concat();
    let seed =
        |(number, part): (usize, Vec<u8>)| (format!("part-{number}"), [&[number as u8][..], &part].concat());
    all.into_iter().enumerate().map(seed).collect()
}
