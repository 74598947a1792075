//! The pictures that base colours come from, and how each material reads its own: picture, coordinates, wrap.
//!
//! ```text
//! material -> baseColorTexture (or diffuseTexture) -> texture -> image -> file | view | data URI -> Picture
//! ```
//!
//! What cannot be read costs a material its picture, not the model: it is told, and `materials.rs` goes on without.
//!
//! Invariants: 1. a picture is read once, however many materials have it; 2. no more than [`MAX_PICTURES`] are open,
//! each with a part of the vertex caches' memory.

use super::accessors::Accessors;
use super::bytes::{BufferPlace, ByteSource};
use super::json::{COORDINATE_SETS, JsonDocument};
use super::json_look::{JsonMaterial, JsonTextureInfo};
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::import::options::TextureUse;
use crate::import::picture::{self, Picture, PictureFault, Wrap};
use crate::printable::one_line;
use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

/// Most pictures of a file that are read.
const MAX_PICTURES: usize = 256;
/// Bytes that a picture takes beside its texels, and a material's texture.
const PICTURE_BYTES: u64 = size_of::<Picture>() as u64 + 128;
const BASE_TEXTURE_BYTES: u64 = size_of::<Option<BaseTexture>>() as u64 + 24;
/// Names of pictures that are told of.
const TOLD_PICTURES: usize = 3;

/// How a material reads its picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct BaseTexture {
    /// In [`Textures::pictures`].
    pub(super) picture: usize,
    /// Which coordinates of a vertex, below [`COORDINATE_SETS`].
    pub(super) set: usize,
    wraps: [Wrap; 2],
    /// Rows of the transform of coordinates: u, v, 1.
    rows: [[f64; 3]; 2],
}

impl BaseTexture {
    /// Coordinates in the picture of those of a vertex.
    pub(super) fn place(&self, uv: [f64; 2]) -> [f64; 2] {
        self.rows.map(|[u, v, offset]| u * uv[0] + v * uv[1] + offset)
    }

    /// The linear colour there.
    pub(super) fn colour(&self, pictures: &mut [Picture], place: [f64; 2]) -> Result<[f64; 3]> {
        pictures[self.picture].colour(place, self.wraps)
    }
}

/// Pictures of a file.
pub(super) struct Textures {
    pub(super) pictures: Vec<Picture>,
    /// By material.
    of_material: Vec<Option<BaseTexture>>,
    /// Whether vertices take their colours from them; else a material has the mean of its picture.
    used: TextureUse,
    /// Why materials have no picture, and how many.
    pub(super) told: Vec<String>,
    pub(super) unread_count: u64,
    lease: Lease,
}

impl Textures {
    /// Reads the pictures of all materials.
    ///
    /// # Errors
    /// Those of memory, of scratch, and of an interrupt.
    pub(super) fn read(accessors: &mut Accessors<'_, '_>, options: &ImportOptions) -> Result<Textures> {
        let document = accessors.document;
        let mut all = Textures::none(document, options)?;
        let mut indices = BTreeMap::new();
        for json in &document.materials {
            if let Some(image) = base_texture(json).and_then(|info| image_of(document, info)) {
                indices.insert(image, None);
            }
        }
        let opened = indices.len().min(MAX_PICTURES) as u64;
        all.lease.grow("the pictures of a glTF file", opened * PICTURE_BYTES)?;
        // Half of what vertex caches have, and each picture a part of that.
        let vertex_cache_bytes = options.vertex_cache_bytes / 2 / opened.max(1);
        let options = ImportOptions { vertex_cache_bytes, ..options.clone() };
        for (&image, index) in indices.iter_mut().take(MAX_PICTURES) {
            match read_image(image, accessors, &options) {
                Ok(picture) => {
                    *index = Some(all.pictures.len());
                    all.pictures.push(picture);
                }
                Err(PictureFault::Failed(error)) => return Err(error),
                Err(PictureFault::Unread(why)) if all.told.len() < TOLD_PICTURES => {
                    all.told.push(format!("images[{image}] is not read: {}", one_line(&why)));
                }
                Err(PictureFault::Unread(_)) => {}
            }
        }
        if indices.len() > MAX_PICTURES {
            all.told.push(format!("{MAX_PICTURES} of {} pictures are read", indices.len()));
        }
        for json in &document.materials {
            let texture = base_texture(json).and_then(|info| {
                let picture = *indices.get(&image_of(document, info)?)?;
                Some(reading(document, info, picture?)).filter(|texture| texture.set < COORDINATE_SETS)
            });
            all.unread_count += u64::from(base_texture(json).is_some() && texture.is_none());
            all.of_material.push(texture);
        }
        Ok(all)
    }

    /// As of a document whose materials have no pictures.
    pub(super) fn none(document: &JsonDocument<'_>, options: &ImportOptions) -> Result<Textures> {
        let bytes = document.materials.len() as u64 * BASE_TEXTURE_BYTES;
        Ok(Textures {
            pictures: Vec::new(),
            of_material: Vec::new(),
            used: options.textures,
            told: Vec::new(),
            unread_count: 0,
            lease: options.budget.lease("the pictures of a glTF file", bytes)?,
        })
    }

    /// What vertices of a material of the document take their colours from.
    pub(super) fn sampled(&self, material: Option<u32>) -> Option<BaseTexture> {
        match self.used {
            TextureUse::Sampled => self.of_material(material?),
            TextureUse::Mean => None,
        }
    }

    /// The factor that stands for the picture of a material in its colour, and its mean; `None` without one that was
    /// read.
    pub(super) fn factors(&self, material: u32) -> Option<([f64; 3], [f64; 3])> {
        let mean = self.pictures[self.of_material(material)?.picture].mean;
        let factor = if self.used == TextureUse::Sampled { [1.0; 3] } else { mean };
        Some((factor, mean))
    }

    fn of_material(&self, material: u32) -> Option<BaseTexture> {
        self.of_material.get(material as usize).copied().flatten()
    }
}

/// What gives the colour of a material.
pub(super) fn base_texture<'a>(json: &'a JsonMaterial<'_>) -> Option<&'a JsonTextureInfo> {
    let older = json.extensions.as_deref().and_then(|extensions| extensions.specular_glossiness.as_deref());
    match older {
        Some(older) => older.diffuse_texture.as_deref().map(|info| &**info),
        None => {
            let pbr = json.pbr_metallic_roughness.as_deref()?;
            pbr.base_color_texture.as_deref().map(|info| &**info)
        }
    }
}

fn image_of(document: &JsonDocument<'_>, info: &JsonTextureInfo) -> Option<u32> {
    document.textures.get(info.index? as usize)?.source
}

/// How a material with this entry reads a picture.
fn reading(document: &JsonDocument<'_>, info: &JsonTextureInfo, picture: usize) -> BaseTexture {
    let texture = info.index.and_then(|index| document.textures.get(index as usize));
    let sampler = texture.and_then(|texture| document.samplers.get(texture.sampler? as usize));
    let wrap = |wrap: Option<u32>| match wrap {
        Some(33_071) => Wrap::Clamp,
        Some(33_648) => Wrap::Mirror,
        _ => Wrap::Repeat,
    };
    let transform = info.extensions.as_deref().and_then(|extensions| extensions.transform.as_deref());
    let numbers = |numbers: Option<&[f64; 2]>, default: f64| numbers.copied().unwrap_or([default; 2]);
    let offset = numbers(transform.and_then(|t| t.offset.as_deref()), 0.0);
    let scale = numbers(transform.and_then(|t| t.scale.as_deref()), 1.0);
    // Counter-clockwise as seen, where v grows downwards.
    let (sin, cos) = transform.and_then(|t| t.rotation).unwrap_or(0.0).sin_cos();
    BaseTexture {
        picture,
        set: transform.and_then(|t| t.coordinates).or(info.coordinates).unwrap_or(0) as usize,
        wraps: [wrap(sampler.and_then(|s| s.wrap_s)), wrap(sampler.and_then(|s| s.wrap_t))],
        rows: [[cos * scale[0], sin * scale[1], offset[0]], [-sin * scale[0], cos * scale[1], offset[1]]],
    }
}

fn read_image(
    image: u32,
    accessors: &mut Accessors<'_, '_>,
    options: &ImportOptions,
) -> Result<Picture, PictureFault> {
    let unread = |why: &str| PictureFault::Unread(why.to_owned());
    let document = accessors.document;
    let json = document.images.get(image as usize).ok_or_else(|| unread("it is not in the list"))?;
    let place = match (json.uri.as_deref(), json.buffer_view) {
        (Some(uri), _) => match accessors.buffers.embedded(image, uri, accessors.spool).map_err(fault)? {
            Some(place) => place,
            None => {
                let path = accessors.buffers.path_of(uri);
                let path = path.ok_or_else(|| unread("it is not on this machine"))?;
                let kind = std::fs::metadata(&path);
                let kind = kind.map_err(|error| unread(&format!("{}: {error}", path.display())))?;
                if !kind.is_file() {
                    return Err(unread("it is not a regular file"));
                }
                BufferPlace::File { path: path.into(), offset: 0, bytes: kind.len() }
            }
        },
        (None, Some(view)) => accessors.plain_view(view, "picture").map_err(fault)?,
        (None, None) => return Err(unread("it names no bytes")),
    };
    let source = ByteSource::open(&place, accessors.spool).map_err(fault)?;
    let read = picture::read(BufReader::new(PlaceReader { source, at: 0 }), options);
    options.interrupt.check()?;
    read
}

/// What is wrong with the file itself costs the picture alone.
fn fault(error: Error) -> PictureFault {
    match error.code() {
        Code::InputFormat | Code::InputRange | Code::InputTruncated | Code::InputUnreadable => {
            PictureFault::Unread(error.what().to_owned())
        }
        _ => PictureFault::Failed(error),
    }
}

/// Reads a place from its beginning to its end.
struct PlaceReader {
    source: ByteSource,
    at: u64,
}

impl Read for PlaceReader {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = (self.source.bytes() - self.at).min(into.len() as u64) as usize;
        self.source
            .read(self.at, &mut into[..count])
            .map_err(|error| io::Error::other(error.what().to_owned()))?;
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for PlaceReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.source.bytes().checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        let at = at.filter(|&at| at <= self.source.bytes());
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::UnexpectedEof))?;
        Ok(self.at)
    }
}
