//! A triangle mesh in memory, all f64, with a median-split tree of its own: closest hit by Möller-Trumbore.

/// Triangles and a tree over them.
pub(crate) struct OracleMesh {
    pub(crate) triangles: Vec<[[f64; 3]; 3]>,
    order: Vec<u32>,
    nodes: Vec<OracleNode>,
}

struct OracleNode {
    lo: [f64; 3],
    hi: [f64; 3],
    first: usize,
    count: usize,
    right: usize,
}

/// A hit: t, index of the triangle, and the least of the three barycentric weights (near zero at an edge).
#[derive(Clone, Copy, Debug)]
pub(crate) struct OracleHit {
    pub(crate) t: f64,
    pub(crate) triangle: usize,
    pub(crate) least_weight: f64,
}

impl OracleMesh {
    pub(crate) fn new(triangles: Vec<[[f64; 3]; 3]>) -> OracleMesh {
        let mut mesh =
            OracleMesh { order: (0..triangles.len() as u32).collect(), triangles, nodes: Vec::new() };
        mesh.grow(0, mesh.triangles.len());
        mesh
    }

    fn grow(&mut self, first: usize, end: usize) -> usize {
        let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for &i in &self.order[first..end] {
            for corner in self.triangles[i as usize] {
                for a in 0..3 {
                    lo[a] = lo[a].min(corner[a]);
                    hi[a] = hi[a].max(corner[a]);
                }
            }
        }
        let at = self.nodes.len();
        self.nodes.push(OracleNode { lo, hi, first, count: end - first, right: 0 });
        if end - first > 4 {
            let axis = (0..3).max_by(|&a, &b| (hi[a] - lo[a]).total_cmp(&(hi[b] - lo[b]))).unwrap();
            let middle = usize::midpoint(first, end);
            let triangles = &self.triangles;
            let key = |i: u32| triangles[i as usize].iter().map(|c| c[axis]).sum::<f64>();
            self.order[first..end].select_nth_unstable_by(middle - first, |&a, &b| key(a).total_cmp(&key(b)));
            self.nodes[at].count = 0;
            self.grow(first, middle);
            self.nodes[at].right = self.grow(middle, end);
        }
        at
    }

    /// The closest hit with `t` in `[0, t_max]`.
    pub(crate) fn closest(&self, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<OracleHit> {
        let mut best: Option<OracleHit> = None;
        let mut stack = vec![0];
        while let Some(at) = stack.pop() {
            let node = &self.nodes[at];
            let limit = best.map_or(t_max, |b| b.t);
            if !meets(node, origin, direction, limit) {
                continue;
            }
            if node.count == 0 {
                stack.push(at + 1);
                stack.push(node.right);
                continue;
            }
            for &i in &self.order[node.first..node.first + node.count] {
                let hit = moeller_trumbore(&self.triangles[i as usize], origin, direction);
                if let Some((t, least_weight)) = hit
                    && (0.0..=best.map_or(t_max, |b| b.t)).contains(&t)
                {
                    best = Some(OracleHit { t, triangle: i as usize, least_weight });
                }
            }
        }
        best
    }
}

fn meets(node: &OracleNode, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> bool {
    let (mut near, mut far) = (0.0f64, t_max);
    for a in 0..3 {
        let pad = 1e-9 * (node.hi[a].abs() + node.lo[a].abs() + 1e-300);
        if direction[a] == 0.0 {
            if origin[a] < node.lo[a] - pad || origin[a] > node.hi[a] + pad {
                return false;
            }
            continue;
        }
        let t0 = (node.lo[a] - pad - origin[a]) / direction[a];
        let t1 = (node.hi[a] + pad - origin[a]) / direction[a];
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    near <= far * (1.0 + 1e-12)
}

/// t and the least barycentric weight of a hit (edges included).
pub(crate) fn moeller_trumbore(
    [a, b, c]: &[[f64; 3]; 3],
    origin: [f64; 3],
    direction: [f64; 3],
) -> Option<(f64, f64)> {
    let (e, f, s) = (sub(*b, *a), sub(*c, *a), sub(origin, *a));
    let p = cross(direction, f);
    let det = dot(e, p);
    if det == 0.0 {
        return None;
    }
    let q = cross(s, e);
    let (u, v, t) = (dot(s, p) / det, dot(direction, q) / det, dot(f, q) / det);
    let least = u.min(v).min(1.0 - u - v);
    (least >= 0.0).then_some((t, least))
}

/// Distance of a point from a triangle.
pub(crate) fn distance(triangle: &[[f64; 3]; 3], p: [f64; 3]) -> f64 {
    let [a, b, c] = *triangle;
    let n = cross(sub(b, a), sub(c, a));
    let area = dot(n, n);
    let mut best = f64::INFINITY;
    for (a, b) in [(a, b), (b, c), (c, a)] {
        let (e, s) = (sub(b, a), sub(p, a));
        let along = if dot(e, e) > 0.0 { (dot(s, e) / dot(e, e)).clamp(0.0, 1.0) } else { 0.0 };
        let d = sub(s, e.map(|x| x * along));
        best = best.min(dot(d, d).sqrt());
    }
    let inside = area > 0.0
        && [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| dot(cross(sub(b, a), sub(p, a)), n) >= 0.0);
    if inside { best.min((dot(sub(p, a), n) / area.sqrt()).abs()) } else { best }
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
