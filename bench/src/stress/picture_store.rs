//! `PictureStore`: pictures of one size in a file, by their index.
//!
//! ```text
//! head | picture 0 | picture 1 | ...        rows of RGB from the top, f32 as the machine has them
//! ```

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use trex_image::Picture;
use trex_store::{Error, Result};

/// Pictures in a file. They take no memory but that of the system's cache, which it can have back.
#[derive(Debug)]
pub(super) struct PictureStore {
    file: File,
    /// The file's path, or the folder of a file that has no name; for errors.
    place: PathBuf,
    /// Width and height, pixels.
    resolution: [u32; 2],
    /// Bytes before the first picture.
    head_bytes: u64,
}

impl PictureStore {
    /// The pictures of `resolution` (width, height; pixels) behind `head_bytes` of `file`, which is found at `place`.
    pub(super) fn new(file: File, place: PathBuf, resolution: [u32; 2], head_bytes: u64) -> PictureStore {
        PictureStore { file, place, resolution, head_bytes }
    }

    /// Width and height, pixels.
    pub(super) fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// Bytes of a file with so many pictures.
    pub(super) fn file_bytes(&self, pictures: u32) -> u64 {
        self.head_bytes + u64::from(pictures) * self.picture_bytes()
    }

    fn picture_bytes(&self) -> u64 {
        let [width, height] = self.resolution.map(u64::from);
        width * height * size_of::<[f32; 3]>() as u64
    }

    /// Writes `bytes` before all pictures.
    ///
    /// # Errors
    /// Those of the file.
    pub(super) fn write_head(&self, bytes: &[u8]) -> Result<()> {
        assert_eq!(bytes.len() as u64, self.head_bytes, "a head of the size that was told");
        self.write_at(bytes, 0)
    }

    /// Writes picture `index`.
    ///
    /// # Errors
    /// Those of the file.
    pub(super) fn write(&self, index: u32, mut radiance: impl FnMut([u32; 2]) -> [f32; 3]) -> Result<()> {
        let [width, height] = self.resolution;
        let mut at = self.file_bytes(index);
        for y in 0..height {
            let row: Vec<[f32; 3]> = (0..width).map(|x| radiance([x, y])).collect();
            let bytes: &[u8] = bytemuck::cast_slice(&row);
            self.write_at(bytes, at)?;
            at += bytes.len() as u64;
        }
        Ok(())
    }

    /// Reads picture `index`.
    ///
    /// # Errors
    /// Those of the file, also where it ends too early.
    pub(super) fn read(&self, index: u32) -> Result<Picture> {
        let [width, height] = self.resolution;
        let mut pixels = vec![[0f32; 3]; width as usize * height as usize];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut pixels);
        let read = self.file.read_exact_at(bytes, self.file_bytes(index));
        read.map_err(|error| Error::io("read a picture to compare", &self.place, &error))?;
        Ok(Picture { width, height, pixels })
    }

    fn write_at(&self, bytes: &[u8], at: u64) -> Result<()> {
        let written = self.file.write_all_at(bytes, at);
        written.map_err(|error| Error::writing("write a picture to compare", &self.place, &error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_back_by_their_index_in_any_order() {
        let store = PictureStore::new(tempfile::tempfile().unwrap(), PathBuf::new(), [3, 2], 5);
        let value = |index: u32, [x, y]: [u32; 2]| [index as f32, x as f32, y as f32];
        for index in [2, 0, 1, 0] {
            store.write(index, |pixel| value(index, pixel)).unwrap();
        }
        store.write_head(b"front").unwrap();
        for index in [1, 0, 2] {
            let expected: Vec<_> = (0..6).map(|at| value(index, [at % 3, at / 3])).collect();
            assert_eq!(store.read(index).unwrap().pixels, expected);
        }
        assert_eq!(store.file.metadata().unwrap().len(), store.file_bytes(3));
        store.read(3).unwrap_err();
    }
}
