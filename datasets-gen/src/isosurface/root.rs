//! The field of level 0: the large shapes, and the bubbles on their faces.
//!
//! Invariants: 1. plain f32 operations, no fused ones, and square roots: the same bits on every machine; 2. a value
//! depends on the seed and the place alone, and nothing farther away than [`FAR`] is felt.

use crate::dice::mix;
use fastnoise_lite::{FastNoiseLite, NoiseType};
use glam::{Vec2, Vec3, vec2, vec3};

/// Model units: the layer is a square of this side.
pub(super) const LAYER_SIDE: f32 = 100.0;
/// The surface stays within this distance of the plane z = 0, whatever the seed: the root field reaches 18, all
/// bumps together some 3 more.
pub(super) const HALF_HEIGHT: f32 = 24.0;
/// Within this distance of that plane lies what the root field makes.
const ROOT_REACH: f32 = 17.0;

/// The large shapes, in layers: spikes with rolled-up caps over ground with pits, pushed about by a warp, and
/// bubbles on every face of them.
///
/// ```text
///      .-""""-.      cap: half of an ellipsoid
///     ( ) |  | ( )   roll: a ring below its rim, what a vortex leaves
///         |  |       stem, widening
///   ___.-'    '-.__  ground
/// ```
pub(super) struct Root {
    warp: FastNoiseLite,
    seed: u64,
}

/// One spike. Lengths in model units.
struct Spike {
    /// From its axis to the point asked, in the plane.
    across: f32,
    /// Height of the cap's rim.
    rim: f32,
    /// Radius of the rim.
    radius: f32,
}

/// Side of the squares with one spike each, and how high the caps rise above the ground: few large ones among many
/// small ones.
const SPIKES: [(f32, f32); 2] = [(13.5, 13.0), (7.0, 6.5)];
/// Level of the ground.
const GROUND: f32 = -8.0;
/// How far the warp moves a point at most, per octave, and its wavelength.
const WARPS: [(f32, f32); 2] = [(3.6, 13.0), (1.8, 5.5)];
/// Bubbles of one size on every face of the large shapes; one to a cube.
#[derive(Clone, Copy)]
pub(super) struct Bubbles {
    /// Side of the cube.
    pub(super) side: f32,
    /// From the crease between two bubbles to their tops, at most.
    pub(super) height: f32,
}

/// The sizes of bubbles.
const BUBBLES: [Bubbles; 2] = [Bubbles { side: 4.4, height: 1.9 }, Bubbles { side: 2.2, height: 1.0 }];
/// The level at which they join: fine enough for the smallest (a sample has half of its side at most), so coarse
/// that they are the same at every resolution and cost next to nothing.
const BUBBLE_LEVEL: u32 = 1;
/// Part of the height that a bubble's top stands out; its creases are as much lower as is left.
pub(super) const BUBBLE_TOP: f32 = 0.6;
/// Shapes nearer than this to each other grow together.
const BLEND: f32 = 1.6;
/// Distances that matter; farther ones are cut, so that what is far away cannot be felt.
const FAR: f32 = 7.0;

impl Root {
    pub(super) fn new(seed: u64) -> Root {
        let mut warp = FastNoiseLite::with_seed(mix(seed ^ 0x7761_7270) as i32);
        warp.set_noise_type(Some(NoiseType::Perlin));
        warp.set_frequency(Some(1.0));
        Root { warp, seed: mix(seed ^ 0x7370_696b) }
    }

    /// Negative below the interface; about the distance from it.
    pub(super) fn value(&self, at: Vec3) -> f32 {
        if at.z.abs() > ROOT_REACH {
            return at.z.clamp(-FAR, FAR);
        }
        let Vec3 { x, y, z } = self.warped(at);
        let swell = self.warp.get_noise_3d(x / 31.0 + 5.5, y / 31.0, 0.5);
        // Pits: the bubbles that rise the other way.
        let pit = 1.0 - squared_to_bubble(self.seed as u32, vec3(x / 9.0, y / 9.0, 0.5)).min(1.0);
        let mut shape = z - GROUND - 5.0 * swell + 6.0 * pit - 3.0;
        for (side, height) in SPIKES {
            shape = self.near_spikes(vec2(x, y), side).into_iter().fold(shape, |shape, (across, dice)| {
                if across > 0.5 * side + FAR {
                    return shape;
                }
                let part = |i: u32| (dice >> (16 * i) & 0xffff) as f32 / 65536.0;
                let radius = side * (0.2 + 0.12 * part(0));
                let rim = GROUND + 5.0 * swell + height * (0.55 + 0.45 * part(1));
                blend_min(shape, Spike { across, rim, radius }.distance(z))
            });
        }
        let limit = (z - ROOT_REACH).max(-FAR);
        shape.clamp(-FAR, FAR).max(limit).min((z + ROOT_REACH).min(FAR))
    }

    /// Where the fluid at `at` came from: two octaves, the second at the place that the first gives.
    fn warped(&self, at: Vec3) -> Vec3 {
        WARPS.iter().fold(at, |at, &(reach, wave)| {
            let Vec3 { x, y, z } = at / wave;
            let shift = |salt: f32| reach * self.warp.get_noise_3d(x + salt, y - salt, z + 0.7 * salt);
            at + vec3(shift(0.0), shift(17.3), 0.6 * shift(31.9))
        })
    }

    /// Distance across from the nine spikes about `at`, and a random number for each.
    fn near_spikes(&self, at: Vec2, side: f32) -> [(f32, u64); 9] {
        let square = (at / side).floor();
        std::array::from_fn(|i| {
            let cell = square + vec2((i % 3) as f32, (i / 3) as f32) - 1.0;
            let place = (cell.x as i64 as u64) << 32 ^ (cell.y as i64 as u64 & 0xffff_ffff);
            let dice = mix(self.seed ^ place ^ u64::from(side.to_bits()).rotate_left(24));
            let part = |shift: u32| (dice >> shift & 0xffff) as f32 / 65536.0;
            let axis = (cell + 0.2 + 0.6 * vec2(part(32), part(48))) * side;
            (at.distance(axis), dice)
        })
    }
}

impl Spike {
    /// About the distance from the spike at height `z`; negative inside.
    fn distance(&self, z: f32) -> f32 {
        let (radius, up) = (self.radius, z - self.rim);
        let dome = vec2(self.across, 1.5 * up.max(0.0)).length() - radius;
        let cap = dome.max(-up - 0.25 * radius);
        let roll = vec2(self.across - 0.95 * radius, up + 0.3 * radius).length() - 0.42 * radius;
        let below = (-up).max(0.0);
        let stem = (self.across - 0.3 * radius - 0.06 * below).max(up);
        cap.min(roll).min(stem)
    }
}

/// The bubbles that join at `level`.
pub(super) fn bubbles_at(level: u32) -> &'static [Bubbles] {
    if level == BUBBLE_LEVEL { &BUBBLES } else { &[] }
}

/// Squared distance from `at` to the nearest bubble's centre: one centre to a unit cube, in its middle half, so
/// that the eight cubes about a point decide.
pub(super) fn squared_to_bubble(seed: u32, at: Vec3) -> f32 {
    // Arrays: with vectors the loop below is not unrolled as well, and a stream opens a fifth slower.
    let at = at.to_array();
    let corner = at.map(|value| (value - 0.5).floor());
    let cell = corner.map(|value| value as i32 as u32);
    let mut least = f32::INFINITY;
    for i in 0..8u32 {
        let step = [i & 1, i >> 1 & 1, i >> 2];
        let mut dice = seed;
        for axis in 0..3 {
            dice = (dice ^ cell[axis].wrapping_add(step[axis])).wrapping_mul(0x9e37_79b1);
            dice ^= dice >> 15;
        }
        dice = dice.wrapping_mul(0x85eb_ca77);
        let mut squared = 0.0;
        for axis in 0..3 {
            let part = (dice >> (10 * axis) & 1023) as f32 * (0.5 / 1024.0) + 0.25;
            let apart = corner[axis] + step[axis] as f32 + part - at[axis];
            squared += apart * apart;
        }
        least = least.min(squared);
    }
    least
}

/// The lesser of two distances, rounded where both are about the same.
fn blend_min(a: f32, b: f32) -> f32 {
    let near = (1.0 - (a - b).abs() / BLEND).max(0.0);
    a.min(b) - 0.25 * BLEND * near * near
}
