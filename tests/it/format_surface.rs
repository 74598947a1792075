//! What the sums of a leaf say of its surface, by `docs/format.md` alone: its front, and the area that a side shows.

use crate::oracle::overlap::{cells, length};

/// The surface that a leaf should show.
pub(crate) struct FrontSurface {
    /// Unit normal of its front.
    pub(crate) normal: [f64; 3],
    /// How long the mean is of normals that are turned to the front.
    pub(crate) flatness: f64,
    /// Area that is seen from a side, for each axis along which the normal is longest, or nearly.
    pub(crate) areas: Vec<f64>,
}

/// The surface of what sums to this area, this normal and these moments, in these subvoxels; `None` where normals look
/// so alike in all directions that rounding decides.
pub(crate) fn front_surface(
    (covered, sum): (f64, [f64; 3]),
    moments: &[[f64; 3]; 3],
    bitmap: u64,
) -> Option<FrontSurface> {
    let mean = length(sum) / covered;
    if (mean - 0.5).abs() < 1e-3 {
        return None;
    }
    let along = |n: [f64; 3]| -> f64 { (0..9).map(|k| n[k / 3] * n[k % 3] * moments[k / 3][k % 3]).sum() };
    let (normal, flatness) = if mean > 0.5 {
        (sum.map(|v| v / length(sum)), mean)
    } else {
        let axis = main_axis(moments)?;
        let cos: f64 = (0..3).map(|a| axis[a] * sum[a]).sum();
        (axis.map(|v| v * cos.signum()), (along(axis) / covered).sqrt())
    };
    let front: f64 = (0..3).map(|a| normal[a] * sum[a]).sum();
    let back = (0.5 * (covered - front / (along(normal) / covered).sqrt())).clamp(0.0, 0.5 * covered);
    let longest = normal.iter().fold(0f64, |most, v| most.max(v.abs()));
    let areas = (0..3).filter(|&a| normal[a].abs() > longest - 1e-3).map(|axis| {
        let columns = cells([0; 3], [3, 3, 0]).filter(|&[u, v, _]| {
            let bit = |w: i64| {
                let mut at = [0; 3];
                (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) = (w, u, v);
                at[0] + 4 * at[1] + 16 * at[2]
            };
            (0..4).any(|w| bitmap >> bit(w) & 1 == 1)
        });
        (columns.count() as f64 / 16.0 / normal[axis].abs()).clamp(covered - back, covered)
    });
    Some(FrontSurface { normal, flatness, areas: areas.collect() })
}

/// The unit vector along which a symmetric matrix is longest, by its characteristic polynomial; `None` where another is
/// nearly as long.
fn main_axis(m: &[[f64; 3]; 3]) -> Option<[f64; 3]> {
    let trace = m[0][0] + m[1][1] + m[2][2];
    let a: [[f64; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] - if i == j { trace / 3.0 } else { 0.0 }));
    let p = (a.iter().flatten().map(|v| v * v).sum::<f64>() / 6.0).sqrt();
    let cross = |u: [f64; 3], v: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3])
    };
    let determinant: f64 = (0..3).map(|k| a[0][k] * cross(a[1], a[2])[k]).sum();
    let angle = (determinant / (2.0 * p * p * p)).clamp(-1.0, 1.0).acos() / 3.0;
    let root = |turn: f64| trace / 3.0 + 2.0 * p * (angle + turn * std::f64::consts::TAU / 3.0).cos();
    let (most, second) = (root(0.0), root(2.0).max(root(1.0)));
    // Not a number where all three are alike.
    if (most - second).is_nan() || most - second < 0.05 * trace {
        return None;
    }
    let rows: [[f64; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] - if i == j { most } else { 0.0 }));
    let axes = [cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])];
    let longest = axes.into_iter().max_by(|u, v| length(*u).total_cmp(&length(*v)))?;
    Some(longest.map(|v| v / length(longest)))
}
