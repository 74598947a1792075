//! `CollapsedSizes`: the triangles with area that the lattice cannot tell from nothing, by how much finer it would have
//! to be.
//!
//! Two corners fall on one point of the lattice only where no axis keeps them a step apart. So a triangle is kept for
//! certain on a lattice whose step is at most its shortest edge, each taken along its longest axis.
//!
//! Invariant: the sum of the counts is that of all such triangles.

use serde::{Deserialize, Serialize};

/// Powers of two by which the lattice may be finer.
const SIZES: usize = 32;

/// See the module's description: how many are kept by a step that is at least 2, 4, 8, ... times finer; the last counts
/// those that need more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct CollapsedSizes([u64; SIZES]);

impl CollapsedSizes {
    /// Counts a triangle with area that two corners on one point have cost, on a lattice of this `step`.
    pub(crate) fn add(&mut self, [a, b, c]: &[[f64; 3]; 3], step: f64) {
        let edge =
            |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).abs()).fold(0.0, f64::max);
        let shortest = edge(a, b).min(edge(b, c)).min(edge(c, a));
        let needed = (step / shortest).log2().ceil().clamp(1.0, SIZES as f64);
        self.0[needed as usize - 1] += 1;
    }

    /// All of them.
    pub(crate) fn count(&self) -> u64 {
        // A record of somebody else's may hold any numbers.
        self.0.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// By how many powers of two the lattice has to be finer, so that at most `most` are lost; `None` where none is
    /// fine enough.
    pub(crate) fn halvings(&self, most: u64) -> Option<u32> {
        let lost =
            |halvings: usize| self.0[halvings..].iter().fold(0u64, |sum, count| sum.saturating_add(*count));
        (0..SIZES).find(|&halvings| lost(halvings) <= most).map(|halvings| halvings as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_needs_the_step_of_its_shortest_edge() {
        let mut sizes = CollapsedSizes::default();
        let triangle = |short: f64| [[0.0; 3], [1.0, 0.5, 0.0], [0.1 * short, -short, 0.0]];
        // Less than a step, of which a half, a quarter, an eighth are at most as long.
        for short in [0.9, 0.5, 0.49, 0.2, 1e-30] {
            sizes.add(&triangle(short), 1.0);
        }
        assert_eq!(sizes.count(), 5);
        let halvings = (0..=5).map(|most| sizes.halvings(most));
        assert_eq!(halvings.collect::<Vec<_>>(), [None, Some(3), Some(2), Some(1), Some(1), Some(0)]);
    }
}
