//! The picture on disk: PNG or EXR by its ending, written beside its name and renamed when whole.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use trex_render::film::{Film, Layers};
use trex_render::picture::{write_exr, write_png};
use trex_store::{Code, Error, Result};

/// Where a picture goes; checked before any work.
pub struct PictureFile {
    path: PathBuf,
    is_exr: bool,
}

impl PictureFile {
    /// Checks ending, folder and whether the file exists.
    pub fn check(path: &Path, overwrite: bool, layers: Layers) -> Result<PictureFile> {
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
        if path.exists() && !overwrite {
            return Err(Error::new(Code::Usage, "the output exists")
                .at(path)
                .next("name another output with -o, or allow --overwrite"));
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(Error::new(Code::Usage, "the output's folder does not exist")
                .at(folder)
                .next("make the folder, or name another output with -o"));
        }
        Ok(PictureFile { path: path.to_path_buf(), is_exr })
    }

    /// Encodes the film; nothing is left behind when that fails.
    pub fn write(&self, film: &Film, exposure: f32) -> Result<()> {
        let part = self.path.with_extension(format!("{}.part", std::process::id()));
        let written = self.write_part(&part, film, exposure);
        if written.is_err() {
            let _ = std::fs::remove_file(&part);
        }
        written
    }

    fn write_part(&self, part: &Path, film: &Film, exposure: f32) -> Result<()> {
        let failed = |error: &std::io::Error| Error::writing("write the picture", &self.path, error);
        let file = File::create(part).map_err(|e| failed(&e))?;
        let mut writer = BufWriter::new(&file);
        if self.is_exr {
            write_exr(film, &mut writer).map_err(|e| failed(&e))?;
        } else {
            write_png(film, exposure, &mut writer).map_err(|e| failed(&e))?;
        }
        writer.flush().map_err(|e| failed(&e))?;
        drop(writer);
        file.sync_all().map_err(|e| failed(&e))?;
        std::fs::rename(part, &self.path).map_err(|e| failed(&e))
    }
}
