//! PNG to linear RGB: 8 and 16 bits, grey, palettes, interlaced; alpha is left out.
//!
//! Values are taken as sRGB, as `trex render` writes them; `gAMA` and colour profiles are not followed.
//!
//! Invariant: the decoder works within [`HEAD_BYTES`], a frame of bytes and a few rows, which the head names.

use super::head::{Format, HEAD_BYTES, Head, Picture, check_length, check_sides};
use super::source::Source;
use ::png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};
use std::io::{BufRead, Seek};
use trex_store::Result;

/// Bytes that a byte of deflate becomes at the most.
const DEFLATE_RATIO: u64 = 1032;
/// Copies of a row that the decoder keeps while it undoes the filters.
const ROW_COPIES: u64 = 16;
/// What inflating and the buffers around it take.
const DECODER_FIXED_BYTES: u64 = HEAD_BYTES + (1 << 20);

/// Reads the head.
pub(super) fn head<R: BufRead + Seek>(source: &mut Source<'_, R>) -> Result<Head> {
    let said = said(source).map_err(|why| source.refused(&why))?;
    let (width, height) = check_sides(said.width as usize, said.height as usize, &source.origin)?;
    let pixels = u64::from(width) * u64::from(height);
    let bits = said.depth as u64 * said.color.samples() as u64;
    check_length((pixels * bits / 8) / DEFLATE_RATIO, &format!("a PNG of {width}x{height}"), &source.origin)?;
    // Palettes become RGB, with what is transparent in them RGBA; less than 8 bits become 8.
    let samples = if said.color == ColorType::Indexed { 4 } else { said.color.samples() as u64 + 1 };
    let pixel_bytes = samples * (said.depth as u64).div_ceil(8);
    let channels = match said.color {
        ColorType::Grayscale => "grey",
        ColorType::GrayscaleAlpha => "grey (alpha left out)",
        ColorType::Rgba => "R G B (alpha left out)",
        ColorType::Rgb | ColorType::Indexed => "R G B",
    };
    Ok(Head {
        format: Format::Png,
        width,
        height,
        channels: channels.to_owned(),
        decoder_bytes: pixels * pixel_bytes
            + u64::from(width) * pixel_bytes * ROW_COPIES
            + DECODER_FIXED_BYTES,
    })
}

/// Reads the pixels.
pub(super) fn picture<R: BufRead + Seek>(source: &mut Source<'_, R>, head: &Head) -> Result<Picture> {
    let again = self::head(source)?;
    source.rewind()?;
    if again != *head {
        return Err(source.refused("the file changed while it was read"));
    }
    decode(source, head).map_err(|why| source.refused(&why))
}

/// What the header chunk says.
struct PngHeader {
    width: u32,
    height: u32,
    depth: BitDepth,
    color: ColorType,
}

fn said<R: BufRead + Seek>(source: &mut Source<'_, R>) -> Result<PngHeader, String> {
    let mut decoder = decoder(source);
    let info = decoder.read_header_info().map_err(words)?;
    Ok(PngHeader { width: info.width, height: info.height, depth: info.bit_depth, color: info.color_type })
}

fn decoder<R: BufRead + Seek>(reader: R) -> Decoder<R> {
    let mut decoder = Decoder::new_with_limits(reader, Limits { bytes: HEAD_BYTES as usize });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder
}

fn decode<R: BufRead + Seek>(source: &mut Source<'_, R>, head: &Head) -> Result<Picture, String> {
    let mut reader = decoder(source).read_info().map_err(words)?;
    let size = reader.output_buffer_size().filter(|&size| size as u64 <= head.decoder_bytes);
    let mut bytes = vec![0; size.ok_or("the frame is larger than its header says")?];
    let frame = reader.next_frame(&mut bytes).map_err(words)?;
    reader.finish().map_err(words)?;
    if (frame.width, frame.height) != (head.width, head.height) {
        return Err("the frame has another size than its header says".to_owned());
    }
    let samples = frame.color_type.samples();
    let is_wide = frame.bit_depth == BitDepth::Sixteen;
    let table: Vec<f32> = (0..=u8::MAX).map(|code| linear(f64::from(code) / 255.0)).collect();
    let value = |pixel: &[u8], sample: usize| {
        if is_wide {
            let code = u16::from_be_bytes([pixel[2 * sample], pixel[2 * sample + 1]]);
            linear(f64::from(code) / 65_535.0)
        } else {
            table[usize::from(pixel[sample])]
        }
    };
    let mut picture = Picture::black(head.width, head.height);
    let rows = picture.pixels.chunks_exact_mut(head.width as usize);
    for (row, line) in rows.zip(bytes.chunks_exact(frame.line_size)) {
        for (to, pixel) in row.iter_mut().zip(line.chunks_exact(samples * if is_wide { 2 } else { 1 })) {
            *to = match samples {
                // Grey, with or without alpha.
                1 | 2 => [value(pixel, 0); 3],
                _ => [value(pixel, 0), value(pixel, 1), value(pixel, 2)],
            };
        }
    }
    Ok(picture)
}

/// sRGB (IEC 61966-2-1) to linear, 0 to 1.
fn linear(coded: f64) -> f32 {
    let linear = if coded <= 0.040_45 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) };
    linear as f32
}

fn words(error: DecodingError) -> String {
    error.to_string()
}
