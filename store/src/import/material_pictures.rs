//! `MaterialPictures`: the pictures of the materials of an OBJ file, by `map_Kd` of its MTL files.
//!
//! Invariants: 1. a picture is read once, however many materials have it; 2. no more than [`MAX_PICTURES`] are open; 3.
//! one that cannot be read costs its materials their picture, not the model: it is told; 4. on a later pass a material
//! has its picture from the row on that named it, as on the first.

use super::ImportOptions;
use super::mtl::PictureRow;
use super::options::TextureUse;
use super::picture::{self, Picture, PictureFault, Wrap};
use crate::budget::Lease;
use crate::error::Result;
use crate::material::Material;
use crate::printable::one_line;
use crate::stamp;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Most pictures of a file that are read.
const MAX_PICTURES: usize = 256;
/// Bytes of a picture beside its texels and the name of its file; of a material's place in it.
const PICTURE_BYTES: u64 = size_of::<Picture>() as u64 + 256;
const PLACE_BYTES: u64 = size_of::<PicturePlace>() as u64 + 64;
/// What memory is called in messages.
const LEASED: &str = "the pictures of an OBJ file";
/// What stands for a picture that is not read where a material has no colour of its own: the mean of pictures in
/// general.
const PICTURE_MEAN: f32 = 0.5;

/// Where the vertices of a material have their colours from.
#[derive(Clone, Copy, Debug)]
pub(super) struct PicturePlace {
    picture: usize,
    /// The row `mtllib` that named it, from 1.
    library_row: u64,
    scale: [f64; 2],
    offset: [f64; 2],
    wrap: Wrap,
}

/// Pictures, and the materials that have them.
pub(super) struct MaterialPictures {
    pictures: Vec<Picture>,
    /// By path: its place in `pictures`, where it was read, and its stamp before.
    files: BTreeMap<PathBuf, (Option<usize>, String)>,
    of_material: BTreeMap<u32, PicturePlace>,
    /// Rows `mtllib` of the OBJ file since the start of this pass.
    library_row_count: u64,
    options: ImportOptions,
    lease: Lease,
}

impl MaterialPictures {
    /// None yet.
    pub(super) fn new(options: &ImportOptions) -> Result<MaterialPictures> {
        Ok(MaterialPictures {
            pictures: Vec::new(),
            files: BTreeMap::new(),
            of_material: BTreeMap::new(),
            library_row_count: 0,
            options: options.clone(),
            lease: options.budget.lease(LEASED, 0)?,
        })
    }

    /// Hears of a row `mtllib`, before what it names is read.
    pub(super) fn begin_library_row(&mut self) {
        self.library_row_count += 1;
    }

    /// Hears of a new pass.
    pub(super) fn rewind(&mut self) {
        self.library_row_count = 0;
    }

    /// Whether vertices have colours from pictures that were named so far.
    pub(super) fn are_sampled(&self) -> bool {
        self.of_material.values().any(|place| self.is_sampled(place))
    }

    fn is_sampled(&self, place: &PicturePlace) -> bool {
        place.library_row <= self.library_row_count && self.options.textures == TextureUse::Sampled
    }

    /// Files that were looked for, each with its stamp.
    pub(super) fn files(&self) -> impl Iterator<Item = (&PathBuf, &String)> {
        self.files.iter().map(|(path, (_, stamp))| (path, stamp))
    }

    /// Reads what `row` names for material `index`, and gives the material with what is left of its own colour: times
    /// the mean of the picture where vertices take no colours. `folder` is that of the MTL file. Says why there is
    /// none.
    pub(super) fn read(
        &mut self,
        (index, material): (u32, Material),
        row: &PictureRow,
        folder: &Path,
    ) -> Result<(Material, Option<String>)> {
        let (picture, told) = self.picture_of(&path_of(folder, &row.file))?;
        let has_colour = material.kd != [0.0; 3];
        let Some(picture) = picture else {
            let kd = if has_colour { material.kd } else { [PICTURE_MEAN; 3] };
            return Ok((Material { kd, ..material }, told));
        };
        self.lease.grow(LEASED, PLACE_BYTES)?;
        let wrap = if row.clamps { Wrap::Clamp } else { Wrap::Repeat };
        let library_row = self.library_row_count;
        let place = PicturePlace { picture, library_row, scale: row.scale, offset: row.offset, wrap };
        self.of_material.insert(index, place);
        // Exporters that write no colour beside a picture write black.
        let own = if has_colour { material.kd } else { [1.0; 3] };
        let mean = self.pictures[picture].mean.map(|part| part as f32);
        let kd = match self.options.textures {
            TextureUse::Sampled => own,
            TextureUse::Mean => std::array::from_fn(|i| own[i] * mean[i]),
        };
        Ok((Material { kd, ..material }, told))
    }

    /// The picture in a file, read unless it was; and why there is none, the first time.
    fn picture_of(&mut self, path: &Path) -> Result<(Option<usize>, Option<String>)> {
        if let Some((picture, _)) = self.files.get(path) {
            return Ok((*picture, None));
        }
        if self.files.len() >= MAX_PICTURES {
            let told = format!("more than {MAX_PICTURES} pictures: the rest is not read");
            return Ok((None, Some(told)));
        }
        self.lease.grow(LEASED, PICTURE_BYTES + 2 * path.as_os_str().len() as u64)?;
        let stamp = stamp(path);
        let read = match open(path) {
            Ok(file) => {
                // Of what a vertex cache has, a quarter for the first, and less for each the more there are.
                let vertex_cache_bytes = self.options.vertex_cache_bytes / 4 / (self.files.len() as u64 + 1);
                let options = ImportOptions { vertex_cache_bytes, ..self.options.clone() };
                picture::read(BufReader::new(file), &options)
            }
            Err(why) => Err(PictureFault::Unread(why)),
        };
        self.options.interrupt.check()?;
        let (picture, told) = match read {
            Ok(picture) => {
                self.pictures.push(picture);
                (Some(self.pictures.len() - 1), None)
            }
            Err(PictureFault::Failed(error)) => return Err(error),
            Err(PictureFault::Unread(why)) => {
                (None, Some(format!("picture {} is not read: {}", path.display(), one_line(&why))))
            }
        };
        self.files.insert(path.to_owned(), (picture, stamp));
        Ok((picture, told))
    }

    /// Where vertices of a material have their colours from, as far as was named.
    pub(super) fn place(&self, material: u32) -> Option<PicturePlace> {
        self.of_material.get(&material).copied().filter(|place| self.is_sampled(place))
    }

    /// The linear colour of a vertex with these coordinates, and its place in the picture; without coordinates the
    /// mean.
    pub(super) fn colour(
        &mut self,
        place: PicturePlace,
        coordinates: Option<[f64; 2]>,
    ) -> Result<([f64; 3], [f64; 2])> {
        let picture = &mut self.pictures[place.picture];
        let Some(coordinates) = coordinates else { return Ok((picture.mean, [0.0; 2])) };
        let [u, v] = std::array::from_fn(|axis| coordinates[axis] * place.scale[axis] + place.offset[axis]);
        // Coordinates of OBJ grow upwards.
        let at = [u, 1.0 - v];
        Ok((picture.colour(at, [place.wrap; 2])?, at))
    }

    /// Sides of a picture as its file has it.
    pub(super) fn size(&self, place: PicturePlace) -> [u32; 2] {
        self.pictures[place.picture].file_size
    }
}

fn open(path: &Path) -> std::result::Result<File, String> {
    let kind = std::fs::metadata(path).map_err(|error| error.to_string())?;
    if !kind.is_file() {
        return Err("it is not a regular file".to_owned());
    }
    File::open(path).map_err(|error| error.to_string())
}

/// The file that a row in an MTL file in `folder` names: as it is written, with the separators of Windows taken for our
/// own, or by its name alone beside the MTL file, where others have left the path of another machine.
fn path_of(folder: &Path, name: &str) -> PathBuf {
    let ours = name.replace('\\', "/");
    let last = Path::new(&ours).file_name().map(|last| folder.join(last));
    let paths = [Some(folder.join(name)), Some(folder.join(&ours)), last];
    let found = paths.iter().flatten().find(|path| path.is_file()).cloned();
    found.unwrap_or_else(|| folder.join(name))
}
