//! The transfer function of sRGB, IEC 61966-2-1: colours of a mesh are its bytes, light is linear.

/// The linear value, 0 to 1, of a coded byte.
pub fn linear_of(byte: u8) -> f64 {
    let coded = f64::from(byte) / 255.0;
    if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) }
}

/// The byte whose linear value is nearest to `linear`; what is no number counts as 0.
pub fn byte_of(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let coded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * coded).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_and_light_is_what_the_standard_says() {
        (0..=u8::MAX).for_each(|byte| assert_eq!(byte_of(linear_of(byte)), byte));
        // 50 % grey, and one on the straight part.
        assert!((linear_of(188) - 0.5029).abs() < 1e-4 && (linear_of(5) - 0.001_517_6).abs() < 1e-6);
        assert_eq!((byte_of(f64::NAN), byte_of(-1.0), byte_of(f64::INFINITY)), (0, 0, 255));
    }
}
