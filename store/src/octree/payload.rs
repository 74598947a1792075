//! What the surface in a leaf is like, in few bits: normal, area, material.
//!
//! Invariant: what is packed comes back to within the width of its field; the tests say how far.

use glam::Vec3;

/// Bits of each octahedral coordinate of a leaf's normal, the lowest of its word.
pub const OCTAHEDRAL_BITS: u32 = 6;
/// Greatest coordinate. Even, so that 0 is one of them: axes and planes across them are met exactly.
const OCTAHEDRAL_MOST: i32 = (1 << OCTAHEDRAL_BITS) - 2;
const LENGTH_MOST: f32 = 15.0;

/// Mean normal of a leaf: direction (octahedral, Cigolle et al., "A survey of efficient representations for
/// independent unit vectors", JCGT 2014) and how long the mean is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LeafNormal(pub(super) u16);

impl LeafNormal {
    /// Of a unit normal and the length of the mean; of zero, none.
    pub(super) fn pack(normal: Vec3, flatness: f32) -> LeafNormal {
        if normal == Vec3::ZERO {
            return LeafNormal(0);
        }
        let n = normal.to_array();
        let l1 = n.iter().map(|v| v.abs()).sum::<f32>();
        let (x, y) = (n[0] / l1, n[1] / l1);
        let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
        let (x, y) = if n[2] < 0.0 { ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)) } else { (x, y) };
        let most = OCTAHEDRAL_MOST as f32;
        let grid = |v: f32| ((v * 0.5 + 0.5) * most).round().clamp(0.0, most) as u16;
        let flat = (flatness.min(1.0) * LENGTH_MOST).round().max(1.0) as u16;
        LeafNormal(grid(x) | grid(y) << OCTAHEDRAL_BITS | flat << (2 * OCTAHEDRAL_BITS))
    }

    /// The unit normal and the length of the mean; zeros where none is known.
    pub(super) fn unpack(self) -> ([f32; 3], f32) {
        let flatness = f32::from(self.0 >> (2 * OCTAHEDRAL_BITS)) / LENGTH_MOST;
        if flatness == 0.0 {
            return ([0.0; 3], 0.0);
        }
        let n = self.octahedral().map(|v| v as f32);
        let length = n.iter().map(|v| v * v).sum::<f32>().sqrt();
        (n.map(|v| v / length), flatness)
    }

    /// The axis and sign along which the normal is longest: `2 * axis`, plus 1 when it looks down the axis.
    #[inline]
    pub(super) fn facet(self) -> usize {
        let n = self.octahedral();
        let size = n.map(i32::abs);
        let axis = if size[0] >= size[1] && size[0] >= size[2] {
            0
        } else if size[1] >= size[2] {
            1
        } else {
            2
        };
        2 * axis + usize::from(n[axis] < 0)
    }

    /// The direction, of some length: in integers, so that a facet is no matter of rounding.
    #[inline]
    fn octahedral(self) -> [i32; 3] {
        let [x, y] = self.coordinates().map(|v| 2 * v - OCTAHEDRAL_MOST);
        let z = OCTAHEDRAL_MOST - x.abs() - y.abs();
        let fold = (-z).max(0);
        let folded = |v: i32| if v < 0 { v + fold } else { v - fold };
        [folded(x), folded(y), z]
    }

    fn coordinates(self) -> [i32; 2] {
        [0, OCTAHEDRAL_BITS].map(|shift| i32::from(self.0 >> shift & ((1 << OCTAHEDRAL_BITS) - 1)))
    }

    /// Whether it is one that `pack` makes.
    pub(super) fn is_sound(self) -> bool {
        self.coordinates().iter().all(|&v| v <= OCTAHEDRAL_MOST)
    }
}

/// Areas are kept as floats of 4 exponent and 4 mantissa bits, from 2^-10 to 2^6: by the bits of an f32, rounded.
const AREA_SHIFT: u32 = 19;
const AREA_FIRST: u32 = (127 - 10) << 4;

/// A positive area in squares of a leaf's side.
pub(super) fn pack_area(area: f32) -> u8 {
    let rounded = (area.max(0.0).to_bits() + (1 << (AREA_SHIFT - 1))) >> AREA_SHIFT;
    rounded.saturating_sub(AREA_FIRST).min(255) as u8
}

pub(super) fn unpack_area(word: u8) -> f32 {
    f32::from_bits((u32::from(word) + AREA_FIRST) << AREA_SHIFT)
}

/// Materials of leaves: nothing where there is but one, a byte each where that does.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Materials {
    Only,
    Narrow(Vec<u8>),
    Wide(Vec<u16>),
}

impl Materials {
    /// An empty list with room for `capacity`, for a model with so many materials.
    pub(super) fn new(material_count: usize, capacity: usize) -> Materials {
        match material_count {
            0 | 1 => Materials::Only,
            ..=256 => Materials::Narrow(Vec::with_capacity(capacity)),
            _ => Materials::Wide(Vec::with_capacity(capacity)),
        }
    }

    /// Bytes of memory of a leaf's.
    pub(super) fn bytes(material_count: usize) -> u64 {
        match material_count {
            0 | 1 => 0,
            ..=256 => 1,
            _ => 2,
        }
    }

    pub(super) fn push(&mut self, material: u16) {
        match self {
            Materials::Only => {}
            Materials::Narrow(list) => list.push(u8::try_from(material).expect("one of the model's")),
            Materials::Wide(list) => list.push(material),
        }
    }

    #[inline]
    pub(super) fn get(&self, leaf: usize) -> u16 {
        match self {
            Materials::Only => 0,
            Materials::Narrow(list) => u16::from(list[leaf]),
            Materials::Wide(list) => list[leaf],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn normals_and_areas_survive(n in proptest::array::uniform3(-1f32..1.0), area in 0.002f32..60.0) {
            let length = n.iter().map(|v| v * v).sum::<f32>().sqrt();
            prop_assume!(length > 0.1);
            let unit = n.map(|v| v / length);
            let packed = LeafNormal::pack(unit.into(), 0.8);
            let (back, flatness) = packed.unpack();
            let cos: f32 = (0..3).map(|a| back[a] * unit[a]).sum();
            // Half a step in two coordinates, both in the third, on a vector no shorter than 1 / sqrt(3): sqrt(18) /
            // 62 rad.
            prop_assert!(cos > 0.9976 && (flatness - 0.8).abs() < 0.04, "{} {}", cos, flatness);
            prop_assert!((unpack_area(pack_area(area)) / area - 1.0).abs() < 0.035);
            let longest = unit.iter().fold(0f32, |m, v| m.max(v.abs()));
            let [axis, sign] = [packed.facet() / 2, packed.facet() % 2];
            // Each component off by so many radians at most.
            prop_assert!(unit[axis].abs() > longest - 2.0 * 18f32.sqrt() / 62.0 && (unit[axis] < 0.0) == (sign == 1));
        }
    }

    #[test]
    fn axes_are_met_exactly() {
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut n = [0.0; 3];
                n[axis] = sign;
                assert_eq!(LeafNormal::pack(n.into(), 1.0).unpack(), (n, 1.0));
            }
        }
    }
}
