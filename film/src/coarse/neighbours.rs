//! `Neighbours`: the light of samples beside those of a row, added where both are alike in depth and albedo, for less
//! the more their normals differ: a bump has light of its own, and a surface that is all bumps has no other neighbours;
//! and for less the more their light differs from what its noise explains.
//!
//! Unsafe code: one call of the same loop compiled for AVX2, where the machine has that.
#![allow(unsafe_code)]

use super::surface::{ALBEDO_APART, DEPTH_SHARE, SurfaceRow};

/// A row of samples from column `first` on, and neighbours of them: of `row`, from column `at` on.
pub(super) struct Neighbours<'a, const N: usize> {
    pub(super) here: &'a SurfaceRow,
    pub(super) first: usize,
    pub(super) row: &'a SurfaceRow,
    pub(super) light: [&'a [f32]; N],
    pub(super) at: usize,
    /// Tells neighbours apart by their light; `None` for those that count whatever it is.
    pub(super) contrast: Option<Contrast<'a>>,
}

/// How the luminance of neighbours differs.
#[derive(Clone, Copy)]
pub(super) struct Contrast<'a> {
    /// Of the row, and of that of the neighbours.
    pub(super) luminances: [&'a [f32]; 2],
    /// One over the difference at which a neighbour counts half, by samples of the row.
    pub(super) per_half: &'a [f32],
}

impl<'a, const N: usize> Neighbours<'a, N> {
    /// Adds the weights and the light of the neighbours to their sums: the given weight times the 16th power of the
    /// cosine between the normals, where depth and albedo are alike, and less by the contrast.
    pub(super) fn add(&self, total: &mut [f32], sums: [&mut [f32]; N], weight: f32) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the machine has what it is compiled for.
            return unsafe { self.add_wide(total, sums, weight) };
        }
        self.add_on_any(total, sums, weight);
    }

    /// [`Neighbours::add_on_any`], eight samples at a time: each by the same operations.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_wide(&self, total: &mut [f32], sums: [&mut [f32]; N], weight: f32) {
        self.add_on_any(total, sums, weight);
    }

    #[inline(always)]
    fn add_on_any(&self, total: &mut [f32], sums: [&mut [f32]; N], weight: f32) {
        let Some(Contrast { luminances: [here, there], per_half }) = self.contrast else {
            return self.add_alike(total, sums, |_| weight, power_16);
        };
        let count = total.len();
        let (here, per_half) = (&here[self.first..][..count], &per_half[self.first..][..count]);
        let there = &there[self.at..][..count];
        self.add_alike(
            total,
            sums,
            #[inline(always)]
            |i| {
                let apart = (there[i] - here[i]) * per_half[i];
                weight / (1.0 + (apart * apart) * (apart * apart))
            },
            power_16,
        );
    }

    /// [`Neighbours::add`] of those alike in depth and albedo, however they are turned and whatever their light.
    pub(super) fn add_turned(&self, total: &mut [f32], sums: [&mut [f32]; N], weight: f32) {
        self.add_alike(total, sums, |_| weight, |_| 1.0);
    }

    /// Adds neighbours of such weights, by `facing` of the cosine between the normals, where they are alike.
    #[inline(always)]
    fn add_alike(
        &self,
        total: &mut [f32],
        sums: [&mut [f32]; N],
        weight: impl Fn(usize) -> f32,
        facing: impl Fn(f32) -> f32,
    ) {
        let count = total.len();
        let mut sums = sums.map(|sum| &mut sum[..count]);
        let (here, there) = (self.here, self.row);
        let of_here = |plane: &'a [f32]| &plane[self.first..self.first + count];
        let of_there = |plane: &'a [f32]| &plane[self.at..self.at + count];
        let (d0, d1) = (of_here(&here.depth), of_there(&there.depth));
        let [nx0, ny0, nz0] = here.normal.each_ref().map(|plane| of_here(plane));
        let [nx1, ny1, nz1] = there.normal.each_ref().map(|plane| of_there(plane));
        let [ar0, ag0, ab0] = here.albedo.each_ref().map(|plane| of_here(plane));
        let [ar1, ag1, ab1] = there.albedo.each_ref().map(|plane| of_there(plane));
        let light = self.light.map(of_there);
        for i in 0..count {
            let dot = nx0[i] * nx1[i] + ny0[i] * ny1[i] + nz0[i] * nz1[i];
            let apart = (ar0[i] - ar1[i]).abs().max((ag0[i] - ag1[i]).abs()).max((ab0[i] - ab1[i]).abs());
            let is_near = (d0[i] - d1[i]).abs() < DEPTH_SHARE * d0[i].min(d1[i]);
            let is_alike = is_near & (apart < ALBEDO_APART);
            let weight = if is_alike { weight(i) * facing(dot) } else { 0.0 };
            total[i] += weight;
            for (sum, light) in sums.iter_mut().zip(light) {
                sum[i] += weight * light[i];
            }
        }
    }
}

/// The 16th power of a cosine, 0 below 0.
#[inline]
fn power_16(cosine: f32) -> f32 {
    let x = cosine.clamp(0.0, 1.0);
    let fourth = (x * x) * (x * x);
    (fourth * fourth) * (fourth * fourth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    /// Numbers by chance in [0, 1): the `index`-th row of them.
    fn row(index: u64, width: usize) -> Vec<f32> {
        (0..width as u64).map(|x| (mix(index << 32 | x) >> 40) as f32 / (1u64 << 24) as f32).collect()
    }

    fn surfaces(index: u64, width: usize) -> SurfaceRow {
        let near = |index: u64, by: f32, from: f32| row(index, width).iter().map(|v| from + by * v).collect();
        SurfaceRow {
            depth: near(index, 0.2, 2.0),
            normal: [near(index + 1, 0.4, 0.0), near(index + 2, 0.4, 0.0), near(index + 3, 0.3, 0.7)],
            albedo: [4, 5, 6].map(|c| near(index + c, 0.1, 0.5)),
            ..SurfaceRow::default()
        }
    }

    /// Whatever the machine has, the bytes are those of the plain loop.
    #[test]
    fn the_loop_for_avx2_gives_the_same_bytes() {
        for width in [1, 7, 8, 33, 200] {
            let (here, there) = (surfaces(1, width), surfaces(10, width));
            let lights = [20, 21, 22].map(|index| row(index, width));
            let luminances = [30, 31].map(|index| row(index, width));
            let per_half: Vec<f32> = row(32, width).iter().map(|v| 8.0 * v).collect();
            for is_guided in [false, true] {
                let contrast =
                    Contrast { luminances: luminances.each_ref().map(|row| &row[..]), per_half: &per_half };
                let contrast = is_guided.then_some(contrast);
                let light = lights.each_ref().map(|row| &row[..]);
                let neighbours = Neighbours { here: &here, first: 0, row: &there, light, at: 0, contrast };
                let sums = |is_plain: bool| {
                    let mut sums = [0; 4].map(|_| vec![0.25; width]);
                    let [total, red, green, blue] = &mut sums;
                    let light = [&mut red[..], green, blue];
                    match is_plain {
                        true => neighbours.add_on_any(total, light, 0.125),
                        false => neighbours.add(total, light, 0.125),
                    }
                    sums.map(|row| row.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
                };
                let plain = sums(true);
                assert!(plain[0].iter().any(|bits| *bits != 0.25f32.to_bits()), "some are alike");
                assert_eq!(sums(false), plain, "{width} {is_guided}");
            }
        }
    }
}
