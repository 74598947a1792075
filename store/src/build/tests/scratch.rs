//! Bits that turn while a build runs, in whatever it has spilled: the model that comes out is the right one, or there
//! is none. One flipped bit used to end, in four of fourteen tries, in a wrong model whose every hash was right.

use super::*;
use crate::octree::Refinement;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::Mutex;

/// When a bit turns: at the first report of this phase.
type Moment = &'static str;
/// All triangles are in cells, no chunk is made.
const PARTED: Moment = "clusters";
/// All records are merged, nothing of the octree is in the file.
const MERGED: Moment = "voxels";

/// Places in a file, evenly spread; one more is its first bit.
const PARTS: usize = 3;
/// So many bits turn, where more are asked for than a normal run turns.
const FLIPS_VARIABLE: &str = "TREX_FLIPS";

/// The scratch files that this process has open in `folder`, longest first. They have no name but that of their handle.
fn scratch_files(folder: &Path) -> Vec<File> {
    let handles = std::fs::read_dir("/proc/self/fd").unwrap().filter_map(|handle| {
        let handle = handle.ok()?.path();
        let place = std::fs::read_link(&handle).ok()?;
        let is_ours = place.starts_with(folder) && place.to_string_lossy().ends_with("(deleted)");
        is_ours.then(|| OpenOptions::new().read(true).write(true).open(&handle).ok())?
    });
    let length = |file: &File| file.metadata().unwrap().len();
    let mut files: Vec<File> = handles.filter(|file| length(file) > 0).collect();
    files.sort_by_key(|file| std::cmp::Reverse(length(file)));
    files
}

/// Turns one bit of `file`, at `part` of its length.
fn flip(file: &File, part: f64) {
    let mut byte = [0];
    let bit = (part * 8.0 * file.metadata().unwrap().len() as f64) as u64;
    file.read_exact_at(&mut byte, bit / 8).unwrap();
    byte[0] ^= 1 << (bit % 8);
    file.write_all_at(&byte, bit / 8).unwrap();
}

/// A build in which bits turn.
struct Bad {
    voxels: Voxels,
    moment: Moment,
    /// Which of the scratch files that are there then, by length.
    which: usize,
    /// Where in it.
    part: f64,
}

impl Bad {
    /// The file that was published or the error, and how many scratch files there were at the moment.
    fn build(&self, mesh: &mut MemoryMesh) -> (Result<Vec<u8>>, usize) {
        let folder = tempfile::tempdir().unwrap();
        let (path, scratch): (PathBuf, PathBuf) =
            (folder.path().join("out.trex"), folder.path().join("scratch"));
        std::fs::create_dir(&scratch).unwrap();
        let found = Mutex::new(None);
        let report = |progress: Progress| {
            let mut found = found.lock().unwrap();
            if progress.phase == self.moment && found.is_none() {
                let files = scratch_files(&scratch);
                files.get(self.which).iter().for_each(|file| flip(file, self.part));
                *found = Some(files.len());
            }
        };
        let options =
            BuildOptions { voxels: self.voxels, temp_dir: Some(scratch.clone()), ..options(2, 1 << 30) };
        mesh.rewind().unwrap();
        let built = build(mesh, &path, &options, &|_| {}, &report);
        assert_eq!(path.exists(), built.is_ok(), "published or not");
        let found = found.lock().unwrap().expect("the phase was reported");
        (built.map(|_| std::fs::read(&path).unwrap()), found)
    }
}

/// Says what was counted, to those who run it with `--nocapture`.
#[allow(clippy::print_stdout)]
fn say(what: &str) {
    println!("{what}");
}

#[test]
fn a_bit_that_turns_in_scratch_is_never_published() {
    let mut mesh = mesh(130, 20, 5);
    let resident = Voxels::Resolution(256);
    let refined = Voxels::Refined { upper: 64, refinement: Refinement::By4 };
    // Partition's; then also that of records, and of the streams of the octree; then also that of families.
    // How many there are at least, and how many of them are still to be read from end to end.
    let moments = [(resident, PARTED, 1, 1), (resident, MERGED, 4, 2), (refined, MERGED, 3, 1)];
    let least: usize = moments.iter().map(|(.., files, _)| files).sum();
    let flips: Option<usize> = std::env::var(FLIPS_VARIABLE).ok().map(|count| count.parse().unwrap());
    let parts = flips.map_or(PARTS, |count| count.div_ceil(least).max(PARTS));
    let (mut turned, mut harmless) = (0, 0);
    for (voxels, moment, files, unread) in moments {
        let bad = |which, part| Bad { voxels, moment, which, part };
        // None of so many: nothing is turned.
        let (whole, found) = bad(usize::MAX, 0.0).build(&mut mesh);
        let whole = whole.unwrap();
        assert!(found >= files, "{moment}: {found} scratch files");
        let mut refused = vec![0; found];
        for which in 0..found {
            for part in (0..parts).map(|part| (part as f64 + 0.377) / parts as f64).chain([0.0]) {
                turned += 1;
                match bad(which, part).build(&mut mesh).0 {
                    // What was read before does no harm.
                    Ok(bytes) => {
                        assert!(bytes == whole, "{moment} {which} {part}: a wrong model");
                        harmless += 1;
                    }
                    Err(error) => {
                        assert_eq!(error.code(), Code::Io, "{moment} {which} {part}: {error}");
                        assert!(error.what().contains("scratch"), "{error}");
                        assert!(error.place().contains(" at byte "), "{error}");
                        assert!(!error.next_step().is_empty() && !error.numbers_text().is_empty(), "{error}");
                        refused[which] += usize::from(part > 0.0);
                    }
                }
            }
        }
        // All that is still to be read is under a hash.
        let whole_files = refused.iter().filter(|&&count| count == parts).count();
        assert!(whole_files >= unread, "{moment}: {refused:?}");
    }
    say(&format!(
        "{turned} bits turned: {} builds refused, {harmless} right all the same",
        turned - harmless
    ));
}
