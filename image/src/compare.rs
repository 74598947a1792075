//! How far a picture is from its reference: RMSE, relMSE, PSNR, the largest error and where, the means.
//!
//! ```text
//! e = a - b, b the reference; over N compared pixels of a channel, and over the 3 N values of all:
//! RMSE = sqrt(mean e^2)   relMSE = mean e^2 / (b^2 + eps)   PSNR = 10 log10(peak^2 / mean e^2) dB
//! ```
//!
//! relMSE as in Rousselle, Knaus, Zwicker, "Adaptive Sampling and Reconstruction using Greedy Error Minimization",
//! 2011, per channel.
//!
//! Invariants: 1. a pixel with a value that is not finite in either picture counts as such and adds to nothing
//! else; 2. sums are in f64, row by row, in one order: the same pictures give the same figures.

use super::head::Picture;
use serde::Serialize;

/// The constant under relMSE that keeps black pixels from ruling it, squared radiance; the field's usual one.
pub const DEFAULT_EPSILON: f64 = 0.01;
/// What PSNR takes as full signal, radiance: the white of a PNG.
pub const DEFAULT_PEAK: f64 = 1.0;

/// The constants of the figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants {
    /// eps of relMSE, above zero.
    pub epsilon: f64,
    /// Peak of PSNR, above zero.
    pub peak: f64,
}

impl Default for Constants {
    fn default() -> Constants {
        Constants { epsilon: DEFAULT_EPSILON, peak: DEFAULT_PEAK }
    }
}

/// Figures of one channel, or of all together. `None` where nothing could be compared; PSNR also without an error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Root of the mean squared error, radiance.
    pub rmse: Option<f64>,
    /// Mean of squared errors over squared references.
    pub relmse: Option<f64>,
    /// Peak signal to noise ratio, dB; `None` for an infinite one.
    pub psnr_db: Option<f64>,
    /// Largest absolute error, radiance.
    pub max_error: Option<f64>,
    /// The first pixel with it (x, y; from the top left), if it is above zero.
    pub max_error_pixel: Option<[u32; 2]>,
    /// Mean of the picture, radiance.
    pub mean_a: Option<f64>,
    /// Mean of the reference, radiance.
    pub mean_b: Option<f64>,
}

/// Pixels of which a value is not finite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct NonFinite {
    /// In the picture.
    pub a: u64,
    /// In the reference.
    pub b: u64,
}

/// What the comparison of two pictures gives.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Pixels of either.
    pub pixel_count: u64,
    /// Those that are finite in both.
    pub compared_pixel_count: u64,
    /// Those that are not.
    pub non_finite_pixel_count: NonFinite,
    /// Whether all values are the same; NaN is the same as NaN here.
    #[serde(skip)]
    pub is_equal: bool,
    /// All channels together.
    pub all: Figures,
    /// Red, green, blue.
    #[serde(serialize_with = "by_name")]
    pub channels: [Figures; 3],
}

/// Compares `a` with the reference `b`.
///
/// # Panics
/// When their sizes differ.
pub fn compare(a: &Picture, b: &Picture, constants: Constants) -> Comparison {
    assert_eq!((a.width, a.height), (b.width, b.height), "pictures of one size");
    let mut sums = [Sums::default(); 3];
    let mut non_finite = NonFinite::default();
    let (mut is_equal, mut compared) = (true, 0u64);
    let width = a.width as usize;
    for (y, (row_a, row_b)) in a.pixels.chunks_exact(width).zip(b.pixels.chunks_exact(width)).enumerate() {
        let mut row = [Sums::default(); 3];
        for (x, (a, b)) in row_a.iter().zip(row_b).enumerate() {
            let [finite_a, finite_b] = [a, b].map(|pixel| pixel.iter().all(|value| value.is_finite()));
            non_finite.a += u64::from(!finite_a);
            non_finite.b += u64::from(!finite_b);
            is_equal &= a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()));
            if finite_a && finite_b {
                compared += 1;
                let pixel = [x as u32, y as u32];
                row.iter_mut().zip(a.iter().zip(b)).for_each(|(sums, (&a, &b))| {
                    sums.add(f64::from(a), f64::from(b), pixel, constants.epsilon);
                });
            }
        }
        sums.iter_mut().zip(&row).for_each(|(sums, row)| sums.merge(row));
    }
    let mut all = Sums::default();
    sums.iter().for_each(|sums| all.merge(sums));
    Comparison {
        pixel_count: a.pixels.len() as u64,
        compared_pixel_count: compared,
        non_finite_pixel_count: non_finite,
        is_equal,
        all: all.figures(compared * 3, constants.peak),
        channels: sums.map(|sums| sums.figures(compared, constants.peak)),
    }
}

/// What is summed up of a channel.
#[derive(Clone, Copy, Default)]
struct Sums {
    squares: f64,
    relative: f64,
    a: f64,
    b: f64,
    largest: f64,
    largest_at: Option<[u32; 2]>,
}

impl Sums {
    fn add(&mut self, a: f64, b: f64, pixel: [u32; 2], epsilon: f64) {
        let error = a - b;
        self.squares += error * error;
        self.relative += error * error / (b * b + epsilon);
        self.a += a;
        self.b += b;
        if error.abs() > self.largest {
            (self.largest, self.largest_at) = (error.abs(), Some(pixel));
        }
    }

    fn merge(&mut self, other: &Sums) {
        self.squares += other.squares;
        self.relative += other.relative;
        self.a += other.a;
        self.b += other.b;
        if other.largest > self.largest {
            (self.largest, self.largest_at) = (other.largest, other.largest_at);
        }
    }

    fn figures(&self, value_count: u64, peak: f64) -> Figures {
        if value_count == 0 {
            return Figures::default();
        }
        let mean = |sum: f64| sum / value_count as f64;
        let mse = mean(self.squares);
        Figures {
            rmse: Some(mse.sqrt()),
            relmse: Some(mean(self.relative)),
            psnr_db: (mse > 0.0).then(|| 10.0 * (peak * peak / mse).log10()),
            max_error: Some(self.largest),
            max_error_pixel: self.largest_at,
            mean_a: Some(mean(self.a)),
            mean_b: Some(mean(self.b)),
        }
    }
}

fn by_name<S: serde::Serializer>(channels: &[Figures; 3], to: S) -> Result<S::Ok, S::Error> {
    to.collect_map(["r", "g", "b"].into_iter().zip(channels))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, pixels: &[[f32; 3]]) -> Picture {
        Picture { width, height: pixels.len() as u32 / width, pixels: pixels.to_vec() }
    }

    fn close(found: Option<f64>, expected: f64) {
        assert!(
            found.is_some_and(|found| (found - expected).abs() <= 1e-12 * expected.abs()),
            "{found:?} {expected}"
        );
    }

    #[test]
    fn figures_are_those_worked_out_by_hand() {
        // Errors: red 0.5 and -1, green 0 and 0, blue 0 and 2.
        let a = picture(2, &[[1.0, 0.0, 3.0], [0.0, 0.25, 4.0]]);
        let b = picture(2, &[[0.5, 0.0, 3.0], [1.0, 0.25, 2.0]]);
        let found = compare(&a, &b, Constants { epsilon: 0.25, peak: 2.0 });
        let [red, green, blue] = found.channels;
        close(red.rmse, (1.25f64 / 2.0).sqrt());
        close(red.relmse, (0.25 / 0.5 + 1.0 / 1.25) / 2.0);
        close(red.psnr_db, 10.0 * (4.0f64 / 0.625).log10());
        assert_eq!((red.max_error, red.max_error_pixel), (Some(1.0), Some([1, 0])));
        assert_eq!((red.mean_a, red.mean_b), (Some(0.5), Some(0.75)));
        assert_eq!((green.rmse, green.relmse, green.psnr_db), (Some(0.0), Some(0.0), None));
        assert_eq!((green.max_error, green.max_error_pixel), (Some(0.0), None));
        close(blue.rmse, 2f64.sqrt());
        close(blue.relmse, 4.0 / 4.25 / 2.0);
        close(found.all.rmse, (5.25f64 / 6.0).sqrt());
        close(found.all.relmse, (1.3 + 4.0 / 4.25) / 6.0);
        close(found.all.psnr_db, 10.0 * (4.0f64 / 0.875).log10());
        assert_eq!((found.all.max_error, found.all.max_error_pixel), (Some(2.0), Some([1, 0])));
        close(found.all.mean_a, 8.25 / 6.0);
        close(found.all.mean_b, 6.75 / 6.0);
        assert!(!found.is_equal);
    }

    #[test]
    fn equal_pictures_have_no_error_and_no_psnr() {
        let a = picture(1, &[[0.1, 7.0, -0.5], [f32::NAN, 0.0, f32::INFINITY]]);
        let found = compare(&a, &a, Constants::default());
        assert!(found.is_equal);
        assert_eq!((found.all.rmse, found.all.psnr_db), (Some(0.0), None));
        let b = picture(1, &[[0.1, 7.0, -0.5], [f32::NAN, 0.0, f32::NEG_INFINITY]]);
        assert!(!compare(&a, &b, Constants::default()).is_equal);
    }

    #[test]
    fn what_is_not_finite_is_counted_and_left_out() {
        let nan = f32::NAN;
        let a = picture(4, &[[1.0; 3], [nan, 1.0, 1.0], [f32::INFINITY; 3], [0.0; 3]]);
        let b = picture(4, &[[0.5; 3], [9.0; 3], [nan; 3], [0.0; 3]]);
        let found = compare(&a, &b, Constants::default());
        assert_eq!((found.pixel_count, found.compared_pixel_count), (4, 2));
        assert_eq!(found.non_finite_pixel_count, NonFinite { a: 2, b: 1 });
        close(found.all.rmse, 0.125f64.sqrt());
        assert_eq!((found.all.mean_a, found.all.mean_b), (Some(0.5), Some(0.25)));
        let nothing = compare(&picture(1, &[[nan; 3]]), &picture(1, &[[0.0; 3]]), Constants::default());
        assert_eq!((nothing.compared_pixel_count, nothing.all), (0, Figures::default()));
    }

    /// Large values after small ones, and many: in f32 the error would vanish.
    #[test]
    fn sums_do_not_lose_small_errors() {
        let pixels = 1 << 20;
        let a = picture(1024, &vec![[1000.001; 3]; pixels]);
        let b = picture(1024, &vec![[1000.0; 3]; pixels]);
        let error = f64::from(1000.001f32) - 1000.0;
        let found = compare(&a, &b, Constants::default());
        assert!((found.all.rmse.unwrap() / error - 1.0).abs() < 1e-12);
    }

    /// Known noise has a known error: uniform in [-w, w] has the standard deviation w / sqrt(3).
    #[test]
    fn noise_has_the_error_that_it_was_given() {
        let mut state = 1u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        };
        let b = picture(512, &vec![[2.0; 3]; 512 * 512]);
        let noisy: Vec<_> = (0..512 * 512).map(|_| [0; 3].map(|_| 2.0 + 0.25 * noise())).collect();
        let found = compare(&picture(512, &noisy), &b, Constants { epsilon: 0.01, peak: 2.0 });
        let variance = 0.25f64 * 0.25 / 3.0;
        assert!((found.all.rmse.unwrap() / variance.sqrt() - 1.0).abs() < 0.005, "{found:?}");
        assert!((found.all.relmse.unwrap() / (variance / 4.01) - 1.0).abs() < 0.01, "{found:?}");
        assert!((found.all.psnr_db.unwrap() - 10.0 * (4.0 / variance).log10()).abs() < 0.05, "{found:?}");
    }
}
