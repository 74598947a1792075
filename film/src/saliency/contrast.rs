//! Contrast: how much neighbours in a tile differ to the eye. A picture that was made of few samples is wrong where it
//! is not flat: at edges, in texture, in noise.

use super::reduced::SIDE_PIXELS;
use crate::packed::luminance;

/// Sums of the differences between pixels beside and above each other, by tiles; none over the edge of a tile.
pub(super) struct ContrastSums {
    /// Tiles in a row.
    columns: usize,
    /// The sum, and how many differences that is of.
    sums: Vec<(f32, f32)>,
    /// What the row of pixels above looks like.
    above: Vec<f32>,
}

impl ContrastSums {
    /// Of a picture of `resolution` (width, height; pixels), of which nothing is known yet.
    pub(super) fn new(resolution: [u32; 2]) -> ContrastSums {
        let [columns, rows] = resolution.map(|side| side.div_ceil(SIDE_PIXELS) as usize);
        ContrastSums {
            columns,
            sums: vec![(0.0, 0.0); columns * rows],
            above: vec![0.0; columns * SIDE_PIXELS as usize],
        }
    }

    /// Adds the pixels of a row of a tile, from (x, y) on, linear RGB; rows come from the top down.
    pub(super) fn add(&mut self, [x, y]: [u32; 2], row: &[[f32; 3]]) {
        let sums = &mut self.sums[(y / SIDE_PIXELS) as usize * self.columns + (x / SIDE_PIXELS) as usize];
        let is_first = y % SIDE_PIXELS == 0;
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
