//! A vertex of a compact cluster as one number, as a frame holds it, and arithmetic on such numbers.
//!
//! ```text
//! packed = x + y * 2^w_x + z * 2^(w_x + w_y)        below 2^57
//! ```
//!
//! Sums and differences are those of the whole numbers modulo 2^(w_x + w_y + w_z): a carry from one axis into the next
//! is taken back by whatever undoes the sum, so nothing is masked between axes. What is to be told of a difference
//! are its *digits*: |digit_a| <= 2^(w_a - 1), small where the axes differ by little, whatever their signs.
//!
//! Invariant: the packed vertex is the prediction plus the digits, each times its axis' place, in this arithmetic.

use super::Widths;

/// How the axes of a cluster's vertices are packed.
#[derive(Clone, Copy)]
pub(super) struct VertexPacking {
    /// Bits per axis.
    pub(super) bits: [u32; 3],
    /// Where each axis begins.
    pub(super) shift: [u32; 3],
    /// All bits.
    pub(super) mask: u64,
}

impl VertexPacking {
    /// That of a compact cluster.
    pub(super) fn new(widths: &Widths) -> VertexPacking {
        let bits = widths.bits.map(u32::from);
        let shift = [0, bits[0], bits[0] + bits[1]];
        VertexPacking { bits, shift, mask: (1 << (shift[2] + bits[2])) - 1 }
    }

    /// Three numbers, each below 2^bits.
    pub(super) fn put(&self, values: [u64; 3]) -> u64 {
        values[0] | values[1] << self.shift[1] | values[2] << self.shift[2]
    }

    /// The three numbers of a packed vertex.
    pub(super) fn get(&self, packed: u64) -> [u64; 3] {
        std::array::from_fn(|a| packed >> self.shift[a] & ((1 << self.bits[a]) - 1))
    }

    /// The corner of the parallelogram over the edge from `a` to `b` that lies opposite of `c`; bits above the mask
    /// mean nothing.
    #[inline(always)]
    pub(super) fn predict(a: u64, b: u64, c: u64) -> u64 {
        a.wrapping_add(b).wrapping_sub(c)
    }

    /// The digits of a difference. Each is what is left of it modulo 2^w, taken from -2^(w - 1) to 2^(w - 1) - 1, or 0
    /// of an axis without bits; it is taken away, and the rest divided by 2^w.
    pub(super) fn digits(&self, difference: u64) -> [i64; 3] {
        let mut left = difference;
        self.bits.map(|bits| {
            let digit = if bits == 0 { 0 } else { (left << (64 - bits)) as i64 >> (64 - bits) };
            left = left.wrapping_sub(digit as u64) >> bits;
            digit
        })
    }

    /// Half of the range of numbers of so many bits an axis, in place: what brings digits to numbers that are not
    /// negative.
    #[inline(always)]
    pub(super) fn halves(&self, bits: [u32; 3]) -> u64 {
        (0..3).map(|a| ((1u64 << bits[a]) / 2) << self.shift[a]).sum()
    }

    /// The greatest number of each axis.
    #[inline(always)]
    pub(super) fn greatest(&self, all: &[u64]) -> [u32; 3] {
        std::array::from_fn(|a| {
            let (shift, mask) = (self.shift[a], !(u32::MAX << self.bits[a]));
            all.iter().fold(0, |most, packed| most.max((packed >> shift) as u32 & mask))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn digits_lead_from_any_prediction_to_the_vertex(
            bits in prop::array::uniform3(0u8..=24).prop_filter("57 in all", |b| b.iter().sum::<u8>() <= 57),
            values in prop::array::uniform4(prop::array::uniform3(any::<u64>())),
        ) {
            let packing = VertexPacking::new(&Widths { base: [0; 3], bits, wide: false });
            let modulo = |v: [u64; 3]| -> [u64; 3] { std::array::from_fn(|a| v[a] & ((1 << bits[a]) - 1)) };
            let [a, b, c, d] = values.map(modulo);
            let [p, q, r, s] = [a, b, c, d].map(|v| packing.put(v));
            prop_assert_eq!(packing.get(p), a);
            let prediction = VertexPacking::predict(p, q, r);
            let digits = packing.digits(s.wrapping_sub(prediction) & packing.mask);
            let mut told = prediction;
            for axis in 0..3 {
                let half = (1i64 << bits[axis]) / 2;
                prop_assert!((-half..half.max(1)).contains(&digits[axis]), "{:?} of {:?}", digits, bits);
                told = told.wrapping_add((digits[axis] as u64) << packing.shift[axis]);
            }
            prop_assert_eq!(told & packing.mask, s);
            prop_assert_eq!(packing.greatest(&[p, q])[1], a[1].max(b[1]) as u32);
        }

        /// No carry: digits are the differences themselves, where these are small.
        #[test]
        fn small_differences_are_their_own_digits(
            values in prop::array::uniform3(100u64..900),
            steps in prop::array::uniform3(-90i64..90),
        ) {
            let packing = VertexPacking::new(&Widths { base: [0; 3], bits: [10, 11, 12], wide: false });
            let moved = std::array::from_fn(|a| (values[a] as i64 + steps[a]) as u64);
            let difference = packing.put(moved).wrapping_sub(packing.put(values)) & packing.mask;
            prop_assert_eq!(packing.digits(difference), steps);
        }
    }
}
