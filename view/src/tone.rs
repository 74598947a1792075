//! `Tone`: radiance to 8 bits of sRGB, by the numbers of the renderer's PNG, fast enough for each frame.
//!
//! ```text
//! value -> bucket (its exponent and 7 bits) -> code at the bucket's start -> one more, if past the next threshold
//! ```
//!
//! Invariants: 1. the code of each value is the one that `trex_render::write_png` gives; 2. no bucket holds two
//! thresholds.

/// Values below this are black; a power of two below the threshold of code 1.
const LEAST: f32 = 1.0 / 8192.0;
/// Bits of a value that a bucket does not tell apart.
const SHIFT: u32 = 16;
/// Buckets from [`LEAST`] up to 1.
const BUCKETS: usize = ((1.0f32.to_bits() - LEAST.to_bits()) >> SHIFT) as usize;

/// The curve of a picture with its exposure.
#[derive(Clone, Debug)]
pub(crate) struct Tone {
    exposure: f32,
    /// The code at the start of each bucket.
    codes: Vec<u8>,
    /// The least value of each code, and one past them all.
    thresholds: Vec<f32>,
}

impl Tone {
    /// The curve for a factor on the light.
    pub(crate) fn new(exposure: f32) -> Tone {
        let mut thresholds: Vec<f32> = (0..=255).map(least_of).collect();
        thresholds.push(f32::INFINITY);
        let start = |bucket: usize| f32::from_bits(LEAST.to_bits() + ((bucket as u32) << SHIFT));
        let codes = (0..BUCKETS).map(|bucket| to_srgb(start(bucket))).collect();
        Tone { exposure, codes, thresholds }
    }

    /// The factor.
    pub(crate) fn exposure(&self) -> f32 {
        self.exposure
    }

    /// Sets the factor.
    pub(crate) fn set_exposure(&mut self, exposure: f32) {
        self.exposure = exposure;
    }

    /// The bytes of a pixel.
    #[inline]
    pub(crate) fn pixel(&self, radiance: [f32; 3]) -> [u8; 3] {
        radiance.map(|value| self.code(self.exposure * value))
    }

    #[inline]
    fn code(&self, value: f32) -> u8 {
        if value >= 1.0 {
            return 255;
        }
        // What is no number is black, too.
        if value >= LEAST {
            let code = self.codes[((value.to_bits() - LEAST.to_bits()) >> SHIFT) as usize];
            return code + u8::from(value >= self.thresholds[usize::from(code) + 1]);
        }
        0
    }
}

/// The least value whose code is `code` or more.
fn least_of(code: u8) -> f32 {
    let (mut below, mut there) = (0u32, 1.0f32.to_bits());
    if code == 0 {
        return 0.0;
    }
    // Values >= 0 are in the order of their bits.
    while there - below > 1 {
        let middle = below + (there - below) / 2;
        if to_srgb(f32::from_bits(middle)) >= code {
            there = middle;
        } else {
            below = middle;
        }
    }
    f32::from_bits(there)
}

/// The transfer function of sRGB (IEC 61966-2-1), in 8 bits, as the renderer has it.
fn to_srgb(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let coded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (coded * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_bucket_holds_two_thresholds() {
        let tone = Tone::new(1.0);
        for (bucket, pair) in tone.codes.windows(2).enumerate() {
            assert!(pair[1] - pair[0] <= 1, "bucket {bucket}: {pair:?}");
        }
        assert!(tone.codes[BUCKETS - 1] >= 254);
    }

    /// Every 97th value there is, and all around each threshold.
    #[test]
    fn codes_are_those_of_the_function() {
        let tone = Tone::new(1.0);
        let around = tone.thresholds[1..=255].iter().flat_map(|value| {
            let bits = value.to_bits();
            bits - 3..bits + 3
        });
        for bits in (0..1.1f32.to_bits()).step_by(97).chain(around) {
            let value = f32::from_bits(bits);
            assert_eq!(tone.code(value), to_srgb(value), "{value}");
        }
        let odd = [f32::NAN, -1.0, f32::NEG_INFINITY, f32::INFINITY, 0.0, -0.0, 7.0];
        assert_eq!(odd.map(|value| tone.code(value)), odd.map(to_srgb));
    }
}
