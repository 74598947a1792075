//! `Journal`: what lets a build that was killed resume, beside the output.
//!
//! ```text
//! .NAME.HASH.journal   who builds what: its flock keeps two builders of one output apart
//! .NAME.HASH.cells     triangles on the lattice, in runs          (in the folder of scratch files)
//! .NAME.HASH.voxels    voxel records, in runs                     (as above)
//! .NAME.HASH.part      the output, page by page
//! .NAME.HASH.sorted    record: the first triangles of the input, in cells, replaced every few seconds
//! .NAME.HASH.chunks    record: what partition found, which runs make which chunk
//! .NAME.HASH.done      record: the chunks that are in .part and .voxels, replaced every few seconds
//! ```
//!
//! A finished unit is each batch of triangles that is in cells, then each chunk. A stream cannot be entered in its
//! middle: what is in cells is read again, but neither scanned nor sorted. `checkpoint` says which records lead
//! back to where.
//!
//! Invariants: 1. a record is written after all that it speaks of was synced; 2. a run of cells is given back after the
//! record that does without it was; 3. input and options stand in the journal: a build resumes with the same ones or
//! not at all; 4. a builder that ends, but for an interrupt, removes all of them; 5. the lock is the kernel's: it ends
//! with its process, however that ends.

mod files;
mod header;
pub mod left_over;
pub(super) mod record;

pub(super) use files::FileKind;

use crate::budget::Budget;
use crate::build::options::BuildOptions;
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use crate::source::SourceStats;
use crate::stamp;
use files::{JournalFiles, busy, bytes_of, lock};
use header::JournalHeader;
use record::JournalRecord;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long somebody may hold the lock who only looks whether it is held.
const GLANCE: Duration = Duration::from_millis(50);
/// Time between two records, over the time that one took: so they cost a twentieth. Beyond the second number, over the
/// time that was asked for, a slow disk costs more than that.
const PAUSE: u32 = 20;
const PAUSE_MOST: u32 = 3;

/// The journal of a build under way.
pub(crate) struct Journal {
    output: PathBuf,
    files: JournalFiles,
    /// Holds the lock.
    file: File,
    every: Duration,
    due: Instant,
    /// Records that are there.
    records: Vec<FileKind>,
    is_kept: bool,
}

impl Journal {
    /// Locks `output`; `None` for a build that leaves nothing.
    ///
    /// # Errors
    /// [`Code::Usage`] where another builder is at work on this output, or one was with other input or options.
    pub(crate) fn begin(
        output: &Path,
        scratch_folder: &Path,
        options: &BuildOptions,
    ) -> Result<Option<Journal>> {
        let Some(resume) = &options.resume else { return Ok(None) };
        let files = JournalFiles::new(output, scratch_folder);
        let path = files.path(FileKind::Journal);
        let mut locked = lock(&path)?;
        if locked.is_none() {
            // Who lists unfinished builds holds the lock for a moment.
            std::thread::sleep(GLANCE);
            locked = lock(&path)?;
        }
        let file = locked.ok_or_else(|| busy(output))?;
        let now = JournalHeader::new(output, resume, options);
        let found = JournalHeader::read(&file);
        let (every, due) = (resume.every, Instant::now() + resume.every);
        let output = output.to_path_buf();
        let mut journal = Journal { output, files, file, every, due, records: Vec::new(), is_kept: false };
        match found {
            Some(found) if found == now => {
                journal.records = FileKind::RECORDS.into();
                journal.records.retain(|&record| journal.files.path(record).exists());
            }
            Some(found) => {
                return Err(journal.refuse(found.differences(&now)));
            }
            None => {
                journal.files.clear();
                let failed = |e| Error::writing("write the journal", &path, &e);
                let header = serde_json::to_vec(&now).expect("headers are plain data");
                let file = &journal.file;
                file.set_len(0).and_then(|()| file.write_all_at(&header, 0)).map_err(failed)?;
                file.sync_all().map_err(failed)?;
            }
        }
        Ok(Some(journal))
    }

    /// The error of a build that is not the one that left what is here, which stays.
    pub(crate) fn refuse(&mut self, differences: String) -> Error {
        self.is_kept = true;
        Error::new(Code::Usage, "an unfinished build of this output is of something else")
            .at(&self.output)
            .numbers(differences)
            .next(NextStep::SameInputOrClean)
    }

    /// Checks that the files that the input names are what they were when it was read.
    ///
    /// # Errors
    /// [`Code::Usage`] where one is not.
    pub(crate) fn check_named_files(&mut self, read: &SourceStats) -> Result<()> {
        let changed = read.named_files.iter().filter_map(|(path, then)| {
            let path = Path::new(OsStr::from_bytes(path));
            let now = stamp(path);
            (now != *then).then(|| format!("{path:?}: {then} then, {now} now"))
        });
        match changed.collect::<Vec<String>>() {
            changed if changed.is_empty() => Ok(()),
            changed => Err(self.refuse(changed.join("; "))),
        }
    }

    /// Removes a record, if it is there, before the files that it speaks of are overwritten.
    pub(crate) fn remove_record(&mut self, record: FileKind) -> Result<()> {
        self.records.retain(|&there| there != record);
        let path = self.path(record);
        if !path.exists() {
            return Ok(());
        }
        std::fs::remove_file(&path).map_err(|e| Error::writing("remove a record", &path, &e))?;
        let synced = File::open(self.folder()).and_then(|folder| folder.sync_all());
        synced.map_err(|e| Error::writing("write the folder to the disk", self.folder(), &e))
    }

    /// Whether there is any record to resume from.
    pub(crate) fn has_records(&self) -> bool {
        !self.records.is_empty()
    }

    /// Whether there is this record.
    pub(crate) fn has_record(&self, record: FileKind) -> bool {
        self.records.contains(&record)
    }

    /// Path of the file of a kind.
    pub(crate) fn path(&self, kind: FileKind) -> PathBuf {
        self.files.path(kind)
    }

    /// The folder of the records.
    pub(crate) fn folder(&self) -> &Path {
        &self.files.folder
    }

    /// Whether a record is due.
    pub(crate) fn is_due(&self) -> bool {
        Instant::now() >= self.due
    }

    /// Writes a record, of which the work was begun at `begin`.
    pub(crate) fn write_record(
        &mut self,
        (record, begin): (FileKind, Instant),
        head: &impl Serialize,
        blobs: &[&[u8]],
    ) -> Result<()> {
        record::write(&self.path(record), self.folder(), head, blobs)?;
        if !self.has_record(record) {
            self.records.push(record);
        }
        self.postpone(begin);
        Ok(())
    }

    /// Reads a record; `None` where there is none that is whole.
    pub(crate) fn read_record<T: DeserializeOwned>(
        &self,
        record: FileKind,
        budget: &Budget,
    ) -> Result<Option<JournalRecord<T>>> {
        record::read(&self.path(record), budget)
    }

    /// Whether a file is there, of so many bytes or more.
    pub(crate) fn holds(&self, kind: FileKind, bytes: u64) -> bool {
        self.path(kind).metadata().is_ok_and(|found| found.is_file() && found.len() >= bytes)
    }

    /// No record is due for a while, since that of a moment begun at `begin` is written or cannot be.
    pub(crate) fn postpone(&mut self, begin: Instant) {
        self.due = Instant::now() + self.every.max((begin.elapsed() * PAUSE).min(self.every * PAUSE_MOST));
    }

    /// Leaves all files for the next build; gives their bytes on disk.
    pub(crate) fn keep(&mut self) -> u64 {
        self.is_kept = true;
        bytes_of(&self.files)
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        if !self.is_kept {
            self.files.clear();
            let _ = std::fs::remove_file(self.files.path(FileKind::Journal));
        }
    }
}
