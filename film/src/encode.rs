//! Pictures: a film as PNG or EXR, encoded a few lines at a time.
//!
//! PNG: 8 bits, sRGB, `clamp(exposure * L)`. EXR: 32-bit scan lines, `R G B` linear and unclamped, and of the
//! layers that the film keeps: `Z` (depth, distance from the camera), `normal.X/Y/Z`, `albedo.R/G/B`, `id` (u32).
//!
//! A picture need not be there as a whole: encoders ask for it strip by strip ([`Strips`]).
//!
//! Invariants: 1. an encoder holds at most [`encoder_bytes`]; 2. the same film gives the same bytes, also where it is
//! cut to strips; 3. strips are asked for from the top down, each once.

use super::film::{self, Film, Layers};
use exr::block::UncompressedBlock;
use exr::block::lines::LineRefMut;
use exr::block::writer::ChunksWriter;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType};
use exr::meta::header::Header;
use exr::prelude::{Compression, Text};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::io::{Error, Result, Seek, Write};

/// Lines of a strip: what EXR's ZIP compresses together, and what of a PNG is converted together.
pub(crate) const STRIP_LINES: u32 = 16;
/// Pixels that a thread converts at a time, at least: less is not worth waking it.
const TONE_PIXELS_LEAST: usize = 1024;
/// Copies of a block that the EXR encoder holds: the lines, their reordered bytes, the compressed ones, one spare.
const EXR_COPIES: u64 = 4;
/// Bytes of zlib and the buffers around it.
const ENCODER_FIXED_BYTES: u64 = 1 << 20;

// The strip of a PNG, 12 bytes a pixel and 3 more, fits what `encoder_bytes` counts for the block of an EXR.
const _: () = assert!(15 <= 3 * 4 * EXR_COPIES);

/// A picture to be written: a film, or a session that shows more than its film.
pub trait Image {
    /// The film that gives the picture its size and its layers.
    fn film(&self) -> &Film;

    /// Radiance of a pixel (x, y), linear RGB.
    fn radiance(&self, pixel: [u32; 2]) -> [f32; 3];

    /// Mean radiance over all pixels, linear RGB, unclamped.
    fn mean(&self) -> [f64; 3] {
        film::mean(self.film(), |pixel| self.radiance(pixel))
    }
}

impl Image for Film {
    fn film(&self) -> &Film {
        self
    }

    fn radiance(&self, pixel: [u32; 2]) -> [f32; 3] {
        Film::radiance(self, pixel)
    }
}

/// A picture that is made strip by strip while it is written.
pub trait Strips {
    /// What a strip is.
    type Image: Image;

    /// Width and height of the picture, pixels.
    fn resolution(&self) -> [u32; 2];

    /// The layers of its strips.
    fn layers(&self) -> Layers;

    /// The picture, of which the rows of a strip from `first` on have to be there.
    ///
    /// # Errors
    /// Those of who makes it.
    fn strip(&mut self, first: u32) -> Result<&Self::Image>;
}

/// A picture that is there as a whole.
struct WholeImage<'a, I>(&'a I);

impl<I: Image> Strips for WholeImage<'_, I> {
    type Image = I;

    fn resolution(&self) -> [u32; 2] {
        self.0.film().resolution()
    }

    fn layers(&self) -> Layers {
        self.0.film().layers()
    }

    fn strip(&mut self, _: u32) -> Result<&I> {
        Ok(self.0)
    }
}

/// Bytes that [`write_png`] or [`write_exr`] takes at `resolution` (width, height; pixels), writer not counted.
pub fn encoder_bytes(resolution: [u32; 2], layers: Layers) -> u64 {
    let [width, height] = resolution.map(u64::from);
    let block = width * channels(layers).len() as u64 * 4 * u64::from(STRIP_LINES);
    let offsets = height.div_ceil(u64::from(STRIP_LINES)) * 8;
    ENCODER_FIXED_BYTES + EXR_COPIES * block + offsets
}

/// Writes `image` as PNG: sRGB of `clamp(exposure * radiance)`, converted on the threads of `pool`.
///
/// # Errors
/// Those of the writer.
pub fn write_png<W: Write>(image: &impl Image, exposure: f32, pool: &ThreadPool, writer: W) -> Result<()> {
    write_png_strips(&mut WholeImage(image), exposure, pool, writer)
}

/// As [`write_png`], of a picture that is made strip by strip.
///
/// # Errors
/// Those of the writer and of the strips.
pub fn write_png_strips<W: Write>(
    strips: &mut impl Strips,
    exposure: f32,
    pool: &ThreadPool,
    writer: W,
) -> Result<()> {
    let [width, height] = strips.resolution();
    let mut encoder = png::Encoder::new(writer, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    let mut png = encoder.write_header()?;
    let mut stream = png.stream_writer()?;
    let mut radiances = Vec::with_capacity(width as usize * STRIP_LINES as usize);
    let mut strip = vec![0u8; radiances.capacity() * 3];
    for first in (0..height).step_by(STRIP_LINES as usize) {
        let lines = first..height.min(first + STRIP_LINES);
        let image = strips.strip(first)?;
        radiances.clear();
        radiances.extend(lines.flat_map(|y| (0..width).map(move |x| image.radiance([x, y]))));
        let coded = &mut strip[..radiances.len() * 3];
        pool.install(|| {
            let pixels = coded.par_chunks_exact_mut(3).zip(&radiances).with_min_len(TONE_PIXELS_LEAST);
            pixels.for_each(|(pixel, radiance)| {
                pixel.copy_from_slice(&radiance.map(|value| to_srgb(exposure * value)));
            });
        });
        stream.write_all(coded)?;
    }
    stream.finish()?;
    png.finish()?;
    Ok(())
}

/// Writes `image` as EXR, with the layers of its film.
///
/// # Errors
/// Errors of `writer`.
pub fn write_exr<W: Write + Seek>(image: &impl Image, writer: W) -> Result<()> {
    write_exr_strips(&mut WholeImage(image), writer)
}

/// As [`write_exr`], of a picture that is made strip by strip.
///
/// # Errors
/// Those of the writer and of the strips.
pub fn write_exr_strips<W: Write + Seek>(strips: &mut impl Strips, writer: W) -> Result<()> {
    let channels = channels(strips.layers());
    let [width, height] = strips.resolution().map(|side| side as usize);
    let list = channels
        .iter()
        .map(|channel| ChannelDescription::new(channel.name(), channel.kind(), true))
        .collect();
    let header = Header::new(Text::from("trex"), (width, height), list).with_encoding(
        Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    let headers = std::iter::once(header).collect();
    exr::block::write(writer, headers, true, |meta, chunks| {
        let mut compressor = chunks.sequential_blocks_compressor(&meta);
        for (place, index) in exr::block::enumerate_ordered_header_block_indices(&meta.headers) {
            let list = &meta.headers[index.layer].channels;
            let image = strips.strip(index.pixel_position.y() as u32)?;
            let block = UncompressedBlock::from_lines(list, index, |line| {
                channels[line.location.channel].fill(image, line);
            });
            compressor.compress_block(place, block)?;
        }
        Ok(())
    })
    .map_err(|error| match error {
        exr::error::Error::Io(error) => error,
        other => Error::other(other.to_string()),
    })
}

/// The transfer function of sRGB (IEC 61966-2-1), in 8 bits.
fn to_srgb(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let coded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (coded * 255.0 + 0.5) as u8
}

/// A channel of an EXR file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Radiance(usize),
    Depth,
    Albedo(usize),
    Id,
    Normal(usize),
}

/// The channels for these layers, in the order of their names' bytes, as EXR wants it.
fn channels(layers: Layers) -> Vec<Channel> {
    use Channel::*;
    let mut list = vec![Radiance(2), Radiance(1), Radiance(0)];
    if layers.depth {
        list.push(Depth);
    }
    if layers.albedo {
        list.extend([Albedo(2), Albedo(1), Albedo(0)]);
    }
    if layers.id {
        list.push(Id);
    }
    if layers.normal {
        list.extend([Normal(0), Normal(1), Normal(2)]);
    }
    list
}

impl Channel {
    fn name(self) -> &'static str {
        match self {
            Channel::Radiance(c) => ["R", "G", "B"][c],
            Channel::Depth => "Z",
            Channel::Albedo(c) => ["albedo.R", "albedo.G", "albedo.B"][c],
            Channel::Id => "id",
            Channel::Normal(c) => ["normal.X", "normal.Y", "normal.Z"][c],
        }
    }

    fn kind(self) -> SampleType {
        if self == Channel::Id { SampleType::U32 } else { SampleType::F32 }
    }

    fn fill(self, image: &impl Image, line: LineRefMut<'_>) {
        let film = image.film();
        let start = line.location.position;
        let pixel = |x: usize| [(start.0 + x) as u32, start.1 as u32];
        let filled = match self {
            Channel::Radiance(c) => line.write_samples(|x| image.radiance(pixel(x))[c]),
            Channel::Depth => line.write_samples(|x| film.depth(pixel(x))),
            Channel::Albedo(c) => line.write_samples(|x| film.albedo(pixel(x))[c]),
            Channel::Id => line.write_samples(|x| film.id(pixel(x))),
            Channel::Normal(c) => line.write_samples(|x| film.normal(pixel(x))[c]),
        };
        filled.expect("a line is as long as its channel says");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::{LayerPixel, NO_ID};
    use crate::testing::pool;
    use crate::tile::tile;
    use std::io::Cursor;
    use trex_store::Budget;

    const ALL: Layers = Layers { depth: true, normal: true, albedo: true, id: true, filter: false };

    /// A film whose pixels say where they are; 37 lines are three EXR blocks.
    fn film(layers: Layers) -> Film {
        let resolution = [19, 37];
        let mut film = Film::new(resolution, layers, &Budget::unlimited()).unwrap();
        for index in 0..crate::tile::tile_count(resolution) {
            let tile = tile(resolution, index);
            let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
            let sums: Vec<_> = pixels.iter().map(|&[x, y]| [x as f32 / 19.0, y as f32 / 18.0, 1.5]).collect();
            film.add(&tile, &sums);
            for [x, y] in pixels {
                let id = if x == 0 { NO_ID } else { x + 100 * y };
                let normal = [0.0, x as f32, 1.0];
                film.set_layers(
                    [x, y],
                    &LayerPixel { depth: y as f32, normal, albedo: [0.25; 3], id, ..LayerPixel::NOTHING },
                );
            }
        }
        film
    }

    #[test]
    fn png_comes_back_as_srgb() {
        let film = film(Layers::default());
        let mut bytes = vec![];
        write_png(&film, 2.0, &pool(2), &mut bytes).unwrap();
        let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (19, 37, png::ColorType::Rgb));
        for y in 0..37 {
            for x in 0..19 {
                let found = &pixels[(y * 19 + x) * 3..][..3];
                let expected = film.radiance([x as u32, y as u32]).map(|value| to_srgb(2.0 * value));
                assert_eq!(found, expected);
            }
        }
        assert_eq!([0.0, 0.002, 0.5, 1.0, 7.0, f32::NAN].map(to_srgb), [0, 7, 188, 255, 255, 0]);
    }

    #[test]
    fn exr_comes_back_bit_by_bit() {
        let film = film(ALL);
        let mut bytes = Cursor::new(vec![]);
        write_exr(&film, &mut bytes).unwrap();
        bytes.set_position(0);
        use exr::prelude::*;
        let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = image.all_attributes().non_parallel().from_buffered(bytes).unwrap();
        let list = &image.layer_data.channel_data.list;
        let names: Vec<_> = list.iter().map(|channel| channel.name.to_string()).collect();
        let expected = [
            "B", "G", "R", "Z", "albedo.B", "albedo.G", "albedo.R", "id", "normal.X", "normal.Y", "normal.Z",
        ];
        assert_eq!(names, expected);
        let value = |name: &str, [x, y]: [u32; 2]| {
            let at = names.iter().position(|n| n == name).unwrap();
            list[at].sample_data.value_by_flat_index((y * 19 + x) as usize)
        };
        for pixel in [[0, 0], [18, 36], [7, 16], [1, 15]] {
            assert_eq!(value("R", pixel), Sample::F32(film.radiance(pixel)[0]));
            assert_eq!(value("B", pixel), Sample::F32(1.5));
            assert_eq!(value("Z", pixel), Sample::F32(pixel[1] as f32));
            assert_eq!(value("normal.Y", pixel), Sample::F32(pixel[0] as f32));
            assert_eq!(value("albedo.G", pixel), Sample::F32(0.25));
            assert_eq!(value("id", pixel), Sample::U32(film.id(pixel)));
        }
    }

    #[test]
    fn the_mean_is_over_all_pixels_and_unclamped() {
        let mean = film(Layers::default()).mean();
        for (found, expected) in mean.into_iter().zip([9.0 / 19.0, 1.0, 1.5]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }
}
