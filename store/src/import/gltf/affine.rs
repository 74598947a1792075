//! `Affine`: a transform of positions in f64, as nodes and instances of glTF state it.
//!
//! ```text
//! x' = m[0] x + m[1] y + m[2] z + m[3]       columns, as glTF writes a matrix
//! ```

/// Columns of a 3x4 matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine(pub(super) [[f64; 3]; 4]);

impl Affine {
    /// Leaves everything where it is.
    pub(super) const IDENTITY: Affine = Affine([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]]);

    /// Of sixteen numbers by columns, the last row of which is 0 0 0 1 and not looked at.
    pub(super) fn from_columns(m: &[f64; 16]) -> Affine {
        Affine(std::array::from_fn(|column| std::array::from_fn(|row| m[4 * column + row])))
    }

    /// Scale, then rotation by a quaternion (x, y, z, w), then translation.
    pub(super) fn from_parts(translation: [f64; 3], rotation: [f64; 4], scale: [f64; 3]) -> Affine {
        let norm = rotation.iter().map(|part| part * part).sum::<f64>().sqrt();
        // A quaternion of zeros turns nothing.
        let [x, y, z, w] = if norm > 0.0 { rotation.map(|part| part / norm) } else { [0.0, 0.0, 0.0, 1.0] };
        let turned = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
            [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let column = |axis: usize| turned[axis].map(|part| part * scale[axis]);
        Affine([column(0), column(1), column(2), translation])
    }

    /// `other` first, then this.
    pub(super) fn after(&self, other: &Affine) -> Affine {
        let [a, b, c, d] = other.0;
        Affine([self.direction(a), self.direction(b), self.direction(c), self.position(d)])
    }

    /// A position.
    #[inline]
    pub(super) fn position(&self, p: [f64; 3]) -> [f64; 3] {
        let [a, b, c, d] = &self.0;
        std::array::from_fn(|row| a[row] * p[0] + b[row] * p[1] + c[row] * p[2] + d[row])
    }

    /// A direction: not translated, and as long as it becomes.
    pub(super) fn direction(&self, v: [f64; 3]) -> [f64; 3] {
        let [a, b, c, _] = &self.0;
        std::array::from_fn(|row| a[row] * v[0] + b[row] * v[1] + c[row] * v[2])
    }

    /// The normal of a plane whose normal was `n`, of whatever length: by the inverse transpose, or, which is as long
    /// as the plane's area becomes, the cofactors. It stays on the front of triangles, which turn in a mirror.
    pub(super) fn normal(&self, n: [f64; 3]) -> [f64; 3] {
        let [a, b, c, _] = &self.0;
        let cross = |u: &[f64; 3], v: &[f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3])
        };
        let (x, y, z) = (cross(b, c), cross(c, a), cross(a, b));
        let side = if self.is_mirrored() { -1.0 } else { 1.0 };
        std::array::from_fn(|row| side * (x[row] * n[0] + y[row] * n[1] + z[row] * n[2]))
    }

    /// True where left and right change places, so that triangles turn the other way.
    pub(super) fn is_mirrored(&self) -> bool {
        let [a, b, c, _] = &self.0;
        let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        cross[0] * c[0] + cross[1] * c[1] + cross[2] * c[2] < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The normal of a triangle that was moved is that of its moved corners, as they go round then.
    #[test]
    fn normals_stay_across_the_plane() {
        let cross = |corners: [[f64; 3]; 3]| -> [f64; 3] {
            let [u, v] = [1, 2].map(|c: usize| [0, 1, 2].map(|i: usize| corners[c][i] - corners[0][i]));
            [0, 1, 2].map(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3])
        };
        let triangle = [[1.0, 2.0, 3.0], [4.0, 1.0, 0.5], [-2.0, 0.0, 1.0]];
        for scale in [[2.0, 3.0, 0.5], [-2.0, 3.0, 0.5], [-1.0, -1.0, -4.0]] {
            let moved = Affine::from_parts([5.0, 6.0, 7.0], [0.1, 0.7, -0.3, 0.6], scale);
            let mut corners = triangle.map(|corner| moved.position(corner));
            if moved.is_mirrored() {
                corners.swap(1, 2);
            }
            let (found, expected) = (moved.normal(cross(triangle)), cross(corners));
            found
                .iter()
                .zip(expected)
                .for_each(|(a, b)| assert!((a - b).abs() < 1e-9, "{found:?} {expected:?}"));
        }
    }

    #[test]
    fn parts_are_applied_from_scale_to_translation() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn around z, of twice the length.
        let turn = Affine::from_parts([10.0, 0.0, 0.0], [0.0, 0.0, 2.0 * half, 2.0 * half], [2.0, 3.0, -1.0]);
        let at = turn.position([1.0, 1.0, 1.0]);
        [7.0, 2.0, -1.0].iter().zip(at).for_each(|(want, is)| assert!((want - is).abs() < 1e-12, "{at:?}"));
        assert!(turn.is_mirrored());
        let twice = turn.after(&turn).position([1.0, 1.0, 1.0]);
        turn.position(at).iter().zip(twice).for_each(|(want, is)| assert!((want - is).abs() < 1e-12));
        assert_eq!(Affine::from_parts([0.0; 3], [0.0; 4], [1.0; 3]), Affine::IDENTITY);
        let columns = [1., 2., 3., 0., 4., 5., 6., 0., 7., 8., 9., 0., 10., 11., 12., 1.];
        assert_eq!(Affine::from_columns(&columns).position([1.0, 0.0, 0.0]), [11.0, 13.0, 15.0]);
        assert!(!Affine::IDENTITY.is_mirrored());
    }
}
