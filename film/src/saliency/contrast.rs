//! Contrast: how much neighbours in a tile differ to the eye. A picture that was made of few samples is wrong where it
//! is not flat: at edges, in texture, in noise.

use crate::packed::luminance;

/// Sums of the differences between pixels beside and above each other, by tiles; none over the edge of a tile.
pub(super) struct ContrastSums {
    /// Pixels of a tile along a side.
    side: u32,
    /// Tiles in a row.
    columns: usize,
    /// The sum, and how many differences that is of.
    sums: Vec<(f32, f32)>,
    /// What the row of pixels above looks like.
    above: Vec<f32>,
}

impl ContrastSums {
    /// Of a picture of `resolution` (width, height; pixels), in tiles of `side` pixels, of which nothing is known yet.
    pub(super) fn new(resolution: [u32; 2], side: u32) -> ContrastSums {
        let [columns, rows] = resolution.map(|pixels| pixels.div_ceil(side) as usize);
        ContrastSums {
            side,
            columns,
            sums: vec![(0.0, 0.0); columns * rows],
            above: vec![0.0; columns * side as usize],
        }
    }

    /// Adds the pixels of a row of a tile, from (x, y) on, linear RGB; rows come from the top down.
    pub(super) fn add(&mut self, [x, y]: [u32; 2], row: &[[f32; 3]]) {
        let [column, row_of_tiles] = [x, y].map(|v| (v / self.side) as usize);
        let sums = &mut self.sums[row_of_tiles * self.columns + column];
        let is_first = y % self.side == 0;
        let mut left = None;
        for (rgb, above) in row.iter().zip(&mut self.above[x as usize..]) {
            // About as light as it looks.
            let seen = luminance(rgb.map(|value| value.clamp(0.0, 1.0)).into()).sqrt();
            for other in [left, (!is_first).then_some(*above)].into_iter().flatten() {
                *sums = (sums.0 + (seen - other).abs(), sums.1 + 1.0);
            }
            (left, *above) = (Some(seen), seen);
        }
    }

    /// The mean difference of each tile, in rows; 0 to 1.
    pub(super) fn means(&self) -> Vec<f32> {
        self.sums.iter().map(|(sum, count)| sum / count.max(1.0)).collect()
    }
}
