//! `LightCache`: the light of surfaces, kept where they are in the world.
//!
//! ```text
//! key of a sample -> a bucket of cells -> light over albedo, and how many samples it is worth
//!                    the least worth makes way
//! ```
//!
//! So what was seen some views ago has its light at once when the camera comes back, which the picture before cannot
//! give. Samples are mixed with what is kept one after the other, so what is shown does not depend on threads.
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
/// Cells of a bucket.
const WAYS: usize = 4;
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

    /// Learns where the light of sample `at` is kept.
    pub(super) fn set_key(&mut self, at: usize, key: LightKey) {
        self.keys[at] = if key == LightKey::NONE { 0 } else { key.bits() | IS_NEW };
    }

    /// The tag of the first cell that light of sample `at` may be in.
    pub(super) fn first_tag(&self, at: usize) -> u32 {
        self.cells[self.keys[at] as usize & (self.cells.len() - WAYS)].tag
    }

    /// Adds the `light` of sample `at`, where that is new, worth one sample, and gives it mixed with what was kept.
    pub(super) fn mix(&mut self, at: usize, light: Vec3) -> Option<Vec3> {
        let key = self.keys[at];
        if key & IS_NEW == 0 {
            return None;
        }
        self.keys[at] = key & !IS_NEW;
        let own = WorthyLight { light, worth: 1.0 };
        self.add(key & !IS_NEW, own).map(|kept| kept.with(own, f32::MAX).light)
    }

    /// Adds the `light` of exact samples in place of sample `at`.
    pub(super) fn add_exact(&mut self, at: usize, own: WorthyLight) {
        let key = self.keys[at] & !IS_NEW;
        if key != 0 {
            self.add(key, own);
        }
    }

    /// Adds light, and gives what was kept there.
    fn add(&mut self, key: u64, own: WorthyLight) -> Option<WorthyLight> {
        let first = key as usize & (self.cells.len() - WAYS);
        let tag = (key >> 32) as u32;
        let bucket = &mut self.cells[first..first + WAYS];
        let at = bucket.iter().position(|cell| cell.tag == tag);
        let kept = at.map(|at| bucket[at].worthy_light());
        let after = kept.map_or(own, |kept| kept.with(own, WORTH_MOST));
        let least = || (0..WAYS).min_by_key(|&at| bucket[at].worth).expect("a bucket has cells");
        let at = at.unwrap_or_else(least);
        bucket[at] = LightCell {
            tag,
            light: PackedLight::new(after.light.into()),
            worth: (after.worth.min(WORTH_MOST) * WORTH_PARTS) as u16,
        };
        self.is_empty = false;
        kept
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

    /// What a sample is mixed with: nothing, then the mean of those before, in which light of long ago ends.
    #[test]
    fn a_sample_is_mixed_with_those_before_it_once() {
        let mut cache = LightCache::new(1);
        let mut mixed = |light: f32| {
            cache.set_key(0, key(0));
            let mixed = cache.mix(0, Vec3::splat(light));
            assert_eq!(cache.mix(0, Vec3::splat(light)), None);
            mixed.map(|light| light.x)
        };
        let is_near =
            |found: Option<f32>, light: f32| found.is_some_and(|found| (found - light).abs() < 1e-2);
        assert_eq!(mixed(1.0), None);
        assert!(is_near(mixed(4.0), 2.5) && is_near(mixed(7.0), 4.0));
        let after: Vec<_> = (0..200).map(|_| mixed(9.0).unwrap()).collect();
        assert!(after.is_sorted() && after[50] > 8.5 && after[199] > 8.95, "{after:?}");
        cache.forget();
        cache.set_key(0, key(0));
        assert_eq!(cache.mix(0, Vec3::ONE), None);
        cache.set_key(0, LightKey::NONE);
        assert_eq!(cache.mix(0, Vec3::ONE), None);
    }

    /// The light of one key is never that of another, however many there are; what is worth most stays.
    #[test]
    fn cells_of_little_worth_make_way() {
        let mut cache = LightCache::new(64);
        let light = |index: u32| Vec3::splat(1.0 + index as f32);
        cache.set_key(0, key(0));
        cache.add_exact(0, WorthyLight { light: light(0), worth: 8.0 });
        for index in 1..1000 {
            cache.set_key(1, key(index));
            assert_eq!(cache.mix(1, light(index)), None, "{index}");
        }
        let found = (0..1000u32).filter(|&index| {
            cache.set_key(1, key(index));
            let found = cache.mix(1, light(index));
            assert!(found.is_none_or(|found| (found - light(index)).abs().max_element() < 0.1), "{index}");
            found.is_some()
        });
        // Those that are asked for take the places of others on the way.
        let found: Vec<_> = found.collect();
        assert!(found[0] == 0 && (2..=64).contains(&found.len()), "{found:?}");
    }
}
