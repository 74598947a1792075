//! The samples of a preview: one at every so many pixels, by all workers, without waiting for any page.
//!
//! ```text
//! per worker: next points of the grid -> their samples together -> the display
//! ```
//!
//! Pages that were missing are recorded by the tracers, and asked for when the preview is done: reading them takes
//! processors, and the picture comes first.
//!
//! Invariant: a sample is of the pixel whose place it takes.

use super::job::JOB_SAMPLES_MAX;
use super::pass::Workers;
use super::samples::{OpenSample, SampleWork, Samples};
use crate::integrate::Together;
use crate::stats::RayCounts;
use crate::trace::PagedTracer;
use glam::Vec3;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use trex_film::{Display, GridPart, LayerPixel, TILE_SIDE_PIXELS, grid_size, tile, tile_count};

/// Tiles of grid points that a worker takes at a time: as many samples as a job of the film has at most.
const PART_TILES: u32 = JOB_SAMPLES_MAX as u32 / (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS);

/// A pixel, and what its sample came to.
type SampledPixel = ([u32; 2], (Vec3, LayerPixel));

/// Counts of a preview.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PreviewStats {
    pub(crate) rays: RayCounts,
    pub(crate) samples: u64,
    /// Samples whose ray from the camera met the model.
    pub(crate) covered: u64,
    /// Samples that saw voxels nearer than those of the grid may stand.
    pub(crate) stand_ins: u64,
}

/// Room of a worker.
#[derive(Default)]
struct Room {
    together: Together,
    taken: Vec<SampledPixel>,
    stats: PreviewStats,
}

impl PreviewStats {
    pub(crate) fn add(&mut self, other: &PreviewStats) {
        self.rays.add(&other.rays);
        self.samples += other.samples;
        self.covered += other.covered;
        self.stand_ins += other.stand_ins;
    }
}

/// A grid of pixels, of a picture of `resolution`: every `step`-th.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) resolution: [u32; 2],
    /// One of [`STEPS`].
    pub(crate) step: u32,
    pub(crate) part: GridPart,
    /// Distance from the camera, model units, up to which voxels stand in for mesh that is missing.
    pub(crate) stand_ins_to: f32,
}

impl Grid {
    /// Count of parts that workers take at a time.
    fn part_count(&self) -> u32 {
        tile_count(grid_size(self.resolution, self.step)).div_ceil(PART_TILES)
    }

    /// The pixels of part `index`.
    fn pixels(&self, index: u32) -> impl Iterator<Item = [u32; 2]> {
        let (size, step) = (grid_size(self.resolution, self.step), self.step);
        let tiles = index * PART_TILES..tile_count(size).min((index + 1) * PART_TILES);
        tiles.map(move |index| tile(size, index)).flat_map(move |part| {
            (0..part.pixel_count()).map(move |point| part.pixel(point).map(|v| v * step))
        })
    }

    /// Takes the samples of `work` for `display`, from part `first` on. Gives their counts, and the part to go on with
    /// where `stop`, which is asked before each part and told how many are begun, said true before all were taken.
    ///
    /// # Panics
    /// When a worker panics.
    pub(crate) fn take<T: PagedTracer + Send>(
        &self,
        first: u32,
        work: &SampleWork<'_>,
        display: &mut Display,
        workers: Workers<'_, T>,
        stop: &(dyn Fn(u32) -> bool + Sync),
    ) -> (PreviewStats, Option<u32>) {
        let next = AtomicU32::new(first);
        let (display, total) = (Mutex::new(display), Mutex::new(PreviewStats::default()));
        let take = |tracer: &mut T| {
            let mut room = Room::default();
            // A part that is begun is taken.
            while !stop(next.load(Ordering::Relaxed) - first) {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= self.part_count() {
                    break;
                }
                room.taken.clear();
                let pixels = self.pixels(index).map(|pixel| (pixel, (Vec3::ZERO, LayerPixel::NOTHING)));
                let (grid, shown) = ((self.step, self.part), display.lock().expect("a worker panicked"));
                let wants = |pixel| shown.wants(grid, self.stand_ins_to, pixel);
                room.taken.extend(pixels.filter(|(pixel, _)| wants(*pixel)));
                drop(shown);
                room.take(work, tracer, self.stand_ins_to);
                let mut display = display.lock().expect("a worker panicked");
                for (pixel, (radiance, seen)) in &room.taken {
                    display.set(*pixel, *radiance, seen);
                }
            }
            total.lock().expect("a worker panicked").add(&room.stats);
        };
        workers.pool.scope(|scope| {
            for tracer in workers.tracers {
                scope.spawn(|_| take(tracer));
            }
        });
        let next = Some(next.into_inner()).filter(|&next| next < self.part_count());
        (total.into_inner().expect("a worker panicked"), next)
    }
}

impl Room {
    /// The samples of the pixels to take; voxels nearer than `stand_ins_to` stand in.
    fn take<T: PagedTracer>(&mut self, work: &SampleWork<'_>, tracer: &mut T, stand_ins_to: f32) {
        let Room { together, taken, stats } = self;
        tracer.begin_tile();
        let start = |(slot, (pixel, _)): (u32, &SampledPixel)| {
            OpenSample::new(slot, work.integrator.start_preview(*pixel))
        };
        let pending: Vec<OpenSample> = (0..).zip(&*taken).map(start).collect();
        Samples::new(pending, work.integrator.rays_asked()).finish(work, tracer, together, |slot, sample| {
            stats.rays.add(&sample.rays);
            stats.samples += 1;
            stats.covered += u64::from(sample.meets_model);
            let radiance = if sample.radiance.is_finite() { sample.radiance } else { Vec3::ZERO };
            let seen = sample.layers.unwrap_or(LayerPixel::NOTHING);
            stats.stand_ins += u64::from(seen.is_voxel() && seen.depth < stand_ins_to);
            taken[slot as usize].1 = (radiance, seen);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_film::STEPS;
    use trex_store::Budget;

    #[test]
    fn the_grids_together_hold_no_pixel_twice() {
        for resolution in [[1, 1], [8, 8], [19, 13], [64, 33]] {
            let lease = Budget::unlimited().lease("the picture on show", Display::bytes(resolution)).unwrap();
            let display = Display::in_lease(resolution, lease);
            let mut times = vec![0; (resolution[0] * resolution[1]) as usize];
            for step in STEPS {
                let grid = Grid { resolution, step, part: GridPart::New, stand_ins_to: 0.0 };
                let pixels = (0..grid.part_count()).flat_map(|index| grid.pixels(index));
                for [x, y] in pixels.filter(|pixel| display.wants((step, GridPart::New), 0.0, *pixel)) {
                    assert!(x % step == 0 && y % step == 0);
                    times[(y * resolution[0] + x) as usize] += 1;
                }
                let [columns, rows] = resolution.map(|side| side.div_ceil(step));
                assert_eq!(times.iter().sum::<u32>(), columns * rows, "{resolution:?} {step}");
            }
            assert!(times.iter().all(|&count| count <= 1));
        }
    }
}
