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
//! Invariants: 1. nothing of it is ever on the film; 2. all that is shown is of one event, and of one state until light
//! changes by itself; 3. its memory is leased before it is taken, with the most of what it, the saliency of the picture
//! and the filter take while they work: they take turns, and [`Display::release_work`] makes way.

use super::coarse::Coarse;
use super::film::LayerPixel;
use super::filter::filter_bytes;
use super::packed::PackedLight;
use super::saliency;
use super::tile::{TILE_SIDE_PIXELS, Tile, tile_count};
use glam::Vec3;
use rayon::ThreadPool;
use trex_store::Lease;

/// Samples of a pixel that the picture of the first rays is worth: it is smoothed over neighbours of one surface
/// (`coarse.rs`), so it is as near to the truth as one or two samples are.
const FIRST_WORTH: f32 = 1.5;

/// Samples of a pixel that what was shown before light changed by itself is worth at most: it is of the light before.
const BEFORE_WORTH_MOST: f32 = 4.0;

/// What the display shows of a tile: the state that it is of, samples of a pixel that it is worth, and where: a bit a
/// pixel, by rows.
#[derive(Clone, Copy, Debug)]
struct TileWorth {
    state: u32,
    worth: f32,
    pixels: u64,
}

const _: () = assert!(TILE_SIDE_PIXELS * TILE_SIDE_PIXELS == u64::BITS);

impl TileWorth {
    /// The preview's, before anything is known of what is there.
    fn of_preview(state: u32) -> TileWorth {
        TileWorth { state, worth: FIRST_WORTH, pixels: u64::MAX }
    }

    /// True when samples were in what is shown: it is more than the preview.
    fn holds_samples(&self) -> bool {
        self.worth > FIRST_WORTH
    }
}

/// The bit of a pixel (x, y) in those of its tile.
fn bit([x, y]: [u32; 2]) -> u32 {
    y % TILE_SIDE_PIXELS * TILE_SIDE_PIXELS + x % TILE_SIDE_PIXELS
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
    /// Per tile; says nothing before the first picture.
    standings: Vec<TileWorth>,
    /// Only the pixels of samples show it yet.
    is_sparse: bool,
    lease: Lease,
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
            standings: vec![TileWorth::of_preview(0); tile_count(resolution) as usize],
            is_sparse: false,
            lease,
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
        let TileWorth { worth, pixels, .. } = self.standings[index as usize];
        if pixels >> bit(pixel) & 1 == 1 { worth } else { 0.0 }
    }

    /// Learns what the first exact samples of pixels (x, y) of `tile` saw. Where the preview saw something else it is
    /// worth nothing from now on.
    pub fn learn(&mut self, tile: &Tile, seen: &[([u32; 2], LayerPixel)]) {
        let standing = &mut self.standings[tile.index as usize];
        if standing.holds_samples() {
            return;
        }
        for (pixel, seen) in seen {
            let is_same = u64::from(self.coarse.is_same(*pixel, seen));
            standing.pixels = standing.pixels & !(1 << bit(*pixel)) | is_same << bit(*pixel);
        }
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
        let worth = (standing.worth + samples as f32).min(BEFORE_WORTH_MOST);
        // What was shown with samples in it is of what they saw.
        let pixels = if samples > 0 { u64::MAX } else { standing.pixels };
        *standing = TileWorth { state, worth, pixels };
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
    }

    /// Shows the samples at every `step`-th pixel, all of which are of `state`; where `is_sparse` at their own pixels
    /// alone, for the time being.
    pub fn show(&mut self, state: u32, step: u32, is_sparse: bool, pool: &ThreadPool) {
        self.coarse.smooth(step, pool);
        (self.shown, self.is_sparse) = (Some((state, step)), true);
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
            self.coarse.fill(step, &mut self.radiance, pool);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coarse::STEPS;
    use crate::film::NO_ID;
    use crate::hash::mix;
    use crate::testing::pool;
    use trex_store::Budget;

    const RESOLUTION: [u32; 2] = [19, 13];

    /// What pixel (x, y) saw: two surfaces, left and right of column 10.
    fn seen([x, _]: [u32; 2]) -> LayerPixel {
        let depth = if x < 10 { 5.0 } else { 9.0 };
        LayerPixel { depth, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 0 }
    }

    /// A display with a sample at every `step`-th pixel.
    fn shown(step: u32, radiance: impl Fn([u32; 2]) -> f32) -> Display {
        let mut display = display(RESOLUTION);
        set_samples(&mut display, step, radiance);
        display.show(7, step, false, &pool(2));
        assert_eq!((display.state(), display.step()), (Some(7), Some(step)));
        display
    }

    fn set_samples(display: &mut Display, step: u32, radiance: impl Fn([u32; 2]) -> f32) {
        for y in (0..RESOLUTION[1]).step_by(step as usize) {
            for x in (0..RESOLUTION[0]).step_by(step as usize) {
                display.set([x, y], Vec3::splat(radiance([x, y])), &seen([x, y]));
            }
        }
    }

    /// What is on show at a pixel.
    fn at(display: &Display, pixel: [u32; 2]) -> [f32; 3] {
        display.radiances(pixel).next().unwrap()
    }

    fn pixels() -> impl Iterator<Item = [u32; 2]> {
        (0..RESOLUTION[1]).flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]))
    }

    /// A slope is its own mean, away from edges.
    fn display(resolution: [u32; 2]) -> Display {
        let lease = Budget::unlimited().lease("the picture on show", Display::bytes(resolution)).unwrap();
        Display::in_lease(resolution, lease)
    }

    #[test]
    fn a_slope_stays_a_slope_between_samples() {
        let slope = |[x, y]: [u32; 2]| x as f32 + 10.0 * y as f32;
        let mut display = display([64, 64]);
        for (x, y) in (0..64).step_by(2).flat_map(|y| (0..64).step_by(2).map(move |x| (x, y))) {
            display.set([x, y], Vec3::splat(slope([x, y])), &seen([0, 0]));
        }
        display.show(0, 2, false, &pool(2));
        for pixel in (14..48).flat_map(|y| (14..48).map(move |x| [x, y])) {
            let found = at(&display, pixel)[0];
            // To the precision of what is kept.
            assert!((found - slope(pixel)).abs() < 1e-4 * 1024.0, "{pixel:?}: {found}");
        }
    }

    /// Light by chance, of mean 1: its variance falls as the smoothing's weights say.
    #[test]
    fn noise_is_smoothed() {
        let noise = |[x, y]: [u32; 2]| 2.0 * (mix(u64::from(x) << 32 | u64::from(y)) % 1000) as f32 / 999.0;
        let mut display = display([128, 128]);
        for pixel in (0..128).step_by(2).flat_map(|y| (0..128).step_by(2).map(move |x| [x, y])) {
            display.set(pixel, Vec3::splat(noise(pixel)), &seen([0, 0]));
        }
        display.show(0, 2, false, &pool(2));
        let pixels = || (0..128).flat_map(|y| (0..128).map(move |x| [x, y]));
        let value = |pixel| f64::from(at(&display, pixel)[0]);
        let mean = pixels().map(value).sum::<f64>() / 128.0f64.powi(2);
        let variance = pixels().map(|pixel| (value(pixel) - mean).powi(2)).sum::<f64>() / 128.0f64.powi(2);
        assert!((mean - 1.0).abs() < 0.03 && variance < 0.03 / 3.0, "{mean} {variance}");
    }

    #[test]
    fn nothing_bleeds_over_the_edge_of_a_surface() {
        for step in STEPS {
            let display = shown(step, |[x, _]| if x < 10 { 1.0 } else { 3.0 });
            for pixel in pixels() {
                let found = at(&display, pixel)[0];
                assert!(
                    [1.0, 3.0].iter().any(|value| (found - value).abs() < 1e-3),
                    "{step} {pixel:?}: {found}"
                );
                // The edge is off by less than the step.
                let (before, after) = (pixel[0] + step <= 10, pixel[0] >= 10 + step);
                assert!(!before || found < 2.0);
                assert!(!after || found > 2.0);
            }
        }
    }

    /// The one tile of a picture whose pixels all saw `seen`.
    fn learn(display: &mut Display, saw: impl Fn([u32; 2]) -> LayerPixel) {
        let tile = crate::tile::tile(RESOLUTION, 0);
        let saw: Vec<_> = (0..64).map(|index| tile.pixel(index)).map(|pixel| (pixel, saw(pixel))).collect();
        display.learn(&tile, &saw);
    }

    #[test]
    fn a_preview_is_worth_nothing_where_exact_samples_saw_something_else() {
        let same = seen([0, 0]);
        let turned = LayerPixel { normal: [0.8, 0.0, 0.6], ..same };
        let other = [
            LayerPixel { depth: 5.6, ..same },
            LayerPixel { id: NO_ID, ..same },
            LayerPixel { albedo: [0.5, 0.5, 0.7], ..same },
            turned,
            LayerPixel::NOTHING,
        ];
        for other in other {
            let mut display = shown(2, |_| 1.0);
            learn(&mut display, |[x, y]| if x < 3 && y > 4 { other } else { LayerPixel { id: 77, ..same } });
            for [x, y] in pixels().filter(|[x, y]| *x < 8 && *y < 8) {
                let expected = if x < 3 && y > 4 { 0.0 } else { FIRST_WORTH };
                assert_eq!(display.worth(0, [x, y]), expected, "{other:?} {x} {y}");
            }
            assert_eq!(display.worth(1, [8, 5]), FIRST_WORTH, "nothing is known of other tiles");
            // What holds samples is of what they saw, whatever the preview was of; the next preview begins anew.
            display.stand(0, 8, 1);
            learn(&mut display, |_| other);
            assert_eq!(display.worth(0, [0, 5]), FIRST_WORTH + 1.0);
            display.show(9, 2, false, &pool(1));
            assert_eq!(display.worth(0, [0, 5]), FIRST_WORTH);
        }
    }

    /// Voxels on show count where exact samples saw them, too: behind the cut of the footprint rule they are the model.
    #[test]
    fn voxels_beside_voxels_and_nothing_beside_nothing_are_the_same() {
        for saw in [LayerPixel { id: NO_ID, ..seen([0, 0]) }, LayerPixel::NOTHING] {
            let mut display = display(RESOLUTION);
            pixels().filter(|[x, y]| x % 2 == 0 && y % 2 == 0).for_each(|pixel| {
                display.set(pixel, Vec3::ONE, &saw);
            });
            display.show(0, 2, false, &pool(1));
            learn(&mut display, |_| saw);
            assert!((0..64).all(|at| display.worth(0, [at % 8, at / 8]) == FIRST_WORTH), "{saw:?}");
            learn(&mut display, |_| seen([0, 0]));
            assert!((0..64).all(|at| display.worth(0, [at % 8, at / 8]) == 0.0), "{saw:?}");
        }
    }

    #[test]
    fn a_sparse_picture_is_that_of_its_samples_until_it_is_filled() {
        let light = |[x, y]: [u32; 2]| (mix(u64::from(x * 100 + y)) % 100) as f32 / 99.0;
        for step in STEPS {
            let whole = shown(step, light);
            let mut sparse = shown(step, light);
            set_samples(&mut sparse, step, light);
            sparse.radiance.fill(PackedLight::new([7.0; 3]));
            sparse.show(8, step, true, &pool(2));
            for pixel in pixels() {
                let is_sample = pixel.iter().all(|v| v % step == 0);
                let expected = if is_sample { at(&whole, pixel) } else { [7.0; 3] };
                assert_eq!(at(&sparse, pixel), expected, "{step} {pixel:?}");
            }
            (0..2).for_each(|_| sparse.fill(&pool(2)));
            assert_eq!((sparse.radiance == whole.radiance, sparse.state()), (true, Some(8)), "{step}");
        }
    }
}
