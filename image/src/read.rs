//! Reading: a head first, so that the caller can lease what the picture takes, then the picture.

use super::head::{Format, Head, Origin, Picture};
use super::source::Source;
use super::{exr, png};
use std::io::{BufRead, Seek};
use trex_store::Result;

/// Reads what a file says of its picture. The reader stands anywhere.
///
/// # Errors
/// Not a PNG or EXR, cut off, sides or layouts that are not read, a size that the file cannot hold; with the path
/// and the byte. Those of the reader.
pub fn read_head<R: BufRead + Seek>(reader: R, origin: Origin<'_>) -> Result<Head> {
    let mut source = Source::new(reader, origin);
    match source.format()? {
        Format::Png => png::head(&mut source),
        Format::Exr => exr::head(&mut source),
    }
}

/// Reads the picture whose head was read before. The reader stands anywhere.
///
/// # Errors
/// Those of [`read_head`]; also when the head has changed, or the pixels are damaged.
pub fn read_picture<R: BufRead + Seek>(reader: R, origin: Origin<'_>, head: &Head) -> Result<Picture> {
    let mut source = Source::new(reader, origin);
    source.rewind()?;
    match head.format {
        Format::Png => png::picture(&mut source, head),
        Format::Exr => exr::picture(&mut source, head),
    }
}
