//! `Surface`: what a sample of the preview saw, and rows of them side by side.
//!
//! Two samples are of one surface when they are alike in depth, normal and albedo; between them (`cells.rs`) however
//! they are turned. Voxels that stand in for missing
//! mesh are smoothed with it where they look like it; an exact sample of the mesh is never of one surface with them.

use crate::film::LayerPixel;
use std::ops::Range;

/// Depths of neighbours on one surface differ by less than this share.
pub(super) const DEPTH_SHARE: f32 = 0.08;
/// Least cosine between the normals of neighbours on one surface.
const NORMAL_COS: f32 = 0.85;
/// Most that the albedos of neighbours on one surface differ by, per channel.
pub(super) const ALBEDO_APART: f32 = 0.08;
/// Least albedo that light is told from.
const ALBEDO_LEAST: f32 = 1.0 / 64.0;
/// Bits of an f32 that a kept depth goes without: 16 of the mantissa. Its sign, which is none, says whether voxels are
/// seen.
const DEPTH_SHIFT: u32 = 16;
const VOXEL_BIT: u16 = 1 << 15;
/// Codes of 1, of a normal's part and of an albedo's.
const NORMAL_PARTS: f32 = 127.0;
const ALBEDO_PARTS: f32 = 255.0;

/// What an albedo of 1 counts as, which lamps have: far from that of any surface beside them.
const ALBEDO_OF_LAMPS: f32 = 2.0;

/// The numbers of the parts that are kept, by their bytes: a look-up is faster than a division.
static NORMALS: [f32; 256] = {
    let (mut table, mut byte) = ([0.0; 256], 0);
    while byte < 256 {
        table[byte] = byte as u8 as i8 as f32 / NORMAL_PARTS;
        byte += 1;
    }
    table
};
static ALBEDOS: [f32; 256] = {
    let (mut table, mut byte) = ([ALBEDO_LEAST; 256], 4);
    while byte < 255 {
        table[byte] = byte as f32 / ALBEDO_PARTS;
        byte += 1;
    }
    table[255] = ALBEDO_OF_LAMPS;
    table
};
const _: () = assert!(3.0 / 255.0 < ALBEDO_LEAST && ALBEDO_LEAST < 4.0 / 255.0);

/// What a sample saw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// The upper bits of an f32: right to 0.4 %, where 8 % count. Infinite where nothing is seen. With [`VOXEL_BIT`].
    depth: u16,
    /// Parts of 127, and of 255.
    normal: [i8; 3],
    albedo: [u8; 3],
}

/// The surfaces of a row of samples, number by number: so that those of a row go side by side.
#[derive(Default)]
pub(super) struct SurfaceRow {
    /// Infinite where nothing is seen.
    pub(super) depth: Vec<f32>,
    pub(super) normal: [Vec<f32>; 3],
    pub(super) albedo: [Vec<f32>; 3],
    pub(super) is_voxel: Vec<bool>,
}

/// Rows that were read last, `stride` apart: by number, row y at the place y / stride % 3. Each is read once while such
/// rows go by.
pub(super) struct SurfaceRows {
    stride: usize,
    rows: [(usize, SurfaceRow); 3],
}

impl SurfaceRow {
    /// Reads every `stride`-th sample of a row.
    fn read(&mut self, row: &[Surface], stride: usize) {
        let count = row.len().div_ceil(stride);
        self.planes().for_each(|plane| plane.resize(count, 0.0));
        self.is_voxel.clear();
        self.is_voxel.extend(row.iter().step_by(stride).map(|seen| seen.is_voxel()));
        let [nx, ny, nz] = self.normal.each_mut().map(|plane| &mut plane[..count]);
        let [red, green, blue] = self.albedo.each_mut().map(|plane| &mut plane[..count]);
        let depth = &mut self.depth[..count];
        for (x, seen) in (0..count).zip(row.iter().step_by(stride)) {
            depth[x] = seen.depth();
            [nx[x], ny[x], nz[x]] = seen.normal.map(|part| NORMALS[usize::from(part as u8)]);
            [red[x], green[x], blue[x]] = seen.albedo();
        }
    }

    fn planes(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        std::iter::once(&mut self.depth).chain(&mut self.normal).chain(&mut self.albedo)
    }
}

impl SurfaceRows {
    /// Rows that are looked at one after the other, `stride` apart, with one before and one after each.
    pub(super) fn new(stride: usize) -> SurfaceRows {
        SurfaceRows { stride, rows: std::array::from_fn(|_| (usize::MAX, SurfaceRow::default())) }
    }

    fn place(&self, y: usize) -> usize {
        y / self.stride % self.rows.len()
    }

    /// Reads row `y`, every `stride`-th of `row`, unless it stands there: true when it did not.
    pub(super) fn see(&mut self, y: usize, row: &[Surface], stride: usize) -> bool {
        let place = self.place(y);
        let (of, place) = &mut self.rows[place];
        let is_new = std::mem::replace(of, y) != y;
        if is_new {
            place.read(row, stride);
        }
        is_new
    }

    /// The samples `at` of row `y`, one of those seen last, saw nothing where they saw voxels.
    pub(super) fn hide_voxels(&mut self, y: usize, at: Range<usize>) {
        let place = self.place(y);
        let row = &mut self.rows[place].1;
        let voxels = row.depth[at.clone()].iter_mut().zip(&row.is_voxel[at]).filter(|(_, is)| **is);
        voxels.for_each(|(depth, _)| *depth = f32::INFINITY);
    }

    /// Row `y`, one of those seen last.
    pub(super) fn row(&self, y: usize) -> &SurfaceRow {
        &self.rows[self.place(y)].1
    }
}

impl Surface {
    pub(super) fn new(seen: &LayerPixel) -> Surface {
        // To the nearest; infinity stays what it is.
        let depth = ((seen.depth.to_bits() + (1 << (DEPTH_SHIFT - 1))) >> DEPTH_SHIFT) as u16;
        Surface {
            depth: if seen.is_voxel() { depth | VOXEL_BIT } else { depth },
            normal: seen.normal.map(|v| (v * NORMAL_PARTS).round() as i8),
            albedo: seen.albedo.map(|v| (v * ALBEDO_PARTS).round() as u8),
        }
    }

    /// Distance from the camera; infinite where nothing is seen.
    pub(super) fn depth(&self) -> f32 {
        f32::from_bits(u32::from(self.depth & !VOXEL_BIT) << DEPTH_SHIFT)
    }

    /// True when it is one of voxels.
    pub(super) fn is_voxel(&self) -> bool {
        self.depth & VOXEL_BIT != 0
    }

    /// True when both are of one surface and of one form of it, mesh or voxels, or both saw nothing.
    pub(super) fn is_same(&self, other: &Surface) -> bool {
        self.is_same_at(self.depth(), other)
    }

    /// As [`Surface::is_same`], of this surface at distance `here`.
    pub(super) fn is_same_at(&self, here: f32, other: &Surface) -> bool {
        let there = other.depth();
        if here == f32::INFINITY || there == f32::INFINITY {
            return here == there;
        }
        let dot: f32 = (0..3).map(|c| f32::from(self.normal[c]) * f32::from(other.normal[c])).sum();
        let [own, others] = [self, other].map(|of| of.albedo.map(|part| ALBEDOS[usize::from(part)]));
        let is_alike = (0..3).all(|c| (own[c] - others[c]).abs() < ALBEDO_APART);
        self.is_voxel() == other.is_voxel()
            && (here - there).abs() < DEPTH_SHARE * here.min(there)
            && dot > NORMAL_COS * NORMAL_PARTS * NORMAL_PARTS
            && is_alike
    }

    /// What light is multiplied by.
    pub(super) fn albedo(&self) -> [f32; 3] {
        match self.depth() == f32::INFINITY {
            true => [1.0; 3],
            false => self.albedo.map(|part| ALBEDOS[usize::from(part)]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depths are told apart from 8 % on: they are right to far less, at any scale, and what is not there stays so.
    #[test]
    fn a_depth_comes_back_in_any_unit() {
        for exponent in -120..120 {
            for share in [1.0f32, 1.001, 1.234_567, 1.5, 1.999_99] {
                let depth = share * 2f32.powi(exponent);
                let found = Surface::new(&LayerPixel { depth, ..LayerPixel::NOTHING }).depth();
                assert!((found / depth - 1.0).abs() <= 0.004, "{depth} {found}");
            }
        }
        assert_eq!(Surface::new(&LayerPixel::NOTHING).depth(), f32::INFINITY);
        assert_eq!(Surface::new(&LayerPixel::NOTHING).albedo(), [1.0; 3]);
        let dark = LayerPixel { depth: 1.0, ..LayerPixel::NOTHING };
        assert_eq!(Surface::new(&dark).albedo(), [ALBEDO_LEAST; 3]);
        assert_eq!(size_of::<Surface>(), 8);
    }

    /// A lamp in a white ceiling was one surface with it, and its light was smoothed over both: a halo.
    #[test]
    fn a_lamp_is_a_surface_of_its_own() {
        let of = |albedo: f32| {
            let seen = LayerPixel {
                depth: 1.0,
                normal: [0.0, 0.0, 1.0],
                albedo: [albedo; 3],
                ..LayerPixel::NOTHING
            };
            Surface::new(&seen)
        };
        assert!(!of(1.0).is_same(&of(0.99)) && of(1.0).is_same(&of(1.0)) && of(0.99).is_same(&of(0.95)));
    }
}
