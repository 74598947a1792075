//! Mirrors and gloss: a room with a mirror for a wall, a glossy sphere and a glossy block under a lamp, each of its
//! walls by `photon` against the same by `path`. And what a sun and a point bring over a mirror to a floor, against
//! geometry: lights behind the mirror.

use crate::command::{document_in, folder, said};
use crate::light_sides::{PIXELS, SLOPE, WALLS, red, wall_means};
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Parts of the sphere around its axis, and half as many along it.
const SPHERE_PARTS: usize = 32;

/// A room of 10 m, closed, whose left wall is a mirror; the lamp is a rectangle of the scene.
fn write_room(folder: &Path) {
    let mut obj = "mtllib m.mtl\n".to_owned();
    let mut face = |material: &str, corners: &[[f64; 3]]| {
        corners.iter().for_each(|[x, y, z]| writeln!(obj, "v {x} {y} {z}").unwrap());
        let names: Vec<_> = (1..=corners.len()).rev().map(|i| format!("-{i}")).collect();
        writeln!(obj, "usemtl {material}\nf {}", names.join(" ")).unwrap();
    };
    box_faces([-5.0, 0.0, -5.0], [5.0, 10.0, 5.0]).iter().enumerate().for_each(|(way, corners)| {
        // Seen from within: the other way round.
        let corners: Vec<_> = corners.iter().rev().copied().collect();
        face(if way == 0 { "mirror" } else { "wall" }, &corners);
    });
    box_faces([0.5, 0.0, -3.5], [3.0, 4.0, -1.0]).iter().for_each(|corners| face("block", corners));
    let (centre, radius) = ([-2.0, 2.0, -1.5], 1.5);
    let at = |around: usize, along: usize| {
        let turn = std::f64::consts::TAU * around as f64 / SPHERE_PARTS as f64;
        let (sin, cos) = (std::f64::consts::TAU * along as f64 / SPHERE_PARTS as f64).sin_cos();
        let unit = [sin * turn.cos(), cos, sin * turn.sin()];
        [0, 1, 2].map(|a| centre[a] + radius * unit[a])
    };
    for (i, j) in (0..SPHERE_PARTS).flat_map(|i| (0..SPHERE_PARTS / 2).map(move |j| (i, j))) {
        face("sphere", &[at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
    fs::write(folder.join("m.obj"), obj).unwrap();
    let materials = "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl mirror\nKd 0 0 0\nKs 0.9 0.9 0.9\nillum 3\n\
                     newmtl sphere\nKd 0.2 0.2 0.2\nKs 0.6 0.6 0.6\nNs 60\nillum 2\n\
                     newmtl block\nKd 0.2 0.2 0.2\nKs 0.7 0.7 0.7\nNs 20\nillum 2\n";
    fs::write(folder.join("m.mtl"), materials).unwrap();
    let scene = format!(
        "model = 'm.trex'\n[camera]\nposition = [0, 5, 4.9]\ntarget = [0, 5, 0]\nfov_x = {}\n\
         [render]\nresolution = [{PIXELS}, {PIXELS}]\nseed = 3\n\
         [[light]]\ntype = 'rect'\ncorner = [-1, 9.9, -1]\nedge_u = [2, 0, 0]\nedge_v = [0, 0, 2]\n\
         radiance = [10, 10, 10]\n",
        2.0 * SLOPE.atan().to_degrees()
    );
    fs::write(folder.join("m.toml"), scene).unwrap();
}

/// The faces of a box, counter-clockwise from outside: -x, +x, -y, +y, -z, +z.
fn box_faces(lo: [f64; 3], hi: [f64; 3]) -> [[[f64; 3]; 4]; 6] {
    std::array::from_fn(|way| {
        let (axis, is_upper) = (way / 2, way % 2 == 1);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |[at_u, at_v]: [bool; 2]| {
            let mut p = [0.0; 3];
            p[axis] = if is_upper { hi[axis] } else { lo[axis] };
            p[u] = if at_u { hi[u] } else { lo[u] };
            p[v] = if at_v { hi[v] } else { lo[v] };
            p
        };
        let mut corners = [[false, false], [true, false], [true, true], [false, true]].map(corner);
        if !is_upper {
            corners.reverse();
        }
        corners
    })
}

/// Gather rays that took a lobe for a diffuse surface of the same colour and lost light at mirrors made walls up to
/// 18 % wrong.
#[test]
fn gloss_and_a_mirror_light_a_room_as_on_the_mesh() {
    let folder = folder();
    write_room(folder.path());
    document_in(folder.path(), "build m.obj -o m.trex --voxels 256");
    let expected = wall_means(folder.path(), "path --spp 768");
    let found = wall_means(folder.path(), "photon --spp 64 --photons 2M");
    let apart: [f64; 5] = std::array::from_fn(|wall| found[wall] / expected[wall] - 1.0);
    said(&format!("{WALLS:?} differ by {apart:.4?}"));
    assert!(apart.iter().all(|apart| apart.abs() < 0.03), "{apart:?}");
}

/// Side of the picture of a floor, pixels.
const FLOOR_PIXELS: usize = 80;
/// Side of the floor, and height of the mirror at its edge x = 0.
const FLOOR: f64 = 10.0;
const MIRROR: f64 = 4.0;
/// What the floor and the mirror reflect.
const FLOOR_KD: f64 = 0.3;
const MIRROR_KS: f64 = 0.8;

/// The radiance that the light of `scene` brings over the mirror to the floor, by distance from the mirror: a mean of
/// each column of pixels, from pictures with caustics and without.
fn over_the_mirror(light: &str, options: &str) -> Vec<f64> {
    let folder = folder();
    let obj = format!(
        "mtllib m.mtl\nv 0 0 0\nv 0 0 {FLOOR}\nv {FLOOR} 0 {FLOOR}\nv {FLOOR} 0 0\n\
         v 0 {MIRROR} 0\nv 0 {MIRROR} {FLOOR}\n\
         usemtl floor\nf 1 2 3 4\nusemtl mirror\nf 1 5 6 2\n"
    );
    fs::write(folder.path().join("m.obj"), obj).unwrap();
    let materials = format!(
        "newmtl floor\nKd {FLOOR_KD} {FLOOR_KD} {FLOOR_KD}\n\
         newmtl mirror\nKd 0 0 0\nKs {MIRROR_KS} {MIRROR_KS} {MIRROR_KS}\nillum 3\n"
    );
    fs::write(folder.path().join("m.mtl"), materials).unwrap();
    let half = FLOOR / 2.0;
    let scene = format!(
        "model = 'm.trex'\n[camera]\nposition = [{half}, 40, {half}]\ntarget = [{half}, 0, {half}]\nup = [0, 0, -1]\n\
         fov_x = {}\n[render]\nresolution = [{FLOOR_PIXELS}, {FLOOR_PIXELS}]\n[[light]]\n{light}\n",
        2.0 * (half / 40.0).atan().to_degrees()
    );
    fs::write(folder.path().join("m.toml"), scene).unwrap();
    document_in(folder.path(), "build m.obj -o m.trex --voxels 256");
    let [without, with] = ["", "--caustics"].map(|caustics| {
        let keys = "--integrator photon --filter off --spp 16 --photons 4M";
        document_in(
            folder.path(),
            &format!("render m.toml -o m.exr --overwrite {keys} {options} {caustics}"),
        );
        red(&folder.path().join("m.exr"))
    });
    let column = |x: usize| (0..FLOOR_PIXELS).map(move |y| y * FLOOR_PIXELS + x);
    let mean = |x| column(x).map(|at| with[at] - without[at]).sum::<f64>() / FLOOR_PIXELS as f64;
    (0..FLOOR_PIXELS).map(mean).collect()
}

/// Distance of the middle of a column of pixels from the mirror; of a row from the floor's edge.
fn distance(column: usize) -> f64 {
    FLOOR * (column as f64 + 0.5) / FLOOR_PIXELS as f64
}

/// Shadow rays and gather rays find neither: the floor was as bright as without the mirror.
#[test]
fn a_mirror_throws_the_sun_on_the_floor() {
    // Down by as much as it goes towards the mirror: lit is as much of the floor as the mirror is high.
    let sun = "type = 'directional'\ndirection = [-1, -1, 0]\nirradiance = [1, 1, 1]";
    let expected = FLOOR_KD / std::f64::consts::PI * MIRROR_KS * 0.5f64.sqrt();
    for options in ["", "--bake"] {
        let found = over_the_mirror(sun, options);
        for (column, found) in found.iter().enumerate() {
            let share = found / expected;
            // The border is as wide as two facets.
            match distance(column) {
                x if (0.4..3.6).contains(&x) => assert!((share - 1.0).abs() < 0.03, "{options} {x}: {share}"),
                x if x > 4.4 => assert!(share.abs() < 0.01, "{options} {x}: {share}"),
                _ => {}
            }
        }
    }
}

#[test]
fn a_mirror_throws_the_light_of_a_point_on_the_floor() {
    let (height, half, intensity) = (3.0, FLOOR / 2.0, 10.0);
    let found = over_the_mirror(
        &format!(
            "type = 'point'\nposition = [{half}, {height}, {half}]\nintensity = [{intensity}, {intensity}, {intensity}]"
        ),
        "",
    );
    // From the image of the point behind the mirror, which shows it to all of the floor. A metre at a time: photons of
    // a point go everywhere, and few of them meet the mirror.
    let image = [-half, height];
    let lit = |x: f64, z: f64| {
        let square = (x - image[0]).powi(2) + image[1].powi(2) + (z - half).powi(2);
        FLOOR_KD / std::f64::consts::PI * MIRROR_KS * intensity * height / square.powf(1.5)
    };
    let column_mean =
        |x: f64| (0..FLOOR_PIXELS).map(|row| lit(x, distance(row))).sum::<f64>() / FLOOR_PIXELS as f64;
    let metre = FLOOR_PIXELS / FLOOR as usize;
    for (at, found) in found.chunks(metre).enumerate().skip(1).take(FLOOR as usize - 2) {
        let expected = (0..metre).map(|i| column_mean(distance(at * metre + i)));
        let share = found.iter().sum::<f64>() / expected.sum::<f64>();
        assert!((share - 1.0).abs() < 0.03, "{at} m: {share}");
    }
}
