//! The picture on disk: PNG or EXR by its ending, written beside its name and renamed when whole.

use rayon::ThreadPool;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use trex_render::{Image, Layers, Strips, write_exr, write_exr_strips, write_png, write_png_strips};
use trex_store::output::{ExistingOutput, check_apart, draft};
use trex_store::{Code, Error, Result};

/// Where a picture goes; checked before any work.
pub struct PictureFile {
    path: PathBuf,
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
        ExistingOutput::replace_if(overwrite).check(path)?;
        inputs.iter().try_for_each(|input| check_apart(path, input))?;
        Ok(PictureFile { path: path.to_path_buf(), is_exr })
    }

    /// As [`PictureFile::check`], for a part of a picture.
    pub fn check_part(path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<PictureFile> {
        if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("trexpart")) {
            return Err(Error::new(Code::Usage, "a part of a picture is no picture yet")
                .at(path)
                .next("end the name in .trexpart"));
        }
        ExistingOutput::replace_if(overwrite).check(path)?;
        inputs.iter().try_for_each(|input| check_apart(path, input))?;
        Ok(PictureFile { path: path.to_path_buf(), is_exr: false })
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
        self.write_draft(encode).map_err(|error| Error::writing("write the picture", &self.path, &error))
    }

    fn write_draft(
        &self,
        encode: impl FnOnce(&mut BufWriter<&mut Disk>) -> io::Result<()>,
    ) -> io::Result<()> {
        let draft = draft(&self.path)?;
        let mut disk = Disk { file: draft.as_file().try_clone()?, failed: None };
        let mut writer = BufWriter::new(&mut disk);
        let encoded = encode(&mut writer).and_then(|()| writer.flush());
        drop(writer);
        encoded.map_err(|error| disk.failed.map_or(error, io::Error::from_raw_os_error))?;
        disk.file.sync_all()?;
        draft.persist(&self.path)?;
        Ok(())
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
