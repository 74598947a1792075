//! The error per pixel as a colour: dark violet for none, over blue and green, to yellow at the end of the scale.
//!
//! The error of a pixel is the root of the mean squared error of its channels. The colours are *viridis* (S. van der
//! Walt, N. Smith, matplotlib): equal steps look equal, also in grey and to the colour-blind. Pixels that were left
//! out are magenta, which it has not.
//!
//! Invariant: the same pictures and scale give the same bytes.

use super::head::Picture;
use ::png::{BitDepth, ColorType, Encoder, SrgbRenderingIntent};
use std::io::{Error, Result, Write};

/// Share of the pixels whose error the scale holds when none is given: fireflies must not turn the rest dark.
pub const SCALE_PERCENTILE: f64 = 99.0;
/// Viridis at ninths of its length, sRGB; between them linear.
const VIRIDIS: [[u8; 3]; 10] = [
    [0x44, 0x01, 0x54],
    [0x48, 0x28, 0x78],
    [0x3e, 0x4a, 0x89],
    [0x31, 0x68, 0x8e],
    [0x26, 0x82, 0x8e],
    [0x1f, 0x9e, 0x89],
    [0x35, 0xb7, 0x79],
    [0x6d, 0xcd, 0x59],
    [0xb4, 0xde, 0x2c],
    [0xfd, 0xe7, 0x25],
];
/// Pixels that are not finite in one of the pictures.
const LEFT_OUT: [u8; 3] = [0xff, 0x00, 0xff];
/// What the encoder takes beside a line, bytes.
const ENCODER_FIXED_BYTES: u64 = 1 << 20;

/// Bytes that [`scale_of`] and [`write()`] take for a picture of this size (pixels), writer not counted.
pub fn work_bytes(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * size_of::<f32>() as u64
        + u64::from(width) * 16
        + ENCODER_FIXED_BYTES
}

/// End of the scale for two pictures: the error that [`SCALE_PERCENTILE`] of the compared pixels do not exceed; the
/// largest, if that is zero; zero for pictures without an error.
pub fn scale_of(a: &Picture, b: &Picture) -> f64 {
    let mut errors: Vec<f32> = errors(a, b).flatten().collect();
    let Some(last) = errors.len().checked_sub(1) else { return 0.0 };
    let place = ((errors.len() as f64 * SCALE_PERCENTILE / 100.0).ceil() as usize).clamp(1, last + 1) - 1;
    let (_, chosen, above) = errors.select_nth_unstable_by(place, f32::total_cmp);
    let largest = above.iter().copied().fold(*chosen, f32::max);
    f64::from(if *chosen > 0.0 { *chosen } else { largest })
}

/// Writes the picture of errors as PNG; errors of `scale_max` (radiance) and above have the last colour.
///
/// # Errors
/// Those of the writer.
///
/// # Panics
/// When the sizes differ.
pub fn write<W: Write>(a: &Picture, b: &Picture, scale_max: f64, writer: W) -> Result<()> {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let mut encoder = Encoder::new(writer, a.width, a.height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_source_srgb(SrgbRenderingIntent::RelativeColorimetric);
    let text =
        format!("error per pixel (RMS of its channels, linear radiance), viridis from 0 to {scale_max:e}");
    encoder.add_text_chunk("Description".to_owned(), text).map_err(Error::other)?;
    let mut png = encoder.write_header()?;
    let mut stream = png.stream_writer()?;
    let line_bytes = a.width as usize * 3;
    let mut line = Vec::with_capacity(line_bytes);
    for error in errors(a, b) {
        line.extend(error.map_or(LEFT_OUT, |error| colour(f64::from(error), scale_max)));
        if line.len() == line_bytes {
            stream.write_all(&line)?;
            line.clear();
        }
    }
    stream.finish()?;
    png.finish()?;
    Ok(())
}

/// Errors of all pixels; `None` where a value is not finite.
fn errors<'a>(a: &'a Picture, b: &'a Picture) -> impl Iterator<Item = Option<f32>> + 'a {
    a.pixels.iter().zip(&b.pixels).map(|(a, b)| {
        let squares = a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2));
        let mean = squares.sum::<f64>() / 3.0;
        // f64 holds the square of any f32: what is not finite here was not in the pictures.
        mean.is_finite().then(|| mean.sqrt() as f32)
    })
}

fn colour(error: f64, scale_max: f64) -> [u8; 3] {
    // Without a scale nothing has an error.
    let share = if scale_max > 0.0 { (error / scale_max).clamp(0.0, 1.0) } else { 0.0 };
    let place = share * (VIRIDIS.len() - 1) as f64;
    let from = (place as usize).min(VIRIDIS.len() - 2);
    let t = place - from as f64;
    std::array::from_fn(|c| {
        let [low, high] = [VIRIDIS[from][c], VIRIDIS[from + 1][c]].map(f64::from);
        (low + (high - low) * t).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(values: &[f32]) -> Picture {
        Picture { width: values.len() as u32, height: 1, pixels: values.iter().map(|&v| [v; 3]).collect() }
    }

    #[test]
    fn the_colours_grow_brighter_all_the_way() {
        let linear = |code: u8| {
            let v = f64::from(code) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        };
        let lightness = |[r, g, b]: [u8; 3]| {
            (0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)).cbrt() * 116.0 - 16.0
        };
        let steps: Vec<f64> = (0..=90).map(|i| lightness(colour(f64::from(i), 90.0))).collect();
        let mean = (steps[90] - steps[0]) / 90.0;
        // Nearly equal steps of lightness are what makes it perceptual.
        for pair in steps.windows(2) {
            assert!((0.4..1.7).contains(&((pair[1] - pair[0]) / mean)), "{pair:?} beside {mean}");
        }
        assert_eq!(colour(0.0, 1.0), VIRIDIS[0]);
        assert_eq!(colour(5.0, 1.0), VIRIDIS[9]);
        assert_eq!(colour(0.0, 0.0), VIRIDIS[0]);
        assert!(!VIRIDIS.contains(&LEFT_OUT));
    }

    #[test]
    fn the_scale_leaves_out_the_brightest_hundredth() {
        let black = picture(&[0.0; 200]);
        let mut values: Vec<f32> = (1..=200).map(|i| i as f32).collect();
        assert_eq!(scale_of(&picture(&values), &black), 198.0);
        values[..100].fill(f32::NAN);
        assert_eq!(scale_of(&picture(&values), &black), 199.0);
        values.fill(0.0);
        values[7] = -3.0;
        assert_eq!(scale_of(&picture(&values), &black), 3.0);
        assert_eq!(scale_of(&black, &black), 0.0);
        assert_eq!(scale_of(&picture(&[f32::NAN]), &picture(&[1.0])), 0.0);
        assert_eq!(scale_of(&picture(&[0.5]), &picture(&[1.0])), 0.5);
    }

    #[test]
    fn the_picture_shows_error_scale_and_what_was_left_out() {
        let (a, b) = (picture(&[0.0, 0.5, 1.0, 9.0, f32::NAN]), picture(&[0.0; 5]));
        let mut bytes = vec![];
        write(&a, &b, 1.0, &mut bytes).unwrap();
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let expected = [VIRIDIS[0], colour(0.5, 1.0), VIRIDIS[9], VIRIDIS[9], LEFT_OUT];
        assert_eq!(pixels, expected.concat());
        assert!(reader.info().uncompressed_latin1_text[0].text.ends_with("from 0 to 1e0"));
    }
}
