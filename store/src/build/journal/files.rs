//! The files of one output's builds: their names, and the lock that keeps two builders of one output apart.
//!
//! Invariant: the lock is the kernel's: it ends with its process, however that ends.

use super::record::unfinished;
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use crate::output::folder_of;
use rustix::fs::{FlockOperation, flock};
use rustix::io::{Errno, retry_on_intr};
use std::fs::{File, OpenOptions};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// Characters of an output's name that its journal's has, too: names end at 255 bytes.
const NAME_CHARS: usize = 40;
/// Tries to lock a journal that others remove meanwhile.
const LOCK_TRIES: u32 = 16;
/// A file of a build, by what it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// The output, page by page.
    Draft,
    /// Triangles on the lattice, in runs.
    Cells,
    /// Voxel records, in runs.
    Voxels,
    /// Record: the first triangles of the input, in cells.
    Sorted,
    /// Record: what partition found, which runs make which chunk.
    Chunks,
    /// Record: the chunks that are in the draft and in the voxel records.
    Emitted,
    /// Who builds what; removed last: while it is there, the others are found.
    Journal,
}

impl FileKind {
    /// All of them, the journal last.
    const ALL: [FileKind; 7] = [
        FileKind::Draft,
        FileKind::Cells,
        FileKind::Voxels,
        FileKind::Sorted,
        FileKind::Chunks,
        FileKind::Emitted,
        FileKind::Journal,
    ];
    /// Records, which have another name while they are written.
    pub(crate) const RECORDS: [FileKind; 3] = [FileKind::Sorted, FileKind::Chunks, FileKind::Emitted];

    /// The end of the file's name.
    fn ending(self) -> &'static str {
        match self {
            FileKind::Draft => "part",
            FileKind::Cells => "cells",
            FileKind::Voxels => "voxels",
            FileKind::Sorted => "sorted",
            FileKind::Chunks => "chunks",
            FileKind::Emitted => "done",
            FileKind::Journal => "journal",
        }
    }
}

/// Names of the files of one output's builds.
#[derive(Clone)]
pub(crate) struct JournalFiles {
    pub(super) folder: PathBuf,
    scratch_folder: PathBuf,
    stem: String,
}

impl JournalFiles {
    pub(crate) fn new(output: &Path, scratch_folder: &Path) -> JournalFiles {
        let name = output.file_name().unwrap_or_default();
        let kept: String = name.to_string_lossy().chars().take(NAME_CHARS).collect();
        let stem = format!(".{kept}.{:016x}", xxh3_64(name.as_bytes()));
        JournalFiles {
            folder: folder_of(output).to_path_buf(),
            scratch_folder: scratch_folder.to_path_buf(),
            stem,
        }
    }

    /// Path of the file of a kind.
    pub(super) fn path(&self, kind: FileKind) -> PathBuf {
        let folder = match kind {
            FileKind::Cells | FileKind::Voxels => &self.scratch_folder,
            _ => &self.folder,
        };
        folder.join(format!("{}.{}", self.stem, kind.ending()))
    }

    /// All files that may be there.
    pub(crate) fn all(&self) -> Vec<PathBuf> {
        let unfinished = FileKind::RECORDS.map(|kind| unfinished(&self.path(kind)));
        unfinished.into_iter().chain(FileKind::ALL.map(|kind| self.path(kind))).collect()
    }

    /// Removes what is there, but for the journal.
    pub(super) fn clear(&self) {
        self.all().iter().filter(|path| **path != self.path(FileKind::Journal)).for_each(|path| {
            let _ = std::fs::remove_file(path);
        });
    }
}

/// Bytes that the files take on disk.
pub(crate) fn bytes_of(files: &JournalFiles) -> u64 {
    files.all().iter().filter_map(|path| path.metadata().ok()).map(|found| found.blocks() * 512).sum()
}

/// The journal `path`, made where there is none, and locked; `None` where somebody else holds the lock.
pub(crate) fn lock(path: &Path) -> Result<Option<File>> {
    let failed = |e| Error::writing("open the journal", path, &e);
    for _ in 0..LOCK_TRIES {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        let file = file.map_err(failed)?;
        match retry_on_intr(|| flock(&file, FlockOperation::NonBlockingLockExclusive)) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => return Ok(None),
            Err(error) => {
                // Without locks nobody holds it.
                if file.metadata().is_ok_and(|found| found.len() == 0) {
                    let _ = std::fs::remove_file(path);
                }
                return Err(Error::writing("lock the journal", path, &error.into())
                    .next(NextStep::BuildWithoutResume));
            }
        }
        // Who held the lock may have removed the file since it was opened.
        let ours = file.metadata().map_err(failed)?;
        if path.metadata().is_ok_and(|found| (found.dev(), found.ino()) == (ours.dev(), ours.ino())) {
            return Ok(Some(file));
        }
    }
    Ok(None)
}

/// The error of an output that somebody else builds.
pub(crate) fn busy(output: &Path) -> Error {
    Error::new(Code::Usage, "another build of this output is at work")
        .at(output)
        .next(NextStep::WaitOrNameOutput)
}
