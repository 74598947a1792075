//! What catches the eye in a picture: a number per tile. Paper, section 5.2.
//!
//! ```text
//! picture -> 2x2 samples a tile -> Achanta: distance in Lab between the mean colour and the blurred picture
//!                               -> Itti: centre minus surround of intensity, colour pairs and orientation, over scales
//!         -> mean per tile
//! ```
//!
//! R. Achanta, S. Hemami, F. Estrada, S. Suesstrunk, "Frequency-tuned salient region detection" (2009); L. Itti, C.
//! Koch, E. Niebur, "A model of saliency-based visual attention for rapid scene analysis" (1998). Itti's scales begin
//! at a quarter of the picture's size, which is what two samples a tile are.
//!
//! Invariant: a picture of one colour has one saliency everywhere.

/// Samples of a tile along a side.
pub(crate) const SAMPLES_PER_SIDE: u32 = 2;
/// The blur of both metrics, along an axis.
const BINOMIAL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
/// Itti: scales of the centre, and how much coarser the surround is.
const CENTRES: std::ops::Range<usize> = 0..3;
const SURROUNDS: [usize; 2] = [3, 4];
/// D65, the white of sRGB.
const WHITE: [f32; 3] = [0.950_47, 1.0, 1.088_83];
/// Intensity below which a colour has no hue, as a share of the greatest.
const HUE_SHARE: f32 = 0.1;

/// A measure of saliency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Saliency {
    /// Achanta et al. 2009.
    #[default]
    Achanta,
    /// Itti et al. 1998.
    Itti,
}

/// A picture at two samples a tile along each side.
#[derive(Clone, Debug)]
pub(crate) struct Reduced {
    /// Width and height, samples.
    size: [usize; 2],
    rgb: Vec<[f32; 3]>,
}

/// One channel of a picture.
#[derive(Clone, Debug)]
struct Plane {
    size: [usize; 2],
    values: Vec<f32>,
}

impl Reduced {
    /// The reduction of a picture of `tiles` (columns, rows), linear RGB by sample (x, y).
    pub(crate) fn new(tiles: [u32; 2], mut radiance: impl FnMut([u32; 2]) -> [f32; 3]) -> Reduced {
        let [width, height] = tiles.map(|side| side * SAMPLES_PER_SIDE);
        let places = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        let rgb = places.map(|place| radiance(place).map(|value| value.clamp(0.0, 1.0))).collect();
        Reduced { size: [width as usize, height as usize], rgb }
    }

    fn plane(&self, value: impl Fn([f32; 3]) -> f32) -> Plane {
        Plane { size: self.size, values: self.rgb.iter().map(|&rgb| value(rgb)).collect() }
    }
}

impl Saliency {
    /// Saliency of each tile, in rows.
    pub(crate) fn tiles(self, picture: &Reduced) -> Vec<f32> {
        let map = match self {
            Saliency::Achanta => achanta(picture),
            Saliency::Itti => itti(picture),
        };
        let side = SAMPLES_PER_SIDE as usize;
        let [columns, rows] = map.size.map(|samples| samples / side);
        let tile = |column: usize, row: usize| -> f32 {
            let places = (0..side * side).map(|i| (column * side + i % side, row * side + i / side));
            places.map(|(x, y)| map.values[y * map.size[0] + x]).sum::<f32>() / (side * side) as f32
        };
        (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (column, row)))
            .map(|(c, r)| tile(c, r))
            .collect()
    }
}

fn achanta(picture: &Reduced) -> Plane {
    let lab: Vec<[f32; 3]> = picture.rgb.iter().map(|&rgb| to_lab(rgb)).collect();
    let mut map = Plane { size: picture.size, values: vec![0.0; lab.len()] };
    for c in 0..3 {
        let channel = Plane { size: picture.size, values: lab.iter().map(|lab| lab[c]).collect() };
        let mean = channel.values.iter().sum::<f32>() / lab.len() as f32;
        for (sum, blurred) in map.values.iter_mut().zip(channel.blurred().values) {
            *sum += (blurred - mean) * (blurred - mean);
        }
    }
    map.values.iter_mut().for_each(|value| *value = value.sqrt());
    map
}

fn itti(picture: &Reduced) -> Plane {
    let intensity = |[r, g, b]: [f32; 3]| (r + g + b) / 3.0;
    let greatest = picture.rgb.iter().map(|&rgb| intensity(rgb)).fold(0.0, f32::max);
    let hue = move |rgb: [f32; 3]| {
        let i = intensity(rgb);
        if i > HUE_SHARE * greatest { rgb.map(|value| value / i) } else { [0.0; 3] }
    };
    let intensities = picture.plane(intensity);
    let pair = |first: fn([f32; 3]) -> f32| picture.plane(|rgb| first(hue(rgb)));
    let features: [Vec<Plane>; 3] = [
        vec![intensities.clone()],
        vec![
            // Red against green, blue against yellow.
            pair(|[r, g, b]| (r - 0.5 * (g + b)).max(0.0) - (g - 0.5 * (r + b)).max(0.0)),
            pair(|[r, g, b]| {
                (b - 0.5 * (r + g)).max(0.0) - (0.5 * (r + g) - 0.5 * (r - g).abs() - b).max(0.0)
            }),
        ],
        (0..4).map(|step| intensities.along_angle(step as f32 * std::f32::consts::FRAC_PI_4)).collect(),
    ];
    let mut map = Plane { size: picture.size, values: vec![0.0; picture.rgb.len()] };
    for planes in features {
        let mut sum = Plane { size: picture.size, values: vec![0.0; picture.rgb.len()] };
        for plane in planes {
            let scales = plane.pyramid(CENTRES.end + SURROUNDS[1]);
            for (centre, surround) in CENTRES.flat_map(|c| SURROUNDS.map(|s| (c, c + s))) {
                if let (Some(centre), Some(surround)) = (scales.get(centre), scales.get(surround)) {
                    sum.add(&centre.minus(surround).promoted());
                }
            }
        }
        map.add(&sum.promoted());
    }
    map
}

impl Plane {
    fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y.min(self.size[1] - 1) * self.size[0] + x.min(self.size[0] - 1)]
    }

    /// Blurred by a binomial of five along each axis; the border repeats.
    fn blurred(&self) -> Plane {
        let [width, height] = self.size;
        let mut across = Vec::with_capacity(self.values.len());
        let mut wider = Vec::with_capacity(width + 4);
        for row in self.values.chunks_exact(width) {
            wider.clear();
            wider.extend([row[0]; 2]);
            wider.extend_from_slice(row);
            wider.extend([row[width - 1]; 2]);
            across.extend(wider.windows(5).map(|taps| blur([taps[0], taps[1], taps[2], taps[3], taps[4]])));
        }
        let mut values = Vec::with_capacity(across.len());
        for y in 0..height {
            let row = |i: usize| &across[(y + i).saturating_sub(2).min(height - 1) * width..][..width];
            let rows: [&[f32]; 5] = std::array::from_fn(row);
            values.extend((0..width).map(|x| blur(rows.map(|row| row[x]))));
        }
        Plane { size: self.size, values }
    }

    /// Slope along an angle, without its sign.
    fn along_angle(&self, angle: f32) -> Plane {
        let [width, height] = self.size;
        let slope = |x: usize, y: usize| {
            let across = self.at(x + 1, y) - self.at(x.saturating_sub(1), y);
            let down = self.at(x, y + 1) - self.at(x, y.saturating_sub(1));
            (angle.cos() * across + angle.sin() * down).abs()
        };
        let values = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| slope(x, y));
        Plane { size: self.size, values: values.collect() }
    }

    /// The plane and up to `levels` more, each half the size of the one before, as long as there are two samples.
    fn pyramid(&self, levels: usize) -> Vec<Plane> {
        let mut scales = vec![self.clone()];
        for _ in 0..levels {
            let last = scales.last().expect("begins with one");
            if last.size.iter().any(|&side| side < 2) {
                break;
            }
            let (blurred, [width, height]) = (last.blurred(), last.size.map(|side| side / 2));
            let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            let values = places.map(|(x, y)| blurred.at(2 * x, 2 * y)).collect();
            scales.push(Plane { size: [width, height], values });
        }
        scales
    }

    /// Difference to a coarser plane, without its sign.
    fn minus(&self, coarser: &Plane) -> Plane {
        let [width, height] = self.size;
        let other =
            |x: usize, y: usize| coarser.at(x * coarser.size[0] / width, y * coarser.size[1] / height);
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let values = places.map(|(x, y)| (self.at(x, y) - other(x, y)).abs()).collect();
        Plane { size: self.size, values }
    }

    /// Itti's N: scaled to at most 1, then weighted by how much its peak stands out of the mean.
    fn promoted(mut self) -> Plane {
        let peak = self.values.iter().copied().fold(0.0, f32::max);
        if peak > 0.0 {
            let mean = self.values.iter().sum::<f32>() / (peak * self.values.len() as f32);
            let weight = (1.0 - mean) * (1.0 - mean) / peak;
            self.values.iter_mut().for_each(|value| *value *= weight);
        }
        self
    }

    /// Adds a plane of any size.
    fn add(&mut self, other: &Plane) {
        let [width, height] = self.size;
        for y in 0..height {
            for x in 0..width {
                let value = other.at(x * other.size[0] / width, y * other.size[1] / height);
                self.values[y * width + x] += value;
            }
        }
    }
}

fn blur(taps: [f32; 5]) -> f32 {
    taps.iter().zip(BINOMIAL).map(|(tap, weight)| weight * tap).sum()
}

/// CIE Lab of linear sRGB.
fn to_lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let xyz = [
        0.412_46 * r + 0.357_58 * g + 0.180_44 * b,
        0.212_67 * r + 0.715_15 * g + 0.072_18 * b,
        0.019_33 * r + 0.119_19 * g + 0.950_30 * b,
    ];
    let [x, y, z] = std::array::from_fn(|a| {
        let t = xyz[a] / WHITE[a];
        if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey picture of 16 x 16 tiles with one tile of another colour at (5, 9).
    fn picture(odd: [f32; 3]) -> Reduced {
        Reduced::new([16, 16], |[x, y]| if [x / 2, y / 2] == [5, 9] { odd } else { [0.3; 3] })
    }

    #[test]
    fn the_odd_one_out_is_found() {
        for metric in [Saliency::Achanta, Saliency::Itti] {
            for odd in [[0.9, 0.1, 0.1], [1.0; 3], [0.0; 3], [0.3, 0.3, 0.6]] {
                let scores = metric.tiles(&picture(odd));
                let best = (0..256).max_by(|&a, &b| scores[a].total_cmp(&scores[b])).unwrap();
                assert_eq!([best % 16, best / 16], [5, 9], "{metric:?} {odd:?}");
            }
        }
    }

    #[test]
    fn one_colour_has_one_saliency() {
        for metric in [Saliency::Achanta, Saliency::Itti] {
            let scores = metric.tiles(&picture([0.3; 3]));
            assert!(scores.iter().all(|score| (score - scores[0]).abs() < 1e-4), "{metric:?}");
        }
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
}
