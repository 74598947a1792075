//! Losses of power: what a folder may hold after one, at every moment of a build, from what the build asked of the
//! kernel. What a file got since its last sync is there, or not, or a part of it; names that were made, changed or
//! removed since the folder's last sync likewise.
//!
//! Over any such folder the same command gives the bytes of a build that was let alone, and leaves nothing beside them;
//! before that, the output's name holds the old file or the new one, whole. Folders that are the same in every byte are
//! built in once. `TREX_FAULTS=full` takes every moment, of a larger build.

mod disk;

use crate::command::{TREX, document_in, hash_of, listing, run_in, said};
use crate::faults::traced_folder;
use crate::random::Random;
use disk::{Disk, Op, PowerLoss, ops_of};
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::path::Path;
use std::process::{Command, Stdio};

/// The calls by which something comes to the disk.
const CALLS: &str = "\
    openat,write,pwrite64,fsync,fdatasync,rename,renameat,renameat2,link,linkat,unlink,unlinkat,ftruncate,fallocate";
const OUTPUT: &str = "out.trex";
/// Random folders of a moment, beside those where all or nothing is kept.
const RANDOM: usize = 3;
/// Of so many moments one is taken, and of the last ones, among which the new name comes, so many.
const STEP: usize = 11;
const LAST: usize = 10;

/// Runs `trex LINE` in `folder`, and gives what it asked of the kernel for files in there.
fn traced(folder: &Path, line: &str) -> Vec<Op> {
    let log = folder.with_extension("strace");
    let mut command = Command::new("strace");
    command.args(["-f", "-qq", "-y", "-xx", "-s", "1000000000", "-e", &format!("trace={CALLS}"), "-o"]);
    command.arg(&log).arg(TREX).args(line.split_whitespace()).current_dir(folder);
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).status().unwrap();
    assert!(status.success(), "{line}: {status}");
    let text = fs::read_to_string(&log).unwrap();
    fs::remove_file(&log).unwrap();
    ops_of(&text, folder)
}

#[test]
fn after_any_loss_of_power_the_bytes_are_the_same() {
    let Some(inside) = traced_folder() else { return };
    let is_full = std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full");
    // In full, two chunks; of an iso-surface, whose voxels take a quarter of the time.
    let input = if is_full { "gen:isosurface:160k" } else { "gen:soup:10k" };
    // A record with every batch: of longer pauses the machine's speed decides how many there are, and whether any comes
    // while triangles are in cells alone.
    let every = "0.000001";
    let line =
        format!("build {input} --voxels 64 -o {OUTPUT} --overwrite --threads 1 --journal-every {every} -q");
    let output = inside.path().join(OUTPUT);
    document_in(inside.path(), &format!("build gen:soup:11k -o {OUTPUT}"));
    let (before, old) = (fs::read(&output).unwrap(), hash_of(&output));
    let ops = traced(inside.path(), &line);
    let whole = hash_of(&output);
    assert!(old != whole && ops.iter().any(|op| matches!(op, Op::Rename(..))), "{} calls", ops.len());

    let mut random = Random::seeded(77);
    let (mut count, mut resumed, mut sorted, mut new) = (0, 0, 0, 0);
    let (hasher, mut met) = (RandomState::new(), HashSet::new());
    let is_taken = |moment: &usize| is_full || moment.is_multiple_of(STEP) || moment + LAST > ops.len();
    for moment in (0..=ops.len()).filter(is_taken) {
        let mut disk = Disk::with(OUTPUT, before.clone());
        ops[..moment].iter().for_each(|op| disk.apply(op));
        let whims = (0..RANDOM).map(|_| PowerLoss::Some(random.bits()));
        let all = [PowerLoss::Nothing, PowerLoss::Everything, PowerLoss::Names, PowerLoss::Bytes]
            .into_iter()
            .chain(whims);
        for kept in all {
            let image = disk.after_loss(kept);
            count += 1;
            if !met.insert(hasher.hash_one(&image)) {
                continue;
            }
            let place = format!("{kept:?} kept after {moment} of {} calls", ops.len());
            put(inside.path(), &image);
            let there = hash_of(&output);
            assert!(there == old || there == whole, "{place}: neither the old file nor the new one");
            new += u32::from(there == whole);
            let ran = run_in(inside.path(), &format!("{line} --json"));
            assert_eq!(ran.code, Some(0), "{place}: {}", ran.stderr);
            resumed += u32::from(ran.document()["resumed_triangle_count"] != 0);
            sorted += u32::from(ran.document()["resumed_sorted_count"] != 0);
            assert!(hash_of(&output) == whole, "{place}: other bytes");
            let names: Vec<String> = listing(inside.path()).into_keys().collect();
            assert_eq!(names, [OUTPUT], "{place}");
        }
    }
    assert!(
        resumed > 0 && sorted > 0 && new > 0,
        "{resumed} gone on with, {sorted} in cells, {new} published"
    );
    said(&format!(
        "{count} losses of power, {} folders: chunks gone on from after {resumed}, cells after {sorted}; {new} after \
         the new name",
        met.len()
    ));
}

/// Makes a folder hold these files and no others.
fn put(folder: &Path, image: &BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap() {
        fs::remove_file(entry.unwrap().path()).unwrap();
    }
    image.iter().for_each(|(name, bytes)| fs::write(folder.join(name), bytes).unwrap());
}
