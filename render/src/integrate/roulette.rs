//! Roulette: how long paths, and gather rays off mirrors, go on.
//!
//! Invariant: what goes on carries more, by one over its chance, so the mean stays what it is without an end.

use glam::Vec3;

/// Bounces before roulette begins: most light comes by fewer, and has no noise by it.
const BOUNCES_SURE: u32 = 4;
/// Greatest chance to go on after that; ends halls of mirrors that lose no light.
const ROULETTE_MAX: f32 = 0.95;
/// Most bounces. By roulette one way in 400,000 gets so far; what it would still bring is lost.
pub(super) const BOUNCES_MAX: u32 = 256;

/// Decides whether a way goes on after so many bounces, with what it can still bring; `number` gives one in [0, 1).
pub(super) fn survives(throughput: &mut Vec3, bounces: u32, number: impl FnOnce() -> f32) -> bool {
    if bounces < BOUNCES_SURE {
        return true;
    }
    let chance = throughput.max_element().min(ROULETTE_MAX);
    if bounces == BOUNCES_MAX || number() >= chance {
        return false;
    }
    *throughput *= 1.0 / chance;
    true
}
