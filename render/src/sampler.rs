//! `Sampler`: the random numbers of one sample of one pixel. Owen-scrambled Sobol points (B. Burley, "Practical
//! hash-based Owen scrambling", JCGT 9 (2020)), padded: each decision has points of its own, stratified over the
//! samples of the pixel, and decisions are decorrelated by their seeds.
//!
//! Invariants: 1. a number is a pure function of (seed, pixel, decision, index): no state, so a sample may be
//! interrupted, retried and moved between threads; 2. all numbers are in [0, 1).

use sobol_burley::parts::{hash, owen_scramble_rev, sobol_rev, u32_to_f32_norm};
use std::sync::LazyLock;
use trex_film::mix;

/// Longest sequence that the Sobol tables hold; longer ones go on in a sequence with another seed.
const SEQUENCE_BITS: u32 = 16;

/// The numbers that the first and the second eight bits of a place in the sequence stand for, their bits reversed: the
/// Sobol point of a place is the exclusive or of both. The crate's own walk over the bits takes three times as long.
static SOBOL: LazyLock<[[[u32; 4]; 256]; 2]> = LazyLock::new(|| {
    let point = |index_rev: u32| std::array::from_fn(|dimension| sobol_rev(index_rev, dimension as u32));
    [24, 16].map(|shift| std::array::from_fn(|byte| point((byte as u32) << shift)))
});

/// Side of a block of pixels that share a sequence, as a power of two.
const BLOCK_BITS: u32 = 3;

/// The numbers of one sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampler {
    pixel_seed: u64,
    sample: u32,
}

/// A decision that takes random numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Decision {
    /// Place in the pixel where the primary ray goes (2 numbers).
    Pixel,
    /// Going on, or not, after the path vertex with this index (1 number).
    Roulette(u32),
    /// Shadow ray `index` of `count` at a path vertex: which light, which emitter, where on it (4 numbers).
    Light {
        /// Index of the path vertex, the first hit = 0.
        vertex: u32,
        /// Index of the shadow ray at this vertex.
        index: u32,
        /// Shadow rays at this vertex.
        count: u32,
    },
    /// Ray `index` of `count` that leaves a path vertex by chance: which way of scattering, whither (3 numbers).
    Gather {
        /// Index of the path vertex, the first hit = 0.
        vertex: u32,
        /// Index of the ray at this vertex.
        index: u32,
        /// Rays at this vertex.
        count: u32,
    },
    /// Place near the path vertex with this index where its caustics are looked up (2 numbers).
    Caustics(u32),
    /// Light that a photon leaves, and place on it (3 numbers).
    PhotonStart,
    /// Direction in which a photon leaves its light (2 numbers).
    PhotonDirection,
}

impl Sampler {
    /// The numbers of sample `sample` of `pixel` (x, y) in the picture that `seed` names.
    pub(crate) fn new(seed: u64, pixel: [u32; 2], sample: u32) -> Sampler {
        let pixel_key = u64::from(pixel[0]) | u64::from(pixel[1]) << 32;
        Sampler { pixel_seed: mix(mix(seed) ^ pixel_key), sample }
    }

    /// The numbers of one sample of `pixel` (x, y), out of a sequence that the pixels of its block share: those at
    /// every fourth pixel come first, then those at every second, so that each grid has points that are stratified.
    pub(crate) fn among(seed: u64, pixel: [u32; 2]) -> Sampler {
        let bit = |v: u32, place: u32| v >> place & 1;
        let place =
            |level: u32| bit(pixel[0], BLOCK_BITS - 1 - level) | bit(pixel[1], BLOCK_BITS - 1 - level) << 1;
        let sample = (0..BLOCK_BITS).map(|level| place(level) << (2 * level)).sum();
        Sampler::new(seed, pixel.map(|v| v >> BLOCK_BITS), sample)
    }

    /// Four numbers for `decision`.
    pub(crate) fn draw(&self, decision: Decision) -> [f32; 4] {
        let sample = u64::from(self.sample);
        let (kind, index) = match decision {
            Decision::Pixel => (0, sample),
            Decision::Roulette(vertex) => (1 | u64::from(vertex) << 8, sample),
            Decision::Light { vertex, index, count } => {
                (2 | u64::from(vertex) << 8, sample * u64::from(count) + u64::from(index))
            }
            Decision::Gather { vertex, index, count } => {
                (3 | u64::from(vertex) << 8, sample * u64::from(count) + u64::from(index))
            }
            Decision::PhotonStart => (4, sample),
            Decision::PhotonDirection => (5, sample),
            Decision::Caustics(vertex) => (6 | u64::from(vertex) << 8, sample),
        };
        let block = index >> SEQUENCE_BITS;
        let seed = mix(mix(self.pixel_seed ^ kind).wrapping_add(block)) as u32;
        scrambled((index & ((1 << SEQUENCE_BITS) - 1)) as u32, seed)
    }
}

/// The first four dimensions of a sequence's point `index`: the bits of `sobol_burley::sample_4d(index, 0, seed)`.
fn scrambled(index: u32, seed: u32) -> [f32; 4] {
    let place = owen_scramble_rev(index.reverse_bits(), hash(seed ^ 0x79c6_8e4a));
    let (high, low) = (SOBOL[0][place as usize >> 24], SOBOL[1][place as usize >> 16 & 255]);
    let scramble = seed.wrapping_mul(0x9c8f_2d3b);
    std::array::from_fn(|a| {
        let salt = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8][a];
        u32_to_f32_norm(owen_scramble_rev(high[a] ^ low[a], hash(scramble ^ salt)).reverse_bits())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_a_pixel_are_stratified_and_pixels_differ() {
        let mut cells = [0; 16];
        for sample in 0..16 {
            let [x, y, ..] = Sampler::new(7, [3, 5], sample).draw(Decision::Pixel);
            cells[(x * 4.0) as usize * 4 + (y * 4.0) as usize] += 1;
        }
        assert_eq!(cells, [1; 16]);
        let first = |seed, pixel| Sampler::new(seed, pixel, 0).draw(Decision::Pixel);
        assert_ne!(first(7, [3, 5]), first(7, [5, 3]));
        assert_ne!(first(7, [3, 5]), first(8, [3, 5]));
    }

    #[test]
    fn numbers_are_those_of_the_crate() {
        for key in 0..20_000u64 {
            let (index, seed) = (mix(key) as u32 >> 16, mix(!key) as u32);
            assert_eq!(scrambled(index, seed), sobol_burley::sample_4d(index, 0, seed));
        }
    }

    #[test]
    fn pixels_of_a_block_are_stratified_at_every_step() {
        for step in [4usize, 2, 1] {
            let mut cells = vec![0; 64 / (step * step)];
            for [x, y] in (0..8).step_by(step).flat_map(|y| (0..8).step_by(step).map(move |x| [x, y])) {
                let [u, ..] = Sampler::among(7, [16 + x, 40 + y]).draw(Decision::Roulette(0));
                cells[(u * (64 / (step * step)) as f32) as usize] += 1;
            }
            assert!(cells.iter().all(|&count| count == 1), "{step}: {cells:?}");
        }
    }

    #[test]
    fn the_mean_is_a_half_past_the_end_of_a_sequence() {
        let mean: f64 = (0..1 << 18)
            .map(|sample| f64::from(Sampler::new(1, [0, 0], sample).draw(Decision::Roulette(9))[0]))
            .sum::<f64>()
            / f64::from(1 << 18);
        assert!((mean - 0.5).abs() < 1e-4, "{mean}");
    }
}
