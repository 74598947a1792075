//! What the papers say comes first, in pictures made so that it is known. Of whole pictures, only the order counts.

use super::achanta::{distance, to_lab};
use super::itti::oriented;
use super::plane::Plane;
use super::{ReducedPicture, SIDE_PIXELS, Saliency};
use crate::hash::mix;
use std::f32::consts::FRAC_1_SQRT_2;

const BOTH: [Saliency; 2] = [Saliency::Achanta, Saliency::Itti];
const GREY: [f32; 3] = [0.3; 3];
/// Tiles along a side of the pictures with bars, and of the cell of a bar.
const TILES: u32 = 64;
const CELL_TILES: u32 = 8;
/// Cells (column, row), in a picture of 8 x 8, that are not as the others.
const ODD: [u32; 2] = [2, 5];
const OTHER: [u32; 2] = [5, 3];

/// The tile (column, row) that a metric puts first, of a picture of so many columns.
fn first(scores: &[f32], columns: u32) -> [u32; 2] {
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b])).unwrap() as u32;
    [best % columns, best / columns]
}

/// A picture of 16 x 16 tiles, grey but for tile (5, 9), whose pixels (x, y) from its first are `odd`.
fn odd_tile(odd: impl Fn([u32; 2]) -> [f32; 3]) -> ReducedPicture {
    ReducedPicture::of([16 * SIDE_PIXELS; 2], |pixel| match pixel.map(|x| x / SIDE_PIXELS) {
        [5, 9] => odd(pixel.map(|x| x % SIDE_PIXELS)),
        _ => GREY,
    })
}

/// Bars of one tile by three on grey, one a cell: whether it lies, and its colour, by cell (column, row).
fn bars(bar: impl Fn([u32; 2]) -> (bool, [f32; 3])) -> ReducedPicture {
    ReducedPicture::of([TILES * SIDE_PIXELS; 2], |pixel| {
        let tile = pixel.map(|x| x / SIDE_PIXELS);
        let (lies, colour) = bar(tile.map(|x| x / CELL_TILES));
        let [x, y] = tile.map(|x| x % CELL_TILES);
        let (along, across) = if lies { (x, y) } else { (y, x) };
        if across == 3 && (2..5).contains(&along) { colour } else { GREY }
    })
}

/// The cell of the tile that a metric puts first among bars.
fn first_bar(metric: Saliency, picture: &ReducedPicture) -> [u32; 2] {
    first(&metric.tiles(picture), TILES).map(|x| x / CELL_TILES)
}

#[test]
fn the_odd_one_out_is_found() {
    for metric in BOTH {
        for odd in [[0.9, 0.1, 0.1], [1.0; 3], [0.0; 3], [0.3, 0.3, 0.6]] {
            assert_eq!(first(&metric.tiles(&odd_tile(|_| odd)), 16), [5, 9], "{metric:?} {odd:?}");
        }
    }
}

#[test]
fn one_colour_has_one_saliency() {
    for metric in BOTH {
        let scores = metric.tiles(&odd_tile(|_| GREY));
        assert!(scores.iter().all(|score| (score - scores[0]).abs() < 1e-4), "{metric:?}");
    }
}

/// Grey where a sample begins, white at the other fifteen pixels; and a single white pixel, wherever it is.
#[test]
fn patterns_between_the_corners_of_samples_are_found() {
    for metric in BOTH {
        let corners = odd_tile(|[x, y]| if x % 4 == 0 && y % 4 == 0 { GREY } else { [1.0; 3] });
        assert_eq!(first(&metric.tiles(&corners), 16), [5, 9], "{metric:?}");
        for place in (0..64).map(|i| [i % 8, i / 8]) {
            let pixel = odd_tile(|pixel| if pixel == place { [1.0; 3] } else { GREY });
            assert_eq!(first(&metric.tiles(&pixel), 16), [5, 9], "{metric:?} {place:?}");
        }
    }
}

/// By definition Achanta's map of a transposed bar is the map transposed: it sees no difference. It puts first what is
/// farther from the mean colour, here a bar that is a little brighter. In Itti's N that bar is one among many maxima
/// nearly as great, and the one that lies is alone in its orientation.
#[test]
fn itti_sees_orientation_and_achanta_does_not() {
    let lying = |cell| cell == ODD;
    let alike = Saliency::Achanta.tiles(&bars(|cell| (lying(cell), [0.8; 3])));
    let greatest = |cell: [u32; 2]| {
        let inside = |i: u32| [i % TILES / CELL_TILES, i / TILES / CELL_TILES] == cell;
        (0..TILES * TILES).filter(|&i| inside(i)).map(|i| alike[i as usize]).fold(0.0, f32::max)
    };
    assert!((greatest(ODD) - greatest(OTHER)).abs() < 1e-3);
    assert_eq!(first_bar(Saliency::Itti, &bars(|cell| (lying(cell), [0.8; 3]))), ODD);

    let picture = bars(|cell| (lying(cell), if cell == OTHER { [0.85; 3] } else { [0.8; 3] }));
    assert_eq!(first_bar(Saliency::Itti, &picture), ODD);
    assert_eq!(first_bar(Saliency::Achanta, &picture), OTHER);
}

/// Pale green bars and a red one, all of the luminance of the grey around: red is farther from it in Lab, and alone.
#[test]
fn both_see_a_colour_alone() {
    let (green, red) = ([0.2, 0.34, 0.2], [0.8, 0.165, 0.165]);
    let picture = bars(|cell| (cell[0] % 2 == 0, if cell == ODD { red } else { green }));
    for metric in BOTH {
        assert_eq!(first_bar(metric, &picture), ODD, "{metric:?}");
    }
}

/// White bars are far from the mean colour and many; the dim blue one is near to it, and alone.
#[test]
fn itti_sees_what_is_alone_and_achanta_what_is_far() {
    let dim_blue = [0.28, 0.28, 0.42];
    let picture = bars(|cell| (false, if cell == ODD { dim_blue } else { [1.0; 3] }));
    assert_eq!(first_bar(Saliency::Itti, &picture), ODD);
    assert_ne!(first_bar(Saliency::Achanta, &picture), ODD);
}

/// Each pixel changes the samples that it is in, and those alone; each is the mean of its pixels.
#[test]
fn samples_are_means_of_their_pixels() {
    for [width, height] in [[16, 8], [9, 13], [1, 1], [30, 5]] {
        let value = |[x, y]: [u32; 2]| (mix(u64::from(y * width + x)) % 1000) as f32 / 800.0;
        let mut asked = vec![0; (width * height) as usize];
        let picture = ReducedPicture::of([width, height], |[x, y]| {
            asked[(y * width + x) as usize] += 1;
            [value([x, y]), 0.5, -1.0]
        });
        assert!(asked.iter().all(|&count| count > 0), "{width} x {height}");
        assert_eq!(picture.size, [width, height].map(|side| side.div_ceil(8) as usize * 2));
        for (i, rgb) in picture.rgb.iter().enumerate() {
            let at = [i % picture.size[0], i / picture.size[0]].map(|x| x as u32 * 4);
            let of = |a: usize, side: u32| at[a].min(side - 1)..(at[a] + 4).min(side);
            let places = of(1, height).flat_map(|y| of(0, width).map(move |x| [x, y]));
            let values: Vec<f32> = places.map(|place| value(place).min(1.0)).collect();
            let mean = values.iter().sum::<f32>() / values.len() as f32;
            assert!((rgb[0] - mean).abs() < 1e-5 && (rgb[1] - 0.5).abs() < 1e-5 && rgb[2] == 0.0, "{i}");
        }
    }
}

/// Achanta at every pixel, word by word: the picture in Lab, blurred by a binomial of five; distance to the mean; and
/// of that the mean per tile.
fn achanta_of_all_pixels(side: u32, rgb: impl Fn([u32; 2]) -> [f32; 3]) -> Vec<f32> {
    let lab = |x: i64, y: i64| {
        let [x, y] = [x, y].map(|x| x.clamp(0, i64::from(side) - 1) as u32);
        to_lab(rgb([x, y]))
    };
    let pixels = || (0..i64::from(side)).flat_map(move |y| (0..i64::from(side)).map(move |x| (x, y)));
    let mut mean = [0.0; 3];
    for (x, y) in pixels() {
        mean = std::array::from_fn(|c| mean[c] + lab(x, y)[c] / (side * side) as f32);
    }
    let columns = side / SIDE_PIXELS;
    let mut tiles = vec![0.0; (columns * columns) as usize];
    for (x, y) in pixels() {
        let mut blurred = [0.0; 3];
        for (i, j) in (0..25).map(|i| (i % 5, i / 5)) {
            let weight = [1.0, 4.0, 6.0, 4.0, 1.0][i] * [1.0, 4.0, 6.0, 4.0, 1.0][j] / 256.0;
            let lab = lab(x + i as i64 - 2, y + j as i64 - 2);
            blurred = std::array::from_fn(|c| blurred[c] + weight * lab[c]);
        }
        let tile = y as u32 / SIDE_PIXELS * columns + x as u32 / SIDE_PIXELS;
        tiles[tile as usize] += distance(blurred, mean) / (SIDE_PIXELS * SIDE_PIXELS) as f32;
    }
    tiles
}

/// Slopes of two colours, a bright disk and a dark line.
#[test]
fn achanta_is_that_of_all_pixels() {
    let side = 128;
    let rgb = |[x, y]: [u32; 2]| {
        let (x, y) = (x as f32 / side as f32, y as f32 / side as f32);
        let slope = [0.2 + 0.2 * x, 0.2 + 0.1 * y, 0.3 - 0.1 * x];
        match ((x - 0.7).hypot(y - 0.3) < 0.11, (x + y - 0.8).abs() < 0.03) {
            (true, _) => [0.9, 0.8, 0.3],
            (_, true) => [0.05; 3],
            _ => slope,
        }
    };
    let expected = achanta_of_all_pixels(side, rgb);
    let found = Saliency::Achanta.tiles(&ReducedPicture::of([side; 2], rgb));
    assert_eq!(first(&found, 16), first(&expected, 16));
    let greatest = expected.iter().copied().fold(0.0, f32::max);
    let off = found.iter().zip(&expected).map(|(a, b)| (a - b).abs() / greatest);
    let (sum, worst) = off.fold((0.0, 0.0f32), |(sum, worst), off| (sum + off, worst.max(off)));
    assert!(sum / 256.0 < 0.01 && worst < 0.1, "{} {worst}", sum / 256.0);
}

/// A wave along each of the four angles is seen by the filter of that angle most, by its neighbours less, and least by
/// the one across. A field without a pattern is seen by none.
#[test]
fn gabor_filters_tell_orientations() {
    let side = 32;
    let plane = |value: &dyn Fn(f32, f32) -> f32| {
        let places = (0..side * side).map(|i| ((i % side) as f32, (i / side) as f32));
        Plane { size: [side; 2], values: places.map(|(x, y)| value(x, y)).collect() }
    };
    let middle = |plane: &Plane| plane.values[side / 2 * side + side / 2];
    let diagonal = FRAC_1_SQRT_2;
    let ways = [(1.0, 0.0), (diagonal, diagonal), (0.0, 1.0), (-diagonal, diagonal)];
    for (angle, (along_x, along_y)) in ways.into_iter().enumerate() {
        let wave =
            |x: f32, y: f32| 0.5 + 0.5 * (std::f32::consts::FRAC_PI_2 * (along_x * x + along_y * y)).sin();
        let [own, next, across, last] =
            std::array::from_fn(|step| middle(&oriented(&plane(&wave))[(angle + step) % 4]));
        assert!(own > 2.0 * next && own > 2.0 * last && next > 2.0 * across && last > 2.0 * across);
    }
    for response in oriented(&plane(&|_, _| 0.7)) {
        assert!(response.values.iter().all(|value| value.abs() < 1e-5));
    }
}

/// N of maps with known maxima: (1 - m)², where m is the mean of all but the greatest.
#[test]
fn the_normalization_is_that_of_the_paper() {
    let promoted = |peaks: &[(usize, f32)], least: f32, scale: f32| {
        let mut values = vec![least; 81];
        peaks.iter().for_each(|&(at, value)| values[at] = least + scale * value);
        Plane { size: [9, 9], values }.promoted().values
    };
    for (least, scale) in [(0.0, 1.0), (0.0, 250.0), (3.0, 0.5)] {
        for (peaks, weight) in [
            (&[(40, 1.0)][..], 1.0),
            (&[(40, 1.0), (10, 0.5)], 0.25),
            (&[(10, 0.25), (70, 1.0), (16, 0.75)], 0.25),
            (&[(0, 1.0), (80, 1.0)], 0.0),
            // Neighbours of one value are one maximum; a shoulder is none, and neither is what is very small.
            (&[(40, 1.0), (41, 1.0), (49, 1.0), (50, 1.0)], 1.0),
            (&[(40, 1.0), (41, 0.8)], 1.0),
            (&[(40, 1.0), (10, 0.05)], 1.0),
        ] {
            for &(at, value) in peaks {
                let found = promoted(peaks, least, scale)[at];
                assert!((found - weight * value).abs() < 1e-5, "{peaks:?} {at}: {found}");
            }
        }
    }
    assert!(promoted(&[], 0.7, 1.0).iter().all(|&value| value == 0.0));
}

#[test]
fn lab_is_that_of_the_tables() {
    for (rgb, expected) in [
        ([1.0, 1.0, 1.0], [100.0, 0.0, 0.0]),
        ([1.0, 0.0, 0.0], [53.24, 80.09, 67.2]),
        ([0.0, 0.0, 1.0], [32.3, 79.19, -107.86]),
        ([0.0; 3], [0.0; 3]),
    ] {
        for (found, expected) in to_lab(rgb).into_iter().zip(expected) {
            assert!((found - expected).abs() < 0.1, "{rgb:?}: {found} {expected}");
        }
    }
}

/// Contrast is the mean difference of roots of luminance between neighbours of a tile; what is flat has no error,
/// however bright and salient, and of tiles of one contrast the one that catches the eye looks the most wrong.
#[test]
fn what_is_flat_is_not_wrong_and_what_catches_the_eye_looks_it() {
    // Columns of a tile: stripes from black to a quarter, whose root is a half; the tile to its right is white.
    let picture = ReducedPicture::of([5 * SIDE_PIXELS, 2 * SIDE_PIXELS + 3], |[x, y]| {
        let tile = [x, y].map(|v| v / SIDE_PIXELS);
        let stripe = if x % 2 == 0 { [0.0; 3] } else { [0.25; 3] };
        let step = if y % SIDE_PIXELS < 4 { [0.0; 3] } else { [0.25; 3] };
        match tile {
            [1, 1] => stripe,
            [2, 1] => [9.0; 3],
            [3, 2] => stripe,
            [4, 0] => step,
            _ => [0.0; 3],
        }
    });
    let side = SIDE_PIXELS as f32;
    let (across, down) = (side * (side - 1.0), side * (side - 1.0));
    let expected = |tile: usize| match tile {
        6 => 0.5 * across / (across + down),
        // Three rows of it are in the picture.
        13 => 0.5 * (3.0 * (side - 1.0)) / (3.0 * (side - 1.0) + 2.0 * side),
        4 => 0.5 * side / (across + down),
        _ => 0.0,
    };
    for (tile, found) in picture.contrast.iter().enumerate() {
        assert!((found - expected(tile)).abs() < 1e-5, "{tile}: {found}");
    }
    for metric in BOTH {
        let (errors, saliency) = (metric.errors(&picture), metric.tiles(&picture));
        let mean = saliency.iter().sum::<f32>() / saliency.len() as f32;
        for (tile, found) in errors.iter().enumerate() {
            let expected = expected(tile) + expected(tile) * saliency[tile] / mean;
            assert!((found - expected).abs() < 1e-4, "{metric:?} {tile}: {found} {expected}");
        }
    }
}
