//! `Cells`: pixels between the samples of two rows.
//!
//! ```text
//! a . . . b        bilinear where all four are of one surface; else of the nearest, and of those that are of one
//! . . . . .        surface with it
//! c . . . d
//! ```
//!
//! Where exact samples said what the pixels between saw, of the corners that are of one surface with that.

use super::corners::TileCorners;
use super::surface::{ALBEDO_APART, DEPTH_SHARE, SurfaceRow};
use crate::packed::PackedLight;
use glam::Vec3;

/// Two rows of samples, between which pixels are filled in; the last row stands for the one after it.
pub(super) struct Cells<'a> {
    pub(super) surfaces: [&'a SurfaceRow; 2],
    /// Red, green and blue of each row.
    pub(super) lights: [[&'a [f32]; 3]; 2],
}

/// The pixels that a cell is filled in.
pub(super) struct CellPixels<'a> {
    /// Rows of pixels, `width` each.
    pub(super) band: &'a mut [PackedLight],
    pub(super) width: usize,
    /// The first pixel (x, y) of the cell and what is known of its tile, where exact samples were taken.
    pub(super) known: Option<([u32; 2], TileCorners)>,
}

/// Weight of a corner that a pixel does not lie between, beside those that it does: it counts where these are of other
/// surfaces.
const FAR_WEIGHT: f32 = 1e-3;

/// A corner of a cell: its row of the two, and its column.
type Corner = (usize, usize);

impl Cells<'_> {
    /// Fills the pixels of cell `x`, `step` along a side, from its corners.
    pub(super) fn fill(&self, pixels: CellPixels<'_>, [x, step]: [usize; 2], weights: &[[f32; 4]]) {
        let CellPixels { band, width, known } = pixels;
        let right = (x + 1).min(self.surfaces[0].depth.len() - 1);
        let corners = [(0, x), (0, right), (1, x), (1, right)];
        let is_one = known.is_some() || corners[1..].iter().all(|&corner| self.is_alike(corners[0], corner));
        let alike = (!is_one).then(|| corners.map(|a| corners.map(|b| self.is_alike(a, b))));
        let shades = corners.map(|corner| self.shade(corner));
        let columns = step.min(width - x * step);
        for ((v, row), weights) in (0..).zip(band.chunks_exact_mut(width)).zip(weights.chunks_exact(step)) {
            for ((u, pixel), weights) in (0..).zip(&mut row[x * step..][..columns]).zip(weights) {
                let mut weights = *weights;
                if let Some(([x, y], corners)) = known {
                    keep_known(corners.of([x + u, y + v]), &mut weights);
                } else if let Some(alike) = &alike {
                    keep_alike(alike, &mut weights);
                }
                let [a, b, c, d] = shades;
                let shade = weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d;
                *pixel = PackedLight::new(shade.into());
            }
        }
    }

    /// Radiance of a sample.
    fn shade(&self, (row, x): Corner) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.lights[row][c][x] * self.surfaces[row].albedo[c][x]))
    }

    /// True when two neighbours are of one surface in one form, or both saw nothing. However they are turned: of bumps
    /// finer than the grid the mean of samples is nearer to the truth than one of them.
    fn is_alike(&self, (row_a, a): Corner, (row_b, b): Corner) -> bool {
        let (here, there) = (self.surfaces[row_a], self.surfaces[row_b]);
        let [depth_a, depth_b] = [here.depth[a], there.depth[b]];
        if depth_a == f32::INFINITY || depth_b == f32::INFINITY {
            return depth_a == depth_b;
        }
        let apart = (0..3).map(|c| (here.albedo[c][a] - there.albedo[c][b]).abs()).fold(0.0, f32::max);
        (depth_a - depth_b).abs() < DEPTH_SHARE * depth_a.min(depth_b)
            && apart < ALBEDO_APART
            && here.is_voxel[a] == there.is_voxel[b]
    }
}

/// Leaves weight only to the nearest corner and those that it is alike to.
fn keep_alike(alike: &[[bool; 4]; 4], weights: &mut [f32; 4]) {
    let nearest = (1..4).fold(0, |best, corner| if weights[corner] > weights[best] { corner } else { best });
    for (weight, stays) in weights.iter_mut().zip(alike[nearest]) {
        *weight = if stays { *weight } else { 0.0 };
    }
    let total: f32 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= total);
}

/// Leaves weight only to the corners that a pixel is of one surface with; as they are where there are none.
fn keep_known(is_same: [bool; 4], weights: &mut [f32; 4]) {
    let kept: [f32; 4] = std::array::from_fn(|c| if is_same[c] { weights[c].max(FAR_WEIGHT) } else { 0.0 });
    let total: f32 = kept.iter().sum();
    if total > 0.0 {
        *weights = kept.map(|weight| weight / total);
    }
}
