//! `ColourMeans`: the mean colour of each material, which voxels have in place of the colours of the mesh.
//!
//! ```text
//! mean of a material = sum of (area x mean of the corners' colours, linear) / sum of areas
//! ```
//!
//! Invariant: sums are made in the order of the stream, so they follow from it alone.

use crate::cluster::Colour;
use crate::layout::MATERIALS;
use crate::srgb;

/// Sums of one material: red, green and blue by area, linear; area, in squares of lattice steps.
type Sums = [f64; 4];

/// The sums of all materials met so far.
pub(crate) struct ColourMeans {
    /// Of each byte.
    linear: [f64; 256],
    sums: Vec<Sums>,
}

impl ColourMeans {
    /// Bytes at most.
    pub(crate) const BYTES: u64 = (MATERIALS * size_of::<Sums>()) as u64;

    /// Of no triangle.
    pub(crate) fn new() -> ColourMeans {
        ColourMeans { linear: std::array::from_fn(|byte| srgb::linear_of(byte as u8)), sums: Vec::new() }
    }

    /// Adds a triangle.
    pub(crate) fn add(&mut self, q: &[[i64; 3]; 3], material: u16, colours: &[Colour; 3]) {
        let index = usize::from(material);
        if index >= self.sums.len() {
            self.sums.reserve_exact(index + 1 - self.sums.len());
            self.sums.resize(index + 1, Sums::default());
        }
        let area = area(q);
        for (channel, sum) in self.sums[index][..3].iter_mut().enumerate() {
            let light: f64 = colours.iter().map(|colour| self.linear[usize::from(colour[channel])]).sum();
            *sum += area * light / 3.0;
        }
        self.sums[index][3] += area;
    }

    /// The mean colour of each material; that of one without area is white.
    pub(crate) fn colours(&self) -> impl Iterator<Item = Colour> {
        self.sums.iter().map(|&[r, g, b, area]| match area > 0.0 {
            true => [r, g, b].map(|sum| srgb::byte_of(sum / area)),
            false => crate::cluster::WHITE,
        })
    }

    /// The sums as words.
    pub(crate) fn words(&self) -> &[u8] {
        bytemuck::cast_slice(&self.sums)
    }

    /// Takes the sums of [`Self::words`]; false where they cannot be any.
    pub(crate) fn restore(&mut self, words: &[u8]) -> bool {
        let is_whole = words.len().is_multiple_of(size_of::<Sums>()) && words.len() as u64 <= Self::BYTES;
        if is_whole {
            self.sums = bytemuck::allocation::pod_collect_to_vec(words);
        }
        let is_sound = |sum: &f64| sum.is_finite() && *sum >= 0.0;
        is_whole && self.sums.as_flattened().iter().all(is_sound)
    }
}

/// In squares of steps; coordinates have 40 bits, so it is finite.
fn area([a, b, c]: &[[i64; 3]; 3]) -> f64 {
    let edge = |to: &[i64; 3]| [0, 1, 2].map(|axis| (to[axis] - a[axis]) as f64);
    let (e, f) = (edge(b), edge(c));
    let cross = [(1, 2), (2, 0), (0, 1)].map(|(x, y)| e[x] * f[y] - e[y] * f[x]);
    0.5 * cross.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::WHITE;

    /// Two triangles of area 8 and 24: a quarter white, three quarters black, as light.
    #[test]
    fn area_weighs_and_light_is_linear() {
        let mut means = ColourMeans::new();
        means.add(&[[0, 0, 5], [4, 0, 5], [0, 4, 5]], 1, &[WHITE; 3]);
        means.add(&[[0, 0, 5], [4, 0, 5], [0, 12, 5]], 1, &[[0; 3]; 3]);
        // 0.25 of light is 137 of 255.
        assert_eq!(means.colours().collect::<Vec<_>>(), [WHITE, [137; 3]]);
        let mut again = ColourMeans::new();
        assert!(again.restore(means.words()) && again.colours().eq(means.colours()));
        assert!(!again.restore(&means.words()[1..]) && !again.restore(&f64::NAN.to_le_bytes().repeat(4)));
    }
}
