//! `StressPictures`: what was on show at some times of a run's last switch, and what it was compared with, as PNG in a
//! folder.
//!
//! Invariant: all names are checked before any work.

use super::picture_file::PictureFile;
use rayon::ThreadPool;
use std::path::Path;
use trex_bench::stress::{ERROR_TIMES_MS, Snapshots};
use trex_image::Picture;
use trex_render::{Film, Image, Layers};
use trex_store::Result;

/// The pictures of a folder.
pub struct StressPictures {
    /// By times.
    shown: Vec<PictureFile>,
    reference: PictureFile,
}

/// A picture that was kept, of the size of a film.
struct KeptPicture<'a> {
    film: &'a Film,
    picture: Picture,
}

impl StressPictures {
    /// Checks what stands under the names in `folder`.
    pub fn check(folder: &Path, overwrite: bool, inputs: &[&Path]) -> Result<StressPictures> {
        let check = |name: &str| PictureFile::check(&folder.join(name), overwrite, Layers::default(), inputs);
        let shown = ERROR_TIMES_MS.iter().map(|ms| check(&format!("{ms}-ms.png"))).collect::<Result<_>>()?;
        Ok(StressPictures { shown, reference: check("reference.png")? })
    }

    /// Writes the pictures that `snapshots` compared last, of the size of `film`; those of times that were not reached
    /// are left out.
    pub fn write(&self, snapshots: &Snapshots, film: &Film, exposure: f32, pool: &ThreadPool) -> Result<()> {
        for compared in snapshots.compared() {
            let (ms, picture) = compared?;
            let at = ms.and_then(|ms| ERROR_TIMES_MS.iter().position(|time| *time == ms));
            let file = at.map_or(&self.reference, |at| &self.shown[at]);
            file.write(&KeptPicture { film, picture }, exposure, pool)?;
        }
        Ok(())
    }
}

impl Image for KeptPicture<'_> {
    fn film(&self) -> &Film {
        self.film
    }

    fn radiance(&self, [x, y]: [u32; 2]) -> [f32; 3] {
        self.picture.pixels[(y * self.picture.width + x) as usize]
    }
}
