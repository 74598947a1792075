//! Filters: what decoded rows are turned into, in place.

/// Unit quaternions of four 16-bit integers: three parts, and in the low bits of the fourth which one is left out
/// and, in the others, what one stands for.
pub(crate) fn quaternions(rows: &mut [u8]) {
    // Where the parts of a row go, by the part that is left out, which comes last.
    const ORDER: [[usize; 4]; 4] = [[1, 2, 3, 0], [2, 3, 0, 1], [3, 0, 1, 2], [0, 1, 2, 3]];
    for row in rows.chunks_exact_mut(8) {
        let part = |at: usize| i16::from_le_bytes([row[2 * at], row[2 * at + 1]]);
        let unit = f32::from(part(3) | 3);
        let scale = std::f32::consts::FRAC_1_SQRT_2 / unit;
        let [x, y, z] = [0, 1, 2].map(|at| f32::from(part(at)) * scale);
        let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let order = ORDER[(part(3) & 3) as usize];
        for (place, share) in order.into_iter().zip([x, y, z, w]) {
            let rounded = (share * 32_767.0 + if share >= 0.0 { 0.5 } else { -0.5 }) as i16;
            row[2 * place..2 * place + 2].copy_from_slice(&rounded.to_le_bytes());
        }
    }
}

/// Floats of a signed mantissa of 24 bits, and a signed exponent above it.
pub(crate) fn exponentials(rows: &mut [u8]) {
    for word in rows.chunks_exact_mut(4) {
        let packed = i32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        let (mantissa, exponent) = ((packed << 8) >> 8, packed >> 24);
        // Exponents of all writers lie within those of f32; others wrap as the reference's do.
        let power = f32::from_bits((exponent.wrapping_add(127) as u32) << 23);
        word.copy_from_slice(&(power * mantissa as f32).to_le_bytes());
    }
}
