//! Triangles and cubes with corners in integers: whether they touch, and how much of one is in the other. Exact but for
//! areas, and of another kind than the store's own test.

pub(crate) type Triangle = [[i64; 3]; 3];

pub(crate) fn cells(first: [i64; 3], last: [i64; 3]) -> impl Iterator<Item = [i64; 3]> {
    let row = move |z, y| (first[0]..=last[0]).map(move |x| [x, y, z]);
    (first[2]..=last[2]).flat_map(move |z| (first[1]..=last[1]).flat_map(move |y| row(z, y)))
}

pub(crate) fn ends(triangle: &Triangle) -> ([i64; 3], [i64; 3]) {
    let of = |a: usize| triangle.map(|corner| corner[a]);
    ([0, 1, 2].map(|a| of(a).into_iter().min().unwrap()), [0, 1, 2].map(|a| of(a).into_iter().max().unwrap()))
}

/// True when a triangle and a closed cube have a point in common: then an edge of the triangle meets the cube, or,
/// where all edges pass beside it, an edge of the cube meets the triangle.
pub(crate) fn overlap(triangle: &Triangle, lo: [i64; 3], side: i64) -> bool {
    let (least, most) = ends(triangle);
    (0..3).all(|a| least[a] <= lo[a] + side && lo[a] <= most[a])
        && ((0..3).any(|i| segment_meets(triangle[i], triangle[(i + 1) % 3], lo, side))
            || (0..3).any(|axis| pierced(triangle, lo, side, axis)))
}

/// True when the way from `a` to `b` comes into the cube: entries and exits are fractions of the way.
fn segment_meets(a: [i64; 3], b: [i64; 3], lo: [i64; 3], side: i64) -> bool {
    let (mut enter, mut leave) = ((0i128, 1i128), (1i128, 1i128));
    let less = |p: (i128, i128), q: (i128, i128)| p.0 * q.1 < q.0 * p.1;
    for axis in 0..3 {
        let way = i128::from(b[axis] - a[axis]);
        let [near, far] = [lo[axis], lo[axis] + side].map(|plane| i128::from(plane - a[axis]));
        let (first, last) = match way {
            0 if near <= 0 && far >= 0 => continue,
            0 => return false,
            1.. => ((near, way), (far, way)),
            _ => ((-far, -way), (-near, -way)),
        };
        enter = if less(enter, first) { first } else { enter };
        leave = if less(last, leave) { last } else { leave };
    }
    !less(leave, enter)
}

/// True when one of the cube's four edges along `axis` meets the triangle. An edge parallel to its plane is left to the
/// other axes: where it lies in the triangle, so do its ends, which are ends of theirs.
fn pierced(triangle: &Triangle, lo: [i64; 3], side: i64, axis: usize) -> bool {
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    let wide = triangle.map(|corner| corner.map(i128::from));
    // Twice the area that `p`, `q` and a point span, seen along `axis`.
    let span = |p: [i128; 3], q: [i128; 3], at: [i128; 2]| {
        (q[b] - p[b]) * (at[1] - p[c]) - (q[c] - p[c]) * (at[0] - p[b])
    };
    let [p, q, r] = wide;
    let whole = span(p, q, [r[b], r[c]]);
    let places = [[0, 0], [0, side], [side, 0], [side, side]];
    whole != 0
        && places.into_iter().any(|step| {
            let at = [i128::from(lo[b] + step[0]), i128::from(lo[c] + step[1])];
            let parts = [span(q, r, at), span(r, p, at), span(p, q, at)].map(|part| part * whole.signum());
            // The triangle's height at this place, times its size; held against both ends of the edge.
            let height: i128 = (0..3).map(|i| parts[i] * wide[i][axis]).sum();
            let [from, to] = [lo[axis], lo[axis] + side].map(|end| i128::from(end) * whole.abs());
            parts.iter().all(|&part| part >= 0) && from <= height && height <= to
        })
}

/// Half the cross product of what is left of a triangle inside a cube.
pub(crate) fn cut(triangle: &Triangle, lo: [i64; 3], side: i64) -> [f64; 3] {
    let mut polygon: Vec<[f64; 3]> = triangle.map(|p| [0, 1, 2].map(|a| (p[a] - lo[a]) as f64)).to_vec();
    for axis in 0..3 {
        for (bound, sign) in [(0.0, 1.0), (side as f64, -1.0)] {
            let inner = |p: &[f64; 3]| sign * (p[axis] - bound);
            let mut left = Vec::new();
            for (i, from) in polygon.iter().enumerate() {
                let to = &polygon[(i + 1) % polygon.len()];
                if inner(from) >= 0.0 {
                    left.push(*from);
                }
                if inner(from) * inner(to) < 0.0 {
                    let part = inner(from) / (inner(from) - inner(to));
                    left.push([0, 1, 2].map(|a| from[a] + part * (to[a] - from[a])));
                }
            }
            polygon = left;
        }
    }
    let mut sum = [0.0; 3];
    for pair in polygon.windows(2).skip(1) {
        let [e, f] = [0, 1].map(|i| [0, 1, 2].map(|a| pair[i][a] - polygon[0][a]));
        for a in 0..3 {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            sum[a] += 0.5 * (e[b] * f[c] - e[c] * f[b]);
        }
    }
    sum
}

pub(crate) fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
