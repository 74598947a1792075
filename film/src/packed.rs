//! Numbers of a pixel in few bytes: light with one exponent for its three channels, a normal on an octahedron, albedo.
//!
//! ```text
//! light   13 | 13 | 13 bits of mantissa, 8 of exponent      6 bytes; right to 2^-13 of the greatest channel
//! normal  12 | 12 bits on the octahedron                    3 bytes; right to 0.06 degrees
//! albedo   8 |  8 |  8 bits                                 3 bytes; right to 1/510
//! ```
//!
//! Half floats were not taken: a scene may be in any unit of light, and their range is less than that of exposures.
//!
//! Invariants: 1. a code of zeros is black; 2. black, the axes, and the lack of a normal come back exactly; 3. every
//! code comes back as finite numbers.
//!
//! Z. Cigolle et al., "A survey of efficient representations for independent unit vectors" (2014), 3.3.

use glam::{Vec2, Vec3};

/// Bits of a channel of light.
const LIGHT_BITS: u32 = 13;
const LIGHT_CODE_MAX: u32 = (1 << LIGHT_BITS) - 1;
/// Bits of the exponent in the word of a channel.
const EXPONENT_BITS: u32 = 16 - LIGHT_BITS;
/// Least exponent of the greatest channel, biased as in f32: with it the step between codes is still a normal number.
const EXPONENT_LEAST: u32 = LIGHT_BITS;
/// That of the greatest f32.
const EXPONENT_MOST: u32 = 254;
/// Added to a number below 2^23 it leaves the nearest whole number in the low bits.
const TO_WHOLE: f32 = (1u32 << 23) as f32;
/// Greatest code along a side of the octahedron: even, so that the axes have codes. The one after it is for no normal.
const SIDE_CODE_MAX: u32 = (1 << 12) - 2;

const _: () = assert!(3 * EXPONENT_BITS >= 8);

/// Light of a pixel, each channel at least 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PackedLight([u16; 3]);

/// A unit normal, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PackedNormal([u8; 3]);

/// An albedo, each channel 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PackedAlbedo([u8; 3]);

impl PackedLight {
    /// What is below 0, and what is no number, is 0.
    #[inline]
    pub fn new(rgb: [f32; 3]) -> PackedLight {
        // Unlike `f32::max` one instruction.
        let greater = |a: f32, b: f32| if a > b { a } else { b };
        let [r, g, b] = rgb.map(|value| greater(value, 0.0));
        let exponent = (greater(greater(r, g), b).to_bits() >> 23).clamp(EXPONENT_LEAST, EXPONENT_MOST);
        // The greatest channel is brought to 2^12 to 2^13.
        let per_step = f32::from_bits((2 * 127 + LIGHT_BITS - 1 - exponent) << 23);
        let stored = exponent - EXPONENT_LEAST;
        let word = |value: f32, index: u32| {
            let steps = value * per_step;
            let steps = if steps < LIGHT_CODE_MAX as f32 { steps } else { LIGHT_CODE_MAX as f32 };
            let part = stored >> (EXPONENT_BITS * index) & ((1 << EXPONENT_BITS) - 1);
            (part << LIGHT_BITS | (steps + TO_WHOLE).to_bits() & LIGHT_CODE_MAX) as u16
        };
        PackedLight([word(r, 0), word(g, 1), word(b, 2)])
    }

    /// As [`PackedLight::new`], rounded up or down by chance: `chances`, evenly from 0 to 1, so that sums of many of
    /// them are right on average.
    #[inline]
    pub fn rounded_by(rgb: [f32; 3], chances: [f32; 3]) -> PackedLight {
        let nearest = PackedLight::new(rgb);
        if nearest == PackedLight::default() {
            return nearest;
        }
        let step = nearest.step();
        // The nearest of what is up to half a step off: the step is that of the greatest channel, which moves by less.
        PackedLight::new(std::array::from_fn(|c| rgb[c].max(0.0) + (chances[c] - 0.5) * step))
    }

    /// The step between codes.
    #[inline]
    fn step(self) -> f32 {
        let [r, g, b] = self.0.map(|word| u32::from(word) >> LIGHT_BITS);
        let stored = r | g << EXPONENT_BITS | b << (2 * EXPONENT_BITS);
        f32::from_bits(((stored + EXPONENT_LEAST).min(EXPONENT_MOST) + 1 - LIGHT_BITS) << 23)
    }

    /// The light.
    #[inline]
    pub fn rgb(self) -> [f32; 3] {
        let step = self.step();
        self.0.map(|word| (u32::from(word) & LIGHT_CODE_MAX) as f32 * step)
    }
}

impl PackedNormal {
    /// No normal, which is the vector zero.
    pub(crate) const NONE: PackedNormal = PackedNormal([u8::MAX; 3]);

    /// A unit normal; [`PackedNormal::NONE`] for zero.
    pub(crate) fn new(normal: [f32; 3]) -> PackedNormal {
        let normal = Vec3::from(normal);
        let sum = normal.abs().element_sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return PackedNormal::NONE;
        }
        let place = fold(normal / sum);
        let [x, y] = (0.5 * (place + Vec2::ONE) * SIDE_CODE_MAX as f32)
            .to_array()
            .map(|code| (code + 0.5).min(SIDE_CODE_MAX as f32) as u32);
        PackedNormal([x as u8, (x >> 8 | (y & 0xf) << 4) as u8, (y >> 4) as u8])
    }

    /// The bytes that files have of it.
    pub(crate) fn to_bytes(self) -> [u8; 3] {
        self.0
    }

    /// The normal of these bytes: any are one, or none.
    pub(crate) fn from_bytes(bytes: [u8; 3]) -> PackedNormal {
        PackedNormal(bytes)
    }

    /// The unit normal; zero where it is none.
    pub(crate) fn normal(self) -> Vec3 {
        if self == PackedNormal::NONE {
            return Vec3::ZERO;
        }
        let [a, b, c] = self.0.map(u32::from);
        let place = [a | (b & 0xf) << 8, b >> 4 | c << 4]
            .map(|code| 2.0 * code.min(SIDE_CODE_MAX) as f32 / SIDE_CODE_MAX as f32 - 1.0);
        let place = Vec2::from(place);
        let z = 1.0 - place.abs().element_sum();
        fold(place.extend(z)).extend(z).normalize()
    }
}

/// Unfolds the lower half of the octahedron over the upper one, along x and y; and folds it back.
fn fold(point: Vec3) -> Vec2 {
    let place = point.truncate();
    if point.z >= 0.0 {
        return place;
    }
    let other = Vec2::ONE - Vec2::new(place.y, place.x).abs();
    Vec2::new(other.x.copysign(place.x), other.y.copysign(place.y))
}

impl PackedAlbedo {
    /// What is outside of 0 to 1 is the nearest of both.
    pub(crate) fn new(albedo: [f32; 3]) -> PackedAlbedo {
        PackedAlbedo(albedo.map(|value| (value * 255.0).round() as u8))
    }

    /// The bytes that files have of it.
    pub(crate) fn to_bytes(self) -> [u8; 3] {
        self.0
    }

    /// The albedo of these bytes: any are one.
    pub(crate) fn from_bytes(bytes: [u8; 3]) -> PackedAlbedo {
        PackedAlbedo(bytes)
    }

    /// The albedo.
    pub(crate) fn albedo(self) -> [f32; 3] {
        self.0.map(|value| f32::from(value) / 255.0)
    }
}

/// Shares of the channels in a luminance: those of Rec. 709.
pub(crate) const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance of linear RGB, ITU-R BT.709.
pub(crate) fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::from(LUMINANCE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    /// A number in 0 to 1.
    fn number(key: u64) -> f32 {
        (mix(key) >> 40) as f32 / (1u64 << 24) as f32
    }

    #[test]
    fn light_of_any_unit_comes_back_to_its_precision() {
        for exponent in -100..=127 {
            for key in 0..200u64 {
                let scale = 2f32.powi(exponent);
                let share = [0, 1, 2].map(|c| number(key * 3 + c));
                let rgb = share.map(|share| share * scale);
                let found = PackedLight::new(rgb).rgb();
                let greatest = rgb.into_iter().fold(0.0, f32::max);
                for c in 0..3 {
                    let off = (f64::from(found[c]) - f64::from(rgb[c])).abs();
                    let most = f64::from(greatest) * 2f64.powi(-13);
                    assert!(off <= most * 1.001, "{rgb:?} 2^{exponent}: {found:?}");
                }
                // What has come back once comes back.
                assert_eq!(PackedLight::new(found).rgb(), found, "{rgb:?}");
            }
        }
    }

    #[test]
    fn light_that_is_none_is_black_and_the_most_is_finite() {
        assert_eq!(PackedLight::default().rgb(), [0.0; 3]);
        assert_eq!(PackedLight::new([0.0; 3]), PackedLight::default());
        assert_eq!(PackedLight::new([-1.0, f32::NAN, -0.0]), PackedLight::default());
        let most = PackedLight::new([f32::INFINITY, 1.0, f32::MAX]).rgb();
        assert!(most[0].is_finite() && most[0] > 3.4e38 && most[1] == 0.0, "{most:?}");
        // Below what f32 can tell in thirteen bits there is nothing.
        assert!(PackedLight::new([f32::MIN_POSITIVE; 3]).rgb()[0] <= 2.0 * f32::MIN_POSITIVE);
        for word in [0, 0x1fff, 0xe000, 0xffff] {
            assert!(PackedLight([word; 3]).rgb().iter().all(|value| value.is_finite()));
        }
        // Whole numbers below 2^13 are themselves.
        assert_eq!(PackedLight::new([8191.0, 1.0, 4097.0]).rgb(), [8191.0, 1.0, 4097.0]);
    }

    #[test]
    fn normals_come_back_within_six_hundredths_of_a_degree() {
        let mut worst: f32 = 0.0;
        for key in 0..20_000u64 {
            let axis = [0, 1, 2].map(|a| 2.0 * number(key * 3 + a) - 1.0);
            let normal = Vec3::from(axis).normalize();
            let found = PackedNormal::new(normal.into()).normal();
            assert!((found.length() - 1.0).abs() < 1e-6);
            worst = worst.max(found.cross(normal).length());
        }
        assert!(worst < 0.06f32.to_radians(), "{worst}");
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for normal in [axis, -axis] {
                assert_eq!(PackedNormal::new(normal.into()).normal(), normal);
            }
        }
        for none in [[0.0; 3], [f32::NAN; 3], [f32::INFINITY, 0.0, 0.0]] {
            assert_eq!(PackedNormal::new(none), PackedNormal::NONE);
        }
        assert_eq!(PackedNormal::NONE.normal(), Vec3::ZERO);
    }

    #[test]
    fn albedo_comes_back_within_half_a_step() {
        for key in 0..1000 {
            let albedo = [0, 1, 2].map(|c| number(key * 3 + c));
            let found = PackedAlbedo::new(albedo).albedo();
            assert!((0..3).all(|c| (found[c] - albedo[c]).abs() <= 0.5 / 255.0 + 1e-6));
        }
        assert_eq!(PackedAlbedo::new([-1.0, 1.0, 7.0]).albedo(), [0.0, 1.0, 1.0]);
    }
}
