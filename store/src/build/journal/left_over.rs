//! What builds that were killed or interrupted left beside their outputs: found, and removed.
//!
//! Invariants: 1. nothing is found but by a journal that says what it is; 2. nothing of a build at work is removed;
//! 3. a journal names no path but the folder of its scratch, in which its own names alone are looked for.

use super::files::{FileKind, JournalFiles, busy, bytes_of, lock};
use super::header::JournalHeader;
use crate::error::{Error, Result};
use crate::output::folder_of;
use serde::Serialize;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// Files of an unfinished build.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOver {
    /// The output that they would have become.
    pub output: PathBuf,
    /// How many there are.
    pub file_count: usize,
    /// Bytes that they take on disk.
    pub bytes: u64,
    /// A build is at work on them.
    pub is_running: bool,
}

/// Unfinished builds of an output; of all outputs in it where `place` is a folder. In the order of their names.
///
/// # Errors
/// Those of reading the folder.
pub fn find(place: &Path) -> Result<Vec<LeftOver>> {
    Ok(find_named(place)?.into_iter().map(|(_, found)| found).collect())
}

/// Removes what [`find`] finds; gives it.
///
/// # Errors
/// [`Code::Usage`](crate::Code::Usage) where a build is at work on an output of this name, and then nothing is removed
/// of it; those of [`find`], and of removing.
pub fn clean(place: &Path) -> Result<Vec<LeftOver>> {
    let mut cleaned = Vec::new();
    for (files, found) in find_named(place)? {
        let journal = files.path(FileKind::Journal);
        let is_folder = place.is_dir();
        let Some(_lock) = lock(&journal)? else {
            // Builds at work beside what was asked for are nobody's left-overs.
            if is_folder {
                continue;
            }
            return Err(busy(&found.output));
        };
        for path in files.all().into_iter().filter(|path| path.exists()) {
            std::fs::remove_file(&path).map_err(|e| Error::writing("remove a left-over", &path, &e))?;
        }
        cleaned.push(found);
    }
    Ok(cleaned)
}

fn find_named(place: &Path) -> Result<Vec<(JournalFiles, LeftOver)>> {
    if !place.is_dir() {
        let journal = JournalFiles::new(place, folder_of(place)).path(FileKind::Journal);
        return Ok(left_over(&journal).into_iter().collect());
    }
    let failed = |e| Error::io("read the folder", place, &e);
    let mut all = Vec::new();
    for entry in std::fs::read_dir(place).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|ending| ending == "journal") {
            all.extend(left_over(&path));
        }
    }
    all.sort_by(|a, b| a.1.output.cmp(&b.1.output));
    Ok(all)
}

/// What the file `journal` leads to, if it is a journal.
fn left_over(journal: &Path) -> Option<(JournalFiles, LeftOver)> {
    let header = JournalHeader::read(&crate::file::open_regular(journal).ok()?)?;
    let output = folder_of(journal).join(Path::new(OsStr::from_bytes(&header.output)).file_name()?);
    let files = JournalFiles::new(&output, header.scratch_folder(folder_of(journal)));
    if files.path(FileKind::Journal) != journal {
        return None;
    }
    let file_count = files.all().iter().filter(|path| path.exists()).count();
    let is_running = lock(journal).is_ok_and(|lock| lock.is_none());
    let bytes = bytes_of(&files);
    Some((files, LeftOver { output, file_count, bytes, is_running }))
}
