//! `Film`: the sums of all samples, and the layers.
//!
//! Invariants: 1. sums are f64: after 10^6 samples the mean is right to f32 (an f32 sum or running mean is not);
//! 2. the samples of a pixel are added in the order of their index, so the bytes do not depend on threads;
//! 3. all pixels of a tile have the same number of samples; 4. its memory is leased before it is taken; 5. the samples
//! of a tile are all of one state of the scene: those of a state before count for nothing, and are shown until the
//! first of the present one comes; 6. a film of a portion of a picture has the rows of that alone, and the samples
//! that it begins behind count as taken.

mod layers;
mod part_rows;

#[cfg(test)]
mod tests;

pub(crate) use layers::Guide;
pub use layers::{LayerPixel, Layers, NO_ID};
pub(crate) use part_rows::{block_bytes, block_bytes_most};

use super::packed::PackedLight;
use super::rgb_sum::RgbSum;
use crate::portion::Portion;
use crate::tile::{Tile, tile};
use layers::LayerPlanes;
use std::ops::Range;
use trex_store::{Budget, Lease, Result};

/// A picture in the making.
#[derive(Debug)]
pub struct Film {
    resolution: [u32; 2],
    layers: Layers,
    /// Its tiles, and the first of its samples; the last is known to those who take them.
    portion: Portion,
    /// The rows of pixels of these tiles.
    rows: Range<u32>,
    /// Sums of radiance per pixel, in rows.
    sums: Vec<RgbSum>,
    /// Samples of each pixel, per tile, and the state that they are of.
    counts: Vec<u32>,
    states: Vec<u32>,
    /// The present state of the scene.
    state: u32,
    planes: LayerPlanes,
    /// The part of `sums` that the filter is to smooth.
    indirect: Vec<RgbSum>,
    /// Mean of `indirect`, smoothed, as of the last time.
    smoothed: Vec<PackedLight>,
    /// Samples of the present state that `smoothed` is of; 0 for none.
    smoothed_of: u32,
    lease: Lease,
}

/// Bytes that a film takes at `resolution` (width, height; pixels).
pub fn film_bytes(resolution: [u32; 2], layers: Layers) -> u64 {
    portion_bytes(resolution, layers, &Portion::whole(resolution, 0))
}

/// Bytes that a film of a portion of such a picture takes.
pub fn portion_bytes(resolution: [u32; 2], layers: Layers, portion: &Portion) -> u64 {
    let filtered = if layers.filter { size_of::<RgbSum>() + size_of::<PackedLight>() } else { 0 };
    let per_pixel = size_of::<RgbSum>() + filtered + layers.pixel_bytes();
    let pixels = u64::from(resolution[0]) * portion.rows(resolution).len() as u64;
    pixels * per_pixel as u64 + u64::from(portion.tiles[1] - portion.tiles[0]) * 8
}

/// Mean over the pixels (x, y) of a film, summed by rows.
pub(super) fn mean(film: &Film, radiance: impl Fn([u32; 2]) -> [f32; 3]) -> [f64; 3] {
    let (mut sums, mut count) = ([0.0; 3], 0u64);
    for pixel in film.portion.pixels(film.resolution) {
        add_radiance(&mut sums, radiance(pixel));
        count += 1;
    }
    sums.map(|sum| sum / count as f64)
}

/// Adds the radiance of one pixel to a sum of many.
pub(super) fn add_radiance(sums: &mut [f64; 3], radiance: [f32; 3]) {
    for (sum, value) in sums.iter_mut().zip(radiance) {
        *sum += f64::from(value);
    }
}

impl Film {
    /// A black film of `resolution` (width, height; pixels) that keeps `layers`.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`film_bytes`].
    pub fn new(resolution: [u32; 2], layers: Layers, budget: &Budget) -> Result<Film> {
        let lease = budget.lease("the film", film_bytes(resolution, layers))?;
        Ok(Film::in_lease(resolution, layers, lease))
    }

    /// As [`Film::new`], in a lease of [`film_bytes`].
    pub fn in_lease(resolution: [u32; 2], layers: Layers, lease: Lease) -> Film {
        Film::of_portion(resolution, layers, Portion::whole(resolution, 0), lease)
    }

    /// A black film of a portion of a picture of `resolution`, in a lease of [`portion_bytes`]: pixels and tiles have
    /// the places and indices that they have in the picture.
    pub fn of_portion(resolution: [u32; 2], layers: Layers, portion: Portion, lease: Lease) -> Film {
        let rows = portion.rows(resolution);
        let pixels = resolution[0] as usize * rows.len();
        let if_asked = |asked: bool| if asked { pixels } else { 0 };
        let tiles = (portion.tiles[1] - portion.tiles[0]) as usize;
        Film {
            resolution,
            layers,
            portion,
            rows,
            sums: vec![RgbSum::default(); pixels],
            counts: vec![portion.samples[0]; tiles],
            states: vec![0; tiles],
            state: 0,
            planes: LayerPlanes::new(layers, pixels),
            indirect: vec![RgbSum::default(); if_asked(layers.filter)],
            smoothed: vec![PackedLight::default(); if_asked(layers.filter)],
            smoothed_of: 0,
            lease,
        }
    }

    /// The lease of its memory.
    pub fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }

    /// Width and height of the picture, pixels.
    pub fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// The part of the picture that it is of: all tiles, but for a film of a portion.
    pub fn portion(&self) -> Portion {
        self.portion
    }

    /// The rows of pixels that it has.
    pub(crate) fn rows(&self) -> Range<u32> {
        self.rows.clone()
    }

    /// Indices of its tiles.
    fn tiles(&self) -> Range<u32> {
        self.portion.tiles[0]..self.portion.tiles[1]
    }

    /// Where counts and states of tile `index` stand.
    fn slot(&self, index: u32) -> usize {
        (index - self.portion.tiles[0]) as usize
    }

    /// The layers that were asked for.
    pub fn layers(&self) -> Layers {
        self.layers
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        self.tiles().for_each(|index| self.clear_tile(index));
        self.states.fill(0);
        self.state = 0;
    }

    /// Begins another state of the scene: the samples so far count no more.
    pub fn begin_state(&mut self) {
        self.state += 1;
        self.smoothed_of = 0;
    }

    /// The present state of the scene: grows with each [`Film::begin_state`].
    pub fn state(&self) -> u32 {
        self.state
    }

    /// The state that the samples of tile `index` are of; `None` without samples.
    pub fn tile_state(&self, index: u32) -> Option<u32> {
        let slot = self.slot(index);
        (self.counts[slot] > self.portion.samples[0]).then_some(self.states[slot])
    }

    /// Samples of the present state whose indirect light was smoothed; 0 for none.
    pub fn smoothed_of(&self) -> u32 {
        self.smoothed_of
    }

    /// Forgets the samples of tile `index`.
    fn clear_tile(&mut self, index: u32) {
        fn fill<T: Copy>(layer: &mut [T], row: Range<usize>, value: T) {
            // A layer that is not kept has no pixels.
            if let Some(row) = layer.get_mut(row) {
                row.fill(value);
            }
        }
        self.smoothed_of = 0;
        // Tiles without samples are as new: where views change fast, that is most of them.
        let (slot, none) = (self.slot(index), self.portion.samples[0]);
        if std::mem::replace(&mut self.counts[slot], none) == none {
            return;
        }
        let Tile { first: [x, y], size: [width, height], .. } = tile(self.resolution, index);
        for y in y..y + height {
            let at = self.place([x, y]);
            let row = at..at + width as usize;
            fill(&mut self.sums, row.clone(), RgbSum::default());
            fill(&mut self.indirect, row.clone(), RgbSum::default());
            self.planes.clear(row);
        }
    }

    /// Adds the next samples of `tile`, of the present state: the first of all its pixels, the second of all its
    /// pixels, and so on. What is no radiance, negative or no number, counts as 0.
    ///
    /// # Panics
    /// When some pixels get more samples than others.
    pub fn add(&mut self, tile: &Tile, radiances: &[[f32; 3]]) {
        let pixels = tile.pixel_count() as usize;
        assert_eq!(radiances.len() % pixels, 0, "a tile of {pixels} pixels");
        let slot = self.slot(tile.index);
        if self.states[slot] != self.state {
            self.clear_tile(tile.index);
            self.states[slot] = self.state;
        }
        for (index, radiance) in radiances.iter().enumerate() {
            let at = self.place(tile.pixel((index % pixels) as u32));
            self.sums[at].add(*radiance);
        }
        self.counts[slot] += (radiances.len() / pixels) as u32;
    }

    /// Adds the share of indirect light of the samples that [`Film::add`] got, in the same order; only with
    /// [`Layers::filter`].
    pub fn add_indirect(&mut self, tile: &Tile, radiances: &[[f32; 3]]) {
        for (index, radiance) in radiances.iter().enumerate() {
            let at = self.place(tile.pixel((index % tile.pixel_count() as usize) as u32));
            self.indirect[at].add(*radiance);
        }
    }

    /// Mean indirect radiance of a pixel (x, y), not smoothed; only with [`Layers::filter`].
    pub(crate) fn indirect(&self, pixel: [u32; 2]) -> [f32; 3] {
        let per_sample = self.per_sample(pixel);
        self.indirect[self.place(pixel)].rgb().map(|sum| (sum * per_sample) as f32)
    }

    /// The filter's view of a pixel (x, y); only with [`Layers::filter`].
    pub(crate) fn guide(&self, pixel: [u32; 2]) -> Guide {
        self.planes.guide(self.place(pixel))
    }

    /// The smoothed indirect light of `rows`, to be written.
    pub(crate) fn smoothed_mut(&mut self, rows: Range<usize>) -> &mut [PackedLight] {
        assert!(self.layers.filter, "this film keeps no indirect light");
        let (width, first) = (self.resolution[0] as usize, self.rows.start as usize);
        &mut self.smoothed[(rows.start - first) * width..(rows.end - first) * width]
    }

    /// From now on the smoothed light counts in place of the other, also of samples to come, until another state.
    pub(crate) fn set_smooth(&mut self) {
        self.smoothed_of = self.samples();
    }

    /// Sets the layers of one pixel (x, y), of a tile that has samples.
    pub fn set_layers(&mut self, pixel: [u32; 2], seen: &LayerPixel) {
        let at = self.place(pixel);
        self.planes.set(at, seen);
    }

    /// Samples of the present state that each pixel of tile `index` has, with those that its portion begins behind.
    pub fn tile_samples(&self, index: u32) -> u32 {
        let slot = self.slot(index);
        match self.states[slot] == self.state {
            true => self.counts[slot],
            false => self.portion.samples[0],
        }
    }

    /// What the mean of tile `index` counts for beside a preview, in samples of a pixel: those that it has, or the
    /// square of them once they are smoothed: what the filter takes away is noise as well.
    pub fn tile_worth(&self, index: u32) -> u32 {
        let samples = self.tile_samples(index);
        if self.smoothed_of > 0 { samples.saturating_mul(samples) } else { samples }
    }

    /// Samples of the present state that every pixel has, with those that its portion begins behind.
    pub fn samples(&self) -> u32 {
        self.tiles().map(|index| self.tile_samples(index)).min().unwrap_or(0)
    }

    /// One over the samples that the sums at a pixel (x, y) are of.
    fn per_sample(&self, pixel: [u32; 2]) -> f64 {
        let taken = self.counts[self.tile_slot(pixel)] - self.portion.samples[0];
        1.0 / f64::from(taken.max(1))
    }

    /// Mean radiance of a pixel (x, y), linear RGB, over its samples of the state that its tile has; black without
    /// samples. Its indirect part is smoothed where the film was.
    pub fn radiance(&self, pixel: [u32; 2]) -> [f32; 3] {
        let mut radiance = [[0.0; 3]];
        self.radiances(pixel, &mut radiance);
        radiance[0]
    }

    /// As [`Film::radiance`], of as many pixels as there are places, from (x, y) on in its row; all of one tile.
    pub fn radiances(&self, first: [u32; 2], radiances: &mut [[f32; 3]]) {
        let per_sample = self.per_sample(first);
        let first = self.place(first);
        let sums = &self.sums[first..][..radiances.len()];
        if self.smoothed_of == 0 {
            let means = sums.iter().map(|sum| sum.rgb().map(|sum| (sum * per_sample) as f32));
            radiances.iter_mut().zip(means).for_each(|(radiance, mean)| *radiance = mean);
            return;
        }
        for ((at, sums), radiance) in (first..).zip(sums).zip(radiances) {
            let (sums, indirect) = (sums.rgb(), self.indirect[at].rgb());
            let rest = |c: usize| (sums[c] - indirect[c]) * per_sample;
            let smoothed = self.smoothed[at].rgb();
            *radiance = std::array::from_fn(|c| (rest(c) + f64::from(smoothed[c])) as f32);
        }
    }

    /// Mean radiance over all pixels, linear RGB, unclamped.
    pub fn mean(&self) -> [f64; 3] {
        mean(self, |pixel| self.radiance(pixel))
    }

    /// Distance from the camera at a pixel (x, y), model units; infinite where nothing is hit.
    ///
    /// # Panics
    /// Without [`Layers::depth`] and [`Layers::filter`], or outside of the film.
    pub fn depth(&self, pixel: [u32; 2]) -> f32 {
        self.planes.depth[self.place(pixel)]
    }

    /// Unit normal at a pixel (x, y); zero where nothing is hit.
    ///
    /// # Panics
    /// Without [`Layers::normal`], or outside of the film.
    pub fn normal(&self, pixel: [u32; 2]) -> [f32; 3] {
        self.planes.normal[self.place(pixel)]
    }

    /// Kd + Ks at a pixel (x, y); zero where nothing is hit.
    ///
    /// # Panics
    /// Without [`Layers::albedo`], or outside of the film.
    pub fn albedo(&self, pixel: [u32; 2]) -> [f32; 3] {
        self.planes.albedo[self.place(pixel)]
    }

    /// Store id of the triangle at a pixel (x, y); [`NO_ID`] where nothing is hit.
    ///
    /// # Panics
    /// Without [`Layers::id`], or outside of the film.
    pub fn id(&self, pixel: [u32; 2]) -> u32 {
        self.planes.id[self.place(pixel)]
    }

    fn place(&self, [x, y]: [u32; 2]) -> usize {
        assert!(x < self.resolution[0] && self.rows.contains(&y), "pixel ({x}, {y}) is not on the film");
        (y - self.rows.start) as usize * self.resolution[0] as usize + x as usize
    }

    fn tile_slot(&self, [x, y]: [u32; 2]) -> usize {
        let side = crate::tile::TILE_SIDE_PIXELS;
        self.slot((y / side) * self.resolution[0].div_ceil(side) + x / side)
    }
}
