//! Tests of reading: what others write, what lies, what is cut, what is damaged.

use super::*;
use crate::head::PIXEL_BYTES;
use ::exr::prelude::*;
use ::png::{BitDepth, ColorType};
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use std::io::Cursor;
use std::result::Result as StdResult;
use trex_store::{Code, Interrupt};

fn origin(bytes: &[u8]) -> Origin<'_> {
    static CALM: std::sync::LazyLock<Interrupt> = std::sync::LazyLock::new(Interrupt::default);
    Origin { path: std::path::Path::new("picture"), file_bytes: bytes.len() as u64, interrupt: &CALM }
}

fn read(bytes: &[u8]) -> StdResult<(Head, Picture), trex_store::Error> {
    let mut reader = Cursor::new(bytes);
    let head = read_head(&mut reader, origin(bytes))?;
    let picture = read_picture(&mut reader, origin(bytes), &head)?;
    Ok((head, picture))
}

/// A radiance that says where it is, exact in half floats.
fn radiance(x: usize, y: usize) -> [f32; 3] {
    [x as f32 * 0.25, y as f32 - 3.0, 7.5]
}

fn expect_radiance(picture: &Picture, width: u32, height: u32, within: f32) {
    assert_eq!((picture.width, picture.height), (width, height));
    for (at, pixel) in picture.pixels.iter().enumerate() {
        let expected = radiance(at % width as usize, at / width as usize);
        for (found, expected) in pixel.iter().zip(expected) {
            assert!((found - expected).abs() <= within * expected.abs().max(1.0), "{at}: {found} {expected}");
        }
    }
}

fn channel(
    name: &str,
    width: usize,
    height: usize,
    value: impl Fn(usize, usize) -> f32,
) -> AnyChannel<FlatSamples> {
    let values = (0..width * height).map(|at| value(at % width, at / width));
    AnyChannel::new(name, FlatSamples::F32(values.collect()))
}

/// An EXR of `list` in one part.
fn exr_of(encoding: Encoding, width: usize, height: usize, list: Vec<AnyChannel<FlatSamples>>) -> Vec<u8> {
    let channels = AnyChannels::sort(list.into_iter().collect());
    let layer = Layer::new((width, height), LayerAttributes::named("main"), encoding, channels);
    let mut bytes = Cursor::new(vec![]);
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn rgb(prefix: &str, width: usize, height: usize) -> Vec<AnyChannel<FlatSamples>> {
    let one = |c: usize| {
        channel(&format!("{prefix}{}", ["R", "G", "B"][c]), width, height, move |x, y| radiance(x, y)[c])
    };
    (0..3).map(one).collect()
}

fn encodings() -> Vec<Encoding> {
    use Compression::*;
    let lines = |compression| Encoding { compression, ..Encoding::UNCOMPRESSED };
    let tiles = |compression, side| Encoding {
        compression,
        blocks: Blocks::Tiles(Vec2(side, side)),
        line_order: LineOrder::Increasing,
    };
    vec![
        lines(Uncompressed),
        lines(RLE),
        lines(ZIP1),
        lines(ZIP16),
        lines(PIZ),
        lines(PXR24),
        lines(B44),
        lines(B44A),
        tiles(Uncompressed, 16),
        tiles(ZIP16, 16),
        tiles(PIZ, 64),
    ]
}

#[test]
fn every_encoding_of_exr_is_read() {
    for encoding in encodings() {
        let bytes = exr_of(encoding, 37, 41, rgb("", 37, 41));
        let (head, picture) = read(&bytes).unwrap_or_else(|error| panic!("{encoding:?}: {error}"));
        assert_eq!((head.format, head.channels.as_str()), (Format::Exr, "R G B"));
        // PXR24 drops bits of floats.
        expect_radiance(&picture, 37, 41, 1e-4);
    }
    for compression in [Compression::DWAA(None), Compression::DWAB(None)] {
        let encoding = Encoding { compression, ..Encoding::UNCOMPRESSED };
        assert!(
            refused(&exr_of(encoding, 37, 41, rgb("", 37, 41)), Code::InputFormat).what().contains("DWA")
        );
    }
}

#[test]
fn layouts_of_others_are_read() {
    let grey = |name: &str| channel(name, 9, 7, |x, _| x as f32);
    let with = |mut list: Vec<_>, more: Vec<_>| {
        list.extend(more);
        list
    };
    for (list, channels) in [
        (
            with(
                rgb("", 9, 7),
                vec![grey("A"), grey("Z"), grey("albedo.R"), grey("albedo.G"), grey("albedo.B")],
            ),
            "R G B",
        ),
        (
            with(rgb("ViewLayer.Combined.", 9, 7), vec![grey("ViewLayer.Combined.A"), grey("Depth.Z")]),
            "ViewLayer.Combined.R ViewLayer.Combined.G ViewLayer.Combined.B",
        ),
        // A lone R is no colour.
        (with(rgb("beauty.", 9, 7), vec![grey("R")]), "beauty.R beauty.G beauty.B"),
    ] {
        let (head, picture) = read(&exr_of(Encoding::UNCOMPRESSED, 9, 7, list)).unwrap();
        assert_eq!(head.channels, channels);
        expect_radiance(&picture, 9, 7, 0.0);
    }
    let (head, picture) = read(&exr_of(Encoding::UNCOMPRESSED, 9, 7, vec![grey("Y"), grey("A")])).unwrap();
    assert_eq!((head.channels.as_str(), picture.pixels[5]), ("Y as grey", [5.0; 3]));
    for list in [
        vec![grey("Z")],
        vec![grey("normal.X"), grey("normal.Y"), grey("normal.Z")],
        vec![grey("Y"), grey("RY"), grey("BY")],
    ] {
        let error = read(&exr_of(Encoding::UNCOMPRESSED, 9, 7, list)).unwrap_err();
        assert_eq!(error.code(), Code::InputFormat);
        assert!(error.what().contains("no channels R G B"), "{error}");
    }
}

#[test]
fn halves_integers_and_later_parts_are_read() {
    let of = |name: &str, samples| AnyChannel::new(name, samples);
    let half = |c: usize| (0..63).map(|at| f16::from_f32(radiance(at % 9, at / 9)[c])).collect();
    let list = vec![
        of("R", FlatSamples::F16(half(0))),
        of("G", FlatSamples::F16(half(1))),
        of("B", FlatSamples::F32(vec![7.5; 63])),
        of("id", FlatSamples::U32(vec![u32::MAX; 63])),
    ];
    expect_radiance(&read(&exr_of(Encoding::FAST_LOSSLESS, 9, 7, list)).unwrap().1, 9, 7, 0.0);
    // The first part has no colour, the second does, and both have another size.
    let layer = |name: &str, size, list: Vec<_>| {
        Layer::new(
            size,
            LayerAttributes::named(name),
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(list.into()),
        )
    };
    let depth = vec![channel("Z", 5, 5, |_, _| 1.0)];
    let layers = vec![layer("depth", (5, 5), depth), layer("beauty", (9, 7), rgb("", 9, 7))];
    let mut bytes = Cursor::new(vec![]);
    let attributes = ImageAttributes::with_size((9, 7));
    Image::from_layers(attributes, layers).write().non_parallel().to_buffered(&mut bytes).unwrap();
    expect_radiance(&read(bytes.get_ref()).unwrap().1, 9, 7, 0.0);
}

/// A PNG of `data`, already packed.
fn png_of(width: u32, height: u32, color: ColorType, depth: BitDepth, data: &[u8], palette: bool) -> Vec<u8> {
    let mut bytes = vec![];
    let mut encoder = ::png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if palette {
        encoder.set_palette(vec![0, 0, 0, 255, 0, 0, 0, 188, 0, 255, 255, 255]);
        encoder.set_trns(vec![0, 255, 128]);
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(data).unwrap();
    writer.finish().unwrap();
    bytes
}

#[test]
fn png_becomes_linear() {
    use BitDepth::{Eight, Sixteen, Two};
    // 188 of 255 is half the light; 10 of 255 lies on the straight part of the curve.
    let half = ((188.0f64 / 255.0 + 0.055) / 1.055).powf(2.4) as f32;
    let dark = (10.0f64 / 255.0 / 12.92) as f32;
    assert!((half - 0.5).abs() < 0.003);
    for (bytes, expected) in [
        (
            png_of(2, 1, ColorType::Rgb, Eight, &[0, 188, 255, 10, 10, 188], false),
            [[0.0, half, 1.0], [dark, dark, half]],
        ),
        (
            png_of(2, 1, ColorType::Rgba, Eight, &[0, 188, 255, 7, 10, 10, 188, 0], false),
            [[0.0, half, 1.0], [dark, dark, half]],
        ),
        (png_of(2, 1, ColorType::Grayscale, Eight, &[188, 10], false), [[half; 3], [dark; 3]]),
        (png_of(2, 1, ColorType::GrayscaleAlpha, Eight, &[188, 0, 10, 9], false), [[half; 3], [dark; 3]]),
        (png_of(2, 1, ColorType::Grayscale, Sixteen, &[188, 188, 10, 10], false), [[half; 3], [dark; 3]]),
        (
            png_of(
                2,
                1,
                ColorType::Rgb,
                Sixteen,
                &[0, 0, 188, 188, 255, 255, 10, 10, 10, 10, 188, 188],
                false,
            ),
            [[0.0, half, 1.0], [dark, dark, half]],
        ),
        (png_of(2, 1, ColorType::Indexed, Two, &[0b0110_0000], true), [[1.0, 0.0, 0.0], [0.0, half, 0.0]]),
        (png_of(2, 1, ColorType::Grayscale, Two, &[0b1100_0000], false), [[1.0; 3], [0.0; 3]]),
    ] {
        let (head, picture) = read(&bytes).unwrap();
        assert_eq!((head.format, picture.width, picture.height), (Format::Png, 2, 1));
        assert_eq!(picture.pixels, expected, "{head:?}");
    }
}

#[track_caller]
fn refused(bytes: &[u8], code: Code) -> trex_store::Error {
    let error = read(bytes).expect_err("read");
    assert_eq!(error.code(), code, "{error}");
    for part in [error.what(), error.place(), error.numbers_text(), error.next_step()] {
        assert!(!part.is_empty(), "{error}");
    }
    error
}

/// Replaces the first `from` after `name`.
fn put(bytes: &[u8], name: &[u8], skip: usize, value: &[u8]) -> Vec<u8> {
    let at = bytes.windows(name.len()).position(|window| window == name).unwrap() + name.len() + skip;
    let mut bytes = bytes.to_vec();
    bytes[at..at + value.len()].copy_from_slice(value);
    bytes
}

#[test]
fn sizes_that_lie_are_refused_before_they_are_allocated() {
    // Without the count of blocks, which would give the lie away.
    let uncounted = |encoding| put(&exr_of(encoding, 37, 41, rgb("", 37, 41)), b"chunkC", 0, b"\x21");
    let exr = uncounted(Encoding::UNCOMPRESSED);
    // dataWindow box2i: length, then xMin, yMin, xMax, yMax.
    let window = |x: i32, y: i32| {
        let values: Vec<u8> = [0, 0, x, y].into_iter().flat_map(i32::to_le_bytes).collect();
        put(&exr, b"dataWindow\0box2i\0", 4, &values)
    };
    refused(&window(65_535, 65_535), Code::InputTruncated);
    refused(&window(65_536, 40), Code::InputRange);
    refused(&window(1 << 29, 1 << 29), Code::InputRange);
    refused(&window(i32::MAX, i32::MAX), Code::InputFormat);
    refused(&window(36, 41), Code::InputTruncated);
    let tiled = uncounted(encodings()[10]);
    let tiles =
        |x: u32, y: u32| put(&tiled, b"tiles\0tiledesc\0", 4, &[x.to_le_bytes(), y.to_le_bytes()].concat());
    refused(&tiles(u32::MAX, u32::MAX), Code::InputFormat);
    refused(&tiles(1 << 20, 1 << 20), Code::InputRange);
    refused(&tiles(0, 16), Code::InputFormat);
    refused(&tiles(1, 1), Code::InputTruncated);
    let png = png_of(2, 1, ColorType::Rgb, BitDepth::Eight, &[9; 6], false);
    let size = |width: u32, height: u32| {
        let mut bytes = put(&png, b"IHDR", 0, &[width.to_be_bytes(), height.to_be_bytes()].concat());
        let crc = crc32(&bytes[12..29]).to_be_bytes();
        bytes[29..33].copy_from_slice(&crc);
        bytes
    };
    assert_eq!(size(2, 1), png);
    refused(&size(65_536, 65_536), Code::InputTruncated);
    refused(&size(65_537, 1), Code::InputRange);
    refused(&size(0, 1), Code::InputFormat);
    // Small enough for the file's length, but the stream ends before the rows do.
    refused(&size(2, 9), Code::InputFormat);
}

/// CRC-32 of PNG's chunks, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    })
}

#[test]
fn blocks_that_come_twice_do_not_pass_for_a_picture() {
    let bytes = exr_of(Encoding::UNCOMPRESSED, 4, 3, rgb("", 4, 3));
    let line = 8 + 3 * 4 * 4;
    let table = bytes.len() - 3 * (8 + line);
    let mut twice = bytes.clone();
    let first = bytes[table..table + 8].to_vec();
    twice[table + 8..table + 16].copy_from_slice(&first);
    assert!(refused(&twice, Code::InputFormat).numbers_text().contains("twice"));
    for offset in [0u64, 1 << 40, u64::MAX] {
        let mut lost = bytes.clone();
        lost[table..table + 8].copy_from_slice(&offset.to_le_bytes());
        assert!(read(&lost).is_err(), "{offset}");
    }
}

#[test]
fn what_is_no_picture_is_refused() {
    refused(b"", Code::InputEmpty);
    refused(b"ply\nformat ascii 1.0\n", Code::InputFormat);
    refused(b"\x89PNG\r\n\x1a\n", Code::InputTruncated);
    refused(&[0x76, 0x2f, 0x31, 0x01], Code::InputTruncated);
    let mut endless = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    while endless.len() < 5 << 20 {
        endless.extend(b"note\0string\0\x10\0\0\0sixteen letters.");
    }
    assert!(refused(&endless, Code::InputFormat).numbers_text().contains("longer than"));
}

#[test]
fn a_raised_interrupt_ends_the_reading() {
    let bytes = exr_of(Encoding::UNCOMPRESSED, 37, 41, rgb("", 37, 41));
    let interrupt = Interrupt::default();
    let origin = Origin { interrupt: &interrupt, ..origin(&bytes) };
    let head = read_head(Cursor::new(&bytes), origin).unwrap();
    interrupt.raise();
    assert_eq!(read_picture(Cursor::new(&bytes), origin, &head).unwrap_err().code(), Code::Interrupted);
}

/// Damaged versions of each file; a run with 100,000 met no panic either.
const DAMAGE_ROUNDS: u32 = 300;

/// Cut anywhere, a picture ends early; with bytes changed, it is read or refused. Nothing panics.
#[test]
fn cut_and_damaged_files_are_read_or_refused() {
    let mut files: Vec<_> = encodings().into_iter().map(|e| exr_of(e, 37, 41, rgb("", 37, 41))).collect();
    files.push(png_of(37, 41, ColorType::Rgb, BitDepth::Eight, &[77; 37 * 41 * 3], false));
    files.push(png_of(37, 41, ColorType::Indexed, BitDepth::Two, &[0x1b; 10 * 41], true));
    let mut random = Pcg32::new(7, 11);
    for (index, bytes) in files.iter().enumerate() {
        for part in 0..40 {
            let cut = bytes.len() * part / 40;
            let error = read(&bytes[..cut]).expect_err("cut");
            let codes = [Code::InputTruncated, Code::InputEmpty, Code::InputFormat];
            assert!(codes.contains(&error.code()), "file {index} cut at {cut}: {error}");
        }
        for _ in 0..DAMAGE_ROUNDS {
            let mut bytes = bytes.clone();
            // The header is the first few hundred bytes: half of the damage falls there.
            let reach = if random.next_u32().is_multiple_of(2) { bytes.len().min(400) } else { bytes.len() };
            for _ in 0..1 + random.next_u32() % 3 {
                let at = random.next_u32() as usize % reach;
                bytes[at] = match random.next_u32() % 3 {
                    0 => 0xff,
                    1 => bytes[at] ^ (1 << (random.next_u32() % 8)),
                    _ => random.next_u32() as u8,
                };
            }
            if let Ok((head, picture)) = read(&bytes) {
                assert_eq!(picture.pixels.len() as u64 * PIXEL_BYTES, head.picture_bytes());
            }
        }
    }
}
