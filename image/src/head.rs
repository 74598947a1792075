//! `Head` and `Picture`: what a file says of its picture, checked, and the picture itself.

use std::path::Path;
use trex_store::{Code, Error, Interrupt, Result};

/// Longest side of a picture that is read, pixels: twice what `trex render` writes.
pub const MAX_SIDE_PIXELS: u32 = 1 << 16;
/// Most that reading a head takes, bytes: text, previews and colour profiles are held as a whole.
pub const HEAD_BYTES: u64 = 4 << 20;
/// Bytes that a pixel of a [`Picture`] takes.
pub(crate) const PIXEL_BYTES: u64 = size_of::<[f32; 3]>() as u64;

/// A picture in memory: linear radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top, `width * height` of them; R, G, B.
    pub pixels: Vec<[f32; 3]>,
}

/// What a file is, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// PNG: sRGB, 8 or 16 bits.
    Png,
    /// OpenEXR: linear.
    Exr,
}

/// What a file says of its picture, checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    /// The format.
    pub format: Format,
    /// Pixels per row, 1 to [`MAX_SIDE_PIXELS`].
    pub width: u32,
    /// Rows, 1 to [`MAX_SIDE_PIXELS`].
    pub height: u32,
    /// The channels that are read as R, G and B, for people.
    pub channels: String,
    /// What [`super::read_picture`] takes beside the picture, bytes.
    pub decoder_bytes: u64,
}

/// Where a picture is read from, for errors and bounds.
#[derive(Clone, Copy, Debug)]
pub struct Origin<'a> {
    /// Its name.
    pub path: &'a Path,
    /// Length of the file, bytes.
    pub file_bytes: u64,
    /// Ends the reading.
    pub interrupt: &'a Interrupt,
}

impl Format {
    /// The name, lower case.
    pub fn as_str(self) -> &'static str {
        match self {
            Format::Png => "png",
            Format::Exr => "exr",
        }
    }
}

impl Head {
    /// Bytes of the picture itself.
    pub fn picture_bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * PIXEL_BYTES
    }
}

impl Picture {
    /// A black picture.
    pub(crate) fn black(width: u32, height: u32) -> Picture {
        Picture { width, height, pixels: vec![[0.0; 3]; width as usize * height as usize] }
    }
}

/// Refuses sides that are zero or too long.
pub(crate) fn check_sides(width: usize, height: usize, origin: &Origin<'_>) -> Result<(u32, u32)> {
    let side = |side: usize| u32::try_from(side).ok().filter(|side| (1..=MAX_SIDE_PIXELS).contains(side));
    match (side(width), side(height)) {
        (Some(width), Some(height)) => Ok((width, height)),
        _ => Err(Error::new(Code::InputRange, "the picture's size is out of range")
            .at(origin.path)
            .numbers(format!("{width}x{height} pixels; sides of 1 to {MAX_SIDE_PIXELS} are read"))
            .next("check that the file is what it is meant to be")),
    }
}

/// Refuses a file that is too short for what its head promises, even if it were compressed as well as can be.
pub(crate) fn check_length(least_bytes: u64, what: &str, origin: &Origin<'_>) -> Result<()> {
    if origin.file_bytes >= least_bytes {
        return Ok(());
    }
    Err(Error::new(Code::InputTruncated, "the file is too short for the picture it promises")
        .at(origin.path)
        .numbers(format!("{} bytes long, {what} needs {least_bytes} at the least", origin.file_bytes))
        .next("write or copy the picture again"))
}
