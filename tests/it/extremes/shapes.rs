//! Shapes on integers: what is closed, convex or star-shaped here is so exactly.

use crate::oracle::exact::{Q, volume};
use crate::random::Random;
use crate::support::Mesh;

/// Integer triangles at `origin + q * unit`.
pub(super) fn placed(name: &str, triangles: &[[Q; 3]], origin: [f64; 3], unit: f64) -> Mesh {
    let place = |q: Q| std::array::from_fn(|a| origin[a] + q[a] as f64 * unit);
    Mesh::new(name, triangles.iter().map(|corners| corners.map(place)).collect())
}

/// The surface of a cube of `n`^3 cells, two triangles to a square, each grid point put where `place` says:
/// closed, whatever `place` does, since a point is one value wherever it is used. Counter-clockwise from outside.
pub(super) fn cube_surface(n: i64, place: impl Fn(Q) -> Q) -> Vec<[Q; 3]> {
    let mut triangles = Vec::new();
    for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, n)]) {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let corner = |i: i64, j: i64| {
                let mut q = [side; 3];
                (q[(axis + 1) % 3], q[(axis + 2) % 3]) = (i, j);
                place(q)
            };
            let square = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            let first = ((i + j) % 2) as usize;
            let [a, b, c, d] = std::array::from_fn(|k| square[(first + k) % 4]);
            let two = [[a, b, c], [a, c, d]];
            triangles.extend(if side == n { two } else { two.map(|[a, b, c]| [a, c, b]) });
        }
    }
    triangles
}

/// A bumpy sphere around 0 that all of its surface can be seen from: a ray from there crosses it once.
pub(super) fn star(n: i64, radius: f64) -> Vec<[Q; 3]> {
    let triangles = cube_surface(n, |q| {
        let p = q.map(|x| (2 * x - n) as f64 / n as f64);
        let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
        let bump = 1.0 + 0.1 * (9.0 * p[0]).sin() * (7.0 * p[1]).cos() * (8.0 * p[2]).sin();
        p.map(|x| (x / length * radius * bump).round() as i64)
    });
    assert!(triangles.iter().all(|t| volume(t, [0; 3]) > 0), "a triangle of the star is not seen from 0");
    triangles
}

/// The box from 0 to 2^doublings on each axis, its faces cut at 0, 1, 2, 4, ..: all sizes and all aspects up to
/// 2^doublings side by side, in six planes.
pub(super) fn graded_box(doublings: i64) -> Vec<[Q; 3]> {
    cube_surface(doublings + 1, |q| q.map(|x| if x == 0 { 0 } else { 1 << (x - 1) }))
}

/// Needles of length `long` (most of the way along x) and width `wide`, in pairs `apart` from each other along z, at
/// slopes up to 1.
pub(super) fn needles(pairs: usize, [long, wide, apart]: [i64; 3], rng: &mut Random) -> Vec<[Q; 3]> {
    let mut triangles = Vec::new();
    let mut below = |bound| rng.below(bound);
    for _ in 0..pairs {
        let (at, rise) = ([0, below(long), below(long)], below(2 * long) - long);
        let far = [long, at[1] + below(long / 8), at[2] + rise];
        let lower = [at, far, [far[0], far[1] + wide, far[2]]];
        triangles.push(lower);
        triangles.push(lower.map(|[x, y, z]| [x, y, z + apart]));
    }
    triangles
}
