//! `Record`: what one material brings to one leaf, and the surface that the sums of a leaf make.
//!
//! ```text
//! sums over what is in the leaf: area a, a n, a n n^T          (n: unit normals)
//!
//! one way, or round a corner:  |sum a n| is most of the area   -> the mean normal
//! sheets back to back, foil:   the sums cancel                 -> the axis along which normals are longest
//! area of the front: with the normal; of the back: against it; of a side: what is seen from there
//! ```
//!
//! Why the axis: the mean of two sheets back to back is rounding noise, and a ray could not tell by it on which of them
//! it is. Light is kept by side, so it has to know.
//!
//! Invariant: whatever is summed, also by a file that somebody else has sealed, a surface is of finite numbers.

use super::LEAF_SIDE;
use glam::{Mat3, Vec3};

/// What one material brings to one leaf.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Record {
    /// The leaf's key (see `leaf_key`) over 16 bits of the material: the order of records.
    pub(super) order: u64,
    /// Subvoxels touched: bit `x + 4 y + 16 z`.
    pub(crate) bitmap: u64,
    /// Area inside of the leaf, in squares of its side.
    pub(crate) area: f32,
    /// Sum of unit normals weighted by area.
    pub(crate) normal: [f32; 3],
    /// Sum of the products of their components, weighted by area: xx, yy, zz, xy, yz, zx.
    pub(crate) moments: [f32; 6],
}

/// The surface in a leaf as light takes it: one plane with two sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LeafSurface {
    /// Unit normal of the front; zero where none is known.
    pub(super) normal: Vec3,
    /// Length of the mean of the normals, each turned to the front: 1 = flat.
    pub(super) flatness: f32,
    /// Area that is seen from either side, in squares of the leaf's side.
    pub(super) side_area: f32,
}

/// Share of the area that the sum of normals has to have so that it tells the front; below it they cancel.
const MEAN_LEAST: f32 = 0.5;
/// Squarings that find the axis: of two directions of which one has a hundredth more, that is 12 times the other then.
const AXIS_SQUARINGS: usize = 8;

impl Record {
    /// An empty one.
    pub(super) fn at(key: u64, material: u16) -> Record {
        Record { order: key << 16 | u64::from(material), ..Record::default() }
    }

    /// Of a flat piece with this area and unit normal.
    pub(super) fn of_piece(key: u64, material: u16, (bitmap, area): (u64, f64), n: [f64; 3]) -> Record {
        let moments =
            [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)].map(|(a, b)| (n[a] * n[b] * area) as f32);
        let normal = n.map(|n| (n * area) as f32);
        Record { bitmap, area: area as f32, normal, moments, ..Record::at(key, material) }
    }

    /// The leaf.
    pub(super) fn key(&self) -> u64 {
        self.order >> 16
    }

    /// The material.
    pub(super) fn material(&self) -> u16 {
        self.order as u16
    }

    /// True when all of its numbers are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.normal.iter().chain(&self.moments).chain([&self.area]).all(|v| v.is_finite())
    }

    /// Sums another record of the same leaf.
    pub(crate) fn add(&mut self, other: &Record) {
        self.bitmap |= other.bitmap;
        self.area += other.area;
        (0..3).for_each(|a| self.normal[a] += other.normal[a]);
        (0..6).for_each(|m| self.moments[m] += other.moments[m]);
    }

    /// The record with its sums times `share`.
    pub(super) fn scaled(&self, share: f32) -> Record {
        let (normal, moments) = (self.normal.map(|n| share * n), self.moments.map(|m| share * m));
        Record { area: share * self.area, normal, moments, ..*self }
    }

    /// The surface that the sums make; none where they have no area, or are not finite.
    pub(super) fn surface(&self) -> LeafSurface {
        let sum = Vec3::from(self.normal);
        let mean = sum.length();
        let is_known = self.is_finite() && self.area > 0.0 && mean.is_finite();
        if !is_known || mean == 0.0 && self.moments[..3].iter().all(|&m| m <= 0.0) {
            let side_area = if self.is_finite() { self.area.max(0.0) } else { 0.0 };
            return LeafSurface { normal: Vec3::ZERO, flatness: 0.0, side_area };
        }
        if mean >= MEAN_LEAST * self.area {
            let normal = sum / mean;
            return self.with_sides(normal, mean / self.area);
        }
        let axis = self.main_axis();
        let front = if axis.dot(sum) < 0.0 { -axis } else { axis };
        self.with_sides(front, (self.along(front) / self.area).max(0.0).sqrt().min(1.0))
    }

    /// The surface with this normal.
    fn with_sides(&self, normal: Vec3, flatness: f32) -> LeafSurface {
        // Of sheets the area of the front less that of the back is the sum along the normal; of what is bent, that over
        // how far a normal of it looks along: half of a pipe is its front.
        let cosine = (self.along(normal) / self.area).max(0.0).sqrt();
        let apart = normal.dot(self.normal.into()) / cosine.max(f32::MIN_POSITIVE);
        let back = 0.5 * (self.area - apart).max(0.0).min(self.area);
        let side_area = self.covered(normal).max(self.area - back).min(self.area);
        LeafSurface { normal, flatness, side_area }
    }

    /// Sum of the squares of the components of normals along unit `n`, weighted by area.
    fn along(&self, n: Vec3) -> f32 {
        n.dot(self.matrix() * n)
    }

    /// The moments as a matrix.
    fn matrix(&self) -> Mat3 {
        let [xx, yy, zz, xy, yz, zx] = self.moments;
        Mat3::from_cols(Vec3::new(xx, xy, zx), Vec3::new(xy, yy, yz), Vec3::new(zx, yz, zz))
    }

    /// The unit axis along which normals are longest: what a high power of the matrix makes of any vector.
    fn main_axis(&self) -> Vec3 {
        let trace = |m: &Mat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
        let mut power = self.matrix();
        for _ in 0..AXIS_SQUARINGS {
            power *= 1.0 / trace(&power);
            power *= power;
        }
        let columns = [power.x_axis, power.y_axis, power.z_axis];
        let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        longest.and_then(Vec3::try_normalize).unwrap_or(Vec3::Z)
    }

    /// Area of a plane with this normal that covers as many columns of subvoxels as the bitmap, along the axis on which
    /// the normal is longest; in squares of the leaf's side.
    fn covered(&self, normal: Vec3) -> f32 {
        let size = normal.abs();
        let (longest, shift) = match size.max_element() {
            most if most == size.x => (size.x, [1, 2, 3]),
            most if most == size.y => (size.y, [4, 8, 12]),
            most => (most, [16, 32, 48]),
        };
        let columns = shift.iter().fold(self.bitmap, |bits, shift| bits | self.bitmap >> shift);
        let first = match shift[0] {
            1 => 0x1111_1111_1111_1111,
            4 => 0x000f_000f_000f_000f,
            _ => 0xffff,
        };
        (columns & first).count_ones() as f32 / ((LEAF_SIDE * LEAF_SIDE) as f32 * longest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits of the layer `index` across an axis.
    fn layer(axis: usize, index: u32) -> u64 {
        let place = |bit: u32| bit >> (2 * axis) & 3;
        (0..64).filter(|&bit| place(bit) == index).fold(0, |bits, bit| bits | 1 << bit)
    }

    fn sum(pieces: &[(u64, f64, [f64; 3])]) -> LeafSurface {
        let mut all = Record::at(0, 0);
        for &(bitmap, area, normal) in pieces {
            all.add(&Record::of_piece(0, 0, (bitmap, area), normal));
        }
        all.surface()
    }

    fn assert_near(found: &LeafSurface, normal: [f32; 3], flatness: f32, side_area: f32) {
        let normal = Vec3::from(normal);
        assert!((found.normal - normal).length() < 1e-3, "{found:?}, not {normal}");
        assert!(
            (found.flatness - flatness).abs() < 1e-3 && (found.side_area - side_area).abs() < 1e-3,
            "{found:?}"
        );
    }

    #[test]
    fn two_sheets_back_to_back_are_a_plane_with_two_sides() {
        for axis in 0..3 {
            let mut n = [0.0; 3];
            n[axis] = 1.0;
            let (up, down) = (n, n.map(|v| -v));
            let front = up.map(|v| v as f32);
            assert_near(&sum(&[(layer(axis, 1), 1.0, up)]), front, 1.0, 1.0);
            // A board of some thickness; its halves as a triangle soup turns them.
            assert_near(&sum(&[(layer(axis, 1), 1.01, up), (layer(axis, 1), 1.0, down)]), front, 1.0, 1.01);
            assert_near(&sum(&[(layer(axis, 2), 0.52, up), (layer(axis, 2), 0.48, down)]), front, 1.0, 1.0);
        }
    }

    #[test]
    fn slanted_sheets_know_their_axis() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for n in [[half, half, 0.0], [half, -half, 0.0], [0.0, half, -half], [-half, 0.0, half]] {
            let board = sum(&[(u64::MAX, 1.2, n), (u64::MAX, 1.1, n.map(|v| -v))]);
            assert_near(&board, n.map(|v| v as f32), 1.0, std::f32::consts::SQRT_2);
        }
    }

    /// A block of a scratch file may be of somebody else's making, with numbers that are finite one by one.
    #[test]
    fn sums_beyond_all_numbers_make_no_surface() {
        let most = [f32::MAX, -f32::MAX];
        for (area, normal) in most.into_iter().flat_map(|area| most.map(|normal| (area, normal))) {
            for moment in most {
                let record = Record { area, normal: [normal; 3], moments: [moment; 6], ..Record::at(0, 0) };
                let mut sum = Record { bitmap: 1, ..record };
                for _ in 0..3 {
                    sum.add(&record);
                    sum.add(&Record { normal: [0.1; 3], ..record });
                    let LeafSurface { normal, flatness, side_area } = sum.surface();
                    assert!(normal.is_finite() && flatness.is_finite() && side_area.is_finite(), "{sum:?}");
                }
            }
        }
    }

    /// Two directions that are nearly as long as each other, neither along an axis of the lattice.
    #[test]
    fn the_longest_axis_is_found_wherever_it_is() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for (n, other) in [([0.0, half, half], [1.0, 0.0, 0.0]), ([half, 0.0, -half], [0.0, 1.0, 0.0])] {
            let pairs = |n: [f64; 3], area: f64| [(u64::MAX, area, n), (u64::MAX, area, n.map(|v| -v))];
            let found = sum(&[pairs(n, 1.0), pairs(other, 0.9)].concat());
            let cos = found.normal.dot(Vec3::from(n.map(|v| v as f32))).abs();
            assert!(cos > 0.999, "{found:?}, not {n:?}");
        }
    }

    /// The wall of a pipe that is thinner than a leaf: either side shows half of it.
    #[test]
    fn a_pipe_shows_half_of_itself() {
        const PIECES: usize = 64;
        let piece = |i: usize| {
            let turn = std::f64::consts::TAU * (i as f64 + 0.5) / PIECES as f64;
            (layer(0, 1) & layer(1, 1), 1.5 / PIECES as f64, [turn.cos(), turn.sin(), 0.0])
        };
        let pipe = sum(&(0..PIECES).map(piece).collect::<Vec<_>>());
        assert!(pipe.normal.z.abs() < 1e-3 && (pipe.side_area - 0.75).abs() < 0.01, "{pipe:?}");
    }

    /// A corner of a room looks into the room, and has all of its area there.
    #[test]
    fn corners_look_between_their_walls() {
        let corner = sum(&[(layer(0, 0), 1.0, [1.0, 0.0, 0.0]), (layer(1, 0), 1.0, [0.0, 1.0, 0.0])]);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert_near(&corner, [half, half, 0.0], half, 2.0);
    }

    #[test]
    fn what_has_no_area_has_no_normal() {
        assert_near(&sum(&[(1, 0.0, [0.0; 3])]), [0.0; 3], 0.0, 0.0);
        // Foil in all directions has an axis, whichever.
        let foil = sum(&[
            (u64::MAX, 1.0, [1.0, 0.0, 0.0]),
            (u64::MAX, 1.0, [-1.0, 0.0, 0.0]),
            (1, 0.5, [0.0, 1.0, 0.0]),
        ]);
        assert!((foil.normal.length() - 1.0).abs() < 1e-5, "{foil:?}");
    }
}
