//! Boxes, the lattice, and space-filling keys.
//!
//! Invariants: 1. an `Aabb` with `lo > hi` on any axis is empty; 2. lattice position = `origin + q * 2^exponent`
//! with `q >= 0`, exact in f64 for what the build stores (`q` up to 40 bits); 3. keys order cells, nothing else.

/// Axis-aligned box in model space.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Aabb {
    /// Least corner.
    pub lo: [f64; 3],
    /// Greatest corner.
    pub hi: [f64; 3],
}

impl Aabb {
    /// The box that holds nothing; the identity of [`Aabb::add`].
    pub const EMPTY: Aabb = Aabb { lo: [f64::INFINITY; 3], hi: [f64::NEG_INFINITY; 3] };

    /// Grows to hold `point`.
    pub fn add(&mut self, point: [f64; 3]) {
        for axis in 0..3 {
            self.lo[axis] = self.lo[axis].min(point[axis]);
            self.hi[axis] = self.hi[axis].max(point[axis]);
        }
    }

    /// Grows to hold `other`.
    pub fn join(&mut self, other: &Aabb) {
        for axis in 0..3 {
            self.lo[axis] = self.lo[axis].min(other.lo[axis]);
            self.hi[axis] = self.hi[axis].max(other.hi[axis]);
        }
    }

    /// True when nothing is inside.
    pub fn is_empty(&self) -> bool {
        (0..3).any(|axis| self.lo[axis] > self.hi[axis])
    }

    /// Length of the longest side; 0 when empty.
    pub fn extent(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (0..3).map(|a| self.hi[a] - self.lo[a]).fold(0.0, f64::max) }
    }

    /// Length of the diagonal; 0 when empty.
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        (0..3).map(|a| (self.hi[a] - self.lo[a]).powi(2)).sum::<f64>().sqrt()
    }

    /// The middle.
    pub fn center(&self) -> [f64; 3] {
        std::array::from_fn(|a| 0.5 * self.lo[a] + 0.5 * self.hi[a])
    }
}

/// The one lattice of a model.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Lattice {
    /// Model-space position of lattice point (0, 0, 0).
    pub origin: [f64; 3],
    /// The step is `2^exponent` model units.
    pub exponent: i32,
}

impl Lattice {
    /// Most bits of a lattice coordinate.
    pub const MAX_BITS: u32 = 40;

    /// Length of one step, model units.
    pub fn step(&self) -> f64 {
        exp2i(self.exponent)
    }

    /// The nearest lattice point (ties to even). A point that is not finite, or too far away for a lattice, comes out
    /// beyond 2^[`Lattice::MAX_BITS`], or below 0.
    pub fn snap(&self, point: [f64; 3]) -> [i64; 3] {
        let per_step = exp2i(-self.exponent);
        std::array::from_fn(|a| nearest_integer((point[a] - self.origin[a]) * per_step))
    }

    /// Model-space position of a lattice point.
    pub fn position(&self, q: [i64; 3]) -> [f64; 3] {
        let step = self.step();
        std::array::from_fn(|a| self.origin[a] + q[a] as f64 * step)
    }
}

/// The nearest integer (ties to even) of a number below 2^51 either way; what is not gives one that is not, either. By
/// arithmetic alone: many processors that this is compiled for have no instruction that rounds.
fn nearest_integer(number: f64) -> i64 {
    // Between 2^52 and 2^53 numbers are integers, and their bits count up by one.
    const ORIGIN: f64 = (3u64 << 51) as f64;
    (number + ORIGIN).to_bits().wrapping_sub(ORIGIN.to_bits()) as i64
}

/// `2^exponent`, exact over the normal range of f64.
pub fn exp2i(exponent: i32) -> f64 {
    assert!((-1022..=1023).contains(&exponent), "2^{exponent} is no normal f64");
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

/// Place of cell `(x, y, z)` on the Hilbert curve through the cube of `2^bits` cells a side (`bits` <= 21).
/// J. Skilling, "Programming the Hilbert curve", AIP Conf. Proc. 707 (2004).
pub fn hilbert_key(cell: [u32; 3], bits: u32) -> u64 {
    debug_assert!((1..=21).contains(&bits) && cell.iter().all(|&c| c >> bits == 0));
    let mut x = cell;
    let mut q = 1u32 << (bits - 1);
    while q > 1 {
        let p = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[i]) & p;
                x[0] ^= t;
                x[i] ^= t;
            }
        }
        q >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut t = 0;
    let mut q = 1u32 << (bits - 1);
    while q > 1 {
        if x[2] & q != 0 {
            t ^= q - 1;
        }
        q >>= 1;
    }
    let mut key = 0u64;
    for bit in (0..bits).rev() {
        for value in x {
            key = key << 1 | u64::from((value ^ t) >> bit & 1);
        }
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hilbert_visits_every_cell_once_and_steps_to_neighbours() {
        for bits in 1..=4 {
            let side = 1u32 << bits;
            let mut order = vec![None; 1 << (3 * bits)];
            for z in 0..side {
                for y in 0..side {
                    for x in 0..side {
                        let key = hilbert_key([x, y, z], bits) as usize;
                        assert!(order[key].replace([x, y, z]).is_none(), "two cells share key {key}");
                    }
                }
            }
            for pair in order.windows(2) {
                let (a, b) = (pair[0].unwrap(), pair[1].unwrap());
                assert_eq!((0..3).map(|i| a[i].abs_diff(b[i])).sum::<u32>(), 1, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn numbers_go_to_the_nearest_integer_or_far_away() {
        let most = exp2i(51);
        for whole in [0.0, 1.0, 2.0, 77.0, 1e9, exp2i(40) - 1.0, exp2i(50), most - 2.0] {
            for part in [0.0, 1e-9, 0.25, 0.499, 0.5, 0.501, 0.999] {
                for number in [whole + part, -whole - part] {
                    assert_eq!(nearest_integer(number), number.round_ties_even() as i64, "{number}");
                }
            }
        }
        for far in [most, 1e17, 1e300, f64::MAX, f64::INFINITY] {
            assert!(nearest_integer(far) >= 1 << 50 && nearest_integer(-far) < 0, "{far}");
        }
        for none in [f64::NAN, -f64::NAN] {
            assert!(!(0..1 << Lattice::MAX_BITS).contains(&nearest_integer(none)));
        }
    }

    #[test]
    fn snap_is_nearest() {
        let lattice = Lattice { origin: [1e7, -3.0, 0.0], exponent: -10 };
        for value in [0.0, 0.1, 1.0 / 3.0, 777.77] {
            let point = [1e7 + value, value - 3.0, value];
            let back = lattice.position(lattice.snap(point));
            for axis in 0..3 {
                assert!((back[axis] - point[axis]).abs() <= 0.5 * lattice.step());
            }
        }
    }
}
