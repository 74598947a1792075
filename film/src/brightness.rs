//! `Brightness`: how bright the surfaces of a picture are, without its background: the exposure by which they are
//! shown, and how much stays dark.
//!
//! ```text
//! luminances of surfaces -> white: one of the brightest       -> lit: a 64th of it or more, dark: below
//!                        -> nine tenths of the lit are below -> exposure: that becomes a light grey
//! ```
//!
//! A percentile does not follow a lamp that is in the picture, nor a patch below it, and the background has no say: a
//! bright sky made the surface in front of it dark. What is dark has no say either: a room is not burnt out for the
//! corners that no lamp reaches.
//!
//! Invariant: a permutation of the pixels changes nothing, and a factor on all light divides the exposure.

use crate::film::Film;
use crate::packed::luminance;

/// Share of the surfaces that lies below their white.
const WHITE_SHARE: f64 = 0.95;
/// What is this much darker than the white is dark: six stops.
const DARK_RATIO: f32 = 64.0;
/// Share of the lit surfaces that is shown darker than [`LIGHT_GREY`].
const LIGHT_SHARE: f64 = 0.9;
/// What surfaces at that share are shown as, linear: some of the range is left to what is brighter. The sun and the sky
/// of models without lights come to an exposure of about 1.
const LIGHT_GREY: f32 = 0.6;

/// The brightness of the surfaces in a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Brightness {
    /// Luminances of the lit surfaces, the darkest first.
    lit: Vec<f32>,
    /// Pixels that show a surface, and of them.
    surface_count: usize,
    pixel_count: usize,
}

impl Brightness {
    /// The brightness of pixels: the radiance of those that show a surface, `None` for the others.
    pub fn new(pixels: impl Iterator<Item = Option<[f32; 3]>>) -> Brightness {
        let (mut luminances, mut pixel_count) = (vec![], 0);
        for surface in pixels {
            pixel_count += 1;
            luminances.extend(surface.map(|rgb| luminance(rgb.into())));
        }
        luminances.sort_unstable_by(f32::total_cmp);
        let surface_count = luminances.len();
        let white = luminances.get((WHITE_SHARE * surface_count as f64) as usize).copied().unwrap_or(0.0);
        // Where less than the rest is lit, that is.
        let white = if white > 0.0 { white } else { luminances.last().copied().unwrap_or(0.0) };
        luminances.retain(|&luminance| luminance > 0.0 && luminance >= white / DARK_RATIO);
        Brightness { lit: luminances, surface_count, pixel_count }
    }

    /// That of a film.
    ///
    /// # Panics
    /// When the film keeps no depth.
    pub fn of_film(film: &Film) -> Brightness {
        let [width, height] = film.resolution();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        Brightness::new(pixels.map(|pixel| film.depth(pixel).is_finite().then(|| film.radiance(pixel))))
    }

    /// The factor by which the lit surfaces are shown well, of three digits; `None` where nothing is lit.
    pub fn exposure(&self) -> Option<f32> {
        let bright = *self.lit.get((LIGHT_SHARE * self.lit.len() as f64) as usize)?;
        let rounded = format!("{:.2e}", LIGHT_GREY / bright).parse::<f32>().ok()?;
        (rounded.is_finite() && rounded > 0.0).then_some(rounded)
    }

    /// Share of the picture that stays dark where its background is black: that, and surfaces that are not lit. 0 of a
    /// picture without pixels.
    pub fn dark_share(&self) -> f64 {
        (self.pixel_count - self.lit.len()) as f64 / self.pixel_count.max(1) as f64
    }

    /// Share of the pixels that show a surface.
    pub fn surface_share(&self) -> f64 {
        self.surface_count as f64 / self.pixel_count.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Brightness {
        Brightness::new(values.iter().map(|&value| (value >= 0.0).then_some([value; 3])))
    }

    /// A sky of 0.8 behind a surface of 0.2 burnt the surface, or left it dark, by how much of the picture it took.
    #[test]
    fn the_background_has_no_say() {
        let few = grey(&[0.2, 0.2, 0.2, -1.0]);
        let many = grey(&[0.2, 0.2, 0.2, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0]);
        assert_eq!((few.exposure(), many.exposure()), (Some(3.0), Some(3.0)));
        assert_eq!((few.surface_share(), many.surface_share()), (0.75, 3.0 / 9.0));
    }

    #[test]
    fn a_lamp_in_the_picture_and_dark_corners_have_no_say() {
        let mut values = vec![0.5; 60];
        values.extend([0.0; 30]);
        values.extend([900.0; 3]);
        let brightness = grey(&values);
        assert_eq!(brightness.exposure(), Some(1.2));
        assert!((brightness.dark_share() - 30.0 / 93.0).abs() < 1e-9);
    }

    #[test]
    fn a_factor_on_the_light_divides_the_exposure() {
        let values: Vec<f32> = (1..100).map(|i| i as f32 / 64.0).collect();
        let brighter: Vec<f32> = values.iter().map(|value| value * 1024.0).collect();
        let [plain, bright] = [grey(&values), grey(&brighter)].map(|of| of.exposure().unwrap());
        assert!((plain / bright / 1024.0 - 1.0).abs() < 0.01, "{plain} {bright}");
    }

    #[test]
    fn nothing_lit_has_no_exposure() {
        for values in [&[][..], &[-1.0], &[0.0, 0.0]] {
            assert_eq!(grey(values).exposure(), None);
        }
        assert_eq!((grey(&[0.0, 0.0]).dark_share(), grey(&[]).dark_share()), (1.0, 0.0));
        // One pixel of a hundred is lit: the rest is dark.
        let mut values = vec![0.0; 99];
        values.push(3.0);
        assert!(grey(&values).dark_share() > 0.98 && grey(&values).exposure().is_some());
    }
}
