//! Outputs: what may stand under the name that a result will get. Asked before any work.
//!
//! Invariant: what is replaced is a regular file, when that is allowed, and never an input of the same work. Devices,
//! pipes and symbolic links would be lost by the rename that publishes.

use crate::error::{Code, Error, Result};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// What to do when the output exists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// Refuse before any work.
    #[default]
    Keep,
    /// Replace it when the new file is whole.
    Replace,
}

impl Existing {
    /// [`Existing::Replace`] where that is allowed.
    pub fn replace_if(is_allowed: bool) -> Existing {
        if is_allowed { Existing::Replace } else { Existing::Keep }
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
                .next("make the folder, or name another output with -o"));
        }
        let Ok(there) = output.symlink_metadata() else { return Ok(folder) };
        if there.is_dir() {
            return Err(Error::new(Code::Usage, "the output is a folder")
                .at(output)
                .next("name a file with -o"));
        }
        if there.is_symlink() {
            return Err(Error::new(Code::Usage, "the output is a symbolic link, which would be replaced")
                .at(output)
                .next("name with -o what it leads to"));
        }
        if !there.is_file() {
            return Err(Error::new(Code::Usage, "the output is a device or a pipe, which would be replaced")
                .at(output)
                .next("name a file with -o"));
        }
        if self == Existing::Keep { Err(Existing::exists(output)) } else { Ok(folder) }
    }

    /// The error of an output that is kept.
    pub fn exists(output: &Path) -> Error {
        Error::new(Code::Usage, "the output exists")
            .at(output)
            .next("name another output with -o, or allow --overwrite")
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
        .next("name another output with -o"))
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
        for existing in [Existing::Keep, Existing::Replace] {
            assert_eq!(existing.check(&missing).unwrap(), folder.path());
            for bad in [&link, Path::new("/dev/null"), folder.path(), &folder.path().join("none/file")] {
                let error = existing.check(bad).unwrap_err();
                assert_eq!(error.code(), Code::Usage, "{}", bad.display());
            }
        }
        assert!(Existing::Keep.check(&file).is_err() && Existing::Replace.check(&file).is_ok());
        assert!(check_apart(&link, &file).is_err() && check_apart(&file, &file).is_err());
        assert!(check_apart(&missing, &file).is_ok() && check_apart(&missing, &missing).is_ok());
    }
}
