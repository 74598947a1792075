//! `Film`: the sums of all samples, and the layers.
//!
//! Invariants: 1. sums are f64: after 10^6 samples the mean is right to f32 (an f32 sum or running mean is not);
//! 2. the samples of a pixel are added in the order of their index, so the bytes do not depend on threads;
//! 3. all pixels of a tile have the same number of samples; 4. its memory is leased before it is taken; 5. the samples
//! of a tile are all of one state of the scene: those of a state before count for nothing, and are shown until the
//! first of the present one comes.

mod layers;

#[cfg(test)]
mod tests;

pub(crate) use layers::Guide;
pub use layers::{LayerPixel, Layers, NO_ID};

use super::packed::PackedLight;
use super::rgb_sum::RgbSum;
use crate::tile::{Tile, tile, tile_count};
use layers::LayerPlanes;
use std::ops::Range;
use trex_store::{Budget, Lease, Result};

/// A picture in the making.
#[derive(Debug)]
pub struct Film {
    resolution: [u32; 2],
    layers: Layers,
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
    let filtered = if layers.filter { size_of::<RgbSum>() + size_of::<PackedLight>() } else { 0 };
    let per_pixel = size_of::<RgbSum>() + filtered + layers.pixel_bytes();
    let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
    pixels * per_pixel as u64 + u64::from(tile_count(resolution)) * 8
}

/// Mean over the pixels (x, y) of a picture of `resolution`, summed by rows.
pub(super) fn mean(resolution: [u32; 2], radiance: impl Fn([u32; 2]) -> [f32; 3]) -> [f64; 3] {
    let [width, height] = resolution;
    let mut mean = [0.0; 3];
    for y in 0..height {
        for x in 0..width {
            for (sum, value) in mean.iter_mut().zip(radiance([x, y])) {
                *sum += f64::from(value);
            }
        }
    }
    mean.map(|sum| sum / (f64::from(width) * f64::from(height)))
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
        let pixels = resolution[0] as usize * resolution[1] as usize;
        let if_asked = |asked: bool| if asked { pixels } else { 0 };
        Film {
            resolution,
            layers,
            sums: vec![RgbSum::default(); pixels],
            counts: vec![0; tile_count(resolution) as usize],
            states: vec![0; tile_count(resolution) as usize],
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

    /// Width and height, pixels.
    pub fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// The layers that were asked for.
    pub fn layers(&self) -> Layers {
        self.layers
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        for index in 0..self.counts.len() as u32 {
            self.clear_tile(index);
        }
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
        (self.counts[index as usize] > 0).then_some(self.states[index as usize])
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
        if std::mem::take(&mut self.counts[index as usize]) == 0 {
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
        if self.states[tile.index as usize] != self.state {
            self.clear_tile(tile.index);
            self.states[tile.index as usize] = self.state;
        }
        for (index, radiance) in radiances.iter().enumerate() {
            let at = self.place(tile.pixel((index % pixels) as u32));
            self.sums[at].add(*radiance);
        }
        self.counts[tile.index as usize] += (radiances.len() / pixels) as u32;
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
        let per_sample = 1.0 / f64::from(self.counts[self.tile_index(pixel)].max(1));
        self.indirect[self.place(pixel)].rgb().map(|sum| (sum * per_sample) as f32)
    }

    /// The filter's view of a pixel (x, y); only with [`Layers::filter`].
    pub(crate) fn guide(&self, pixel: [u32; 2]) -> Guide {
        self.planes.guide(self.place(pixel))
    }

    /// The smoothed indirect light of `rows`, to be written.
    pub(crate) fn smoothed_mut(&mut self, rows: Range<usize>) -> &mut [PackedLight] {
        assert!(self.layers.filter, "this film keeps no indirect light");
        let width = self.resolution[0] as usize;
        &mut self.smoothed[rows.start * width..rows.end * width]
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

    /// Samples of the present state that each pixel of tile `index` has.
    pub fn tile_samples(&self, index: u32) -> u32 {
        match self.states[index as usize] == self.state {
            true => self.counts[index as usize],
            false => 0,
        }
    }

    /// Samples of the present state that every pixel has.
    pub fn samples(&self) -> u32 {
        (0..self.counts.len() as u32).map(|index| self.tile_samples(index)).min().unwrap_or(0)
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
        let per_sample = 1.0 / f64::from(self.counts[self.tile_index(first)].max(1));
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
        mean(self.resolution, |pixel| self.radiance(pixel))
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
        assert!(x < self.resolution[0] && y < self.resolution[1], "pixel ({x}, {y}) is not on the film");
        y as usize * self.resolution[0] as usize + x as usize
    }

    fn tile_index(&self, [x, y]: [u32; 2]) -> usize {
        let side = crate::tile::TILE_SIDE_PIXELS;
        ((y / side) * self.resolution[0].div_ceil(side) + x / side) as usize
    }
}
