//! `Display`: the picture that a frame shows at once, until the film has samples of the same state.
//!
//! Its samples are taken at every 8th pixel, then every 4th, then every 2nd: a finer grid holds the coarser ones. What
//! is shown between them: see `coarse.rs`.
//!
//! Where light goes on to change after that, what was shown until then takes its place, tile by tile.
//!
//! A pixel with an exact sample says whether the preview saw the same there: the same surface, in the same form. Where
//! it did not, as where voxels stood in for mesh, the preview is worth nothing: it would shine through as a ghost.
//!
//! From time to time the picture is made anew with the light of the exact samples, smoothed as that of the preview was
//! ([`Display::refresh`]): while samples are few it is far less noisy than they are.
//!
//! Invariants: 1. nothing of it is ever on the film; 2. all that is shown is of one event, and of one state until light
//! changes by itself; 3. its memory is leased before it is taken, with the most of what it, the saliency of the picture
//! and the filter take while they work: they take turns, and [`Display::release_work`] makes way.

mod kept;
mod shrinkage;
#[cfg(test)]
mod tests;
mod wanted;

use super::coarse::{Coarse, Reprojection, STEPS, TileCorners};
use super::film::{Film, LayerPixel};
use super::filter::filter_bytes;
use super::packed::{PackedLight, luminance};
use super::saliency;
use super::tile::{TILE_SIDE_PIXELS, Tile, bit, tile, tile_count};
use glam::Vec3;
pub use kept::KeptLight;
use rayon::ThreadPool;
use rayon::prelude::*;
use shrinkage::TileLuminances;
use trex_store::Lease;
pub use wanted::GridPart;

/// Samples of a pixel that the picture of the first rays is worth: it is smoothed over neighbours of one surface
/// (`coarse.rs`), so it is as near to the truth as one or two samples are.
const FIRST_WORTH: f32 = 1.5;

/// How many times brighter than the picture on show a pixel of no sample would count.
const HIT_MOST: f32 = 8.0;

/// Samples of a pixel that what was shown before light changed by itself is worth at most: it is of the light before.
const BEFORE_WORTH_MOST: f32 = 4.0;

/// Parts of a sample in which worth is kept.
const WORTH_PARTS: f32 = 64.0;

/// What the display shows of a tile: the state that it is of, samples of a pixel that it is worth, and where: a bit a
/// pixel, by rows.
#[derive(Clone, Copy, Debug)]
struct TileWorth {
    state: u32,
    /// In [`WORTH_PARTS`].
    worth: u16,
    /// What is shown was mixed with samples before light changed by itself.
    holds_samples: bool,
    /// Some of its samples are not shown yet.
    has_new: bool,
    pixels: u64,
    /// What exact samples found pixels to be of one surface with; nothing before there are any.
    corners: TileCorners,
}

const _: () = assert!(TILE_SIDE_PIXELS * TILE_SIDE_PIXELS == u64::BITS);

impl TileWorth {
    /// The preview's, before anything is known of what is there.
    fn of_preview(state: u32) -> TileWorth {
        let corners = TileCorners::default();
        let worth =
            TileWorth { state, worth: 0, holds_samples: false, has_new: false, pixels: u64::MAX, corners };
        worth.with(FIRST_WORTH)
    }

    /// Worth so many samples of a pixel.
    fn with(self, worth: f32) -> TileWorth {
        TileWorth { worth: (worth * WORTH_PARTS).round() as u16, ..self }
    }

    /// Samples of a pixel that it is worth.
    fn samples(&self) -> f32 {
        f32::from(self.worth) / WORTH_PARTS
    }
}

/// Luminances of a tile: of the samples on `film`, and on show in `radiance`, by rows.
fn luminances(tile: Tile, film: &Film, radiance: &[PackedLight]) -> TileLuminances {
    let Tile { first: [x, first], size: [width, height], .. } = tile;
    let mut luminances = TileLuminances::default();
    for (y, row) in (first..first + height).zip(&mut luminances) {
        let mut exact = [[0.0; 3]; TILE_SIDE_PIXELS as usize];
        let exact = &mut exact[..width as usize];
        film.radiances([x, y], exact);
        let shown = &radiance[y as usize * film.resolution()[0] as usize + x as usize..];
        for ((pair, exact), shown) in row.iter_mut().zip(exact).zip(shown) {
            *pair = [luminance(Vec3::from(*exact)), luminance(shown.rgb().into())];
        }
    }
    luminances
}

/// The picture where the film has none.
#[derive(Debug)]
pub struct Display {
    resolution: [u32; 2],
    /// What is shown, by rows.
    radiance: Vec<PackedLight>,
    /// What `radiance` is made of.
    coarse: Coarse,
    /// The state of the first rays on show and the step of their grid; `None` before the first picture.
    shown: Option<(u32, u32)>,
    /// It was shown after the last event.
    is_fresh: bool,
    /// Per tile; says nothing before the first picture.
    standings: Vec<TileWorth>,
    /// Only the pixels of samples show it yet.
    is_sparse: bool,
    refreshes: u32,
    lease: Lease,
    /// Of the picture before, if it is kept.
    history_lease: Option<Lease>,
    /// Of light in the world, if it is kept.
    cache_lease: Option<Lease>,
}

impl Display {
    /// Bytes that a display takes at `resolution` (width, height; pixels), and one of three works that never meet: on
    /// its samples, on its saliency, and the filter's on the film beside it.
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        let work = Coarse::work_bytes(resolution)
            .max(saliency::work_bytes(tile_count(resolution)))
            .max(filter_bytes(resolution));
        pixels * size_of::<PackedLight>() as u64
            + u64::from(tile_count(resolution)) * size_of::<TileWorth>() as u64
            + Coarse::bytes(resolution)
            + work
    }

    /// A display of `resolution` (width, height; pixels) that shows nothing, in a lease of [`Display::bytes`].
    pub fn in_lease(resolution: [u32; 2], lease: Lease) -> Display {
        let radiance = vec![PackedLight::default(); resolution[0] as usize * resolution[1] as usize];
        Display {
            resolution,
            radiance,
            coarse: Coarse::new(resolution),
            shown: None,
            is_fresh: false,
            standings: vec![TileWorth::of_preview(0); tile_count(resolution) as usize],
            is_sparse: false,
            refreshes: 0,
            lease,
            history_lease: None,
            cache_lease: None,
        }
    }

    /// Leaves the room for its work to another, until the next [`Display::show`]. What is on show is filled in.
    pub fn release_work(&mut self, pool: &ThreadPool) {
        self.fill(pool);
        self.coarse.release_work();
    }

    /// The lease of its memory.
    pub fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }

    /// The state of the first rays on show; `None` before the first picture.
    pub fn state(&self) -> Option<u32> {
        self.shown.map(|(state, _)| state)
    }

    /// The state that tile `index` shows; `None` before the first picture.
    pub fn tile_state(&self, index: u32) -> Option<u32> {
        self.shown.map(|_| self.standings[index as usize].state)
    }

    /// Samples of a pixel that what is shown at (x, y), in tile `index`, is worth beside exact ones.
    pub fn worth(&self, index: u32, pixel: [u32; 2]) -> f32 {
        let standing = self.standings[index as usize];
        if standing.pixels >> bit(pixel) & 1 == 1 { standing.samples() } else { 0.0 }
    }

    /// Radiance at pixel (x, y) of tile `index` whose so many exact samples have the mean `exact`, where the display
    /// shows `own`. Chance hits far brighter than that count up to a bound, which rises with the samples.
    pub fn mixed(
        &self,
        (index, pixel): (u32, [u32; 2]),
        (samples, exact): (u32, [f32; 3]),
        own: [f32; 3],
    ) -> [f32; 3] {
        let worth = self.worth(index, pixel);
        let share = worth / (worth + samples as f32);
        let exact = Vec3::from(exact);
        let (bright, most) = (luminance(exact), HIT_MOST * (samples + 1) as f32 * luminance(own.into()));
        let exact = if share > 0.0 && most > 0.0 && bright > most { exact * (most / bright) } else { exact };
        exact.lerp(own.into(), share).into()
    }

    /// Learns what the first exact samples of pixels (x, y) of `tile` saw. Where the preview saw something else it is
    /// worth nothing from now on.
    pub fn learn(&mut self, tile: &Tile, seen: &[([u32; 2], LayerPixel)]) {
        let step = self.step().unwrap_or(STEPS[0]);
        let standing = &mut self.standings[tile.index as usize];
        // Samples after the first of a pixel say nothing of what it saw.
        if standing.holds_samples || seen.is_empty() {
            return;
        }
        for (pixel, seen) in seen {
            let is_same = u64::from(self.coarse.is_same((step, *pixel), seen));
            standing.pixels = standing.pixels & !(1 << bit(*pixel)) | is_same << bit(*pixel);
        }
        standing.corners = self.coarse.set_seen(seen);
    }

    fn tile_at(&self, pixel: [u32; 2]) -> usize {
        let [x, y] = pixel.map(|v| v / TILE_SIDE_PIXELS);
        (y * self.resolution[0].div_ceil(TILE_SIDE_PIXELS) + x) as usize
    }

    /// Shows the samples of the finest grid beside the exact ones of their state on `film`, whose tiles have all been
    /// learned.
    pub fn show_beside(&mut self, film: &Film, reprojection: Option<&dyn Reprojection>, pool: &ThreadPool) {
        self.make_anew((film, true), reprojection, pool);
        let (state, step) = (film.state(), STEPS[STEPS.len() - 1]);
        self.shown = Some((state, step));
        for (_, standing) in
            (0..).zip(&mut self.standings).filter(|(index, _)| film.tile_samples(*index) == 0)
        {
            *standing = TileWorth::of_preview(state);
        }
    }

    /// Makes the picture anew with the light of the exact samples on `film`, whose tiles have all been learned, and of
    /// those taken again; does nothing where it shows no picture of the finest grid, or one of another state beside
    /// which not all pixels have a sample yet.
    pub fn refresh(&mut self, film: &Film, pool: &ThreadPool) {
        let (state, finest) = (film.state(), STEPS[STEPS.len() - 1]);
        if !self.shown.is_some_and(|(of, step)| step == finest && (of == state || film.samples() > 0)) {
            return;
        }
        if self.shown.replace((state, finest)) != Some((state, finest)) {
            // Nothing of the light before is left in it.
            self.standings.iter_mut().for_each(|standing| standing.holds_samples = false);
        }
        self.make_anew((film, false), None, pool);
        self.refreshes = self.refreshes.wrapping_add(1);
    }

    /// Makes a picture of the finest grid, with the light of the exact samples on `film`; of other tiles those stay as
    /// they are whose samples are shown already, unless `all_is_new`.
    fn make_anew(
        &mut self,
        (film, all_is_new): (&Film, bool),
        reprojection: Option<&dyn Reprojection>,
        pool: &ThreadPool,
    ) {
        let step = STEPS[STEPS.len() - 1];
        let Display { resolution, radiance, coarse, standings, .. } = self;
        // A picture of first rays over exact samples knows nothing of what these saw.
        let corners = |index: u32| {
            let corners = standings[index as usize].corners;
            Some(corners).filter(|corners| film.tile_samples(index) > 0 && corners.any() != 0)
        };
        let is_new =
            |index: u32| corners(index).is_none() && (all_is_new || standings[index as usize].has_new);
        coarse.recall(&is_new, pool);
        coarse.take_light(film, &corners, pool);
        coarse.keep_exact(&|index| film.tile_samples(index));
        coarse.smooth_exact(&|index| corners(index).is_none() && !is_new(index), pool);
        // A picture of the finest grid has one sample where these are of some pixels.
        coarse.carry((step, 1.0 + film.samples() as f32), reprojection, pool);
        coarse.fill(step, &corners, radiance, pool);
        pool.install(|| {
            standings.par_iter_mut().enumerate().for_each(|(index, standing)| {
                standing.has_new = false;
                let samples = film.tile_samples(index as u32);
                if samples > 0 && standing.corners.any() != 0 {
                    standing.pixels = standing.corners.any();
                    let luminances = luminances(tile(*resolution, index as u32), film, radiance);
                    *standing = standing.with(shrinkage::worth(&luminances, standing.pixels, samples));
                }
            });
        });
        (self.is_sparse, self.is_fresh) = (false, true);
    }

    /// How often the picture was made anew, so far.
    pub fn refreshes(&self) -> u32 {
        self.refreshes
    }

    /// Shows `radiances` from pixel (x, y) on: what is on show there, the display's own picture with that of samples.
    pub fn keep(&mut self, [x, y]: [u32; 2], radiances: &[[f32; 3]]) {
        let first = y as usize * self.resolution[0] as usize + x as usize;
        for (kept, &radiance) in self.radiance[first..].iter_mut().zip(radiances) {
            *kept = PackedLight::new(radiance);
        }
    }

    /// What tile `index` shows counts from now on as of `state`, and for so many `samples` more.
    pub fn stand(&mut self, index: u32, state: u32, samples: u32) {
        let standing = &mut self.standings[index as usize];
        let worth = (standing.samples() + samples as f32).min(BEFORE_WORTH_MOST);
        // What was shown with samples in it is of what they saw, however often light changes after that.
        let holds_samples = samples > 0 || standing.holds_samples;
        let pixels = if holds_samples { u64::MAX } else { standing.pixels };
        *standing = TileWorth { state, holds_samples, pixels, ..*standing }.with(worth);
    }

    /// Pixels from sample to sample of what is on show; `None` before the first picture.
    pub fn step(&self) -> Option<u32> {
        self.shown.map(|(_, step)| step)
    }

    /// Radiance on show from pixel (x, y) on, by rows, linear RGB.
    pub fn radiances(&self, [x, y]: [u32; 2]) -> impl Iterator<Item = [f32; 3]> {
        let first = y as usize * self.resolution[0] as usize + x as usize;
        self.radiance[first..].iter().map(|radiance| radiance.rgb())
    }

    /// Sets the sample of a pixel (x, y), one of the finest grid: its radiance, linear RGB, and what it saw.
    pub fn set(&mut self, pixel: [u32; 2], radiance: Vec3, seen: &LayerPixel) {
        self.coarse.set(pixel, radiance, seen);
        let index = self.tile_at(pixel);
        self.standings[index].has_new = true;
    }

    /// Shows the samples at every `step`-th pixel, all of which are of `state`; where `is_sparse` at their own pixels
    /// alone, for the time being.
    pub fn show(
        &mut self,
        (state, step): (u32, u32),
        is_sparse: bool,
        reprojection: Option<&dyn Reprojection>,
        pool: &ThreadPool,
    ) {
        self.coarse.smooth(step, pool);
        self.coarse.carry((step, 1.0), reprojection, pool);
        (self.shown, self.is_sparse, self.is_fresh) = (Some((state, step)), true, true);
        self.standings.fill(TileWorth::of_preview(state));
        if is_sparse {
            self.coarse.set_samples(step, &mut self.radiance);
        } else {
            self.fill(pool);
        }
    }

    /// Fills in the pixels between the samples that are shown, where that is still to be done.
    pub fn fill(&mut self, pool: &ThreadPool) {
        if let Some((_, step)) = self.shown.filter(|_| std::mem::take(&mut self.is_sparse)) {
            let standings = &self.standings;
            let known =
                |index: u32| Some(standings[index as usize].corners).filter(|corners| corners.any() != 0);
            self.coarse.fill(step, &known, &mut self.radiance, pool);
        }
    }
}
