//! `History`: the picture on show before the camera moved, and its light where a surface of it is seen now.
//!
//! ```text
//! sample: pixel, depth -> the same place in the picture before -> the four samples around
//!                         those of one surface with it: their light, and how many pictures that is worth
//! ```
//!
//! Where light has changed since, it is worth less the more it differs from what is found now. What was not seen
//! before, or looks otherwise there, has no history. Light is carried by a surface, without its albedo. C. Schied et
//! al., "Spatiotemporal variance-guided filtering" (2017), 4.1.

use super::grid::{KEPT_STEP, grid_size, sample_count};
use super::surface::Surface;
use crate::film::LayerPixel;
use crate::packed::PackedLight;
use glam::Vec3;
use rayon::prelude::*;

/// Parts of a picture in which worth is kept.
const WORTH_PARTS: f32 = 16.0;
/// Of light that has changed, what differs from what is found now by this share of the greater is worth nothing.
const LIGHT_APART: f32 = 0.25;
/// Share of the samples around that has to be of one surface with what is seen.
const SHARE_LEAST: f32 = 0.05;

/// Where a place was seen in the picture before.
pub trait Reprojection: Sync {
    /// Film position (pixels from the upper left corner) and distance from the camera, model units, of a place in the
    /// picture before, which is seen at `film` and `depth` now; `None` where that camera had it behind itself, or saw
    /// it from a direction in which its light may be another.
    fn before(&self, film: [f64; 2], depth: f64) -> Option<([f64; 2], f64)>;

    /// True where light has changed since.
    fn is_lit_anew(&self) -> bool;
}

/// Light of a sample, over its albedo, and how many pictures of the finest grid it is worth.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorthyLight {
    pub(super) light: Vec3,
    pub(super) worth: f32,
}

/// The light on show at the samples that are kept.
#[derive(Debug)]
pub(super) struct ShownLight {
    lights: Vec<PackedLight>,
    worths: Vec<u8>,
}

/// A row of it.
pub(super) struct ShownRow<'a> {
    lights: &'a mut [PackedLight],
    worths: &'a mut [u8],
}

/// The picture before, and the light of the one on show, which will be that of the one before.
#[derive(Debug)]
pub(super) struct History {
    before: PictureBefore,
    now: ShownLight,
    /// No picture has been made since the last was taken for the one before: that is on show.
    shows_before: bool,
}

/// The picture before.
#[derive(Debug)]
pub(super) struct PictureBefore {
    surfaces: Vec<Surface>,
    shown: ShownLight,
    /// Pixels from sample to sample of it; `None` while there is none.
    step: Option<u32>,
}

impl WorthyLight {
    /// Both, each for what it is worth; together at most `most`.
    pub(super) fn with(self, other: WorthyLight, most: f32) -> WorthyLight {
        let worth = self.worth + other.worth;
        WorthyLight {
            light: (self.worth * self.light + other.worth * other.light) / worth,
            worth: worth.min(most),
        }
    }

    /// Worth less the more it differs from `light`, which is that of the same place in light that may be another.
    pub(super) fn as_near_to(self, light: Vec3) -> WorthyLight {
        let greatest = self.light.max(light).max_element().max(f32::MIN_POSITIVE);
        let apart = (self.light - light).abs().max_element() / greatest;
        WorthyLight { worth: self.worth * (1.0 - apart / LIGHT_APART).max(0.0), ..self }
    }
}

impl ShownLight {
    pub(super) const BYTES_PER_SAMPLE: usize = size_of::<PackedLight>() + size_of::<u8>();

    pub(super) fn new(count: usize) -> ShownLight {
        ShownLight { lights: vec![PackedLight::default(); count], worths: vec![0; count] }
    }

    /// Rows from each `pitch`-th sample on.
    pub(super) fn rows(&mut self, pitch: usize) -> impl IndexedParallelIterator<Item = ShownRow<'_>> {
        let rows = self.lights.par_chunks_mut(pitch).zip(self.worths.par_chunks_mut(pitch));
        rows.map(|(lights, worths)| ShownRow { lights, worths })
    }

    fn get(&self, at: usize) -> WorthyLight {
        WorthyLight { light: self.lights[at].rgb().into(), worth: f32::from(self.worths[at]) / WORTH_PARTS }
    }
}

impl ShownRow<'_> {
    pub(super) fn put(&mut self, x: usize, WorthyLight { light, worth }: WorthyLight) {
        self.lights[x] = PackedLight::new(light.into());
        self.worths[x] = (worth * WORTH_PARTS).round() as u8;
    }
}

impl History {
    /// Bytes that it takes beside a picture of `resolution`.
    pub(super) fn bytes(resolution: [u32; 2]) -> u64 {
        let bytes = size_of::<Surface>() + 2 * ShownLight::BYTES_PER_SAMPLE;
        (sample_count(resolution, KEPT_STEP) * bytes) as u64
    }

    /// Of nothing, in room for `count` samples.
    pub(super) fn new(count: usize) -> History {
        let surfaces = vec![Surface::new(&LayerPixel::NOTHING); count];
        let before = PictureBefore { surfaces, shown: ShownLight::new(count), step: None };
        History { before, now: ShownLight::new(count), shows_before: false }
    }

    /// Takes the picture on show, of samples at every `step`-th pixel that saw `surfaces`, for the one before.
    pub(super) fn exchange(&mut self, step: u32, surfaces: &mut Vec<Surface>) {
        let PictureBefore { surfaces: before, shown, step: of } = &mut self.before;
        std::mem::swap(before, surfaces);
        std::mem::swap(shown, &mut self.now);
        (*of, self.shows_before) = (Some(step), true);
    }

    pub(super) fn forget(&mut self) {
        self.before.step = None;
    }

    /// Nothing of the light on show is that of sample `at` any more.
    pub(super) fn lose(&mut self, at: usize) {
        self.now.worths[at] = 0;
    }

    /// What the samples of the picture on show saw, where that is the one before by now.
    pub(super) fn surfaces_on_show(&self) -> Option<&Vec<Surface>> {
        self.shows_before.then_some(&self.before.surfaces)
    }

    /// The picture before, and the light of one that is made.
    pub(super) fn parts(&mut self) -> (&PictureBefore, &mut ShownLight) {
        self.shows_before = false;
        (&self.before, &mut self.now)
    }
}

impl PictureBefore {
    /// The light of what is `seen` now at pixel (x, y) of a picture of `resolution`, where the picture before has it.
    pub(super) fn light(
        &self,
        (resolution, pixel): ([u32; 2], [u32; 2]),
        seen: &Surface,
        reprojection: &dyn Reprojection,
    ) -> Option<WorthyLight> {
        let step = self.step?;
        let depth = seen.depth();
        if depth == f32::INFINITY {
            return None;
        }
        let centre = pixel.map(|x| f64::from(x) + 0.5);
        let (film, depth) = reprojection.before(centre, f64::from(depth))?;
        let (size, pitch) = (grid_size(resolution, step), grid_size(resolution, KEPT_STEP)[0] as usize);
        let place = film.map(|x| (x - 0.5) / f64::from(step));
        let first = place.map(f64::floor);
        let [u, v] = [0, 1].map(|axis| (place[axis] - first[axis]) as f32);
        let around = [(0, 0, 1.0 - u, 1.0 - v), (1, 0, u, 1.0 - v), (0, 1, 1.0 - u, v), (1, 1, u, v)];
        let (mut share, mut light, mut worth) = (0.0, Vec3::ZERO, 0.0);
        for (right, down, weight_x, weight_y) in around {
            let [x, y] = [first[0] + f64::from(right), first[1] + f64::from(down)];
            // No number is on no grid.
            let is_on_grid = x >= 0.0 && y >= 0.0 && x < f64::from(size[0]) && y < f64::from(size[1]);
            if !is_on_grid {
                continue;
            }
            let at = (y as usize * pitch + x as usize) * (step / KEPT_STEP) as usize;
            let before = self.shown.get(at);
            if before.worth > 0.0 && seen.is_same_at(depth as f32, &self.surfaces[at]) {
                let weight = weight_x * weight_y;
                share += weight;
                light += weight * before.light;
                worth += weight * before.worth;
            }
        }
        (share > SHARE_LEAST).then(|| WorthyLight { light: light / share, worth: worth / share })
    }
}
