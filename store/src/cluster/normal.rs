//! `Normal`: a direction in 20 bits, on an octahedron that is unfolded into a square.
//! Cigolle et al., "A survey of efficient representations for independent unit vectors" (2014).
//!
//! ```text
//! code = x, 10 bits | y, 10 bits    each 0 to 1022, 511 = 0; both 1023: no normal
//! ```
//!
//! Invariants: 1. the axes have codes; 2. a direction that was decoded has the code that it was decoded from: those of
//! the square's edge that mean one direction have one code; 3. a direction comes back within a quarter of a degree.

/// Bits of a coordinate. With eight, highlights on smooth surfaces have steps that are seen.
pub(super) const NORMAL_BITS: u32 = 10;
/// The code of a coordinate of 0; coordinates go so far to either side of it.
const HALF: i32 = (1 << (NORMAL_BITS - 1)) - 1;
/// Greatest coordinate.
const COORDINATE_MASK: u32 = (1 << NORMAL_BITS) - 1;

/// A unit normal as it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct Normal(u32);

impl Normal {
    /// Of a corner that has none: it is shaded by the plane of its triangle.
    pub const NONE: Normal = Normal(COORDINATE_MASK << NORMAL_BITS | COORDINATE_MASK);

    /// The normal along a vector of whatever length; none for what has no direction.
    pub fn from_vector(vector: [f64; 3]) -> Normal {
        // So that squares and sums are finite.
        let greatest = vector.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        if !(greatest > 0.0 && greatest.is_finite() && vector.iter().all(|v| v.is_finite())) {
            return Normal::NONE;
        }
        let [x, y, z] = vector.map(|v| v / greatest);
        let sum = x.abs() + y.abs() + z.abs();
        let [mut x, mut y] = [x / sum, y / sum];
        if z < 0.0 {
            [x, y] = [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)];
        }
        let [mut x, mut y] = [x, y].map(|v| (v * f64::from(HALF)).round() as i32);
        // On the edge of the square two points are one direction: that of the positive side stands for both.
        if x.abs() == HALF {
            y = y.abs();
        }
        if y.abs() == HALF {
            x = x.abs();
        }
        Normal::from_coordinates([x + HALF, y + HALF].map(|v| v as u32))
    }

    /// Of coordinates on the square, modulo their bits.
    pub(super) fn from_coordinates([x, y]: [u32; 2]) -> Normal {
        Normal((x & COORDINATE_MASK) | (y & COORDINATE_MASK) << NORMAL_BITS)
    }

    /// The coordinates on the square.
    pub(super) fn coordinates(self) -> [u32; 2] {
        [self.0, self.0 >> NORMAL_BITS].map(|v| v & COORDINATE_MASK)
    }

    /// The unit vector; `None` where there is no normal.
    pub fn vector(self) -> Option<[f32; 3]> {
        if self.coordinates().contains(&COORDINATE_MASK) {
            return None;
        }
        let [x, y] = self.coordinates().map(|v| v as i32 - HALF);
        let z = HALF - x.abs() - y.abs();
        let folded = z.min(0);
        let along = |v: i32| (v + if v < 0 { -folded } else { folded }) as f32;
        let [x, y, z] = [along(x), along(y), z as f32];
        let length = (x * x + y * y + z * z).sqrt();
        Some([x / length, y / length, z / length])
    }

    /// The code, and the normal of a code.
    pub(crate) fn code(self) -> u32 {
        self.0
    }

    /// Of a code, modulo its bits.
    pub(crate) fn from_code(code: u32) -> Normal {
        Normal(code & Normal::NONE.0)
    }
}

/// 1 for zero of either sign, so that it counts as the positive side.
fn sign(v: f64) -> f64 {
    if v < 0.0 { -1.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn angle(a: [f64; 3], b: [f32; 3]) -> f64 {
        let b = b.map(f64::from);
        let cross = [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
        let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        cross.iter().map(|v| v * v).sum::<f64>().sqrt().atan2(dot).to_degrees()
    }

    #[test]
    fn axes_are_exact_and_what_has_no_direction_has_none() {
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut along = [0.0; 3];
                along[axis] = sign;
                assert_eq!(Normal::from_vector(along).vector().unwrap().map(f64::from), along);
            }
        }
        for none in [[0.0; 3], [f64::NAN, 1.0, 0.0], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(Normal::from_vector(none), Normal::NONE);
        }
        assert_eq!(Normal::NONE.vector(), None);
        assert!(Normal::from_vector([5e-324, 0.0, 0.0]) == Normal::from_vector([1e308, 0.0, 0.0]));
    }

    #[test]
    fn every_code_is_of_a_unit_vector_and_of_none_other() {
        for code in 0..=Normal::NONE.code() {
            let normal = Normal::from_code(code);
            let Some(vector) = normal.vector() else { continue };
            let length: f32 = vector.iter().map(|v| v * v).sum();
            assert!((length - 1.0).abs() < 1e-6);
            let again = Normal::from_vector(vector.map(f64::from));
            // Its own, but on the edge, where the positive side stands for both.
            let is_edge = normal.coordinates().iter().any(|&v| v == 0 || v == 2 * HALF as u32);
            assert!(again == normal || is_edge && again.vector() == Some(vector), "{normal:?} {again:?}");
        }
    }

    proptest! {
        #[test]
        fn directions_come_back(vector in prop::array::uniform3(-1.0f64..1.0)) {
            prop_assume!(vector.iter().any(|v| v.abs() > 1e-3));
            let normal = Normal::from_vector(vector);
            let back = normal.vector().unwrap();
            prop_assert!(angle(vector, back) < 0.25, "{}", angle(vector, back));
            prop_assert_eq!(Normal::from_vector(back.map(f64::from)), normal);
        }
    }
}
