//! `smooth`: what a viewer shows of a picture of few samples a pixel, and how long that takes.
//!
//! ```text
//! trex render -o few.exr --layers ... -> film: the samples' mean, as often as there are samples
//!                                     -> display: learns what each tile saw; refresh; mixed with the samples
//!                                     -> what is shown, as EXR
//! ```
//!
//! The order is that of a live session (`trex_render`, `session/live.rs`), of a view whose preview saw what the samples
//! saw, at the moment when each pixel has that many samples.
//!
//! Invariants: 1. the film has what the file has: nothing is smoothed before; 2. the picture does not depend on threads
//! or rounds; 3. the first round warms memory up, and is not measured.

use crate::channels::Channels;
use crate::median::median;
use crate::model::Surroundings;
use anyhow::{Context, ensure};
use glam::Vec3;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Instant;
use trex_render::{
    Display, Film, Image, LayerPixel, Layers, NO_ID, STEPS, TILE_SIDE_PIXELS, Tiles, write_exr,
};

/// Most samples of a pixel: each is added to the film.
pub const MAX_SAMPLES: u32 = 1024;
/// Any id of a triangle: without it a surface would count as voxels.
const TRIANGLE: u32 = 0;

/// What to smooth.
#[derive(Clone, Debug)]
pub struct SmoothOptions {
    /// An EXR of ours with the layers albedo, normal and depth.
    pub picture: PathBuf,
    /// Where what is shown goes, an EXR.
    pub output: PathBuf,
    /// Samples of each pixel that the picture is the mean of, 1 to [`MAX_SAMPLES`].
    pub samples: u32,
    /// Measured rounds, at least 1.
    pub rounds: usize,
}

/// Times of one picture, medians over the rounds.
#[derive(Clone, Debug, Serialize)]
pub struct SmoothFigures {
    width: u32,
    height: u32,
    sample_count: u32,
    thread_count: usize,
    /// Learning what all tiles saw: once a view, on one thread.
    learn_ms: f64,
    /// The picture made anew with the light of the samples.
    refresh_ms: f64,
    /// Each pixel mixed with its samples.
    mix_ms: f64,
    /// `refresh_ms` and `mix_ms` of a round together.
    filter_ms: f64,
}

/// A picture of few samples, and what each pixel saw.
struct FewSamples {
    resolution: [u32; 2],
    radiances: Vec<[f32; 3]>,
    seen: Vec<LayerPixel>,
}

/// The picture on show.
struct PictureOnShow {
    film: Film,
    display: Display,
    tiles: Tiles,
    radiances: Vec<[f32; 3]>,
}

/// Smooths a picture, writes what is shown and says how long it took.
///
/// # Errors
/// A file that cannot be read or written, layers that are missing, no room in the budget.
pub fn run(options: &SmoothOptions, around: &Surroundings) -> anyhow::Result<SmoothFigures> {
    let SmoothOptions { picture, output, samples, rounds } = options;
    ensure!((1..=MAX_SAMPLES).contains(samples), "samples: accepted are 1 to {MAX_SAMPLES}");
    ensure!(*rounds > 0, "at least one round is measured");
    let few = FewSamples::read(picture).with_context(|| format!("cannot smooth {}", picture.display()))?;
    let pool = ThreadPoolBuilder::new().num_threads(around.threads).build()?;
    let mut shown = PictureOnShow::new(&few, *samples, around, &pool)?;
    let begin = Instant::now();
    shown.learn(&few);
    let learn_ms = milliseconds(begin);
    let (mut refresh, mut mix) = (vec![], vec![]);
    for round in 0..=*rounds {
        let begin = Instant::now();
        shown.display.refresh(&shown.film, &pool);
        let refresh_ms = milliseconds(begin);
        let begin = Instant::now();
        shown.mix(&pool);
        let mix_ms = milliseconds(begin);
        if round > 0 {
            refresh.push(refresh_ms);
            mix.push(mix_ms);
        }
    }
    let filter: Vec<f64> = refresh.iter().zip(&mix).map(|(refresh, mix)| refresh + mix).collect();
    shown.write(output)?;
    let [width, height] = few.resolution;
    Ok(SmoothFigures {
        width,
        height,
        sample_count: *samples,
        thread_count: around.threads,
        learn_ms,
        refresh_ms: median(&refresh),
        mix_ms: median(&mix),
        filter_ms: median(&filter),
    })
}

fn milliseconds(begin: Instant) -> f64 {
    begin.elapsed().as_secs_f64() * 1e3
}

impl FewSamples {
    fn read(path: &Path) -> anyhow::Result<FewSamples> {
        let channels = Channels::read(path)?;
        let normals = channels.colours(["normal.X", "normal.Y", "normal.Z"])?;
        let albedos = channels.colours(["albedo.R", "albedo.G", "albedo.B"])?;
        let surfaces = channels.plane("Z")?.iter().zip(normals).zip(albedos);
        let seen = surfaces.map(|((&depth, normal), albedo)| {
            let id = if depth < f32::INFINITY { TRIANGLE } else { NO_ID };
            LayerPixel { depth, normal, albedo, id, ..LayerPixel::NOTHING }
        });
        Ok(FewSamples {
            resolution: [channels.width, channels.height].map(|side| side as u32),
            radiances: channels.colours(["R", "G", "B"])?,
            seen: seen.collect(),
        })
    }

    fn place(&self, [x, y]: [u32; 2]) -> usize {
        y as usize * self.resolution[0] as usize + x as usize
    }
}

impl PictureOnShow {
    /// The film with `samples` of each pixel, under a preview that saw the same.
    fn new(
        few: &FewSamples,
        samples: u32,
        around: &Surroundings,
        pool: &ThreadPool,
    ) -> anyhow::Result<PictureOnShow> {
        let resolution = few.resolution;
        let mut film = Film::new(resolution, Layers::default(), &around.budget)?;
        let lease = around.budget.lease("the picture on show", Display::bytes(resolution))?;
        let mut display = Display::in_lease(resolution, lease);
        let step = STEPS[STEPS.len() - 1];
        for y in (0..resolution[1]).step_by(step as usize) {
            for x in (0..resolution[0]).step_by(step as usize) {
                let at = few.place([x, y]);
                display.set([x, y], Vec3::from(few.radiances[at]), &few.seen[at]);
            }
        }
        display.show((film.state(), step), false, None, pool);
        let tiles = Tiles::z_curve(resolution);
        for tile in (0..tiles.count()).map(|index| tiles.tile(index)) {
            let radiance = |index| few.radiances[few.place(tile.pixel(index))];
            let radiances: Vec<_> = (0..tile.pixel_count()).map(radiance).collect();
            (0..samples).for_each(|_| film.add(&tile, &radiances));
        }
        Ok(PictureOnShow { film, display, tiles, radiances: vec![[0.0; 3]; few.radiances.len()] })
    }

    /// Learns what the pixels of each tile saw.
    fn learn(&mut self, few: &FewSamples) {
        for tile in (0..self.tiles.count()).map(|index| self.tiles.tile(index)) {
            let seen = |index| (tile.pixel(index), few.seen[few.place(tile.pixel(index))]);
            let seen: Vec<_> = (0..tile.pixel_count()).map(seen).collect();
            self.display.learn(&tile, &seen);
        }
    }

    /// Mixes the picture with the samples.
    fn mix(&mut self, pool: &ThreadPool) {
        let PictureOnShow { film, display, radiances, .. } = self;
        let width = film.resolution()[0];
        let columns = width.div_ceil(TILE_SIDE_PIXELS);
        let rows = radiances.par_chunks_mut(width as usize).enumerate();
        let mix_row = |(y, row): (usize, &mut [[f32; 3]])| {
            let y = y as u32;
            let runs = row.chunks_mut(TILE_SIDE_PIXELS as usize);
            for ((index, first), run) in (y / TILE_SIDE_PIXELS * columns..)
                .zip((0..width).step_by(TILE_SIDE_PIXELS as usize))
                .zip(runs)
            {
                film.radiances([first, y], run);
                let samples = film.tile_samples(index);
                for ((x, shown), own) in (first..).zip(run).zip(display.radiances([first, y])) {
                    *shown = display.mixed((index, [x, y]), (samples, *shown), own);
                }
            }
        };
        pool.install(|| rows.for_each(mix_row));
    }

    fn write(&self, path: &Path) -> anyhow::Result<()> {
        let write = || write_exr(self, BufWriter::new(File::create(path)?));
        write().with_context(|| format!("cannot write {}", path.display()))
    }
}

impl Image for PictureOnShow {
    fn film(&self) -> &Film {
        &self.film
    }

    fn radiance(&self, [x, y]: [u32; 2]) -> [f32; 3] {
        self.radiances[y as usize * self.film.resolution()[0] as usize + x as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::{Budget, Interrupt};

    /// Noise on an even wall goes, what is not on the wall stays, and a file without layers is refused by name.
    #[test]
    fn noise_on_a_wall_is_smoothed() {
        let folder = tempfile::tempdir().unwrap();
        let around = Surroundings {
            threads: 2,
            budget: Budget::unlimited(),
            folder: folder.path().to_owned(),
            interrupt: Interrupt::default(),
        };
        let (few, shown) = (folder.path().join("few.exr"), folder.path().join("shown.exr"));
        let layers = Layers { depth: true, normal: true, albedo: true, ..Layers::default() };
        let mut film = Film::new([24, 16], layers, &around.budget).unwrap();
        let tiles = Tiles::z_curve([24, 16]);
        let wall = LayerPixel {
            depth: 5.0,
            normal: [0.0, 0.0, 1.0],
            albedo: [0.5; 3],
            id: TRIANGLE,
            ..LayerPixel::NOTHING
        };
        for tile in (0..tiles.count()).map(|index| tiles.tile(index)) {
            let light = |[x, y]: [u32; 2]| if x >= 16 { 0.25 } else { ((x + y) % 2 * 2) as f32 };
            let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
            film.add(&tile, &pixels.iter().map(|&pixel| [light(pixel); 3]).collect::<Vec<_>>());
            pixels.iter().filter(|pixel| pixel[0] < 16).for_each(|&pixel| film.set_layers(pixel, &wall));
        }
        write_exr(&film, File::create(&few).unwrap()).unwrap();

        let options = SmoothOptions { picture: few, output: shown.clone(), samples: 1, rounds: 1 };
        let figures = run(&options, &around).unwrap();
        assert_eq!((figures.width, figures.height, figures.sample_count), (24, 16, 1));
        let picture = Channels::read(&shown).unwrap().picture().unwrap();
        for (at, pixel) in picture.pixels.iter().enumerate() {
            match at % 24 {
                0..16 => assert!((pixel[0] - 1.0).abs() < 0.5, "{at}: {pixel:?}"),
                _ => assert_eq!(*pixel, [0.25; 3]),
            }
        }

        let bare = SmoothOptions { picture: shown, ..options };
        assert!(format!("{:#}", run(&bare, &around).unwrap_err()).contains("no channel normal.X"));
    }
}
