//! `BuildSite`: the folders in which a build works, and what stays of one that is stopped.

use super::journal::{Journal, left_over};
use super::options::BuildOptions;
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use std::path::{Path, PathBuf};

/// Where a build works.
pub(super) struct BuildSite {
    /// Of the output.
    pub(super) folder: PathBuf,
    /// Of scratch files.
    pub(super) scratch_folder: PathBuf,
}

impl BuildSite {
    /// Checks the output and both folders; removes what a build before this has left, where this one leaves nothing.
    pub(super) fn check(output: &Path, options: &BuildOptions) -> Result<BuildSite> {
        let site = BuildSite::folders(output, options)?;
        if options.resume.is_none() {
            left_over::clean(output)?;
        }
        Ok(site)
    }

    /// Checks the output and both folders.
    pub(super) fn folders(output: &Path, options: &BuildOptions) -> Result<BuildSite> {
        let folder = options.existing.check(output)?.to_path_buf();
        let scratch_folder = options.temp_dir.clone().unwrap_or_else(|| folder.clone());
        if !scratch_folder.is_dir() {
            return Err(Error::new(Code::Usage, "the folder for scratch files does not exist")
                .at(&scratch_folder)
                .next(NextStep::MakeScratchFolder));
        }
        Ok(BuildSite { folder, scratch_folder })
    }
}

/// The error with which a build ends: after an interrupt, and where the limit is too small, its files are kept if it
/// can resume from them.
pub(super) fn stopped(error: Error, output: &Path, journal: Option<&mut Journal>) -> Error {
    let code = error.code();
    let keeps = |journal: &&mut Journal| {
        journal.has_records() && matches!(code, Code::Interrupted | Code::MemoryLimit)
    };
    match journal.filter(keeps) {
        None => error,
        // The next step is a larger limit, with which it resumes.
        Some(journal) if code == Code::MemoryLimit => error.keeping(journal.keep()),
        Some(journal) => error.at(output).numbers("").keeping(journal.keep()).next(NextStep::ResumeOrClean),
    }
}
