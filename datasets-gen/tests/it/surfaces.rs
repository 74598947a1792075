//! Closed surfaces: every edge has its opposite.

use super::{collect, open_seeded};
use datasets_gen::{Kind, Spec};
use glam::DVec3;
use std::collections::HashMap;

type Point = [u64; 3];

/// Edges that do not belong to exactly one triangle in each direction: (in one only, in more).
fn bad_edges(spec: Spec) -> (Vec<[[f64; 3]; 2]>, usize) {
    let all = collect(&mut *open_seeded(spec, 2));
    let mut uses: HashMap<[Point; 2], [u32; 2]> = HashMap::new();
    for corners in &all.corners {
        for side in 0..3 {
            // + 0.0: both zeros are one position.
            let [a, b] =
                [corners[side], corners[(side + 1) % 3]].map(|p| p.map(|value| (value + 0.0).to_bits()));
            assert_ne!(a, b, "a degenerate triangle");
            uses.entry(if a < b { [a, b] } else { [b, a] }).or_default()[usize::from(a > b)] += 1;
        }
    }
    let open = uses.iter().filter(|&(_, &[forth, back])| forth + back == 1);
    let open = open.map(|(edge, _)| edge.map(|point| point.map(f64::from_bits))).collect();
    (open, uses.values().filter(|&&[forth, back]| forth + back > 1 && (forth, back) != (1, 1)).count())
}

#[test]
fn the_statue_is_closed_and_oriented() {
    for seed in [1, 5] {
        let (open, crowded) = bad_edges(Spec { kind: Kind::Scan, triangles: 60_000, seed, colours: None });
        assert_eq!((open.len(), crowded), (0, 0));
    }
}

#[test]
fn the_layer_is_closed_but_for_its_walls() {
    for (triangles, seed) in [(30_000, 1), (30_000, 9), (300_000, 3)] {
        let (open, crowded) = bad_edges(Spec { kind: Kind::Isosurface, triangles, seed, colours: None });
        assert_eq!(crowded, 0);
        assert!(!open.is_empty());
        let mut walls = [[0.0f64; 2]; 3];
        for point in open.as_flattened() {
            for axis in [0, 2] {
                walls[axis] = [walls[axis][0].min(point[axis]), walls[axis][1].max(point[axis])];
            }
        }
        for [a, b] in &open {
            let on_wall = |axis: usize, wall: f64| a[axis] == wall && b[axis] == wall;
            assert!(
                [0, 2].into_iter().any(|axis: usize| walls[axis].iter().any(|&wall| on_wall(axis, wall))),
                "{a:?} {b:?}"
            );
        }
    }
}

#[test]
fn the_statue_encloses_a_positive_volume_and_the_layer_faces_up() {
    let statue =
        collect(&mut *open_seeded(Spec { kind: Kind::Scan, triangles: 20_000, seed: 1, colours: None }, 1));
    let volume: f64 = statue
        .corners
        .iter()
        .map(|corners| corners.map(DVec3::from))
        .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
        .sum();
    assert!((1.0..20.0).contains(&volume), "{volume}");
    let layer = collect(&mut *open_seeded(
        Spec { kind: Kind::Isosurface, triangles: 50_000, seed: 1, colours: None },
        1,
    ));
    let corners = layer.corners.iter().map(|corners| corners.map(DVec3::from));
    let upward: f64 = corners.map(|[a, b, c]| 0.5 * (b - a).cross(c - a).y).sum();
    // What the layer covers of its square, to a cell.
    assert!((9_500.0..10_500.0).contains(&upward), "{upward}");
}
