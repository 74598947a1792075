//! `Neighbours`: the light of samples beside those of a row, added where both are alike in depth and albedo, for less
//! the more their normals differ: a bump has light of its own, and a surface that is all bumps has no other neighbours.

use super::surface::{ALBEDO_APART, DEPTH_SHARE, SurfaceRow};

/// A row of samples from column `first` on, and neighbours of them: of `row`, from column `at` on.
pub(super) struct Neighbours<'a> {
    pub(super) here: &'a SurfaceRow,
    pub(super) first: usize,
    pub(super) row: &'a SurfaceRow,
    pub(super) at: usize,
    pub(super) light: [&'a [f32]; 3],
}

impl<'a> Neighbours<'a> {
    /// Adds the weights and the light of the neighbours to their sums: the given weight times the 16th power of the
    /// cosine between the normals, where depth and albedo are alike.
    #[inline]
    pub(super) fn add(&self, total: &mut [f32], [red, green, blue]: [&mut [f32]; 3], weight: f32) {
        let count = total.len();
        let (red, green, blue) = (&mut red[..count], &mut green[..count], &mut blue[..count]);
        let (here, there) = (self.here, self.row);
        let of_here = |plane: &'a [f32]| &plane[self.first..self.first + count];
        let of_there = |plane: &'a [f32]| &plane[self.at..self.at + count];
        let (d0, d1) = (of_here(&here.depth), of_there(&there.depth));
        let [nx0, ny0, nz0] = here.normal.each_ref().map(|plane| of_here(plane));
        let [nx1, ny1, nz1] = there.normal.each_ref().map(|plane| of_there(plane));
        let [ar0, ag0, ab0] = here.albedo.each_ref().map(|plane| of_here(plane));
        let [ar1, ag1, ab1] = there.albedo.each_ref().map(|plane| of_there(plane));
        let [lr, lg, lb] = self.light.map(of_there);
        for i in 0..count {
            let dot = nx0[i] * nx1[i] + ny0[i] * ny1[i] + nz0[i] * nz1[i];
            let apart = (ar0[i] - ar1[i]).abs().max((ag0[i] - ag1[i]).abs()).max((ab0[i] - ab1[i]).abs());
            let is_near = (d0[i] - d1[i]).abs() < DEPTH_SHARE * d0[i].min(d1[i]);
            let is_alike = is_near & (apart < ALBEDO_APART);
            let weight = if is_alike { weight * power_16(dot.clamp(0.0, 1.0)) } else { 0.0 };
            total[i] += weight;
            red[i] += weight * lr[i];
            green[i] += weight * lg[i];
            blue[i] += weight * lb[i];
        }
    }
}

#[inline]
fn power_16(x: f32) -> f32 {
    let fourth = (x * x) * (x * x);
    (fourth * fourth) * (fourth * fourth)
}
