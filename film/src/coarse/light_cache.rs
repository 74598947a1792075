//! `LightCache`: the light of surfaces, kept where they are in the world.
//!
//! ```text
//! key of a sample -> a bucket of cells -> light over albedo, and how many samples it is worth
//!                    the least worth makes way; the others are worth less then
//! ```
//!
//! So what was seen some views ago has its light at once when the camera comes back, which the picture before cannot
//! give. Samples are mixed with what was kept before their picture, and then added one after the other, so what is
//! shown does not depend on threads.
//!
//! Invariants: 1. light goes with its key alone: what was not seen before has none; 2. the worth of a cell is bounded:
//! what comes later counts for more than what was long ago; 3. nothing is kept over a change of light.

use super::history::WorthyLight;
use crate::light_key::LightKey;
use crate::packed::PackedLight;
use glam::Vec3;

/// Most samples that light in a cell is worth.
const WORTH_MOST: f32 = 16.0;
/// Parts of a sample in which worth is kept.
const WORTH_PARTS: f32 = 256.0;
/// Samples whose cells are brought from memory together.
const TOGETHER: usize = 64;
/// Cells of a bucket.
const WAYS: usize = 4;
/// Most that comes at once: more would leave little of what is kept.
const ADDED_MOST: f32 = WORTH_MOST / 4.0;
/// One of so many parts of its worth is what a cell loses when another of its bucket makes way: so the views that
/// filled the bucket first do not stay for good.
const AGED_PARTS: u16 = 8;
/// Says that the sample of a key has not been mixed with what is kept.
const IS_NEW: u64 = 1 << 63;

#[derive(Clone, Copy, Debug, Default)]
struct LightCell {
    /// Upper half of the key; 0 for none.
    tag: u32,
    light: PackedLight,
    /// In [`WORTH_PARTS`].
    worth: u16,
}

/// The cells, and the keys of the samples that a picture is made of.
#[derive(Debug)]
pub(super) struct LightCache {
    cells: Vec<LightCell>,
    is_empty: bool,
    keys: Vec<u64>,
}

impl LightCache {
    /// Bytes for pictures of so many samples.
    pub(super) fn bytes(samples: usize) -> u64 {
        (LightCache::cell_count(samples) * size_of::<LightCell>() + samples * size_of::<u64>()) as u64
    }

    fn cell_count(samples: usize) -> usize {
        samples.next_power_of_two().max(WAYS)
    }

    /// Of nothing.
    pub(super) fn new(samples: usize) -> LightCache {
        let cells = vec![LightCell::default(); LightCache::cell_count(samples)];
        LightCache { cells, is_empty: true, keys: vec![0; samples] }
    }

    pub(super) fn forget(&mut self) {
        if !std::mem::replace(&mut self.is_empty, true) {
            self.cells.fill(LightCell::default());
        }
    }

    /// Learns where the light of sample `at` is kept, and whether that `is_new`.
    pub(super) fn set_key(&mut self, at: usize, key: LightKey, is_new: bool) {
        let new = if is_new { IS_NEW } else { 0 };
        self.keys[at] = if key == LightKey::NONE { 0 } else { key.bits() | new };
    }

    /// Mixes the light of samples that are new with what is kept of pictures before; each is told by its place in
    /// `light` and its own. Those of one picture are not mixed with each other: what chance brought one would stand for
    /// many.
    pub(super) fn mix(&self, light: [&mut [f32]; 3], mut samples: impl Iterator<Item = (usize, usize)>) {
        let [red, green, blue] = light;
        let mut together = Vec::with_capacity(TOGETHER);
        while self.next_of(&mut samples, &mut together, |(_, at)| *at) {
            for &(to, at) in &together {
                if let Some(kept) = self.kept(at) {
                    let own = WorthyLight { light: Vec3::new(red[to], green[to], blue[to]), worth: 1.0 };
                    [red[to], green[to], blue[to]] = kept.with(own, f32::MAX).light.to_array();
                }
            }
        }
    }

    /// Adds the light of samples that are new, worth one sample each, from their places in `light`.
    pub(super) fn add_new(&mut self, light: [&[f32]; 3], mut samples: impl Iterator<Item = usize>) {
        let [red, green, blue] = light;
        let mut together = Vec::with_capacity(TOGETHER);
        while self.next_of(&mut samples, &mut together, |at| *at) {
            for &at in &together {
                let key = self.keys[at];
                self.keys[at] = key & !IS_NEW;
                if key & IS_NEW != 0 {
                    let light = Vec3::new(red[at], green[at], blue[at]);
                    self.add(key & !IS_NEW, WorthyLight { light, worth: 1.0 });
                }
            }
        }
    }

    /// The next samples together, `at` the places of which their keys stand; false where there are none.
    fn next_of<S>(
        &self,
        left: &mut impl Iterator<Item = S>,
        together: &mut Vec<S>,
        at: impl Fn(&S) -> usize,
    ) -> bool {
        together.clear();
        together.extend(left.take(TOGETHER));
        // Loads that wait for memory together, not one after the other.
        let first_cell = |sample| &self.cells[self.keys[at(sample)] as usize & (self.cells.len() - WAYS)];
        std::hint::black_box(together.iter().fold(0, |all, sample| all ^ first_cell(sample).tag));
        !together.is_empty()
    }

    /// What is kept of the light of sample `at`, where that is new.
    fn kept(&self, at: usize) -> Option<WorthyLight> {
        let key = self.keys[at];
        let first = key as usize & (self.cells.len() - WAYS);
        let tag = (key >> 32) as u32 & !((IS_NEW >> 32) as u32);
        let cell = self.cells[first..first + WAYS].iter().find(|cell| cell.tag == tag);
        cell.filter(|_| key & IS_NEW != 0).map(LightCell::worthy_light)
    }

    /// Adds the light of exact samples in place of sample `at`.
    pub(super) fn add_exact(&mut self, at: usize, own: WorthyLight) {
        let key = self.keys[at] & !IS_NEW;
        if key != 0 {
            self.add(key, WorthyLight { worth: own.worth.min(ADDED_MOST), ..own });
        }
    }

    /// Adds light to what is kept there.
    fn add(&mut self, key: u64, own: WorthyLight) {
        let first = key as usize & (self.cells.len() - WAYS);
        let tag = (key >> 32) as u32;
        let bucket = &mut self.cells[first..first + WAYS];
        let at = bucket.iter().position(|cell| cell.tag == tag);
        let kept = at.map(|at| bucket[at].worthy_light());
        let after = kept.map_or(own, |kept| kept.with(own, WORTH_MOST));
        let at = at.unwrap_or_else(|| {
            bucket.iter_mut().for_each(|cell| cell.worth -= cell.worth / AGED_PARTS);
            (0..WAYS).min_by_key(|&at| bucket[at].worth).expect("a bucket has cells")
        });
        bucket[at] = LightCell {
            tag,
            light: PackedLight::new(after.light.into()),
            worth: (after.worth.min(WORTH_MOST) * WORTH_PARTS) as u16,
        };
        self.is_empty = false;
    }
}

impl LightCell {
    fn worthy_light(&self) -> WorthyLight {
        WorthyLight { light: self.light.rgb().into(), worth: f32::from(self.worth) / WORTH_PARTS }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light_key::LightPlace;

    /// The key of a place of its own.
    fn key(index: u32) -> LightKey {
        LightKey::new(&LightPlace {
            place: [f64::from(index) + 0.5, 0.5, 0.5],
            normal: [0.0, 0.0, 1.0],
            pixel_width: 0.25,
            is_voxel: false,
            seen_from: None,
        })
    }

    /// Adds the light of sample `at`, of `key`, and gives what was kept before.
    fn add(cache: &mut LightCache, at: usize, key: LightKey, light: f32) -> Option<f32> {
        cache.set_key(at, key, true);
        let kept = cache.kept(at);
        cache.add_new([&[light; 2]; 3], std::iter::once(at));
        assert!(cache.kept(at).is_none(), "it is not new any more");
        kept.map(|kept| kept.light.x)
    }

    /// What is kept: nothing, then the mean of the samples before, in which light of long ago ends.
    #[test]
    fn the_mean_of_the_samples_before_is_kept() {
        let mut cache = LightCache::new(1);
        let mut kept = |light: f32| add(&mut cache, 0, key(0), light);
        let is_near =
            |found: Option<f32>, light: f32| found.is_some_and(|found| (found - light).abs() < 1e-2);
        assert_eq!(kept(1.0), None);
        assert!(is_near(kept(4.0), 1.0) && is_near(kept(7.0), 2.5) && is_near(kept(8.0), 4.0));
        let after: Vec<_> = (0..200).map(|_| kept(9.0).unwrap()).collect();
        assert!(after.is_sorted() && after[50] > 8.5 && after[199] > 8.95, "{after:?}");
        cache.forget();
        assert_eq!(add(&mut cache, 0, key(0), 1.0), None);
        cache.set_key(0, LightKey::NONE, true);
        assert!(cache.kept(0).is_none());
    }

    /// The light of one key is never that of another, however many there are; what is worth most makes way last, and in
    /// time all do.
    #[test]
    fn cells_of_little_worth_make_way() {
        let mut cache = LightCache::new(64);
        let light = |index: u32| Vec3::splat(1.0 + index as f32);
        cache.set_key(0, key(0), false);
        cache.add_exact(0, WorthyLight { light: light(0), worth: 8.0 });
        let is_kept = |cache: &mut LightCache| {
            cache.set_key(0, key(0), true);
            cache.kept(0).is_some()
        };
        for index in 1..1000 {
            assert_eq!(add(&mut cache, 1, key(index), light(index).x), None, "{index}");
            // Of 16 buckets each.
            assert!(is_kept(&mut cache) || index > 100, "{index}");
        }
        assert!(!is_kept(&mut cache));
        let found = (0..1000u32).rev().filter(|&index| {
            let found = add(&mut cache, 1, key(index), light(index).x);
            assert!(found.is_none_or(|found| (found - light(index).x).abs() < 0.1), "{index}");
            found.is_some()
        });
        // Those that came last, until those that are asked for take the places of others.
        let found: Vec<_> = found.collect();
        assert!(found[0] == 999 && (16..=64).contains(&found.len()), "{found:?}");
    }
}
