//! Outputs: what may stand under the name that a result will get. Asked before any work.
//!
//! Invariant: what is replaced is a regular file, when that is allowed, and never an input of the same work. Devices,
//! pipes and symbolic links would be lost by the rename that publishes.

use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use std::fs::{OpenOptions, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use tempfile::{NamedTempFile, TempPath};

/// Characters of an output's name that its draft has, too: names end at 255 bytes, and a draft's has some more.
const DRAFT_NAME_CHARS: usize = 40;

/// What to do when the output exists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExistingOutput {
    /// Refuse before any work.
    #[default]
    Keep,
    /// Replace it when the new file is whole.
    Replace,
}

impl ExistingOutput {
    /// [`ExistingOutput::Replace`] where that is allowed.
    pub fn replace_if(is_allowed: bool) -> ExistingOutput {
        if is_allowed { ExistingOutput::Replace } else { ExistingOutput::Keep }
    }

    /// Refuses an `output` that must not be written; gives its folder.
    ///
    /// # Errors
    /// [`Code::Usage`]: the folder does not exist; a folder, a device, a pipe or a symbolic link has that name; or a
    /// file has it and is kept.
    pub fn check(self, output: &Path) -> Result<&Path> {
        let folder = folder_of(output);
        if !folder.is_dir() {
            return Err(Error::new(Code::Usage, "the output's folder does not exist")
                .at(folder)
                .next(NextStep::MakeOutputFolder));
        }
        let Ok(there) = output.symlink_metadata() else { return Ok(folder) };
        if there.is_dir() {
            return Err(Error::new(Code::Usage, "the output is a folder")
                .at(output)
                .next(NextStep::NameOutputFile));
        }
        if there.is_symlink() {
            return Err(Error::new(Code::Usage, "the output is a symbolic link, which would be replaced")
                .at(output)
                .next(NextStep::NameLinkTarget));
        }
        if !there.is_file() {
            return Err(Error::new(Code::Usage, "the output is a device or a pipe, which would be replaced")
                .at(output)
                .next(NextStep::NameOutputFile));
        }
        if self == ExistingOutput::Keep { Err(ExistingOutput::exists(output)) } else { Ok(folder) }
    }

    /// The error of an output that is kept.
    pub fn exists(output: &Path) -> Error {
        Error::new(Code::Usage, "the output exists").at(output).next(NextStep::Overwrite)
    }
}

/// Refuses an `output` that is `input`, by whatever name.
///
/// # Errors
/// [`Code::Usage`].
pub fn check_apart(output: &Path, input: &Path) -> Result<()> {
    let identity = |path: &Path| path.metadata().ok().map(|found| (found.dev(), found.ino()));
    if identity(output).is_none_or(|output| identity(input) != Some(output)) {
        return Ok(());
    }
    Err(Error::new(Code::Usage, "the output is an input, which would be lost")
        .at(output)
        .next(NextStep::NameOutput))
}

/// A file beside `output` that is to take its name once it is whole: hidden until then, gone when it is dropped, with
/// the permissions of the file that it replaces, else those of a plain create.
///
/// # Errors
/// Those of the folder.
pub fn draft(output: &Path) -> std::io::Result<NamedTempFile> {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    let kept: String = name.chars().take(DRAFT_NAME_CHARS).collect();
    let file = tempfile::Builder::new()
        .prefix(&format!(".{kept}."))
        .suffix(".part")
        // The user's umask takes its part.
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder_of(output))?;
    permit(&file, output)?;
    Ok(file)
}

/// The draft `path`, a new one or one that is there. It stays when it is dropped: who names it removes it.
///
/// # Errors
/// Those of the folder.
pub(crate) fn draft_at(output: &Path, path: &Path, is_new: bool) -> std::io::Result<NamedTempFile> {
    let mut options = OpenOptions::new();
    let file = options.read(true).write(true).create(is_new).truncate(is_new).open(path)?;
    let mut path = TempPath::try_from_path(path)?;
    path.disable_cleanup(true);
    let file = NamedTempFile::from_parts(file, path);
    permit(&file, output)?;
    Ok(file)
}

/// Gives a draft the permissions of what it replaces.
fn permit(file: &NamedTempFile, output: &Path) -> std::io::Result<()> {
    match output.metadata() {
        Ok(replaced) => file.as_file().set_permissions(Permissions::from_mode(replaced.mode() & 0o777)),
        Err(_) => Ok(()),
    }
}

/// The folder of an output.
pub fn folder_of(output: &Path) -> &Path {
    match output.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, missing] = ["file", "link", "missing"].map(|name| folder.path().join(name));
        std::fs::write(&file, "x").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        for existing in [ExistingOutput::Keep, ExistingOutput::Replace] {
            assert_eq!(existing.check(&missing).unwrap(), folder.path());
            for bad in [&link, Path::new("/dev/null"), folder.path(), &folder.path().join("none/file")] {
                let error = existing.check(bad).unwrap_err();
                assert_eq!(error.code(), Code::Usage, "{}", bad.display());
            }
        }
        assert!(ExistingOutput::Keep.check(&file).is_err() && ExistingOutput::Replace.check(&file).is_ok());
        assert!(check_apart(&link, &file).is_err() && check_apart(&file, &file).is_err());
        assert!(check_apart(&missing, &file).is_ok() && check_apart(&missing, &missing).is_ok());
    }

    #[test]
    fn a_draft_has_the_permissions_of_what_it_replaces_and_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "x").unwrap();
        let mode = |file: &NamedTempFile| file.as_file().metadata().unwrap().mode() & 0o7777;
        for wanted in [0o600, 0o640, 0o666, 0o444] {
            std::fs::set_permissions(&file, Permissions::from_mode(wanted)).unwrap();
            assert_eq!(mode(&draft(&file).unwrap()), wanted);
        }
        assert_eq!(mode(&draft(&folder.path().join("new")).unwrap()) & !0o666, 0);
        for name in ["x".repeat(255), "\u{20ac}".repeat(85)] {
            let path = folder.path().join(name);
            draft(&path).unwrap().persist(&path).unwrap();
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "drafts are left behind");
    }
}
