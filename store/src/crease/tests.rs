//! Normals of the mesh are those that all pairs of corners give.

use super::{CreaseOptions, CreasedSource};
use crate::budget::Budget;
use crate::cluster::Normal;
use crate::progress::Interrupt;
use crate::source::{TriangleBatch, TriangleSource};
use crate::spool::TriangleSpool;
use glam::{DVec3, Vec3};
use proptest::prelude::*;

type ThreePlaces = [[f64; 3]; 3];

/// The normals of triangles that come from a spool.
fn creased(triangles: &[ThreePlaces], angle_deg: f64) -> Vec<[Normal; 3]> {
    let (folder, budget) = (tempfile::tempdir().unwrap(), Budget::new(128 << 20));
    let mut spool = TriangleSpool::create(folder.path(), "a list", &budget).unwrap();
    triangles.iter().for_each(|&corners| spool.push(corners, 0).unwrap());
    let source = Box::new(spool.finish().unwrap());
    let interrupt = Interrupt::default();
    let options = CreaseOptions {
        angle_deg,
        folder: folder.path(),
        budget: &budget,
        interrupt: &interrupt,
        report: &|_| {},
    };
    let mut source = CreasedSource::new(source, &options).unwrap();
    assert!(source.attributes().normals);
    let mut passes = [(); 2].map(|()| {
        let (mut rows, mut batch) = (Vec::new(), TriangleBatch::default());
        while source.next_batch(&mut batch).unwrap() {
            rows.extend((0..batch.len()).map(|at| batch.attributes.of(at).normals));
        }
        source.rewind().unwrap();
        rows
    });
    assert!(passes[0] == passes[1]);
    drop(source);
    assert_eq!((budget.used_bytes(), std::fs::read_dir(folder.path()).unwrap().count()), (0, 0));
    std::mem::take(&mut passes[0])
}

/// The plane's normal, as a vector of unit length.
fn plane([a, b, c]: &ThreePlaces) -> DVec3 {
    let [a, b, c] = [a, b, c].map(|v| DVec3::from(*v));
    (b - a).cross(c - a).normalize_or_zero()
}

/// By all pairs of corners. An angle by its tangent, a crease by the angle itself.
fn oracle(triangles: &[ThreePlaces], angle_deg: f64) -> Vec<[Option<DVec3>; 3]> {
    let of = |triangle: &ThreePlaces, at: usize| {
        let sum: DVec3 = triangles
            .iter()
            .flat_map(|other| (0..3).map(move |corner| (other, corner)))
            .filter(|(other, corner)| other[*corner] == triangle[at])
            .filter(|(other, _)| plane(triangle).angle_between(plane(other)).to_degrees() <= angle_deg)
            .map(|(other, corner)| {
                let [from, to, last] = [0, 1, 2].map(|i| DVec3::from(other[(corner + i) % 3]));
                let (one, two) = (to - from, last - from);
                plane(other) * one.cross(two).length().atan2(one.dot(two))
            })
            .sum();
        sum.try_normalize()
    };
    triangles.iter().map(|triangle| [0, 1, 2].map(|at| of(triangle, at))).collect()
}

#[track_caller]
fn check(triangles: &[ThreePlaces], angle_deg: f64) {
    let found = creased(triangles, angle_deg);
    for ((triangle, found), expected) in triangles.iter().zip(&found).zip(oracle(triangles, angle_deg)) {
        for (found, expected) in found.iter().zip(expected) {
            let found = found.vector().map_or(plane(triangle), |n| Vec3::from(n).as_dvec3());
            let expected = expected.unwrap_or(plane(triangle));
            let apart = found.angle_between(expected).to_degrees();
            assert!(apart < 0.3 || expected == DVec3::ZERO, "{triangle:?}: {found}, not {expected}");
        }
    }
}

/// The faces of a cube of side 2 about the origin.
fn cube() -> Vec<ThreePlaces> {
    let mut all = Vec::new();
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let at = |u: f64, v: f64| {
            let mut place = [0.0; 3];
            place[axis] = side;
            place[(axis + 1) % 3] = u * side;
            place[(axis + 2) % 3] = v;
            place
        };
        let [a, b, c, d] = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
        all.extend([[a, b, c], [a, c, d]]);
    }
    all
}

#[test]
fn a_cube_is_sharp_below_a_right_angle_and_round_above() {
    assert!(creased(&cube(), 89.0).iter().all(|row| *row == [Normal::NONE; 3]));
    for (triangle, row) in cube().iter().zip(creased(&cube(), 91.0)) {
        for (place, normal) in triangle.iter().zip(row) {
            let normal = Vec3::from(normal.vector().unwrap()).as_dvec3();
            assert!(normal.angle_between(DVec3::from(*place)).to_degrees() < 0.3, "{place:?} {normal}");
        }
    }
}

#[test]
fn what_has_no_plane_has_no_normal_and_no_say() {
    let mut triangles = cube();
    triangles.push([[1.0; 3], [1.0; 3], [5.0, 1.0, 1.0]]);
    triangles.push([[1.0; 3], [f64::NAN, 0.0, 0.0], [0.0, 7.0, 1.0]]);
    let found = creased(&triangles, 91.0);
    assert!(found[..12] == creased(&cube(), 91.0)[..] && found[12..] == [[Normal::NONE; 3]; 2]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn normals_are_those_of_all_pairs(
        heights in proptest::collection::vec(-3i8..=3, 36), angle in 0u8..180, order in any::<u64>(),
    ) {
        // A rough sheet: places are shared, planes are not.
        let at = |x: usize, y: usize| [x as f64, y as f64, 0.4 * f64::from(heights[6 * y + x])];
        let mut triangles: Vec<ThreePlaces> = (0..25)
            .flat_map(|cell| {
                let (x, y) = (cell % 5, cell / 5);
                [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]]
            })
            .collect();
        triangles.sort_by_key(|t| t[0][0].to_bits().wrapping_mul(order | 1) ^ t[1][1].to_bits());
        // At least 0.002 degrees from every angle between planes of such heights: cosines 3e-5 apart, not 1e-6.
        check(&triangles, f64::from(angle) + 0.5981);
    }
}
