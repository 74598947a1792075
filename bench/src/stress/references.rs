//! `References`: the pictures that others are measured by, one a state of the scenario, in a file that may be kept.
//!
//! ```text
//! magic, version, count of states, hash of what decides them | a picture of each state
//!                                                            | every fourth again, of other samples: the floor
//! ```
//!
//! Invariants: 1. the head is written last: a file with a head has all pictures; 2. a file whose hash is another is of
//! another model, scene, scenario, seed or count of samples, and is not used.

use super::picture_error::PictureError;
use super::picture_store::PictureStore;
use crate::median::median;
use serde::Serialize;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use trex_image::Picture;
use trex_render::Film;
use trex_store::{Code, Error, Result};
use xxhash_rust::xxh3::xxh3_64;

/// First bytes of a file of references, and its version.
const MAGIC: [u8; 8] = *b"TREXREFS";
const VERSION: u32 = 1;
const HEAD_BYTES: usize = 24;
/// Every so many states have a second picture.
const FLOOR_EVERY: u32 = 4;

/// Identifies the references of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReferencesKey {
    hash: u64,
    /// States.
    count: u32,
}

/// See the module's description.
#[derive(Debug)]
pub struct References {
    pictures: PictureStore,
    key: ReferencesKey,
}

/// Two pictures of a state at leisure, of different samples, against each other: no error below says anything.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ErrorFloor {
    /// States that have two.
    pub count: u64,
    /// relMSE of the middle one.
    pub relmse: f64,
    /// FLIP of the middle one.
    pub flip: f64,
}

impl ReferencesKey {
    /// The key of `count` references that `text` decides: all that is drawn and how, in words.
    pub fn new(text: &str, count: u32) -> ReferencesKey {
        ReferencesKey { hash: xxh3_64(text.as_bytes()), count }
    }

    fn head(self) -> [u8; HEAD_BYTES] {
        let mut head = [0; HEAD_BYTES];
        head[..8].copy_from_slice(&MAGIC);
        head[8..12].copy_from_slice(&VERSION.to_le_bytes());
        head[12..16].copy_from_slice(&self.count.to_le_bytes());
        head[16..].copy_from_slice(&self.hash.to_le_bytes());
        head
    }
}

impl References {
    /// No references yet: `file` is empty, and is found at `place`. `resolution`: width and height, pixels.
    pub fn new(file: File, place: PathBuf, resolution: [u32; 2], key: ReferencesKey) -> References {
        References { pictures: PictureStore::new(file, place, resolution, HEAD_BYTES as u64), key }
    }

    /// The references of a run before; `None` where `file` has those of other pictures.
    ///
    /// # Errors
    /// Those of reading the file; [`Code::Usage`] for one that holds something else, which is not to be replaced.
    pub fn kept(
        file: File,
        place: PathBuf,
        resolution: [u32; 2],
        key: ReferencesKey,
    ) -> Result<Option<References>> {
        let mut head = [0; HEAD_BYTES];
        let length = file.metadata().map_err(|error| Error::io("read references", &place, &error))?.len();
        if length >= HEAD_BYTES as u64 {
            file.read_exact_at(&mut head, 0).map_err(|error| Error::io("read references", &place, &error))?;
        }
        if head[..8] != MAGIC {
            return Err(Error::new(Code::Usage, "the file holds no references")
                .at(&place)
                .numbers(format!("{length} bytes, which do not begin with TREXREFS"))
                .next("name another file for the references, or remove this one"));
        }
        let references = References::new(file, place, resolution, key);
        let is_whole = length == references.pictures.file_bytes(references.picture_count());
        Ok((head == key.head() && is_whole).then_some(references))
    }

    /// Pictures in all.
    fn picture_count(&self) -> u32 {
        self.key.count + self.key.count.div_ceil(FLOOR_EVERY)
    }

    /// True for states that have a second picture.
    pub(super) fn has_second(state: u32) -> bool {
        state.is_multiple_of(FLOOR_EVERY)
    }

    /// Writes the picture of `state`, or its second one.
    ///
    /// # Errors
    /// Those of writing the file.
    pub(super) fn write(&self, state: u32, is_second: bool, film: &Film) -> Result<()> {
        assert!(state < self.key.count, "a state that the scenario has");
        let index = if is_second { self.key.count + state / FLOOR_EVERY } else { state };
        self.pictures.write(index, |pixel| film.radiance(pixel))
    }

    /// Notes that all pictures are there.
    ///
    /// # Errors
    /// Those of writing the file.
    pub(super) fn finish(&self) -> Result<()> {
        self.pictures.write_head(&self.key.head())
    }

    /// Width and height, pixels.
    pub(super) fn resolution(&self) -> [u32; 2] {
        self.pictures.resolution()
    }

    /// The picture of `state`.
    ///
    /// # Errors
    /// Those of reading the file.
    pub(super) fn picture(&self, state: u32) -> Result<Picture> {
        assert!(state < self.key.count, "a state without a reference");
        self.pictures.read(state)
    }

    /// Two pictures of a state against each other, shown with `exposure`; `None` where no pixel can be compared.
    ///
    /// # Errors
    /// Those of reading the file.
    pub(super) fn floor(&self, exposure: f32) -> Result<Option<ErrorFloor>> {
        let mut errors = vec![];
        for state in (0..self.key.count).filter(|state| References::has_second(*state)) {
            let second = self.pictures.read(self.key.count + state / FLOOR_EVERY)?;
            errors.extend(PictureError::of(&second, &self.picture(state)?, exposure));
        }
        let middle = |of: fn(&PictureError) -> f64| median(&errors.iter().map(of).collect::<Vec<_>>());
        Ok((!errors.is_empty()).then(|| ErrorFloor {
            count: errors.len() as u64,
            relmse: middle(|error| error.relmse),
            flip: middle(|error| error.flip),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Five states, two of which have a second picture; each picture is of one value.
    fn filled(path: &Path, key: ReferencesKey) -> References {
        let file = File::options().read(true).write(true).create(true).truncate(true).open(path).unwrap();
        let references = References::new(file, path.into(), [2, 2], key);
        for (index, value) in (0..7).zip([1.0, 2.0, 3.0, 4.0, 5.0, 1.5, 5.0]) {
            references.pictures.write(index, |_| [value; 3]).unwrap();
        }
        references
    }

    fn kept(path: &Path, key: ReferencesKey) -> Result<Option<References>> {
        References::kept(File::open(path).unwrap(), path.into(), [2, 2], key)
    }

    #[test]
    fn kept_references_are_used_for_the_same_pictures_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("refs");
        let key = ReferencesKey::new("a plant", 5);
        let references = filled(&path, key);
        kept(&path, key).expect_err("without a head it may be anything");
        references.finish().unwrap();
        assert_eq!(kept(&path, key).unwrap().unwrap().picture(4).unwrap().pixels, [[5.0; 3]; 4]);
        for other in [ReferencesKey::new("a scan", 5), ReferencesKey::new("a plant", 6)] {
            assert!(kept(&path, other).unwrap().is_none());
        }
        File::options().write(true).open(&path).unwrap().set_len(40).unwrap();
        assert!(kept(&path, key).unwrap().is_none(), "some pictures are missing");
        std::fs::write(&path, "resolution = [64, 64]\nspp = 9\n").unwrap();
        assert_eq!(kept(&path, key).unwrap_err().code(), Code::Usage);
    }

    #[test]
    fn the_floor_is_that_of_states_with_two_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let references = filled(&folder.path().join("refs"), ReferencesKey::new("a plant", 5));
        let floor = references.floor(1.0).unwrap().unwrap();
        // One of them differs by a half from 1, the other by nothing.
        assert_eq!(floor.count, 2);
        assert!((floor.relmse - 0.25 / (1.0 + 0.01) / 2.0).abs() < 0.01, "{floor:?}");
    }
}
