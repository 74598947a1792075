//! Seeded random numbers, the only ones of the tests.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// A sequence of random numbers.
pub(crate) struct Random(Pcg64);

impl Random {
    pub(crate) fn seeded(seed: u64) -> Random {
        Random(Pcg64::seed_from_u64(seed))
    }

    /// 64 random bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in `[0, 1)`.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A whole number below `bound`, for bounds far below 2^63.
    pub(crate) fn below(&mut self, bound: i64) -> i64 {
        (self.bits() % bound as u64) as i64
    }

    /// Uniform in the box from `lo` to `hi`.
    pub(crate) fn point(&mut self, lo: [f64; 3], hi: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| lo[a] + self.unit() * (hi[a] - lo[a]))
    }

    /// Uniform on the unit sphere.
    pub(crate) fn direction(&mut self) -> [f64; 3] {
        loop {
            let d: [f64; 3] = std::array::from_fn(|_| 2.0 * self.unit() - 1.0);
            let square: f64 = d.iter().map(|x| x * x).sum();
            if square > 1e-4 && square <= 1.0 {
                return d.map(|x| x / square.sqrt());
            }
        }
    }
}
