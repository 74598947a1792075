//! `Draft`: a temporary file beside the output, written once, read back, renamed.
//!
//! ```text
//! ExistingOutput::check -> Draft::create -> append* -> fsync -> read back -> rename -> fsync folder
//! ```
//!
//! Invariants: 1. the output's name holds either the old file or the whole new one; 2. a draft that is not
//! published is removed; 3. what was written leaves the page cache soon.

use super::options::BuildOptions;
use super::report::PhaseReport;
use super::scratch::drop_cache;
use crate::error::{Code, Error, Result};
use crate::layout::Superblock;
use crate::output::{ExistingOutput, draft, draft_at};
use crate::scratch::Place;
use crate::verify;
use rustix::fs::fdatasync;
use rustix::io::retry_on_intr;
use std::fs::File;
use std::io::ErrorKind;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Dirty bytes after which they are written back and dropped from the page cache.
const FLUSH_BYTES: u64 = 16 << 20;

/// The output while it has no name yet.
pub(super) struct Draft {
    file: tempfile::NamedTempFile,
    folder: PathBuf,
}

/// Appends to a draft.
pub(super) struct DraftFile<'a> {
    draft: &'a Draft,
    end: u64,
    flushed: u64,
}

impl Draft {
    /// A new one, or the one that a build before this has left.
    pub(super) fn create(output: &Path, folder: &Path, place: Place) -> Result<Draft> {
        let file = match place {
            Place::Unnamed(_) => draft(output),
            Place::New(path) => draft_at(output, &path, true),
            Place::Left(path) => draft_at(output, &path, false),
        };
        let file = file.map_err(|e| Error::writing("create a file", folder, &e))?;
        Ok(Draft { file, folder: folder.to_path_buf() })
    }

    /// To append to it. What is in it is written over.
    pub(super) fn file(&self) -> DraftFile<'_> {
        DraftFile { draft: self, end: 0, flushed: 0 }
    }

    /// Makes the draft the output, after every byte was read back and checked.
    pub(super) fn publish(
        self,
        output: &Path,
        block: &Superblock,
        options: &BuildOptions,
        report: PhaseReport<'_>,
    ) -> Result<()> {
        let file = self.file.as_file();
        file.sync_all().map_err(|e| Error::io("write to the disk", output, &e))?;
        drop_cache(file, 0, block.file_bytes);
        let read = |done, total| {
            report("check", "bytes", done, total);
            options.interrupt.check()
        };
        let found = verify::read_back(self.file.path(), &options.budget, &read)?;
        if let Some(damage) = found.damage.first() {
            return Err(Error::new(Code::Io, "the disk gave back other bytes than were written")
                .at(output)
                .numbers(damage.to_string())
                .next("check the disk; nothing was published"));
        }
        self.persist(output, options)
    }

    /// Makes the draft the output, all of which its readers check.
    pub(super) fn publish_unread(self, output: &Path, options: &BuildOptions) -> Result<()> {
        self.file.as_file().sync_all().map_err(|e| Error::io("write to the disk", output, &e))?;
        self.persist(output, options)
    }

    fn persist(self, output: &Path, options: &BuildOptions) -> Result<()> {
        let failed = |e: tempfile::PersistError| match e.error.kind() {
            ErrorKind::AlreadyExists => ExistingOutput::exists(output),
            _ => Error::writing("rename the finished file", output, &e.error),
        };
        match options.existing {
            ExistingOutput::Replace => self.file.persist(output).map_err(failed)?,
            // Somebody may have made the file meanwhile.
            ExistingOutput::Keep => self.file.persist_noclobber(output).map_err(failed)?,
        };
        // Whatever refuses from here on: what was built has its name.
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(|e| {
            let failed =
                Error::writing("write the folder of the finished file to the disk", &self.folder, &e);
            failed.next("the file is there, and whole; after a loss of power it may not be: check the folder")
        })
    }
}

impl DraftFile<'_> {
    /// Bytes so far.
    pub(super) fn bytes(&self) -> u64 {
        self.end
    }

    /// Appends; gives the offset.
    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<u64> {
        let (file, offset) = (self.draft.file.as_file(), self.end);
        file.write_all_at(bytes, offset).map_err(|e| self.failed(&e))?;
        self.end += bytes.len() as u64;
        if self.end - self.flushed >= FLUSH_BYTES {
            self.sync()?;
        }
        Ok(offset)
    }

    /// Waits until all that was written is on the disk.
    pub(super) fn sync(&mut self) -> Result<()> {
        let file = self.draft.file.as_file();
        retry_on_intr(|| fdatasync(file)).map_err(|e| self.failed(&e.into()))?;
        drop_cache(file, self.flushed, self.end - self.flushed);
        self.flushed = self.end;
        Ok(())
    }

    /// Resumes behind the first `bytes`; what comes after them is cut off.
    pub(super) fn resume_at(&mut self, bytes: u64) -> Result<()> {
        self.draft.file.as_file().set_len(bytes).map_err(|e| self.failed(&e))?;
        (self.end, self.flushed) = (bytes, bytes);
        Ok(())
    }

    /// Writes the head, last.
    pub(super) fn write_head(&mut self, head: &[u8]) -> Result<()> {
        self.draft.file.as_file().write_all_at(head, 0).map_err(|e| self.failed(&e))
    }

    fn failed(&self, error: &std::io::Error) -> Error {
        Error::writing("write the output", &self.draft.folder, error)
    }
}
