//! `Job`: a tile in work: its samples on their way, and what those that are finished came to.

use super::samples::{OpenSample, Samples};
use crate::integrate::{Sample, SampleIntegrator};
use crate::stats::RayCounts;
use crate::trace::Tracer;
use trex_film::{LayerPixel, TILE_SIDE_PIXELS, Tile};

/// Most samples of a pixel in one pass: enough work per tile to pay for its pages, little enough to hold.
pub(crate) const PASS_SAMPLES_MAX: u32 = 4;
/// Most samples of a job: a whole tile in one pass.
pub(super) const JOB_SAMPLES_MAX: usize = (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS * PASS_SAMPLES_MAX) as usize;

/// A tile in work.
pub(super) struct Job {
    pub(super) tile: Tile,
    /// The worker that began it.
    pub(super) home: usize,
    /// Samples not yet finished; their slots are places in `radiances`.
    pub(super) samples: Samples,
    /// Radiances by sample, then by pixel; linear RGB.
    pub(super) radiances: Vec<[f32; 3]>,
    /// The indirect part of `radiances`.
    pub(super) indirect: Vec<[f32; 3]>,
    pub(super) layers: Vec<([u32; 2], LayerPixel)>,
    pub(super) rays: RayCounts,
    pub(super) look_ups: u64,
    pub(super) not_finite: u64,
    /// Finished samples that met the model.
    pub(super) covered: u64,
}

impl Job {
    /// Bytes that a job takes at most.
    pub(super) fn bytes() -> u64 {
        Job::bytes_of(PASS_SAMPLES_MAX)
    }

    /// Bytes that a job of so many samples a pixel takes.
    pub(super) fn bytes_of(samples: u32) -> u64 {
        let samples = (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS * samples) as usize
            * (size_of::<OpenSample>() + 2 * size_of::<[f32; 3]>());
        let pixels = (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS) as usize * size_of::<([u32; 2], LayerPixel)>();
        (samples + pixels) as u64
    }

    /// The next samples of a tile whose pixels have `from`, up to `target`; begun by worker `home`.
    pub(super) fn new(
        integrator: &SampleIntegrator<'_>,
        home: usize,
        tile: Tile,
        [from, target]: [u32; 2],
    ) -> Job {
        let (count, pixels) = ((target - from).min(PASS_SAMPLES_MAX), tile.pixel_count());
        let pending = |slot: u32| {
            let path = integrator.start(tile.pixel(slot % pixels), from + slot / pixels);
            OpenSample::new(slot, path)
        };
        // The samples of a pixel together: rays that are alike are neighbours.
        let pending: Vec<_> = (0..count * pixels).map(|i| pending(i % count * pixels + i / count)).collect();
        Job {
            tile,
            home,
            samples: Samples::new(pending, integrator.rays_asked()),
            radiances: vec![[0.0; 3]; (count * pixels) as usize],
            indirect: vec![[0.0; 3]; (count * pixels) as usize],
            layers: vec![],
            rays: RayCounts::default(),
            look_ups: 0,
            not_finite: 0,
            covered: 0,
        }
    }

    /// Takes all samples as far as the answers go. True when any ray was answered.
    pub(super) fn go_on<T: Tracer>(&mut self, integrator: &SampleIntegrator<'_>, tracer: &mut T) -> bool {
        let mut samples = std::mem::take(&mut self.samples);
        let has_advanced = samples.go_on(integrator, tracer, |slot, sample| self.finish(slot, sample));
        self.samples = samples;
        has_advanced
    }

    /// True when none of its samples is finished: to begin it again loses little.
    pub(super) fn is_fresh(&self) -> bool {
        self.samples.pending.len() == self.radiances.len()
    }

    /// Takes what a sample came to.
    pub(super) fn finish(&mut self, slot: u32, sample: &Sample) {
        let finite = sample.radiance.is_finite();
        self.not_finite += u64::from(!finite);
        self.radiances[slot as usize] = if finite { sample.radiance.into() } else { [0.0; 3] };
        self.indirect[slot as usize] = if finite { sample.indirect.into() } else { [0.0; 3] };
        self.covered += u64::from(sample.meets_model);
        self.rays.add(&sample.rays);
        self.look_ups += sample.look_ups;
        if let Some(seen) = sample.layers {
            self.layers.push((self.tile.pixel(slot % self.tile.pixel_count()), seen));
        }
    }
}
