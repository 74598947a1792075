//! Pictures of known colours, as other encoders write them, against colours computed pixel by pixel.

use super::*;
use crate::import::ImportOptions;
use crate::srgb;
use std::io::Cursor;

fn png(size: [u32; 2], color: png::ColorType, bytes: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, size[0], size[1]);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    file
}

/// Three channels of a pixel.
fn rgb(x: u32, y: u32) -> [u8; 3] {
    [(x * 37 % 256) as u8, (y * 53 % 256) as u8, ((x * y) % 256) as u8]
}

fn pixels(size: [u32; 2], alpha: &[u8]) -> Vec<u8> {
    let places = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
    places.flat_map(|(x, y)| rgb(x, y).into_iter().chain(alpha.iter().copied())).collect()
}

fn opened(file: &[u8]) -> Picture {
    let folder = tempfile::tempdir().unwrap();
    read(Cursor::new(file), &ImportOptions::unlimited(folder.path())).unwrap()
}

fn centre(at: u32, count: u32) -> f64 {
    (f64::from(at) + 0.5) / f64::from(count)
}

fn near(found: [f64; 3], wanted: [f64; 3]) -> bool {
    found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-9)
}

#[test]
fn centres_of_texels_have_their_colours_and_places_between_are_weighed() {
    let size = [7, 5];
    for (color, alpha) in [(png::ColorType::Rgb, &[][..]), (png::ColorType::Rgba, &[9])] {
        let mut picture = opened(&png(size, color, &pixels(size, alpha)));
        let wanted = |x: u32, y: u32| rgb(x, y).map(srgb::linear_of);
        for (x, y) in (0..5).flat_map(|y| (0..7).map(move |x| (x, y))) {
            for wraps in [[Wrap::Repeat; 2], [Wrap::Clamp; 2], [Wrap::Mirror; 2]] {
                let found = picture.colour([centre(x, 7), centre(y, 5)], wraps).unwrap();
                assert!(near(found, wanted(x, y)), "{x}, {y}: {found:?}");
            }
        }
        let between = picture.colour([centre(2, 7) + 0.25 / 7.0, centre(3, 5)], [Wrap::Repeat; 2]).unwrap();
        let weighed = [0, 1, 2].map(|i| 0.75 * wanted(2, 3)[i] + 0.25 * wanted(3, 3)[i]);
        assert!(near(between, weighed), "{between:?}");
    }
}

#[test]
fn beside_the_picture_is_what_the_wrap_says() {
    let size = [4, 1];
    let mut picture = opened(&png(size, png::ColorType::Rgb, &pixels(size, &[])));
    let mut at = |u: f64, wrap: Wrap| picture.colour([u, 0.5], [wrap, Wrap::Clamp]).unwrap();
    let wanted = |x: u32| rgb(x, 0).map(srgb::linear_of);
    for (u, wrap, x) in [
        (1.125, Wrap::Repeat, 0),
        (-0.125, Wrap::Repeat, 3),
        (5.625, Wrap::Repeat, 2),
        (7.0, Wrap::Clamp, 3),
        (-7.0, Wrap::Clamp, 0),
        (1.125, Wrap::Mirror, 3),
        (-0.375, Wrap::Mirror, 1),
        (2.125, Wrap::Mirror, 0),
    ] {
        assert!(near(at(u, wrap), wanted(x)), "{u} {wrap:?}: {:?}", at(u, wrap));
    }
    // The last texel and the first one are neighbours where the picture repeats.
    let seam = [0, 1, 2].map(|i| 0.5 * (wanted(3)[i] + wanted(0)[i]));
    assert!(near(at(1.0, Wrap::Repeat), seam) && near(at(0.0, Wrap::Repeat), seam));
    assert!(at(f64::NAN, Wrap::Mirror).iter().all(|part| part.is_finite()));
}

/// 2,500 texels across become 834, each the mean of three, but for the last.
#[test]
fn large_pictures_are_averaged_box_by_box() {
    let size = [2_500, 4];
    let mut picture = opened(&png(size, png::ColorType::Rgb, &pixels(size, &[])));
    assert_eq!((picture.size, picture.file_size), ([834, 2], size));
    for (column, row) in [(0, 0), (17, 0), (832, 1), (833, 0), (833, 1)] {
        let inside = |x: u32, y: u32| x / 3 == column && y / 3 == row;
        let places = (0..4).flat_map(|y| (0..2_500).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y));
        let colours: Vec<_> = places.map(|(x, y)| rgb(x, y).map(srgb::linear_of)).collect();
        let mean = [0, 1, 2].map(|i| colours.iter().map(|c| c[i]).sum::<f64>() / colours.len() as f64);
        let found = picture.colour([centre(column, 834), centre(row, 2)], [Wrap::Clamp; 2]).unwrap();
        assert!(near(found, mean), "{column}, {row}: {found:?}, not {mean:?}");
    }
    let all = (0..4).flat_map(|y| (0..2_500).map(move |x| rgb(x, y).map(srgb::linear_of)));
    let mean = all.fold([0.0; 3], |sum, c| [0, 1, 2].map(|i| sum[i] + c[i] / 10_000.0));
    assert!(near(picture.mean, mean));
}

#[test]
fn grey_palettes_and_jpeg_are_read() {
    let mut grey = opened(&png([2, 1], png::ColorType::Grayscale, &[10, 200]));
    assert!(near(grey.colour([0.75, 0.5], [Wrap::Clamp; 2]).unwrap(), [srgb::linear_of(200); 3]));
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 8, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::One);
    encoder.set_palette(vec![1, 2, 3, 40, 50, 60]);
    encoder.write_header().unwrap().write_image_data(&[0b0100_0000]).unwrap();
    let found = opened(&file).colour([centre(1, 8), 0.5], [Wrap::Clamp; 2]).unwrap();
    assert!(near(found, [40, 50, 60].map(srgb::linear_of)));

    let mut file = Vec::new();
    let plain = [90, 140, 30].repeat(48 * 32);
    jpeg_encoder::Encoder::new(&mut file, 95).encode(&plain, 48, 32, jpeg_encoder::ColorType::Rgb).unwrap();
    let mut picture = opened(&file);
    let found = picture.colour([0.4, 0.6], [Wrap::Clamp; 2]).unwrap().map(srgb::byte_of);
    assert!(
        found.iter().zip([90u8, 140, 30]).all(|(found, wanted)| found.abs_diff(wanted) <= 2),
        "{found:?}"
    );
}

/// Files that are cut, changed, or none: words, never a panic, and no lease stays.
#[test]
fn what_is_no_picture_comes_back_as_words() {
    let folder = tempfile::tempdir().unwrap();
    let options = ImportOptions::unlimited(folder.path());
    let whole = png([33, 21], png::ColorType::Rgb, &pixels([33, 21], &[]));
    let mut jpeg = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut jpeg, 80);
    encoder.encode(&pixels([33, 21], &[]), 33, 21, jpeg_encoder::ColorType::Rgb).unwrap();
    for file in [&whole, &jpeg] {
        for cut in 0..file.len() {
            let _ = read(Cursor::new(&file[..cut]), &options);
            let mut changed = file.clone();
            changed[cut] ^= 0x5a;
            let _ = read(Cursor::new(&changed), &options);
        }
    }
    for (file, words) in
        [(&b"KTX 20"[..], "neither"), (b"", "ends early"), (&whole[..60], ""), (&jpeg[..40], "ends early")]
    {
        let Err(PictureFault::Unread(told)) = read(Cursor::new(file), &options) else {
            panic!("{words}: it was read")
        };
        assert!(told.contains(words), "{told}");
    }
    assert_eq!(options.budget.used_bytes(), 0);
}

#[test]
fn a_picture_that_memory_has_no_room_for_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let budget = crate::budget::Budget::new(1 << 20);
    let file = png([33, 21], png::ColorType::Rgb, &pixels([33, 21], &[]));
    let found = read(Cursor::new(&file), &ImportOptions::new(budget, folder.path()));
    assert!(
        matches!(found, Err(PictureFault::Failed(error)) if error.code() == crate::error::Code::MemoryLimit)
    );
}
