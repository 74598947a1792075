//! Rays against triangles on lattice integers, decided without rounding.
//!
//! ```text
//! corners A, B, C seen from the ray's origin, direction d:
//! u = d . (C x B), v = d . (A x C), w = d . (B x A)      all of one sign (zero is both): the ray meets the triangle
//! t = (A . n) / (d . n),  n = (B - A) x (C - A)
//! ```
//!
//! Invariants: 1. signs are those of integers of 128 bits; what would not fit panics (overflow checks are on in the
//! test profile); 2. only quotients and lengths are f64, each of exact integers: right to a few ulps.

/// A lattice point or a vector between two.
pub(crate) type Q = [i64; 3];
type Wide = [i128; 3];

/// Where a ray's line meets a triangle; lengths in lattice steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExactHit {
    /// Index of the triangle.
    pub(crate) triangle: usize,
    /// Parameter; may be negative.
    pub(crate) t: f64,
    /// Least distance between the ray's line and the lines of the edges; 0 on an edge.
    pub(crate) clearance: f64,
    /// |cosine| of the angle between ray and normal.
    pub(crate) cosine: f64,
}

/// The triangles that the line of a ray meets, edges and vertices included; ones seen edge-on are not met.
pub(crate) fn met(triangles: &[[Q; 3]], origin: Q, direction: Q) -> Vec<ExactHit> {
    let meet = |(index, t): (usize, &[Q; 3])| meet(t, origin, direction, index);
    triangles.iter().enumerate().filter_map(meet).collect()
}

fn meet(corners: &[Q; 3], origin: Q, direction: Q, triangle: usize) -> Option<ExactHit> {
    let [a, b, c] = corners.map(|q| wide(sub(q, origin)));
    let d = wide(direction);
    let volumes = [dot(d, cross(c, b)), dot(d, cross(a, c)), dot(d, cross(b, a))];
    if !(volumes.iter().all(|&x| x >= 0) || volumes.iter().all(|&x| x <= 0)) || volumes == [0; 3] {
        return None;
    }
    let edges = [(b, c), (c, a), (a, b)].map(|(from, to)| wide_sub(to, from));
    let n = cross(edges[2], wide_sub(c, a));
    let across = dot(d, n);
    let clear = |i: usize| volumes[i].unsigned_abs() as f64 / length(cross(d, edges[i]));
    Some(ExactHit {
        triangle,
        t: dot(a, n) as f64 / across as f64,
        clearance: (0..3).map(clear).fold(f64::INFINITY, f64::min),
        cosine: across.unsigned_abs() as f64 / (length(d) * length(n)),
    })
}

/// |cosine| of the angle between a direction and the normal of a triangle.
pub(crate) fn cosine(&[a, b, c]: &[Q; 3], direction: Q) -> f64 {
    let n = cross(wide(sub(b, a)), wide(sub(c, a)));
    let d = wide(direction);
    dot(n, d).unsigned_abs() as f64 / (length(d) * length(n))
}

/// Six times the volume of the tetrahedron (p, a, b, c); positive where p sees the triangle's back.
pub(crate) fn volume([a, b, c]: &[Q; 3], p: Q) -> i128 {
    let [a, b, c] = [a, b, c].map(|&q| wide(sub(q, p)));
    dot(a, cross(b, c))
}

pub(crate) fn sub(a: Q, b: Q) -> Q {
    std::array::from_fn(|i| a[i] - b[i])
}

fn wide(q: Q) -> Wide {
    q.map(i128::from)
}

fn wide_sub(a: Wide, b: Wide) -> Wide {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: Wide, b: Wide) -> Wide {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Wide, b: Wide) -> i128 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: Wide) -> f64 {
    a.iter().map(|&x| (x as f64) * (x as f64)).sum::<f64>().sqrt()
}

#[test]
fn edges_vertices_and_the_plane_are_told_apart() {
    let triangle = [[[0, 0, 5], [8, 0, 5], [0, 8, 5]]];
    let hit = |origin, direction| met(&triangle, origin, direction).first().map(|h| (h.t, h.clearance));
    assert_eq!(hit([2, 2, 0], [0, 0, 1]), Some((5.0, 2.0)));
    assert_eq!(hit([8, 0, 0], [0, 0, 10]), Some((0.5, 0.0)), "a vertex");
    assert_eq!(hit([4, 4, 9], [0, 0, 1]), Some((-4.0, 0.0)), "an edge, behind");
    assert_eq!(hit([4, 5, 0], [0, 0, 1]), None, "a step beside the edge");
    assert_eq!(hit([-1, 1, 5], [1, 0, 0]), None, "in its plane");
    assert_eq!(volume(&triangle[0], [0; 3]), 320);
}
