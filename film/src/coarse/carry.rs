//! Light carried on: what was smoothed last is mixed with that of the picture before, where its surfaces are seen
//! again.

use super::history::{History, Reprojection, WorthyLight};
use super::{Coarse, KEPT_STEP, grid_size, planes_mut, smoothed_place};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Most that light before is worth, in pictures of the finest grid: what moves in it, as a reflection does, is gone
/// after some pictures.
const HISTORY_MOST: f32 = 4.0;

impl Coarse {
    /// Bytes that the picture before takes beside them.
    pub(crate) fn history_bytes(resolution: [u32; 2]) -> u64 {
        History::bytes(resolution)
    }

    /// Makes room for the picture before, or takes it away.
    pub(crate) fn keep_history(&mut self, is_kept: bool) {
        self.history = is_kept.then(|| History::new(self.surfaces.len()));
    }

    /// The light on show, of samples at every `step`-th pixel, is from now on that of the picture before. Where it is
    /// not of another light, samples that are new are kept in the world.
    pub(crate) fn remember(&mut self, step: u32, lit_anew: bool) {
        // Those of the finest grid are added when their picture is made.
        if step > KEPT_STEP && !lit_anew {
            self.keep_new(step);
        }
        if let Some(history) = &mut self.history {
            history.exchange(step, &mut self.surfaces);
        }
    }

    /// There is no picture before.
    pub(crate) fn forget(&mut self) {
        if let Some(history) = &mut self.history {
            history.forget();
        }
    }

    /// Mixes the light of the samples at every `step`-th pixel, which were smoothed last and are worth so many
    /// `pictures`, with that before, and keeps it for the next; does nothing without room for a history.
    pub(crate) fn carry(
        &mut self,
        (step, pictures): (u32, f32),
        reprojection: Option<&dyn Reprojection>,
        pool: &ThreadPool,
    ) {
        let Coarse { resolution, surfaces, light, work, history, .. } = self;
        let Some(history) = history else { return };
        let resolution = *resolution;
        let [columns, pitch] = [step, KEPT_STEP].map(|step| grid_size(resolution, step)[0] as usize);
        let stride = (step / KEPT_STEP) as usize;
        let smoothed = &mut work[smoothed_place(resolution, step)];
        // A sample stands for what is around it, since light is smoothed: by the side of that.
        let worth = (pictures * KEPT_STEP as f32 / step as f32).min(HISTORY_MOST);
        let (before, now) = history.parts();
        let is_lit_anew = reprojection.is_some_and(Reprojection::is_lit_anew);
        let [red, green, blue] = planes_mut(smoothed).map(|plane| plane.par_chunks_exact_mut(columns));
        let rows = red.zip(green).zip(blue).zip(now.rows(pitch * stride)).enumerate();
        pool.install(|| {
            rows.for_each(|(y, (((red, green), blue), mut now))| {
                for x in 0..columns {
                    let mut shown = WorthyLight { light: [red[x], green[x], blue[x]].into(), worth };
                    let seen = &surfaces[(y * pitch + x) * stride];
                    let pixel = [x, y].map(|v| v as u32 * step);
                    let carried = reprojection
                        .and_then(|reprojection| before.light((resolution, pixel), seen, reprojection));
                    if let Some(mut carried) = carried {
                        if is_lit_anew {
                            carried = carried.as_near_to(shown.light);
                        }
                        shown = shown.with(carried, HISTORY_MOST);
                        [red[x], green[x], blue[x]] = shown.light.to_array();
                    }
                    now.put(x * stride, shown);
                }
            });
        });
        // Samples of the finest grid keep what is on show.
        if step == KEPT_STEP && reprojection.is_some() {
            light.copy_from_slice(smoothed);
        }
    }
}
