//! The picture on disk: PNG or EXR by its ending, written beside its name and renamed when whole.
//!
//! Invariant: without leave to replace it, a file that somebody makes under the name meanwhile stays, and so does the
//! picture, under a name of its own.

use rayon::ThreadPool;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;
use trex_render::{Image, Layers, Strips, write_exr, write_exr_strips, write_png, write_png_strips};
use trex_store::output::{ExistingOutput, check_apart, draft};
use trex_store::{Code, Error, Result};

/// Where a picture goes; checked before any work.
pub struct PictureFile {
    path: PathBuf,
    existing: ExistingOutput,
    is_exr: bool,
}

impl PictureFile {
    /// Checks the ending, and what stands under the name, which must be none of the files that the work reads.
    pub fn check(path: &Path, overwrite: bool, layers: Layers, inputs: &[&Path]) -> Result<PictureFile> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let is_exr = match ending.as_deref() {
            Some("png") => false,
            Some("exr") => true,
            _ => {
                return Err(Error::new(Code::Usage, "the picture's name does not say which format to write")
                    .at(path)
                    .next("end it in .png or .exr"));
            }
        };
        if layers.any() && !is_exr {
            return Err(Error::new(Code::Usage, "a PNG holds no layers").at(path).next("write an .exr"));
        }
        PictureFile::of(path, overwrite, is_exr, inputs)
    }

    /// As [`PictureFile::check`], for a part of a picture.
    pub fn check_part(path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<PictureFile> {
        if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("trexpart")) {
            return Err(Error::new(Code::Usage, "a part of a picture is no picture yet")
                .at(path)
                .next("end the name in .trexpart"));
        }
        PictureFile::of(path, overwrite, false, inputs)
    }

    fn of(path: &Path, overwrite: bool, is_exr: bool, inputs: &[&Path]) -> Result<PictureFile> {
        let existing = ExistingOutput::replace_if(overwrite);
        existing.check(path)?;
        inputs.iter().try_for_each(|input| check_apart(path, input))?;
        Ok(PictureFile { path: path.to_path_buf(), existing, is_exr })
    }

    /// As [`PictureFile::check`], for what is written as PNG alone.
    pub fn check_png(path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<PictureFile> {
        let file = PictureFile::check(path, overwrite, Layers::default(), inputs)?;
        if file.is_exr {
            return Err(Error::new(Code::Usage, "false colours are no radiance for an EXR")
                .at(path)
                .next("end the name in .png"));
        }
        Ok(file)
    }

    /// Encodes the picture; nothing is left behind when that fails.
    pub fn write(&self, image: &impl Image, exposure: f32, pool: &ThreadPool) -> Result<()> {
        self.write_with(|writer| {
            if self.is_exr { write_exr(image, writer) } else { write_png(image, exposure, pool, writer) }
        })
    }

    /// As [`PictureFile::write`], of a picture that is made strip by strip.
    pub fn write_strips(&self, strips: &mut impl Strips, exposure: f32, pool: &ThreadPool) -> Result<()> {
        self.write_with(|writer| match self.is_exr {
            true => write_exr_strips(strips, writer),
            false => write_png_strips(strips, exposure, pool, writer),
        })
    }

    /// Publishes what `encode` writes; nothing is left behind when that fails.
    pub fn write_with(&self, encode: impl FnOnce(&mut BufWriter<&mut Disk>) -> io::Result<()>) -> Result<()> {
        self.publish(self.draft(encode).map_err(|error| self.failed(&error))?)
    }

    fn failed(&self, error: &io::Error) -> Error {
        Error::writing("write the picture", &self.path, error)
    }

    fn draft(
        &self,
        encode: impl FnOnce(&mut BufWriter<&mut Disk>) -> io::Result<()>,
    ) -> io::Result<NamedTempFile> {
        let draft = draft(&self.path)?;
        let mut disk = Disk { file: draft.as_file().try_clone()?, failed: None };
        let mut writer = BufWriter::new(&mut disk);
        let encoded = encode(&mut writer).and_then(|()| writer.flush());
        drop(writer);
        encoded.map_err(|error| disk.failed.map_or(error, io::Error::from_raw_os_error))?;
        disk.file.sync_all()?;
        Ok(draft)
    }

    fn publish(&self, draft: NamedTempFile) -> Result<()> {
        let refused = match self.existing {
            ExistingOutput::Replace => draft.persist(&self.path),
            ExistingOutput::Keep => draft.persist_noclobber(&self.path),
        };
        let Err(refused) = refused else { return Ok(()) };
        if self.existing == ExistingOutput::Replace || refused.error.kind() != io::ErrorKind::AlreadyExists {
            return Err(self.failed(&refused.error));
        }
        let (_, kept) = refused.file.keep().map_err(|kept| self.failed(&kept.error))?;
        Err(Error::new(Code::Usage, "the output exists: it was made while the picture was")
            .at(&self.path)
            .numbers(format!("the picture is whole, in {}", kept.display()))
            .next("give that file a name of its own"))
    }
}

/// A file that remembers the system's first refusal: encoders pass on its words, but not that the disk is full.
pub struct Disk {
    file: File,
    failed: Option<i32>,
}

impl Disk {
    fn noted<T>(&mut self, done: io::Result<T>) -> io::Result<T> {
        match &done {
            // It is made again.
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => self.failed = self.failed.or(error.raw_os_error()),
            Ok(_) => {}
        }
        done
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let done = self.file.write(bytes);
        self.noted(done)
    }

    fn flush(&mut self) -> io::Result<()> {
        let done = self.file.flush();
        self.noted(done)
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let done = self.file.seek(to);
        self.noted(done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_file_that_is_made_meanwhile_stays_and_so_does_the_picture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let picture = |overwrite| PictureFile::check(&path, overwrite, Layers::default(), &[]).unwrap();
        let ours = |writer: &mut BufWriter<&mut Disk>| writer.write_all(b"ours");
        let file = picture(false);
        fs::write(&path, "theirs").unwrap();
        let error = file.write_with(ours).unwrap_err();
        assert_eq!((error.code(), fs::read(&path).unwrap()), (Code::Usage, b"theirs".to_vec()));
        let kept = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
        let kept: Vec<_> = kept.filter(|other| *other != path).collect();
        assert_eq!(fs::read(&kept[0]).unwrap(), b"ours");
        assert!(error.to_string().contains(&*kept[0].to_string_lossy()), "{error}");
        picture(true).write_with(ours).unwrap();
        assert_eq!((fs::read(&path).unwrap(), kept.len()), (b"ours".to_vec(), 1));
    }
}
