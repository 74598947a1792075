//! OpenEXR to linear RGB: scan lines or tiles, half, float or u32; all compressions of the `exr` crate but DWA, whose
//! decoder allocates what the file says (exr 1.74.2: 35 TB asked for by one damaged byte), and which is lossy.
//!
//! Which channels: the first part with `R G B`, else the first with `NAME.R NAME.G NAME.B` for some NAME, else
//! the first with a lone `Y` as grey. Alpha is left out; of mip maps the finest is read. The size is that of the
//! data window.
//!
//! Invariants: 1. the head is read twice and must be the same, since the crate keeps the reader; 2. every block of
//! the finest level comes once, or the picture is refused.

use super::head::{Format, HEAD_BYTES, Head, Picture, check_length, check_sides};
use super::source::Source;
use ::exr::block::UncompressedBlock;
use ::exr::block::lines::LineRef;
use ::exr::block::reader::ChunksReader;
use ::exr::math::Vec2;
use ::exr::meta::attribute::SampleType;
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::{Compression, f16};
use std::io::{BufRead, Read, Seek};
use trex_store::{Code, Error, Result};

/// Longest side of a tile that is larger than its picture, pixels. Blocks are allocated by their nominal size.
const MAX_SPARE_TILE_PIXELS: usize = 1024;
/// Most channels of a part.
const MAX_CHANNELS: usize = 1024;
/// Copies of a block that the decoder holds: its bytes in the file, the inflated ones, the reordered ones, a spare.
const BLOCK_COPIES: u64 = 4;
/// What tables of chunks take per chunk of any part: offset, place, offset again while sorted, doubled by growth.
const CHUNK_BYTES: u64 = 192;
/// Least bytes of a chunk in the file: offset, coordinate, length, a byte.
const LEAST_CHUNK_BYTES: u64 = 17;
/// Tables of the compressions, and the head.
const DECODER_FIXED_BYTES: u64 = HEAD_BYTES + (4 << 20);

/// The channels that are read.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Choice {
    /// Index of the part.
    part: usize,
    /// Indices of its channels for R, G and B.
    channels: [usize; 3],
    words: String,
}

/// Reads the head.
pub(super) fn head<R: BufRead + Seek>(source: &mut Source<'_, R>) -> Result<Head> {
    let headers = headers(source).map_err(|why| source.refused(&why))?;
    let choice = choose(&headers, source)?;
    checked_head(&headers, &choice, source)
}

/// Reads the pixels.
pub(super) fn picture<R: BufRead + Seek>(source: &mut Source<'_, R>, head: &Head) -> Result<Picture> {
    let headers = headers(source).map_err(|why| source.refused(&why))?;
    let choice = choose(&headers, source)?;
    source.rewind()?;
    if checked_head(&headers, &choice, source)? != *head {
        return Err(source.refused("the file changed while it was read"));
    }
    decode(source, &headers[choice.part], &choice).map_err(|why| source.refused(&why))
}

/// All parts' headers, within [`HEAD_BYTES`].
fn headers<R: BufRead + Seek>(source: &mut Source<'_, R>) -> Result<Vec<Header>, String> {
    let mut limited = source.by_ref().take(HEAD_BYTES);
    let read = MetaData::read_from_buffered(&mut limited, true);
    if limited.limit() == 0 {
        return Err(format!("the header is longer than the {HEAD_BYTES} bytes that are read"));
    }
    let meta = read.map_err(|error| error.to_string())?;
    MetaData::validate(&meta.headers, false).map_err(|error| error.to_string())?;
    Ok(meta.headers.into_vec())
}

fn choose<R: BufRead + Seek>(headers: &[Header], source: &Source<'_, R>) -> Result<Choice> {
    let names = |header: &Header| -> Vec<String> {
        header.channels.list.iter().map(|channel| channel.name.to_string()).collect()
    };
    let parts: Vec<Vec<String>> = headers.iter().map(names).collect();
    let rgb = |part: usize, prefix: &str| {
        let place = |name: &str| parts[part].iter().position(|found| *found == format!("{prefix}{name}"));
        let words = format!("{prefix}R {prefix}G {prefix}B");
        Some(Choice { part, channels: [place("R")?, place("G")?, place("B")?], words })
    };
    let prefixed = |part: usize| {
        let prefixes = parts[part].iter().filter_map(|name| name.strip_suffix('R'));
        prefixes.filter(|prefix| prefix.ends_with('.')).find_map(|prefix| rgb(part, prefix))
    };
    let grey = |part: usize| {
        let place = parts[part].iter().position(|name| name == "Y")?;
        // With RY and BY it is colour of another kind.
        let lone = !parts[part].iter().any(|name| name == "RY" || name == "BY");
        lone.then(|| Choice { part, channels: [place; 3], words: "Y as grey".to_owned() })
    };
    let each = || 0..parts.len();
    let found = each()
        .find_map(|part| rgb(part, ""))
        .or_else(|| each().find_map(prefixed))
        .or_else(|| each().find_map(grey));
    found.ok_or_else(|| {
        let mut list = parts.concat();
        list.truncate(20);
        Error::new(Code::InputFormat, "the EXR has no channels R G B, and no Y")
            .at(source.origin.path)
            .numbers(format!("channels: {}", list.join(", ")))
            .next("write the picture with the channels R, G and B")
    })
}

fn checked_head<R: BufRead + Seek>(
    headers: &[Header],
    choice: &Choice,
    source: &Source<'_, R>,
) -> Result<Head> {
    let origin = &source.origin;
    for header in headers {
        check_sides(header.layer_size.0, header.layer_size.1, origin)?;
        check_blocks(header, source)?;
    }
    let header = &headers[choice.part];
    if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Err(Error::new(Code::InputFormat, "the EXR is compressed with DWA, which is not read")
            .at(origin.path)
            .numbers(header.compression.to_string())
            .next("write it again with a lossless compression: ZIP, PIZ, RLE or none"));
    }
    let (width, height) = check_sides(header.layer_size.0, header.layer_size.1, origin)?;
    let chunks: u64 = headers.iter().map(|header| header.chunk_count as u64).sum();
    let block_bytes = header.max_block_byte_size() as u64;
    let pixel_bytes = header.channels.bytes_per_pixel as u64;
    let least_pixels = u64::from(width) * u64::from(height) * pixel_bytes
        / best_ratio(header.compression).unwrap_or(u64::MAX);
    check_length(
        least_pixels.max(chunks.saturating_mul(LEAST_CHUNK_BYTES)),
        &format!("an EXR of {width}x{height}, {} channels, {chunks} blocks", header.channels.list.len()),
        origin,
    )?;
    Ok(Head {
        format: Format::Exr,
        width,
        height,
        channels: choice.words.clone(),
        decoder_bytes: DECODER_FIXED_BYTES + chunks * CHUNK_BYTES + BLOCK_COPIES * block_bytes,
    })
}

/// Refuses blocks that are large whatever the picture's size.
fn check_blocks<R: BufRead + Seek>(header: &Header, source: &Source<'_, R>) -> Result<()> {
    let refused = |what: &str, numbers: String| {
        Err(Error::new(Code::InputRange, what)
            .at(source.origin.path)
            .numbers(numbers)
            .next("write the picture again with scan lines or smaller tiles"))
    };
    if header.channels.list.len() > MAX_CHANNELS {
        let count = header.channels.list.len();
        return refused("the EXR has too many channels", format!("{count}, at most {MAX_CHANNELS} are read"));
    }
    if let BlockDescription::Tiles(tiles) = header.blocks {
        let Vec2(width, height) = tiles.tile_size;
        let most = |side: usize| side.max(MAX_SPARE_TILE_PIXELS);
        if width > most(header.layer_size.0) || height > most(header.layer_size.1) {
            let Vec2(across, down) = header.layer_size;
            return refused(
                "the EXR's tiles are larger than its picture",
                format!("tiles of {width}x{height}, picture of {across}x{down}"),
            );
        }
    }
    Ok(())
}

/// Bytes that a byte of the file becomes at the most, where the method has such a bound.
fn best_ratio(compression: Compression) -> Option<u64> {
    match compression {
        Compression::Uncompressed => Some(1),
        // Two bytes stand for 128.
        Compression::RLE => Some(64),
        // Deflate's 1032.
        Compression::ZIP1 | Compression::ZIP16 => Some(1032),
        // Deflate after a byte of each float is dropped.
        Compression::PXR24 => Some(1376),
        _ => None,
    }
}

fn decode<R: BufRead + Seek>(
    source: &mut Source<'_, R>,
    header: &Header,
    choice: &Choice,
) -> Result<Picture, String> {
    let reader = ::exr::block::read(source, false).map_err(|error| error.to_string())?;
    if reader.headers().get(choice.part).map(|again| (again.layer_size, &again.channels))
        != Some((header.layer_size, &header.channels))
    {
        return Err("the file changed while it was read".to_owned());
    }
    let wanted = |part: usize, level: Vec2<usize>| part == choice.part && level == Vec2(0, 0);
    let mut canvas = Canvas::new(header);
    let chunks = reader
        .filter_chunks(false, |_, _, block| wanted(block.layer, block.level))
        .map_err(|error| error.to_string())?;
    chunks
        .decompress_sequential(false, |_, block| {
            if !wanted(block.index.layer, block.index.level) {
                return Err(invalid("a block of another part where the table named ours"));
            }
            canvas.add(header, choice, &block)
        })
        .map_err(|error| error.to_string())?;
    canvas.finish()
}

/// The picture while its blocks come in.
struct Canvas {
    picture: Picture,
    /// Size of a whole block, pixels.
    block_size: Vec2<usize>,
    blocks_across: usize,
    /// Per block, row by row: whether it came.
    seen: Vec<bool>,
}

impl Canvas {
    fn new(header: &Header) -> Canvas {
        let (Vec2(width, height), block_size) = (header.layer_size, header.max_block_pixel_size());
        let blocks_across = width.div_ceil(block_size.0);
        Canvas {
            picture: Picture::black(width as u32, height as u32),
            block_size,
            blocks_across,
            seen: vec![false; blocks_across * height.div_ceil(block_size.1)],
        }
    }

    fn add(
        &mut self,
        header: &Header,
        choice: &Choice,
        block: &UncompressedBlock,
    ) -> Result<(), ::exr::error::Error> {
        let Vec2(x, y) = block.index.pixel_position;
        let place = (y / self.block_size.1) * self.blocks_across + x / self.block_size.0;
        match self.seen.get_mut(place) {
            Some(seen) if !*seen => *seen = true,
            _ => return Err(invalid("a block that came twice")),
        }
        let width = self.picture.width as usize;
        for line in block.lines(&header.channels) {
            let Vec2(x, y) = line.location.position;
            let samples = y * width + x..y * width + x + line.location.sample_count;
            let row = self.picture.pixels.get_mut(samples);
            let row = row.ok_or_else(|| invalid("a block outside of the picture"))?;
            let channel = line.location.channel;
            let kind = header.channels.list[channel].sample_type;
            for rgb in (0..3).filter(|&rgb| choice.channels[rgb] == channel) {
                read_line(line, kind, row, rgb)?;
            }
        }
        Ok(())
    }

    /// The picture, if it is whole.
    fn finish(self) -> Result<Picture, String> {
        match self.seen.iter().filter(|seen| !**seen).count() {
            0 => Ok(self.picture),
            missing => Err(format!("{missing} of {} blocks are missing", self.seen.len())),
        }
    }
}

/// The crate's error for a block that makes no sense.
fn invalid(what: &'static str) -> ::exr::error::Error {
    ::exr::error::Error::Invalid(what.into())
}

/// Puts a line's samples into component `rgb` of `row`.
fn read_line(
    line: LineRef<'_>,
    kind: SampleType,
    row: &mut [[f32; 3]],
    rgb: usize,
) -> Result<(), ::exr::error::Error> {
    match kind {
        SampleType::F16 => {
            for (pixel, sample) in row.iter_mut().zip(line.read_samples::<f16>()) {
                pixel[rgb] = sample?.to_f32();
            }
        }
        SampleType::F32 => {
            for (pixel, sample) in row.iter_mut().zip(line.read_samples::<f32>()) {
                pixel[rgb] = sample?;
            }
        }
        SampleType::U32 => {
            for (pixel, sample) in row.iter_mut().zip(line.read_samples::<u32>()) {
                pixel[rgb] = sample? as f32;
            }
        }
    }
    Ok(())
}
