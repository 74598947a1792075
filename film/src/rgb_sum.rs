//! `RgbSum`: the radiances of a pixel, summed: three mantissas under one exponent in 16 bytes, where three f64 take 24.
//!
//! ```text
//! bits   0..39    39..78   78..117   117..126
//!        red      green    blue      exponent: the last bit of a mantissa stands for 2^(exponent - 149)
//! ```
//!
//! A sum of 10^6 samples has more bits than a mantissa. What does not fit is rounded up or down by a chance that is as
//! large as its share of the last bit, so that errors cancel as samples do, and equal samples sum to their multiple.
//! The chance is drawn from what is added and to what: the bytes depend on nothing else.
//!
//! Invariants: 1. exponents are the least at which all three mantissas fit; 2. a mantissa is below 2^39; 3. one add is
//! off by at most 2^-38 of the brightest of the three sums.

use crate::hash::chances;

/// Bits of a mantissa.
const MANTISSA_BITS: u32 = 39;
const MANTISSA: u64 = (1 << MANTISSA_BITS) - 1;
/// The last bit of the smallest f32 stands for 2^-149; so does that of a mantissa under exponent 0.
const BIAS: i32 = 149;
/// Bits of the fraction, and the bias, of an f64.
const F64_BITS: u32 = 52;
const F64_BIAS: i32 = 1023;

/// A sum of linear RGB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RgbSum(u128);

impl RgbSum {
    /// Adds a radiance. What is negative or no number counts as 0, what is infinite as the largest f32.
    pub(crate) fn add(&mut self, radiance: [f32; 3]) {
        let radiance = radiance.map(|value| if value > 0.0 { value.min(f32::MAX) } else { 0.0 });
        let before = self.rgb();
        let sums: [f64; 3] = std::array::from_fn(|c| before[c] + f64::from(radiance[c]));
        let most = sums[0].max(sums[1]).max(sums[2]);
        let [red, green, blue] = radiance.map(|value| u64::from(value.to_bits()));
        let chances = chances(self.0 as u64 ^ (self.0 >> 64) as u64 ^ red ^ green << 21 ^ blue << 42);
        let exponent = exponent_of(most);
        // Rounded up, the largest may need one bit more.
        let packed = RgbSum::pack(sums, exponent, chances);
        *self = packed
            .unwrap_or_else(|| RgbSum::pack(sums, exponent + 1, chances).expect("half of a mantissa fits"));
    }

    /// The sums.
    pub(crate) fn rgb(self) -> [f64; 3] {
        let unit = power_of_two((self.0 >> (3 * MANTISSA_BITS)) as i32 - BIAS);
        // Through i64, which processors turn into f64 and back in an instruction.
        [0, 1, 2].map(|c| ((self.0 >> (c * MANTISSA_BITS)) as u64 & MANTISSA) as i64 as f64 * unit)
    }

    /// `sums` under `exponent`; `None` when one of them does not fit.
    fn pack(sums: [f64; 3], exponent: i32, chances: [f32; 3]) -> Option<RgbSum> {
        let per_unit = power_of_two(BIAS - exponent);
        let mut bits = (exponent as u128) << (3 * MANTISSA_BITS);
        for (c, (sum, chance)) in (0..).zip(sums.into_iter().zip(chances)) {
            let mantissa = (sum * per_unit + f64::from(chance)) as i64 as u64;
            if mantissa > MANTISSA {
                return None;
            }
            bits |= u128::from(mantissa) << (c * MANTISSA_BITS);
        }
        Some(RgbSum(bits))
    }
}

/// The least exponent under which `sum` fits a mantissa.
fn exponent_of(sum: f64) -> i32 {
    let highest_bit = (sum.to_bits() >> F64_BITS) as i32 - F64_BIAS;
    (highest_bit + BIAS + 1 - MANTISSA_BITS as i32).max(0)
}

/// 2^`power`, one that an f64 has.
fn power_of_two(power: i32) -> f64 {
    f64::from_bits(((power + F64_BIAS) as u64) << F64_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum_of(radiances: impl IntoIterator<Item = [f32; 3]>) -> [f64; 3] {
        let mut sum = RgbSum::default();
        radiances.into_iter().for_each(|radiance| sum.add(radiance));
        sum.rgb()
    }

    #[test]
    fn a_single_sample_is_kept_as_it_is() {
        for value in [0.0, 1.0, 0.1, f32::MIN_POSITIVE, f32::from_bits(1), f32::from_bits(3), f32::MAX, 1e-30]
        {
            // Channels 2^15 times darker than the brightest keep all of their bits.
            let radiance = [value, value / 256.0, 0.0];
            assert_eq!(sum_of([radiance]), radiance.map(f64::from), "{value}");
        }
    }

    #[test]
    fn what_is_no_radiance_adds_nothing_and_infinity_the_most() {
        assert_eq!(sum_of([[-1.0, f32::NAN, 0.5]]), [0.0, 0.0, 0.5]);
        assert_eq!(sum_of([[f32::INFINITY, 0.0, 0.0]]), [f64::from(f32::MAX), 0.0, 0.0]);
        // As many of the largest as a count holds do not go past the exponent.
        let mut most = RgbSum(u128::from(MANTISSA) | ((BIAS as u128 + 160 - 39) << (3 * MANTISSA_BITS)));
        most.add([f32::MAX; 3]);
        assert!(most.rgb()[0] >= 2f64.powi(159));
    }

    /// Rounded to the nearest, each of these adds would be off the same way: 10^6 of them by 1e-6 and more.
    #[test]
    fn a_million_equal_samples_are_a_million_times_one() {
        for value in [0.1f32, 0.7, 3e-5, 1234.567] {
            let sum = sum_of((0..1_000_000).map(|_| [value, 0.3 * value, 1e-3 * value]));
            for (sum, factor) in sum.into_iter().zip([1.0f32, 0.3, 1e-3]) {
                let exact = f64::from(factor * value) * 1e6;
                assert!(
                    (sum - exact).abs() < 1e-8 * f64::from(value) * 1e6,
                    "{value} {factor}: {sum} {exact}"
                );
            }
        }
    }

    proptest! {
        /// Beside sums in f64: within 2^-38 of the brightest an add.
        #[test]
        fn sums_are_those_of_f64(samples in prop::collection::vec([0f32..1e3, 0f32..1.0, 0f32..1e-3], 1..200)) {
            let exact = samples.iter().fold([0.0; 3], |sum: [f64; 3], sample| {
                std::array::from_fn(|c| sum[c] + f64::from(sample[c]))
            });
            let found = sum_of(samples.iter().copied());
            let bound = samples.len() as f64 * exact[0].max(exact[1]).max(exact[2]) * 2f64.powi(-38);
            for c in 0..3 {
                prop_assert!((found[c] - exact[c]).abs() <= bound, "{found:?} {exact:?}");
            }
        }
    }
}
