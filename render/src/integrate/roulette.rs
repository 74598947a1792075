//! Roulette: how long paths, and gather rays off mirrors, go on.
//!
//! Invariant: what goes on carries more, by one over its chance, so the mean stays what it is without an end.

use glam::Vec3;

/// Bounces before roulette begins: most light comes by fewer, and has no noise by it.
const BOUNCES_SURE: u32 = 4;
/// Greatest chance to go on after that off a mirror: ends halls of mirrors that lose no light.
pub(super) const MIRROR_CHANCE: f32 = 0.95;
/// And off other surfaces: at an albedo of 0.999 a path has a thousand bounces on average, and by a smaller chance the
/// few that last would carry most of the light.
pub(super) const SURFACE_CHANCE: f32 = 0.999;
/// Most bounces. By roulette one way in 10^7 gets so far; what it would still bring is lost.
pub(super) const BOUNCES_MAX: u32 = 1 << 14;

/// Decides whether a way goes on after so many bounces, with what it can still bring and at most this chance; `draw`
/// gives a number in [0, 1).
pub(super) fn survives(throughput: &mut Vec3, bounces: u32, most: f32, draw: impl FnOnce() -> f32) -> bool {
    if bounces < BOUNCES_SURE {
        return true;
    }
    let chance = throughput.max_element().min(most);
    if bounces == BOUNCES_MAX || draw() >= chance {
        return false;
    }
    *throughput *= 1.0 / chance;
    true
}
