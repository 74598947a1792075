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
//! Two sums of different samples are added by the same rule.
//!
//! Invariants: 1. exponents are the least at which all three mantissas fit; 2. a mantissa is below 2^39; 3. one add is
//! off by at most 2^-38 of the brightest of the three sums; 4. what is added to nothing, and to what nothing is added,
//! stays bit by bit.

use crate::hash::chances;

/// Bits of a mantissa.
const MANTISSA_BITS: u32 = 39;
const MANTISSA: u64 = (1 << MANTISSA_BITS) - 1;
/// The last bit of the smallest f32 stands for 2^-149; so does that of a mantissa under exponent 0.
const BIAS: i32 = 149;
/// Greatest exponent: of 2^32 samples of the largest f32, rounded up.
const EXPONENT_MOST: u32 = 160 + BIAS as u32 + 1 - MANTISSA_BITS + 1;
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
        let [red, green, blue] = radiance.map(|value| u64::from(value.to_bits()));
        let key = self.folded() ^ red ^ green << 21 ^ blue << 42;
        *self = self.plus_rounded(radiance.map(f64::from), key);
    }

    /// Adds the sum of other samples.
    pub(crate) fn add_sum(&mut self, other: RgbSum) {
        *self = match (self.0, other.0) {
            (_, 0) => *self,
            (0, _) => other,
            // Another order of the two is another number.
            _ => self.plus_rounded(other.rgb(), self.folded() ^ other.folded().rotate_left(17)),
        };
    }

    /// This sum and `more`, rounded by the chances of `key`.
    fn plus_rounded(self, more: [f64; 3], key: u64) -> RgbSum {
        let before = self.rgb();
        let sums: [f64; 3] = std::array::from_fn(|c| before[c] + more[c]);
        let chances = chances(key);
        let exponent = exponent_of(sums[0].max(sums[1]).max(sums[2]));
        // Rounded up, the largest may need one bit more.
        let packed = RgbSum::pack(sums, exponent, chances);
        packed.unwrap_or_else(|| RgbSum::pack(sums, exponent + 1, chances).expect("half of a mantissa fits"))
    }

    fn folded(self) -> u64 {
        self.0 as u64 ^ (self.0 >> 64) as u64
    }

    /// The bytes that files have of it.
    pub(crate) fn to_bytes(self) -> [u8; 16] {
        self.0.to_le_bytes()
    }

    /// The sum of these bytes; `None` where no samples sum to it.
    pub(crate) fn from_bytes(bytes: [u8; 16]) -> Option<RgbSum> {
        let sum = RgbSum(u128::from_le_bytes(bytes));
        let exponent = (sum.0 >> (3 * MANTISSA_BITS)) as u32;
        let greatest = (0..3).map(|c| (sum.0 >> (c * MANTISSA_BITS)) as u64 & MANTISSA).max()?;
        let is_least = exponent == 0 || greatest >> (MANTISSA_BITS - 1) == 1;
        (exponent <= EXPONENT_MOST && is_least).then_some(sum)
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

    #[test]
    fn bytes_that_no_samples_sum_to_are_refused() {
        let mut sum = RgbSum::default();
        for _ in 0..3 {
            assert_eq!(RgbSum::from_bytes(sum.to_bytes()), Some(sum));
            sum.add([f32::MAX, 1.0, 0.0]);
        }
        for bits in [
            u128::MAX,
            1 << 117 | 5,
            1 << 127 | MANTISSA as u128,
            (EXPONENT_MOST as u128 + 1) << 117 | 1 << 38,
        ] {
            assert_eq!(RgbSum::from_bytes(bits.to_le_bytes()), None, "{bits:x}");
        }
    }

    proptest! {
        /// Sums of a cut sequence, added: within 2^-38 of the brightest an add, as in one sequence.
        #[test]
        fn sums_of_parts_are_those_of_f64(
            samples in prop::collection::vec([0f32..1e3, 0f32..1.0, 0f32..1e-3], 2..200),
            cut in 0.0..1.0,
        ) {
            let cut = (samples.len() as f64 * cut) as usize;
            let exact = samples.iter().fold([0.0; 3], |sum: [f64; 3], sample| {
                std::array::from_fn(|c| sum[c] + f64::from(sample[c]))
            });
            let [mut first, mut second] = [RgbSum::default(); 2];
            samples[..cut].iter().for_each(|sample| first.add(*sample));
            samples[cut..].iter().for_each(|sample| second.add(*sample));
            let before = first;
            first.add_sum(second);
            if cut == 0 {
                prop_assert_eq!(first, second);
            }
            second.add_sum(RgbSum::default());
            prop_assert!(cut > 0 || first == second);
            let bound = (samples.len() + 1) as f64 * exact[0].max(exact[1]).max(exact[2]) * 2f64.powi(-38);
            for c in 0..3 {
                prop_assert!((first.rgb()[c] - exact[c]).abs() <= bound, "{before:?} {first:?} {exact:?}");
            }
        }

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
