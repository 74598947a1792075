//! PNG and JPEG to rows of bytes, told apart by their first bytes.
//!
//! Values are taken as sRGB: `gAMA` and colour profiles are not followed. Alpha is left out.
//!
//! Invariant: what a decoder takes is leased before it begins, by what the header says of the picture.

use super::texels::{Picture, PictureFault, Shrinker};
use crate::import::ImportOptions;
use jpeg_decoder::PixelFormat;
use png::{Decoder, Limits, Transformations};
use std::io::{self, BufRead, Read, Seek};

/// Longest side of a picture that is read.
const SIDE_MAX: u32 = 32_768;
/// What a PNG decoder takes beside rows: its header's chunks, inflating, and buffers.
const PNG_FIXED_BYTES: u64 = 2 << 20;
const PNG_HEAD_BYTES: usize = 1 << 20;
/// Copies of a row that it keeps.
const ROW_COPIES: u64 = 16;
/// Bytes of a pixel of a progressive JPEG while it is decoded: coefficients, planes, and the picture.
const JPEG_PIXEL_BYTES: u64 = 16;
const JPEG_FIXED_BYTES: u64 = 1 << 20;
/// What the leases are called in messages.
const LEASED: &str = "a picture that is decoded";

/// Reads a picture.
///
/// # Errors
/// [`PictureFault::Unread`] for a file that is none, or none that is read.
pub(in crate::import) fn read<R: BufRead + Seek>(
    mut from: R,
    options: &ImportOptions,
) -> Result<Picture, PictureFault> {
    let mut magic = [0; 3];
    let is_whole = from.read_exact(&mut magic).and_then(|()| from.rewind());
    match (is_whole, magic) {
        (Ok(()), [0x89, b'P', b'N']) => png(from, options),
        (Ok(()), [0xff, 0xd8, 0xff]) => jpeg(from, options),
        (Ok(()), _) => Err(PictureFault::Unread("neither PNG nor JPEG".to_owned())),
        (Err(error), _) => Err(unread_by(&error)),
    }
}

fn png<R: BufRead + Seek>(from: R, options: &ImportOptions) -> Result<Picture, PictureFault> {
    let _fixed = options.budget.lease(LEASED, PNG_FIXED_BYTES)?;
    let mut decoder = Decoder::new_with_limits(from, Limits { bytes: PNG_HEAD_BYTES });
    decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(|error| unread(&error))?;
    let size = checked([reader.info().width, reader.info().height])?;
    let pixel_bytes = reader.output_color_type().0.samples();
    let row_bytes = u64::from(size[0]) * pixel_bytes as u64;
    let is_interlaced = reader.info().interlaced;
    let frame_bytes = if is_interlaced { row_bytes * u64::from(size[1]) } else { 0 };
    let _rows = options.budget.lease(LEASED, row_bytes * ROW_COPIES + frame_bytes)?;
    let mut shrinker = Shrinker::new(size, options)?;
    if is_interlaced {
        let mut frame = vec![0; frame_bytes as usize];
        reader.next_frame(&mut frame).map_err(|error| unread(&error))?;
        for row in frame.chunks_exact(row_bytes as usize) {
            shrinker.row(row, pixel_bytes)?;
        }
    } else {
        while let Some(row) = reader.next_row().map_err(|error| unread(&error))? {
            shrinker.row(row.data(), pixel_bytes)?;
        }
    }
    shrinker.finish()
}

fn jpeg<R: Read>(from: R, options: &ImportOptions) -> Result<Picture, PictureFault> {
    let _fixed = options.budget.lease(LEASED, JPEG_FIXED_BYTES)?;
    let mut decoder = jpeg_decoder::Decoder::new(from);
    decoder.read_info().map_err(|error| jpeg_fault(&error))?;
    let info = decoder.info().ok_or_else(|| PictureFault::Unread("it has no header".to_owned()))?;
    let size = checked([u32::from(info.width), u32::from(info.height)])?;
    let pixel_bytes = match info.pixel_format {
        PixelFormat::L8 => 1,
        PixelFormat::RGB24 => 3,
        PixelFormat::L16 | PixelFormat::CMYK32 => {
            return Err(PictureFault::Unread("a JPEG that is neither grey nor RGB".to_owned()));
        }
    };
    let pixels = u64::from(size[0]) * u64::from(size[1]);
    let _pixels = options.budget.lease(LEASED, pixels * JPEG_PIXEL_BYTES)?;
    decoder.set_max_decoding_buffer_size((pixels * JPEG_PIXEL_BYTES) as usize);
    let bytes = decoder.decode().map_err(|error| jpeg_fault(&error))?;
    let mut shrinker = Shrinker::new(size, options)?;
    for row in bytes.chunks_exact(size[0] as usize * pixel_bytes) {
        shrinker.row(row, pixel_bytes)?;
    }
    shrinker.finish()
}

fn checked(size: [u32; 2]) -> Result<[u32; 2], PictureFault> {
    match size.iter().all(|side| (1..=SIDE_MAX).contains(side)) {
        true => Ok(size),
        false => Err(PictureFault::Unread(format!(
            "{}x{} pixels, and a side of {SIDE_MAX} at most is read",
            size[0], size[1]
        ))),
    }
}

/// What a decoder says of a file that is cut names its own buffer.
fn unread_by(error: &io::Error) -> PictureFault {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => PictureFault::Unread("it ends early".to_owned()),
        _ => unread(error),
    }
}

fn jpeg_fault(error: &jpeg_decoder::Error) -> PictureFault {
    match error {
        jpeg_decoder::Error::Io(error) => unread_by(error),
        other => unread(other),
    }
}

fn unread(error: &impl std::fmt::Display) -> PictureFault {
    PictureFault::Unread(error.to_string())
}
