//! Itti, Koch and Niebur 1998: what differs from its surround in intensity, colour or orientation, and is alone in it.
//!
//! ```text
//! intensity, red/green, blue/yellow, Gabor energy at 4 angles
//!     -> pyramid -> |centre - surround|, 6 pairs of scales -> N -> sum over scales
//! N(intensity) + N(colour pairs) + N(N(angle) summed over angles), over 3
//! ```
//!
//! Scales are those of the paper, from the whole picture: a sample of the reduced picture is scale 2, a tile scale 3.
//! Where the paper leaves open or this differs:
//!
//! - Sums are made at the scale of a tile, not at 4, since it is tiles that are asked for.
//! - The first scale is a mean of 4 x 4 pixels of linear light, each at most 1, not two steps of a pyramid; hues are of
//!   these means.
//! - A colour pair's surround is subtracted, as the text says; the formula as printed, |(R - G)(c) - (G - R)(s)|, adds
//!   it.
//! - The Gabor filters have a period of four samples under a binomial of seven. The response is the modulus of the even
//!   and the odd one; the even one has its mean taken out, so that light without a pattern has no orientation.
//! - Maxima of less than a tenth of the greatest do not count in N, as in the authors' program.

use super::plane::Plane;
use super::reduced::{ReducedPicture, SAMPLE_PIXELS, SAMPLES_PER_SIDE};
use std::f32::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

/// The scale of a sample of the reduced picture, and of a tile.
const FIRST_SCALE: usize = SAMPLE_PIXELS.ilog2() as usize;
const TILE_SCALE: usize = FIRST_SCALE + SAMPLES_PER_SIDE.ilog2() as usize;
/// Scales of the centre, and how much coarser the surround is.
const CENTRES: [usize; 3] = [2, 3, 4];
const SURROUNDS: [usize; 2] = [3, 4];
const SCALES: usize = CENTRES[2] + SURROUNDS[1] + 1 - FIRST_SCALE;
/// Intensity below which a colour has no hue, as a share of the greatest.
const HUE_SHARE: f32 = 0.1;
/// The envelope of the Gabor filters along an axis; their wave, radians a sample.
const ENVELOPE: [f32; 7] =
    [1.0 / 64.0, 6.0 / 64.0, 15.0 / 64.0, 20.0 / 64.0, 15.0 / 64.0, 6.0 / 64.0, 1.0 / 64.0];
const WAVE: f32 = FRAC_PI_2;

const _: () = assert!(FIRST_SCALE == CENTRES[0] && TILE_SCALE == CENTRES[1]);

/// Saliency of each tile.
pub(super) fn map(picture: &ReducedPicture) -> Plane {
    // One after the other: of what is as large as the picture, little is there at a time.
    let [red_green, blue_yellow] = [RED_GREEN, BLUE_YELLOW].map(|pair| {
        let scales = pyramid(colour_pair(picture, pair));
        conspicuity(&scales)
    });
    let colour = red_green.plus(&blue_yellow);
    let scales = pyramid(picture.plane(intensity));
    let intensity = conspicuity(&scales);
    let mut angles: [Vec<Plane>; 4] = Default::default();
    for scale in &scales {
        for (angle, response) in angles.iter_mut().zip(oriented(scale)) {
            angle.push(response);
        }
    }
    drop(scales);
    let orientation = angles
        .into_iter()
        .map(|scales| conspicuity(&scales).promoted())
        .reduce(|sum, angle| sum.plus(&angle))
        .expect("there are four");
    let mut map = intensity.promoted().plus(&colour.promoted()).plus(&orientation.promoted());
    map.values.iter_mut().for_each(|value| *value /= 3.0);
    map
}

fn intensity([r, g, b]: [f32; 3]) -> f32 {
    (r + g + b) / 3.0
}

/// One colour against another, of a hue.
type ColourPair = fn([f32; 3]) -> f32;

const RED_GREEN: ColourPair = |[r, g, b]| (r - 0.5 * (g + b)).max(0.0) - (g - 0.5 * (r + b)).max(0.0);
const BLUE_YELLOW: ColourPair =
    |[r, g, b]| (b - 0.5 * (r + g)).max(0.0) - (0.5 * (r + g) - 0.5 * (r - g).abs() - b).max(0.0);

/// A colour pair of the hue of each sample.
fn colour_pair(picture: &ReducedPicture, pair: ColourPair) -> Plane {
    let greatest = picture.rgb.iter().map(|&rgb| intensity(rgb)).fold(0.0, f32::max);
    picture.plane(|rgb| {
        let i = intensity(rgb);
        pair(if i > HUE_SHARE * greatest { rgb.map(|value| value / i) } else { [0.0; 3] })
    })
}

/// All scales of a plane, from that of a sample on.
fn pyramid(plane: Plane) -> Vec<Plane> {
    let mut scales = vec![plane];
    while scales.len() < SCALES {
        scales.push(scales[scales.len() - 1].halved());
    }
    scales
}

/// The sum of N(|centre - surround|) over the pairs of scales, by tile.
fn conspicuity(scales: &[Plane]) -> Plane {
    let at = |centre: usize| {
        let pair = |s: usize| {
            let surround = &scales[centre + s - FIRST_SCALE];
            scales[centre - FIRST_SCALE].minus(surround, s as u32).promoted()
        };
        pair(SURROUNDS[0]).plus(&pair(SURROUNDS[1]))
    };
    let [fine, tile, coarse] = CENTRES.map(at);
    let coarse = coarse.enlarged(1, tile.size);
    fine.means(SAMPLES_PER_SIDE).plus(&tile).plus(&coarse)
}

/// Gabor energy at 0, 45, 90 and 135 degrees: the way that the picture changes along, from rightward to downward.
pub(super) fn oriented(plane: &Plane) -> [Plane; 4] {
    let taps = |wave: fn(f32) -> f32, per_sample: f32| -> [f32; 7] {
        std::array::from_fn(|i| ENVELOPE[i] * wave((i as f32 - 3.0) * per_sample))
    };
    let (even, odd) = (taps(f32::cos, WAVE), taps(f32::sin, WAVE));
    let (part_even, part_odd) = (taps(f32::cos, WAVE * FRAC_1_SQRT_2), taps(f32::sin, WAVE * FRAC_1_SQRT_2));
    let mean: f32 = even.iter().sum();
    let even: [f32; 7] = std::array::from_fn(|i| even[i] - mean * ENVELOPE[i]);
    let energy = |even: f32, odd: f32| (even * even + odd * odd).sqrt();
    let of_axis = |even: Plane, odd: Plane| even.with(&odd, energy);
    let rightward = of_axis(plane.across(&even).down(&ENVELOPE), plane.across(&odd).down(&ENVELOPE));
    let smooth = plane.across(&ENVELOPE);
    let downward = of_axis(smooth.down(&even), smooth.down(&odd));
    // A wave along a diagonal is a product of waves along the axes: e^i(x + y) = e^ix e^iy.
    let part_mean = part_even.iter().sum::<f32>().powi(2);
    let flat = smooth.down(&ENVELOPE);
    drop(smooth);
    let (across_even, across_odd) = (plane.across(&part_even), plane.across(&part_odd));
    let mut even_even = across_even.down(&part_even).with(&flat, |value, flat| value - part_mean * flat);
    drop(flat);
    let mut odd_odd = across_odd.down(&part_odd);
    let even_odd = across_even.down(&part_odd);
    drop(across_even);
    let odd_even = across_odd.down(&part_even);
    let mixed = even_odd.values.iter().zip(&odd_even.values);
    for ((ee, oo), (eo, oe)) in even_even.values.iter_mut().zip(&mut odd_odd.values).zip(mixed) {
        (*ee, *oo) = (energy(*ee - *oo, eo + oe), energy(*ee + *oo, eo - oe));
    }
    let (rising, falling) = (odd_odd, even_even);
    [rightward, falling, downward, rising]
}
