//! `History`: light of the pictures before, carried to where its surface is seen from now on.
//!
//! ```text
//! sample: place of its surface -> where the picture before saw that place -> light between the samples there that are of
//!         one surface with it: as far from that eye as the place is, of its normal, albedo and form
//! light = (worth * light before + light) / (worth + 1), worth + 1 up to a bound
//! ```
//!
//! A surface that was hidden, or out of the picture, begins anew. What is kept is the light before it is smoothed: smoothed
//! light that is smoothed again would spread further with each picture. The nearest sample alone would not do: where a
//! picture moves by less than half of a step, its light would stay where it is on the film. D. Scherzer, S. Jeschke, M.
//! Wimmer, "Pixel-correct shadow maps with temporal reprojection and shadow test confidence" (2007).
//!
//! Invariants: 1. light is carried between pictures of the same lamps and materials alone: [`History::begin`] is told; 2. a
//! sample counts once in each picture, and no light is worth more than [`WORTH_MOST`] samples.

use super::grid_size;
use super::surface::Surface;
use super::{FixedTiles, KEPT_STEP, Planes, SampleGrid, sample_count};
use crate::film::LayerPixel;
use crate::lens::Eye;
use crate::packed::PackedLight;
use glam::{DVec3, Vec3};

/// Samples that carried light is worth at most, with the one that it is carried to: what depends on the view lags behind by
/// as many pictures.
pub(super) const WORTH_MOST: u8 = 16;
/// Weight of a sample of four below which it is not there.
const WEIGHT_LEAST: f64 = 1e-3;

/// Light of a picture before it was smoothed, over its albedo, at every [`KEPT_STEP`]-th pixel.
#[derive(Debug)]
struct Kept {
    light: Vec<PackedLight>,
    /// Samples that it is worth.
    worth: Vec<u8>,
    /// Where it is seen from, and pixels from sample to sample; `None` for no picture.
    seen: Option<(Eye, u32)>,
}

/// See the module's description.
#[derive(Debug)]
pub(super) struct History {
    resolution: [u32; 2],
    before: Kept,
    /// What the samples before saw.
    surfaces: Vec<Surface>,
    now: Kept,
    /// Where the picture in work is seen from.
    eye: Option<Eye>,
}

impl Kept {
    fn new(count: usize) -> Kept {
        Kept { light: vec![PackedLight::default(); count], worth: vec![1; count], seen: None }
    }
}

impl History {
    /// Bytes of the history of a picture of `resolution` (width, height; pixels).
    pub(super) fn bytes(resolution: [u32; 2]) -> u64 {
        let bytes = size_of::<Surface>() + 2 * (size_of::<PackedLight>() + size_of::<u8>());
        (sample_count(resolution, KEPT_STEP) * bytes) as u64
    }

    /// No picture yet.
    pub(super) fn new(resolution: [u32; 2]) -> History {
        let count = sample_count(resolution, KEPT_STEP);
        let surfaces = vec![Surface::new(&LayerPixel::NOTHING); count];
        History { resolution, before: Kept::new(count), surfaces, now: Kept::new(count), eye: None }
    }

    /// Begins a picture that is seen from `eye`; `surfaces` are those of the one before, whose light goes on to be seen
    /// where `is_lit_alike`.
    pub(super) fn begin(&mut self, eye: Eye, is_lit_alike: bool, surfaces: &[Surface]) {
        if !is_lit_alike {
            self.forget();
        } else if self.now.seen.is_some() {
            std::mem::swap(&mut self.before, &mut self.now);
            self.surfaces.copy_from_slice(surfaces);
        }
        self.now.seen = None;
        self.eye = Some(eye);
    }

    /// Forgets all light: it is no longer what surfaces are lit by.
    pub(super) fn forget(&mut self) {
        (self.before.seen, self.now.seen) = (None, None);
    }

    /// The light of a new sample at pixel (x, y), place `at`, with what is carried to it.
    pub(super) fn add(&mut self, pixel: [u32; 2], at: usize, light: Vec3, seen: &LayerPixel) -> Vec3 {
        let (mut light, mut worth) = (light, 1);
        if let Some((old, old_worth)) = self.find(pixel, seen) {
            let carried = (old_worth.round() as u8).min(WORTH_MOST - 1);
            light = (f32::from(carried) * old + light) / f32::from(carried + 1);
            worth = carried + 1;
        }
        self.now.worth[at] = worth;
        light
    }

    /// Light of what is `seen` at pixel (x, y) in the picture before, and samples that it is worth: between those around
    /// it that are of one surface with it.
    fn find(&self, [x, y]: [u32; 2], seen: &LayerPixel) -> Option<(Vec3, f32)> {
        let ((then, step), now) = (self.before.seen?, self.eye?);
        if !seen.depth.is_finite() {
            return None;
        }
        let place = now.place(f64::from(x) + 0.5, f64::from(y) + 0.5, f64::from(seen.depth));
        let film = then.film(place)?;
        let depth = (place - DVec3::from(then.position)).length() as f32;
        let surface = Surface::new(&LayerPixel { depth, ..*seen });
        let [columns, rows] = grid_size(self.resolution, step).map(|side| side as i64);
        // In samples; each is half a pixel into its pixel.
        let [u, v] = film.map(|at| (at - 0.5) / f64::from(step));
        let pitch = grid_size(self.resolution, KEPT_STEP)[0] as usize;
        let (mut light, mut worth, mut total) = (Vec3::ZERO, 0.0, 0.0);
        for (right, below) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = (u.floor() as i64 + right, v.floor() as i64 + below);
            let weight = (1.0 - (column as f64 - u).abs()) * (1.0 - (row as f64 - v).abs());
            if !(0..columns).contains(&column) || !(0..rows).contains(&row) || weight < WEIGHT_LEAST {
                continue;
            }
            let at = (row as usize * pitch + column as usize) * (step / KEPT_STEP) as usize;
            if self.surfaces[at].is_same(&surface) {
                let weight = weight as f32;
                total += weight;
                light += weight * Vec3::from(self.before.light[at].rgb());
                worth += weight * f32::from(self.before.worth[at]);
            }
        }
        (total > 0.0).then(|| (light / total, worth / total))
    }

    /// Keeps the light of the samples of `grid`, at every `step`-th pixel, for the next picture.
    pub(super) fn keep(&mut self, step: u32, grid: &SampleGrid<'_>, light: Planes<'_>) {
        for at in grid.places() {
            self.now.light[at] = PackedLight::new([0, 1, 2].map(|c| light[c][at]));
        }
        self.now.seen = self.eye.map(|eye| (eye, step));
    }

    /// Keeps the light of exact samples, in the tiles of the finest grid that are not `is_fixed`.
    pub(super) fn keep_exact(&mut self, grid: &SampleGrid<'_>, is_fixed: FixedTiles<'_>, light: Planes<'_>) {
        let [columns, rows] = grid.size;
        for y in 0..rows {
            let exact = grid.tiles_of_row(y).filter(|(tile, _)| !is_fixed(*tile));
            for at in exact.flat_map(|(_, xs)| xs).map(|x| y * columns + x) {
                self.now.light[at] = PackedLight::new([0, 1, 2].map(|c| light[c][at]));
                self.now.worth[at] = WORTH_MOST;
            }
        }
    }

    /// Samples that the light of sample `at` is worth.
    #[cfg(test)]
    pub(super) fn worth(&self, at: usize) -> u8 {
        self.now.worth[at]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coarse::{Coarse, planes};
    use crate::hash::mix;
    use crate::lens::Lens;
    use crate::testing::{Pinhole, pool};

    const RESOLUTION: [u32; 2] = [96, 64];
    /// Where the near plate ends, and how far it and the wall are from the eye.
    const PLATE_END: f64 = 0.0;
    const PLATE: f64 = 5.0;
    const WALL: f64 = 10.0;

    /// An eye that looks along -z from (x, 0, 0).
    fn lens(x: f64) -> Pinhole {
        let position = DVec3::new(x, 0.0, 0.0);
        Pinhole { position, target: position - DVec3::Z, fov_x: 60.0, resolution: RESOLUTION }
    }

    /// What a pixel sees: the plate, where there is one, else the wall, and the place.
    fn seen(lens: &Pinhole, [x, y]: [u32; 2], has_plate: bool) -> (LayerPixel, DVec3) {
        let direction = DVec3::from(lens.direction(f64::from(x) + 0.5, f64::from(y) + 0.5));
        let at = |distance: f64| lens.position + direction * (distance / -direction.z);
        let is_plate = has_plate && at(PLATE).x < PLATE_END;
        let place = at(if is_plate { PLATE } else { WALL });
        let depth = (place - lens.position).length() as f32;
        (LayerPixel { depth, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 0 }, place)
    }

    fn samples() -> impl Iterator<Item = [u32; 2]> {
        let [width, height] = RESOLUTION;
        (0..height).step_by(2).flat_map(move |y| (0..width).step_by(2).map(move |x| [x, y]))
    }

    /// Takes a picture; gives the light of its samples before it is smoothed.
    fn picture(
        coarse: &mut Coarse,
        (x, has_plate, is_lit_alike): (f64, bool, bool),
        radiance: impl Fn([u32; 2], DVec3) -> f32,
    ) -> Vec<f32> {
        let lens = lens(x);
        coarse.begin(lens.eye(), is_lit_alike);
        for pixel in samples() {
            let (seen, place) = seen(&lens, pixel, has_plate);
            coarse.set(pixel, Vec3::splat(radiance(pixel, place)), &seen);
        }
        let light = planes(&coarse.light)[0].to_vec();
        coarse.smooth(2, &pool(2));
        light
    }

    /// Light by chance, of mean 1 over the albedo of a half.
    fn noise(picture: u64) -> impl Fn([u32; 2], DVec3) -> f32 {
        move |[x, y], _| (mix(picture << 40 | u64::from(y) << 20 | u64::from(x)) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Samples whose place was on the film in all pictures of a way to the right, and their variance.
    fn variance(light: &[f32]) -> f64 {
        let columns = RESOLUTION[0] as usize / 2;
        let inner = light.chunks(columns).flat_map(|row| &row[..columns / 2]).map(|x| f64::from(*x));
        let count = inner.clone().count() as f64;
        let mean = inner.clone().sum::<f64>() / count;
        inner.map(|x| (x - mean).powi(2)).sum::<f64>() / count
    }

    /// How far the eye goes from picture to picture so that the wall moves by one sample.
    fn sample_width() -> f64 {
        2.0 * WALL * 30f64.to_radians().tan() / 48.0
    }

    #[test]
    fn noise_on_a_wall_falls_as_one_over_the_pictures_up_to_the_bound() {
        // Uniform from 0 to 2.
        let of_one = 4.0 / 12.0;
        for samples_moved in [1.0, 0.4] {
            let mut coarse = Coarse::new(RESOLUTION);
            for count in 1..=20u32 {
                let x = samples_moved * sample_width() * f64::from(count);
                let light = picture(&mut coarse, (x, false, true), noise(count.into()));
                let found = variance(&light) * f64::from(count.min(16)) / of_one;
                match count {
                    // Between samples it is less noisy than either.
                    0..=16 if samples_moved < 1.0 => assert!(found < 1.2, "{count}: {found}"),
                    0..=16 => assert!((found - 1.0).abs() < 0.2, "{count}: {found}"),
                    // A mean that forgets: 16 / 31 in the end.
                    _ => assert!(found < 1.2, "{count}: {found}"),
                }
            }
            assert!(samples().enumerate().all(|(at, _)| coarse.history.worth(at) <= WORTH_MOST));
        }
    }

    /// A pattern on the wall stays where it is while the eye moves by less than half a sample a picture.
    #[test]
    fn light_stays_on_its_surface() {
        let mut coarse = Coarse::new(RESOLUTION);
        let pattern = |_: [u32; 2], place: DVec3| (1.0 + 0.5 * (2.0 * place.x).sin()) as f32;
        let mut drift = 0.0;
        for count in 0..30 {
            let x = 0.4 * sample_width() * f64::from(count);
            let light = picture(&mut coarse, (x, false, true), pattern);
            let lens = lens(x);
            let (mut moved, mut slopes) = (0.0, 0.0);
            for (pixel, light) in samples().zip(light) {
                let (_, place) = seen(&lens, pixel, false);
                let off = f64::from(light * 0.5) - f64::from(pattern(pixel, place));
                let slope = (2.0 * place.x).cos();
                (moved, slopes) = (moved - off * slope, slopes + slope * slope);
            }
            drift = f64::max(drift, (moved / slopes).abs());
        }
        // In samples; sixteen pictures that stay on the film would be off by three.
        assert!(drift / sample_width() < 0.2, "{drift}");
    }

    #[test]
    fn what_was_hidden_or_out_of_the_picture_has_no_history() {
        let mut coarse = Coarse::new(RESOLUTION);
        let (first, second) = (0.0, 1.0);
        picture(&mut coarse, (first, true, true), noise(0));
        picture(&mut coarse, (second, true, true), noise(1));
        let [mut carried, mut hidden, mut beside] = [0; 3];
        for (at, pixel) in samples().enumerate() {
            let (saw, place) = seen(&lens(second), pixel, true);
            let way = place - lens(first).position;
            // Where the way from the first eye goes through the plane of the plate, and where on the film it is seen.
            let through = way.x * PLATE / WALL;
            let across = 0.5 + 0.5 * way.x / -way.z / 30f64.to_radians().tan();
            let is_wall = f64::from(saw.depth) > WALL - 1e-3;
            let worth = coarse.history.worth(at);
            let margin = 0.3;
            if is_wall && through < PLATE_END - margin {
                assert_eq!(worth, 1, "{pixel:?} was hidden");
                hidden += 1;
            } else if across > 1.02 {
                assert_eq!(worth, 1, "{pixel:?} was out of the picture");
                beside += 1;
            } else if across < 0.95 && is_wall && through > PLATE_END + margin {
                assert_eq!(worth, 2, "{pixel:?} was seen");
                carried += 1;
            }
        }
        assert!(carried > 200 && hidden > 50 && beside > 50, "{carried} {hidden} {beside}");
    }

    #[test]
    fn an_edit_of_light_leaves_no_trail() {
        for is_by_itself in [false, true] {
            let mut coarse = Coarse::new(RESOLUTION);
            (0..5).for_each(|_| drop(picture(&mut coarse, (0.0, false, true), |_, _| 9.0)));
            if is_by_itself {
                coarse.forget();
            }
            let light = picture(&mut coarse, (0.0, false, is_by_itself), |_, _| 1.0);
            assert!(light.iter().all(|light| (light - 2.0).abs() < 0.01), "{is_by_itself}");
            assert!(samples().enumerate().all(|(at, _)| coarse.history.worth(at) == 1));
        }
    }
}
