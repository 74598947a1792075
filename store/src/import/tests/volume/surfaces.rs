//! What a surface is, against a walk over all edges of the lattice that knows no cells, slabs or tables.

use super::{Noise, check_closed, nrrd, sampled, sides, surface, surfaces, with_values};
use crate::budget::Budget;
use crate::import::open;
use crate::import::tests::{Fixture, SourceTriangle};
use crate::source::TriangleBatch;
use std::collections::{HashMap, HashSet};
use std::f64::consts::PI;

/// An edge of the lattice: its first sample, and its axis.
type LatticeEdge = ([usize; 3], usize);

/// Every edge whose ends lie on two sides of the value, and how far along it the value is.
fn crossings(size: [usize; 3], samples: &[f64], value: f64) -> HashMap<LatticeEdge, f64> {
    let at = |[i, j, k]: [usize; 3]| samples[(k * size[1] + j) * size[0] + i];
    let mut found = HashMap::new();
    for (k, j, i) in
        (0..size[2]).flat_map(|k| (0..size[1]).flat_map(move |j| (0..size[0]).map(move |i| (k, j, i))))
    {
        for axis in 0..3 {
            let mut end = [i, j, k];
            end[axis] += 1;
            if end[axis] == size[axis] {
                continue;
            }
            let (a, b) = (at([i, j, k]), at(end));
            if (a >= value) != (b >= value) {
                found.insert(([i, j, k], axis), (value - a) / (b - a));
            }
        }
    }
    found
}

/// Checks that the corners of a surface without ties are the crossings, all of them, and that each triangle stays in a
/// cell.
#[track_caller]
fn check_corners(size: [usize; 3], samples: &[f64], value: f64, triangles: &[SourceTriangle]) {
    let expected = crossings(size, samples, value);
    let mut met = HashSet::new();
    for triangle in triangles {
        for corner in triangle {
            let along: Vec<usize> = (0..3).filter(|&axis| corner[axis].fract() != 0.0).collect();
            assert_eq!(along.len(), 1, "{corner:?} lies on no edge");
            let edge = (corner.map(|part| part.floor() as usize), along[0]);
            let part = expected.get(&edge).unwrap_or_else(|| panic!("{corner:?}: no crossing"));
            assert!((corner[along[0]].fract() - part).abs() < 1e-12, "{corner:?}: {part}");
            met.insert(edge);
        }
        for axis in 0..3 {
            let parts = triangle.map(|corner| corner[axis]);
            let (least, most) = parts.iter().fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)));
            assert!(most <= least.floor() + 1.0, "{triangle:?} leaves its cell");
        }
    }
    assert_eq!(met.len(), expected.len(), "crossings without a corner");
}

/// The content, positive where triangles are counter-clockwise from outside.
fn content(triangles: &[SourceTriangle]) -> f64 {
    let of = |[a, b, c]: &SourceTriangle| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    triangles.iter().map(of).sum::<f64>() / 6.0
}

fn area(triangles: &[SourceTriangle]) -> f64 {
    let of = |[a, b, c]: &SourceTriangle| {
        let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
        let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        cross.iter().map(|part| part * part).sum::<f64>().sqrt() / 2.0
    };
    triangles.iter().map(of).sum()
}

/// Vertices less sides plus triangles.
fn euler(triangles: &[SourceTriangle]) -> i64 {
    let vertices: HashSet<[u64; 3]> =
        triangles.iter().flatten().map(|corner| corner.map(|part| (part + 0.0).to_bits())).collect();
    vertices.len() as i64 - sides(triangles).len() as i64 + triangles.len() as i64
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// A ball's samples: more inside.
fn ball(size: [usize; 3], center: [f64; 3], radius: f64) -> Vec<f64> {
    sampled(size, |at| radius - distance(at, center))
}

#[test]
fn a_ball_is_closed_and_as_large_as_it_is() {
    let (size, radius) = ([45, 47, 49], 18.3);
    let samples = ball(size, [22.1, 23.2, 24.3], radius);
    let mesh = surface(size, &samples, 0.0);
    check_corners(size, &samples, 0.0, &mesh.triangles);
    check_closed(&mesh.triangles);
    assert_eq!(euler(&mesh.triangles), 2);
    // A chord of a cell stands off its arc by some 1 / (8 * radius) of the radius: far less than .5 %.
    let [volume, surface] = [4.0 / 3.0 * PI * radius.powi(3), 4.0 * PI * radius.powi(2)];
    let [of_volume, of_area] = [content(&mesh.triangles) / volume, area(&mesh.triangles) / surface];
    assert!((0.995..1.0).contains(&of_volume) && (0.995..1.0).contains(&of_area), "{of_volume} {of_area}");
    assert_eq!(mesh.stats.warnings, [""; 0]);
}

#[test]
fn a_ring_has_a_hole_and_two_balls_are_two() {
    let size = [60, 60, 30];
    let ring = |at: [f64; 3]| {
        let across = (at[0] - 29.6).hypot(at[1] - 29.7) - 18.0;
        7.0 - across.hypot(at[2] - 14.4)
    };
    let samples = sampled(size, ring);
    let triangles = surface(size, &samples, 0.0).triangles;
    check_closed(&triangles);
    assert_eq!(euler(&triangles), 0);
    let expected = 2.0 * PI * PI * 18.0 * 49.0;
    assert!((content(&triangles) / expected - 1.0).abs() < 0.01, "{}", content(&triangles));
    let balls = |at| (8.0 - distance(at, [15.3, 30.2, 15.1])).max(6.0 - distance(at, [44.3, 28.2, 13.1]));
    let triangles = surface(size, &sampled(size, balls), 0.0).triangles;
    check_closed(&triangles);
    assert_eq!(euler(&triangles), 4);
}

/// Noise has all patterns, ambiguous faces on most cells, and rows of several words; its triangles fill batches.
#[test]
fn noise_leaves_no_hole() {
    for (size, seed) in [([131, 40, 9], 1), ([64, 33, 20], 2), ([65, 2, 31], 3), ([2, 9, 200], 4)] {
        let mut noise = Noise(seed);
        let is_inside =
            |at: [f64; 3]| (0..3).all(|axis| at[axis] > 0.0 && at[axis] < (size[axis] - 1) as f64);
        let mut values = sampled(size, |_| 0.0);
        values.iter_mut().for_each(|value| *value = noise.next() - 0.5);
        let open = surface(size, &values, 0.001);
        check_corners(size, &values, 0.001, &open.triangles);
        // Where it is open it lies in a face of the volume.
        for (side, [forth, back]) in sides(&open.triangles) {
            let on_face = |axis: usize, face: f64| side.iter().all(|end| f64::from_bits(end[axis]) == face);
            let on_border = (0..3).any(|axis| on_face(axis, 0.0) || on_face(axis, (size[axis] - 1) as f64));
            assert!(forth == 1 && back == 1 || on_border && forth + back == 1, "{side:?}: {forth}, {back}");
        }
        assert!(open.stats.warnings[0].contains("iso_0.001 meets the border"), "{:?}", open.stats.warnings);
        let inside = sampled(size, |at| f64::from(is_inside(at)));
        let closed: Vec<f64> = values
            .iter()
            .zip(inside)
            .map(|(value, inside)| if inside == 1.0 { *value } else { -0.7 })
            .collect();
        if size.iter().all(|&side| side > 2) {
            let mesh = surface(size, &closed, 0.001);
            check_corners(size, &closed, 0.001, &mesh.triangles);
            assert!(sides(&mesh.triangles).values().all(|sides| *sides == [1, 1]), "seed {seed}");
            assert_eq!(mesh.stats.warnings, [""; 0]);
        }
    }
}

/// Integers at an integer value: many samples are the value itself, where corners fall together.
#[test]
fn samples_at_the_value_leave_no_hole() {
    let (size, mut noise) = ([70, 20, 20], Noise(7));
    let mut values =
        sampled(size, |at| f64::from((0..3).all(|a| at[a] > 0.0 && at[a] < (size[a] - 1) as f64)));
    values.iter_mut().for_each(|value| *value *= (noise.next() * 5.0).floor());
    for value in [1.0, 2.0, 4.0] {
        let mesh = surface(size, &values, value);
        check_closed(&mesh.triangles);
        assert!(content(&mesh.triangles) > 0.0);
    }
    // Nothing of a lone sample at the value is left but a point.
    let lone = sampled([5, 5, 5], |at| f64::from(at == [2.0; 3]));
    assert_eq!(surface([5, 5, 5], &lone, 1.0).triangles.len(), 0);
    assert_eq!(surface([5, 5, 5], &lone, 0.5).triangles.len(), 8);
}

#[test]
fn what_is_no_number_is_outside() {
    let size = [20, 20, 20];
    let mut samples = ball(size, [9.6; 3], 7.0);
    let odd = [f64::NAN, f64::NEG_INFINITY, f64::INFINITY, f64::NAN, f64::NAN];
    let places = [9 * 400 + 9 * 20 + 9, 9 * 400 + 9 * 20 + 2, 3 * 400 + 9 * 20 + 9, 5 * 400, 3];
    places.iter().zip(odd).for_each(|(&place, odd)| samples[place] = odd);
    let mesh = surface(size, &samples, 0.0);
    check_closed(&mesh.triangles);
    assert!(mesh.triangles.iter().flatten().flatten().all(|part| part.is_finite()));
    assert!(mesh.stats.warnings[0].starts_with("5 samples are NaN or infinite"), "{:?}", mesh.stats.warnings);
    // Within the ball a NaN makes a hole of its own: halfway to its six neighbours.
    let around = mesh.triangles.iter().flatten().filter(|corner| distance(**corner, [9.0; 3]) == 0.5).count();
    assert_eq!(around, 24);
}

#[test]
fn several_surfaces_are_several_materials() {
    let (size, samples) = ([20, 21, 22], ball([20, 21, 22], [9.6; 3], 8.5));
    let mesh = surfaces("a.nrrd", &nrrd(size, &samples, ""), &[0.25, 5.0, 0.25, -1e20]).unwrap();
    for (name, value) in [("iso_0.25", 0.25), ("iso_5", 5.0)] {
        let of: Vec<SourceTriangle> = mesh
            .triangles
            .iter()
            .zip(&mesh.material_names)
            .filter(|(_, of)| *of == name)
            .map(|(triangle, _)| *triangle)
            .collect();
        check_corners(size, &samples, value, &of);
        check_closed(&of);
    }
    assert!(mesh.material_names.iter().all(|name| ["iso_0.25", "iso_5"].contains(&name.as_str())));
}

/// Oblique, mirrored and stretched axes: the same surface, moved, its front outside.
#[test]
fn axes_move_the_surface_and_keep_its_front() {
    let (size, samples) = ([24, 25, 26], ball([24, 25, 26], [11.6, 12.1, 12.4], 9.0));
    let plain = surface(size, &samples, 0.0).triangles;
    for (fields, steps, origin) in [
        ("spacings: 0.5 2 3\n", [[0.5, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]], [0.0; 3]),
        (
            "space: left-posterior-superior\nspace directions: (-0.5,0,0) (0, 1.5, 0) (0.25,0,2e0)\n\
             space origin: (100.5,-20,3)\n",
            [[-0.5, 0.0, 0.0], [0.0, 1.5, 0.0], [0.25, 0.0, 2.0]],
            [100.5, -20.0, 3.0],
        ),
        (
            "space directions: (0,1,0) (1,0,0) (0,0,1)\n",
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            [0.0; 3],
        ),
    ] {
        let moved = surfaces("a.nrrd", &nrrd(size, &samples, fields), &[0.0]).unwrap().triangles;
        check_closed(&moved);
        let determinant = content(&[steps]) * 6.0;
        let expected = content(&plain) * determinant.abs();
        assert!((content(&moved) / expected - 1.0).abs() < 1e-9, "{fields}: {} {expected}", content(&moved));
        for (moved, plain) in moved.iter().zip(&plain) {
            let place = |corner: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|a| origin[a] + (0..3).map(|i| corner[i] * steps[i][a]).sum::<f64>())
            };
            let mut expected = plain.map(place);
            if determinant < 0.0 {
                expected.swap(1, 2);
            }
            assert!((0..3).all(|corner| distance(moved[corner], expected[corner]) < 1e-9), "{moved:?}");
        }
    }
}

/// What is taken is what was leased, whatever the volume's depth.
#[test]
fn memory_is_two_slices() {
    let size = [100, 90, 120];
    let samples = ball(size, [50.2, 44.1, 60.3], 40.0);
    let fixture = Fixture::new("a.nrrd", &nrrd(size, &samples, ""));
    let mut options = with_values(&fixture, &[0.0]);
    options.budget = Budget::new(1 << 30);
    let mut source = open(&fixture.path, &options).unwrap();
    // The batch is its consumer's.
    let mut batch = TriangleBatch::default();
    batch.corners.reserve(2 * TriangleBatch::TARGET_TRIANGLES);
    batch.material.reserve(2 * TriangleBatch::TARGET_TRIANGLES);
    let taken = allocation_counter::measure(|| while source.next_batch(&mut batch).unwrap() {});
    let leased = options.budget.used_bytes();
    assert!(leased < 100 * 90 * 8 * 2 + (1 << 20), "{leased} bytes were leased");
    assert!(taken.bytes_max <= leased, "{} bytes were taken, {leased} leased", taken.bytes_max);
    drop(source);
    assert_eq!(options.budget.used_bytes(), 0);
}
