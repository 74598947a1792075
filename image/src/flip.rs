//! `flip`: how different two pictures look to who flips between them: 0 alike, 1 as different as can be.
//!
//! ```text
//! picture -> Y Cx Cz --what the eye resolves--> linear RGB, clamped -> L* a* b*, colours by lightness --,
//!               |                                                                                      distance
//!               Y -> edges and points                                               difference of features |
//! flip of a pixel = colour difference ^ (1 - difference of features); of a picture: the mean
//! ```
//!
//! LDR-FLIP: P. Andersson et al., "FLIP: A difference evaluator for alternating images" (2020), with its constants:
//! a screen 3840 pixels and 0.7 m wide, seen from 0.7 m. Held to `flip-evaluator` by the tests.
//!
//! Every kernel is a sum of products of one along a row and one along a column. Rows are filtered once into a ring of
//! those around the row at hand: it takes no more for a higher picture.
//!
//! Invariants: 1. a picture has 0 to itself; 2. what is no number is black; 3. beside the pictures [`flip_bytes`] are
//! taken, which the caller leases.

use super::head::Picture;
use std::f64::consts::PI;
use std::ops::Range;

/// Pixels of a degree of sight.
const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;
/// Width of the eye's edges and points, degrees.
const FEATURE_DEGREES: f64 = 0.082;
/// Exponents of the differences of colours and of features.
const COLOUR_POWER: f32 = 0.7;
const FEATURE_POWER: f32 = 0.5;
/// The share of the largest colour difference that is spread over this share of the range.
const SPREAD_FROM: f32 = 0.4;
const SPREAD_TO: f32 = 0.95;
/// What the eye resolves of Y, of Cx, and, as a sum of two, of Cz: weights, and squares of widths, degrees^2.
const SIGHT: [(f64, f64); BLURS] = [(1.0, 0.0047), (1.0, 0.0053), (34.1, 0.04), (13.5, 0.025)];
const BLURS: usize = 4;
/// Pixels that kernels reach on each side: three standard deviations of the widest.
const REACH: usize = 10;
const TAPS: usize = 2 * REACH + 1;
/// Planes of a row that is filtered along: the blurs, and Y by the kernels of features.
const PLANES: usize = BLURS + 3;
/// Linear RGB to XYZ, and what white comes to.
const XYZ_OF_RGB: [[f32; 3]; 3] = [
    [0.412_386_56, 0.357_591_5, 0.180_450_49],
    [0.212_636_82, 0.715_183, 0.072_180_2],
    [0.019_330_62, 0.119_197_16, 0.950_372_6],
];
const WHITE: [f32; 3] = [0.950_428_55, 1.0, 1.088_900_4];

/// A kernel along an axis.
type Taps = [f32; TAPS];

/// Bytes that [`flip`] takes beside two pictures that are `width` pixels wide.
pub fn flip_bytes(width: u32) -> u64 {
    let numbers = 2 * (TAPS * PLANES + 3 + PLANES + 2) + 1;
    u64::from(width) * (numbers * size_of::<f32>()) as u64
}

/// The mean difference of `a` and `b` as they are shown: times `exposure`, clamped to 0..1, in sRGB.
///
/// # Panics
/// When their sizes differ.
pub fn flip(a: &Picture, b: &Picture, exposure: f32) -> f64 {
    let mut sum = 0.0;
    flip_each(a, b, exposure, |difference| sum += f64::from(difference));
    sum / (f64::from(a.width) * f64::from(a.height))
}

/// The differences that [`flip`] is the mean of, pixel by pixel along rows.
///
/// # Panics
/// When the sizes differ.
pub fn flip_each(a: &Picture, b: &Picture, exposure: f32, mut tell: impl FnMut(f32)) {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let (kernels, scale) = (Kernels::new(), ColourScale::new());
    let [mut rows_a, mut rows_b] = [a, b].map(|of| FilteredRows::new(of, exposure, &kernels));
    for y in 0..a.height as usize {
        rows_a.see(y);
        rows_b.see(y);
        for x in 0..a.width as usize {
            let [a, b] = [&rows_a, &rows_b].map(|rows| rows.looks(x));
            tell(scale.difference(&a, &b));
        }
    }
}

/// The kernels along an axis.
struct Kernels {
    /// Of [`SIGHT`], with the weights that the products of two have.
    blurs: [Taps; BLURS],
    weights: [f32; BLURS],
    /// Of features: the mean, its first and its second derivative.
    features: [Taps; 3],
}

/// A pixel as it is compared.
struct PixelLooks {
    /// L*, and a* and b* times a hundredth of L*.
    lab: [f32; 3],
    /// How much of an edge, and of a point.
    edge: f32,
    point: f32,
}

/// A picture's rows, filtered along x, around the row at hand; and that row filtered along y.
struct FilteredRows<'a> {
    picture: &'a Picture,
    exposure: f32,
    kernels: &'a Kernels,
    /// Row y at y % TAPS: planes of one row after the other.
    ring: Vec<f32>,
    /// Rows in the ring.
    seen: Range<usize>,
    /// A row in Y Cx Cz.
    colours: [Vec<f32>; 3],
    /// The row at hand: blurs, then edges and points along x and along y.
    row: [Vec<f32>; BLURS + 4],
}

impl Kernels {
    fn new() -> Kernels {
        let taps = |value: &dyn Fn(f64) -> f64| -> [f64; TAPS] {
            std::array::from_fn(|at| value(at as f64 - REACH as f64))
        };
        let blurs = SIGHT.map(|(_, width)| taps(&|x| (-(PI * x / PIXELS_PER_DEGREE).powi(2) / width).exp()));
        let sums = blurs.map(|taps| taps.iter().sum::<f64>());
        // A kernel's sum over both axes, before it is made 1.
        let total = |of: Range<usize>| -> f64 {
            of.map(|k| SIGHT[k].0 * (PI / SIGHT[k].1).sqrt() * sums[k] * sums[k]).sum()
        };
        let weight = |k: usize, of: Range<usize>| SIGHT[k].0 * (PI / SIGHT[k].1).sqrt() / total(of);
        let weights = [weight(0, 0..1), weight(1, 1..2), weight(2, 2..4), weight(3, 2..4)];
        let sd = 0.5 * FEATURE_DEGREES * PIXELS_PER_DEGREE;
        let reach = (3.0 * sd).ceil();
        let within = |x: f64, value: f64| if x.abs() <= reach { value } else { 0.0 };
        let bell = |x: f64| within(x, (-0.5 * (x / sd).powi(2)).exp());
        let mean = taps(&bell);
        let mean = mean.map(|tap| tap / mean.iter().sum::<f64>());
        // Positive taps sum to 1, negative ones to -1.
        let even = |taps: [f64; TAPS]| {
            let sum = |sign: f64| taps.iter().map(|tap| (sign * tap).max(0.0)).sum::<f64>();
            taps.map(|tap| tap / if tap > 0.0 { sum(1.0) } else { sum(-1.0) })
        };
        let first = even(taps(&|x| -x * bell(x)));
        let second = even(taps(&|x| ((x / sd).powi(2) - 1.0) * bell(x)));
        let f32s = |taps: [f64; TAPS]| taps.map(|tap| tap as f32);
        Kernels {
            blurs: blurs.map(f32s),
            weights: weights.map(|weight| weight as f32),
            features: [mean, first, second].map(f32s),
        }
    }
}

/// The largest difference of colours, by which others are measured.
struct ColourScale {
    most: f32,
}

impl ColourScale {
    fn new() -> ColourScale {
        let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|rgb| hunt(lab(xyz(rgb))));
        ColourScale { most: apart(&green, &blue).powf(COLOUR_POWER) }
    }

    /// The difference of two pixels, 0 to 1.
    fn difference(&self, a: &PixelLooks, b: &PixelLooks) -> f32 {
        let colour = apart(&a.lab, &b.lab).powf(COLOUR_POWER);
        let from = SPREAD_FROM * self.most;
        let colour = if colour < from {
            colour * SPREAD_TO / from
        } else {
            SPREAD_TO + (colour - from) / (self.most - from) * (1.0 - SPREAD_TO)
        };
        let feature = (a.edge - b.edge).abs().max((a.point - b.point).abs());
        let feature = (feature * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_POWER).min(1.0);
        colour.powf(1.0 - feature)
    }
}

impl<'a> FilteredRows<'a> {
    fn new(picture: &'a Picture, exposure: f32, kernels: &'a Kernels) -> FilteredRows<'a> {
        let width = picture.width as usize;
        let row = || vec![0.0; width];
        FilteredRows {
            picture,
            exposure,
            kernels,
            ring: vec![0.0; TAPS * PLANES * width],
            seen: 0..0,
            colours: [row(), row(), row()],
            row: std::array::from_fn(|_| row()),
        }
    }

    /// Filters row `y`, the one after that of before.
    fn see(&mut self, y: usize) {
        let height = self.picture.height as usize;
        for near in self.seen.end..height.min(y + REACH + 1) {
            self.filter_along(near);
        }
        self.seen.end = height.min(y + REACH + 1);
        let (width, Kernels { blurs, features: [mean, first, second], .. }) =
            (self.picture.width as usize, self.kernels);
        // Which plane, by which kernel: the second factor of each product.
        let columns = [
            (0, &blurs[0]),
            (1, &blurs[1]),
            (2, &blurs[2]),
            (3, &blurs[3]),
            (BLURS + 1, mean),
            (BLURS, first),
            (BLURS + 2, mean),
            (BLURS, second),
        ];
        for ((plane, taps), out) in columns.into_iter().zip(&mut self.row) {
            out.fill(0.0);
            for (at, tap) in taps.iter().enumerate() {
                // What is beyond the picture is as at its edge.
                let near = (y + at).saturating_sub(REACH).min(height - 1);
                let row = &self.ring[(near % TAPS * PLANES + plane) * width..][..width];
                out.iter_mut().zip(row).for_each(|(sum, value)| *sum += tap * value);
            }
        }
    }

    /// Filters row `y` along x, into the ring.
    fn filter_along(&mut self, y: usize) {
        let (width, exposure) = (self.picture.width as usize, self.exposure);
        let pixels = &self.picture.pixels[y * width..][..width];
        let [luma, red_green, blue_yellow] = &mut self.colours;
        for (x, pixel) in pixels.iter().enumerate() {
            #[expect(clippy::manual_clamp, reason = "what is no number becomes 0")]
            let rgb = pixel.map(|value| (value * exposure).max(0.0).min(1.0));
            [luma[x], red_green[x], blue_yellow[x]] = opponents(xyz(rgb));
        }
        let Kernels { blurs, features, .. } = self.kernels;
        let sources = [0, 1, 2, 2, 0, 0, 0];
        let planes = &mut self.ring[y % TAPS * PLANES * width..][..PLANES * width];
        let kernels = blurs.iter().chain(features);
        for ((source, taps), out) in sources.into_iter().zip(kernels).zip(planes.chunks_exact_mut(width)) {
            filter_row(&self.colours[source], taps, out);
        }
    }

    /// Pixel `x` of the row at hand.
    fn looks(&self, x: usize) -> PixelLooks {
        let at = |plane: usize| self.row[plane][x];
        let weights = self.kernels.weights;
        let colour = [weights[0] * at(0), weights[1] * at(1), weights[2] * at(2) + weights[3] * at(3)];
        let rgb = rgb(xyz_of_opponents(colour)).map(|value| value.clamp(0.0, 1.0));
        // Y goes from -16 to 100, features from 0 to 1.
        let size = |x: f32, y: f32| x.hypot(y) / 116.0;
        let (edge, point) = (size(at(4), at(5)), size(at(6), at(7)));
        PixelLooks { lab: hunt(lab(xyz(rgb))), edge, point }
    }
}

/// `row` by `taps`, as at its edges beyond them.
fn filter_row(row: &[f32], taps: &Taps, out: &mut [f32]) {
    let width = row.len();
    out.fill(0.0);
    for (at, tap) in taps.iter().enumerate() {
        // Pixels whose neighbour, `at - REACH` off, is in the row.
        let first = REACH.saturating_sub(at).min(width);
        let end = (width + REACH).saturating_sub(at).min(width).max(first);
        out[..first].iter_mut().for_each(|sum| *sum += tap * row[0]);
        let inside = out[first..end].iter_mut();
        inside
            .zip(&row[(first + at).saturating_sub(REACH).min(width)..])
            .for_each(|(sum, value)| *sum += tap * value);
        out[end..].iter_mut().for_each(|sum| *sum += tap * row[width - 1]);
    }
}

/// XYZ over that of white.
fn xyz(rgb: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|row: usize| (0..3).map(|c| XYZ_OF_RGB[row][c] * rgb[c]).sum::<f32>() / WHITE[row])
}

/// Linear RGB of XYZ over that of white: the inverse of [`xyz`].
fn rgb(xyz: [f32; 3]) -> [f32; 3] {
    const RGB_OF_XYZ: [[f32; 3]; 3] = [
        [3.241_003_3, -1.537_399, -0.498_615_9],
        [-0.969_224_2, 1.875_93, 0.041_554_226],
        [0.055_639_42, -0.204_011_2, 1.057_149],
    ];
    let xyz: [f32; 3] = std::array::from_fn(|row| xyz[row] * WHITE[row]);
    RGB_OF_XYZ.map(|row| (0..3).map(|c| row[c] * xyz[c]).sum())
}

/// Y, Cx (red against green) and Cz (blue against yellow): L* a* b* without its cube root.
fn opponents([x, y, z]: [f32; 3]) -> [f32; 3] {
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// XYZ over that of white: the inverse of [`opponents`].
fn xyz_of_opponents([luma, red_green, blue_yellow]: [f32; 3]) -> [f32; 3] {
    let y = (luma + 16.0) / 116.0;
    [y + red_green / 500.0, y, y - blue_yellow / 200.0]
}

/// L* a* b* of XYZ over that of white.
fn lab(xyz: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let [x, y, z] = xyz.map(|value| match value > DELTA * DELTA * DELTA {
        true => value.cbrt(),
        false => value / (3.0 * DELTA * DELTA) + 4.0 / 29.0,
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Colours are told better where it is bright.
fn hunt([l, a, b]: [f32; 3]) -> [f32; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// HyAB: lightness by itself, colours by their distance.
fn apart(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [96, 64];

    /// A picture of codes in sRGB, each of a pixel's place and channel.
    fn picture([width, height]: [u32; 2], code: impl Fn(u32, u32, u32) -> u32) -> Picture {
        let linear = |code: u32| {
            let value = code as f32 / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        let pixel = |x, y| [0, 1, 2].map(|c| linear(code(x, y, c)));
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| pixel(x, y));
        Picture { width, height, pixels: pixels.collect() }
    }

    fn slope(x: u32, y: u32, c: u32) -> u32 {
        (2 * x + y + 10 * c) * 3 / 4
    }

    fn noise(x: u32, y: u32, c: u32) -> u32 {
        let value =
            x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ (c + 1).wrapping_mul(83_492_791);
        value.wrapping_mul(2_654_435_761) >> 24
    }

    /// The means that `flip_evaluator.evaluate(a, b, "LDR")` of version 1.7 gives for the same codes over 255, in f32.
    #[test]
    fn means_are_those_of_flip_evaluator() {
        let checks = |x: u32, y: u32| (x / 8 + y / 8).is_multiple_of(2);
        let either = |is: bool, hue: [u32; 3], c: u32| if is { hue[c as usize] } else { 128 };
        let edge = |at: u32| move |x: u32, _: u32, _: u32| if x < at { 230 } else { 20 };
        for (a, b, expected) in [
            (
                picture(SIZE, slope),
                picture(SIZE, |x, y, c| slope(x, y, c) + noise(x, y, c) / 8),
                0.258_630_216,
            ),
            (picture(SIZE, edge(48)), picture(SIZE, edge(50)), 0.049_885_217),
            (
                picture(SIZE, |x, y, c| either(checks(x, y), [200, 60, 40], c)),
                picture(SIZE, |x, y, c| either(checks(x, y), [60, 90, 200], c)),
                0.596_208_155,
            ),
        ] {
            let found = flip(&a, &b, 1.0);
            assert!((found - expected).abs() < 1e-3, "{found} {expected}");
            assert!((flip(&b, &a, 1.0) - found).abs() < 1e-6, "both ways alike");
        }
    }

    #[test]
    fn a_picture_is_not_different_from_itself_and_black_is_from_white() {
        for size in [[1, 1], [3, 40], [40, 3], [12, 12]] {
            let a = picture(size, |x, y, c| noise(x, y, c) % 256);
            assert_eq!(flip(&a, &a, 1.0), 0.0, "{size:?}");
            let [black, white] = [0, 255].map(|code| picture(size, |_, _, _| code));
            let found = flip(&black, &white, 1.0);
            assert!((0.96..1.0).contains(&found), "{size:?}: {found}");
        }
    }

    /// What is shown is compared: beyond white there is nothing, and what is no number is black.
    #[test]
    fn pictures_are_compared_as_they_are_shown() {
        let plain = |value: f32| Picture { width: 8, height: 8, pixels: vec![[value; 3]; 64] };
        assert_eq!(flip(&plain(3.0), &plain(7.0), 1.0), 0.0);
        assert_eq!(flip(&plain(f32::NAN), &plain(-1.0), 1.0), 0.0);
        assert!(flip(&plain(3.0), &plain(7.0), 0.1) > 0.2);
    }
}
