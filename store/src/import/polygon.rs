//! `Polygon`: the corners of one face, and how it becomes triangles.
//!
//! Convex faces become fans from their first corner. Concave ones are cut by clipping ears (Meisters, "Polygons
//! Have Ears", Am. Math. Monthly 82, 1975) in the plane that their normal (Newell's) faces most. Faces of more than
//! [`EAR_CLIP_MAX_SIDES`] sides, those without a plane, and what is left when no ear is found (a face that crosses
//! itself) become fans.
//!
//! Invariants: 1. a face of n >= 3 sides gives exactly n - 2 triangles, in the orientation of the face, whatever
//! its corners are; 2. only its own corners are used; 3. memory is fixed by [`MAX_POLYGON_SIDES`].

use crate::attributes::CornerAttributes;
use crate::budget::{Budget, Lease};
use crate::cluster::{Colour, CornerValue, Normal, WHITE};
use crate::error::Result;
use crate::source::{SourceStats, TriangleBatch};

/// Most sides of a face. A batch that is almost full then stays below the twice that `TriangleBatch` allows.
pub(super) const MAX_POLYGON_SIDES: usize = TriangleBatch::TARGET_TRIANGLES;

/// Most sides that are searched for ears: the search takes up to n^3 steps, 16 million at this size.
const EAR_CLIP_MAX_SIDES: usize = 256;

/// Bytes of the places of all corners.
const POLYGON_BYTES: u64 = (MAX_POLYGON_SIDES * size_of::<[f64; 3]>()) as u64;
/// What they are called in messages.
const LEASED: &str = "the corners of a face";

/// A corner of a face.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaceCorner {
    pub(super) position: [f64; 3],
    pub(super) colour: Colour,
    pub(super) normal: Normal,
}

impl Default for FaceCorner {
    fn default() -> FaceCorner {
        FaceCorner { position: [0.0; 3], colour: WHITE, normal: Normal::NONE }
    }
}

impl FaceCorner {
    /// Adds the triangle of three corners to `batch`.
    pub(super) fn push_triangle(corners: [FaceCorner; 3], material: u32, batch: &mut TriangleBatch) {
        let attributes = CornerAttributes {
            colours: corners.map(|corner| corner.colour),
            normals: corners.map(|corner| corner.normal),
        };
        batch.push_with(corners.map(|corner| corner.position), material, &attributes);
    }
}

/// The corners of the face at hand. Reused from face to face.
pub(super) struct Polygon {
    corners: Vec<[f64; 3]>,
    /// As long as `corners`, or empty where all are white.
    colours: Vec<Colour>,
    /// As long as `corners`, or empty where none has one.
    normals: Vec<Normal>,
    lease: Lease,
}

impl Polygon {
    /// Leases and takes memory for the largest face.
    pub(super) fn new(budget: &Budget) -> Result<Polygon> {
        let lease = budget.lease(LEASED, POLYGON_BYTES)?;
        Ok(Polygon {
            corners: Vec::with_capacity(MAX_POLYGON_SIDES),
            colours: Vec::new(),
            normals: Vec::new(),
            lease,
        })
    }

    /// Makes room for the colours of corners, before the first that has one.
    pub(super) fn lease_colours(&mut self) -> Result<()> {
        lease_values(&mut self.colours, &mut self.lease)
    }

    /// Makes room for the normals of corners, before the first that has one.
    pub(super) fn lease_normals(&mut self) -> Result<()> {
        lease_values(&mut self.normals, &mut self.lease)
    }

    /// Forgets all corners.
    pub(super) fn clear(&mut self) {
        self.corners.clear();
        self.colours.clear();
        self.normals.clear();
    }

    /// Corners so far.
    pub(super) fn len(&self) -> usize {
        self.corners.len()
    }

    /// Adds a corner. The caller refuses more than [`MAX_POLYGON_SIDES`]. Before one with a colour comes
    /// [`Polygon::lease_colours`], before one with a normal [`Polygon::lease_normals`].
    pub(super) fn push(&mut self, corner: FaceCorner) {
        assert!(self.corners.len() < MAX_POLYGON_SIDES);
        push_value(&mut self.colours, corner.colour, self.corners.len());
        push_value(&mut self.normals, corner.normal, self.corners.len());
        self.corners.push(corner.position);
    }

    fn corner(&self, index: usize) -> FaceCorner {
        FaceCorner {
            position: self.corners[index],
            colour: self.colours.get(index).copied().unwrap_or(WHITE),
            normal: self.normals.get(index).copied().unwrap_or(Normal::NONE),
        }
    }

    /// Gives all corners this colour.
    pub(super) fn paint(&mut self, colour: Colour) {
        self.colours.clear();
        self.colours.resize(self.corners.len(), colour);
    }

    /// Adds the triangles of the face to `batch`, and counts.
    pub(super) fn emit(&self, material: u32, batch: &mut TriangleBatch, stats: &mut SourceStats) {
        let corners = &self.corners[..];
        match *corners {
            [] | [_] | [_, _] => stats.skipped_face_count += 1,
            [_, _, _] => self.push_triangle([0, 1, 2], material, batch),
            _ => {
                stats.polygon_count += 1;
                triangulate(corners, |triangle| self.push_triangle(triangle, material, batch));
            }
        }
    }

    fn push_triangle(&self, triangle: [usize; 3], material: u32, batch: &mut TriangleBatch) {
        FaceCorner::push_triangle(triangle.map(|corner| self.corner(corner)), material, batch);
    }
}

fn lease_values<V>(values: &mut Vec<V>, lease: &mut Lease) -> Result<()> {
    if values.capacity() == 0 {
        lease.grow(LEASED, (MAX_POLYGON_SIDES * size_of::<V>()) as u64)?;
        values.reserve_exact(MAX_POLYGON_SIDES);
    }
    Ok(())
}

/// Adds the value of a corner behind `count` others.
fn push_value<V: CornerValue>(values: &mut Vec<V>, value: V, count: usize) {
    if !values.is_empty() || value != V::NONE {
        values.resize(count, V::NONE);
        values.push(value);
    }
}

/// Calls `emit` with the corners of each triangle of a face of four sides or more.
fn triangulate(corners: &[[f64; 3]], mut emit: impl FnMut([usize; 3])) {
    if corners.len() <= EAR_CLIP_MAX_SIDES
        && let Some(plane) = flatten(corners)
        && !is_convex(&plane)
    {
        clip_ears(&plane, emit);
    } else {
        (1..corners.len() - 1).for_each(|corner| emit([0, corner, corner + 1]));
    }
}

/// The face seen from its front, without the axis along which it is thinnest. `None` where it has no area.
fn flatten(corners: &[[f64; 3]]) -> Option<Vec<[f64; 2]>> {
    let origin = corners[0];
    // Relative to a corner, or faces far from the origin lose their shape.
    let local = |corner: usize| -> [f64; 3] {
        let corner = corners[corner % corners.len()];
        std::array::from_fn(|axis| corner[axis] - origin[axis])
    };
    let mut normal = [0.0f64; 3];
    for corner in 0..corners.len() {
        let (a, b) = (local(corner), local(corner + 1));
        for (axis, sum) in normal.iter_mut().enumerate() {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            *sum += (a[u] - b[u]) * (a[v] + b[v]);
        }
    }
    let axis = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs()))?;
    if !normal[axis].is_finite() || normal[axis] == 0.0 {
        return None;
    }
    let (u, v) =
        if normal[axis] > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
    Some((0..corners.len()).map(|corner| [local(corner)[u], local(corner)[v]]).collect())
}

fn is_convex(plane: &[[f64; 2]]) -> bool {
    let n = plane.len();
    (0..n).all(|i| turn(plane[i], plane[(i + 1) % n], plane[(i + 2) % n]) >= 0.0)
}

fn clip_ears(plane: &[[f64; 2]], mut emit: impl FnMut([usize; 3])) {
    let mut left: Vec<usize> = (0..plane.len()).collect();
    let mut at = 0;
    let mut misses = 0;
    while left.len() > 3 {
        let n = left.len();
        let ear = [left[(at + n - 1) % n], left[at], left[(at + 1) % n]];
        if misses < n && !is_ear(plane, &left, ear) {
            at = (at + 1) % n;
            misses += 1;
            continue;
        }
        if misses == n {
            break;
        }
        emit(ear);
        left.remove(at);
        // On to the corner after the next one: ears taken in turn make better shapes than a run of slivers.
        at = (at + 1) % left.len();
        misses = 0;
    }
    (1..left.len() - 1).for_each(|i| emit([left[0], left[i], left[i + 1]]));
}

fn is_ear(plane: &[[f64; 2]], left: &[usize], ear: [usize; 3]) -> bool {
    let [a, b, c] = ear.map(|corner| plane[corner]);
    turn(a, b, c) > 0.0
        && left.iter().map(|&corner| plane[corner]).all(|point| {
            // A corner in the same place as one of the ear's is a bridge to a hole, and not in the way.
            let inside = turn(a, b, point) >= 0.0 && turn(b, c, point) >= 0.0 && turn(c, a, point) >= 0.0;
            !inside || point == a || point == b || point == c
        })
}

/// Twice the area of the triangle, positive when it turns left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lifts a plane outline into space, cuts it, and compares count, orientation and area.
    fn check(outline: &[[f64; 2]], simple: Simple) {
        for lift in [
            (|p: [f64; 2]| [p[0], p[1], 0.0]) as fn([f64; 2]) -> [f64; 3],
            |p| [0.0, p[0], p[1]],
            |p| [5e5 + p[1], 3.0, 4e6 + p[0]],
            |p| [p[1], p[0], p[0] + 0.5 * p[1]],
        ] {
            let corners: Vec<_> = outline.iter().map(|&p| lift(p)).collect();
            let mut polygon = Polygon::new(&Budget::unlimited()).unwrap();
            let place = |&position: &[f64; 3]| FaceCorner { position, ..FaceCorner::default() };
            corners.iter().map(place).for_each(|corner| polygon.push(corner));
            let (mut batch, mut stats) = (TriangleBatch::default(), SourceStats::default());
            polygon.emit(7, &mut batch, &mut stats);
            assert_eq!(batch.len(), outline.len() - 2);
            let whole = (1..corners.len() - 1)
                .map(|i| cross(corners[0], corners[i], corners[i + 1]))
                .fold([0.0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
            let parts: Vec<_> = batch.corners.iter().map(|t| cross(t[0], t[1], t[2])).collect();
            let scale = dot(whole, whole).sqrt();
            if matches!(simple, Simple::Yes) {
                assert!(parts.iter().all(|&part| dot(part, whole) >= -1e-9 * scale * scale), "{outline:?}");
                let area: f64 = parts.iter().map(|&part| dot(part, part).sqrt()).sum();
                assert!((area - scale).abs() <= 1e-9 * scale, "{outline:?}: {area} of {scale}");
            }
        }
    }

    enum Simple {
        Yes,
        No,
    }

    fn cross(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> [f64; 3] {
        let (u, v): ([f64; 3], [f64; 3]) =
            (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }

    fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    fn ring(sides: usize, radius: impl Fn(usize) -> f64) -> Vec<[f64; 2]> {
        let angle = |i: usize| i as f64 / sides as f64 * std::f64::consts::TAU;
        (0..sides).map(|i| [radius(i) * angle(i).cos(), radius(i) * angle(i).sin()]).collect()
    }

    #[test]
    fn outlines() {
        check(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]], Simple::Yes);
        for turn in 0..4 {
            let mut dart = [[0.0, 0.0], [4.0, 0.0], [1.0, 1.0], [0.0, 4.0]];
            dart.rotate_left(turn);
            check(&dart, Simple::Yes);
        }
        let comb = [
            [0.0, 0.0],
            [5.0, 0.0],
            [5.0, 4.0],
            [4.0, 4.0],
            [4.0, 1.0],
            [3.0, 1.0],
            [3.0, 4.0],
            [2.0, 4.0],
            [2.0, 1.0],
            [1.0, 1.0],
            [1.0, 4.0],
            [0.0, 4.0],
        ];
        check(&comb, Simple::Yes);
        // A square with a square hole, joined by a bridge whose two ends occur twice.
        let bridged = [
            [0.0, 0.0],
            [9.0, 0.0],
            [9.0, 9.0],
            [0.0, 9.0],
            [0.0, 0.0],
            [3.0, 3.0],
            [3.0, 6.0],
            [6.0, 6.0],
            [6.0, 3.0],
            [3.0, 3.0],
        ];
        check(&bridged, Simple::Yes);
        check(&ring(200, |i| if i % 2 == 0 { 3.0 } else { 1.0 }), Simple::Yes);
        check(&ring(68, |_| 2.0), Simple::Yes);
        check(&ring(MAX_POLYGON_SIDES, |_| 2.0), Simple::Yes);
        check(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [3.0, 0.5]], Simple::No);
        check(&[[1.0, 1.0]; 6], Simple::No);
        check(&[[0.0, f64::NAN], [1.0, 0.0], [f64::INFINITY, 1.0], [0.0, 1.0]], Simple::No);
    }
}
