//! Light kept in the world, mixed into the samples of a picture and taken from them: see `light_cache.rs`.

use super::history::WorthyLight;
use super::light_cache::LightCache;
use super::{Coarse, KEPT_STEP, SampleGrid, Surface, ToldTiles, planes, planes_mut, sample_count};
use crate::film::LayerPixel;
use glam::Vec3;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Pixels that a sample of the finest grid stands for.
const PIXELS_OF_SAMPLE: f32 = (KEPT_STEP * KEPT_STEP) as f32;

impl Coarse {
    /// Bytes that light kept in the world takes beside the samples.
    pub(crate) fn cache_bytes(resolution: [u32; 2]) -> u64 {
        LightCache::bytes(sample_count(resolution, KEPT_STEP))
    }

    /// Makes room for light in the world, or takes it away.
    pub(crate) fn keep_cache(&mut self, is_kept: bool) {
        self.cache = is_kept.then(|| LightCache::new(self.surfaces.len()));
    }

    /// Nothing is kept in the world.
    pub(crate) fn forget_cache(&mut self) {
        if let Some(cache) = &mut self.cache {
            cache.forget();
        }
    }

    /// Sample `at` sees something from now on, whose light is kept by its key; it `is_new` where its own light is to be
    /// mixed with that. Another surface has none of the light that is on show there.
    pub(super) fn see(&mut self, at: usize, seen: &LayerPixel, is_new: bool) {
        let surface = Surface::new(seen);
        let before = std::mem::replace(&mut self.surfaces[at], surface);
        if let Some(cache) = &mut self.cache {
            cache.set_key(at, seen.light_key, is_new);
        }
        if let Some(history) = self.history.as_mut().filter(|_| !before.is_same(&surface)) {
            history.lose(at);
        }
    }

    /// Mixes the light of those samples of the finest grid that are new, in tiles that are told, with what is kept of
    /// it in the world, and adds it to that; does nothing without room for it.
    pub(crate) fn recall(&mut self, is_told: ToldTiles<'_>, pool: &ThreadPool) {
        self.make_room();
        let Coarse { resolution, surfaces, light, work, cache, .. } = self;
        let Some(cache) = cache else { return };
        let picked = SampleGrid::new(surfaces, *resolution, KEPT_STEP);
        let told =
            |y: usize| picked.tiles_of_row(y).filter(|(index, _)| is_told(*index)).flat_map(|(_, xs)| xs);
        let own = &mut work[..light.len()];
        own.copy_from_slice(light);
        let [red, green, blue] = planes_mut(light).map(|plane| plane.par_chunks_exact_mut(picked.pitch));
        pool.install(|| {
            red.zip(green).zip(blue).enumerate().for_each(|(y, ((red, green), blue))| {
                cache.mix([red, green, blue], told(y).map(|x| (x, y * picked.pitch + x)));
            });
        });
        let places = (0..picked.size[1]).flat_map(|y| told(y).map(move |x| y * picked.pitch + x));
        cache.add_new(planes(own), places);
    }

    /// Adds the light of the samples at every `step`-th pixel that are new to what is kept.
    pub(super) fn keep_new(&mut self, step: u32) {
        let Coarse { resolution, surfaces, light, cache, .. } = self;
        let Some(cache) = cache else { return };
        cache.add_new(planes(light), SampleGrid::new(surfaces, *resolution, step).places());
    }

    /// Adds the light of the samples that exact ones have taken the place of to that kept in the world; `samples` tells
    /// how many of those a pixel of a tile has.
    pub(crate) fn keep_exact(&mut self, samples: &dyn Fn(u32) -> u32) {
        let Coarse { resolution, surfaces, light, cache, .. } = self;
        let Some(cache) = cache else { return };
        let [red, green, blue] = planes(light);
        let picked = SampleGrid::new(surfaces, *resolution, KEPT_STEP);
        for y in 0..picked.size[1] {
            for (index, columns) in picked.tiles_of_row(y) {
                let worth = PIXELS_OF_SAMPLE * samples(index) as f32;
                for at in columns.map(|x| y * picked.pitch + x).filter(|_| worth > 0.0) {
                    cache
                        .add_exact(at, WorthyLight { light: Vec3::new(red[at], green[at], blue[at]), worth });
                }
            }
        }
    }
}
