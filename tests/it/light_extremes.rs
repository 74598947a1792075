//! Light at its extremes: powers, sizes, places, angles, gloss and albedo far from what rooms have, each against a
//! formula, or against the same picture where nothing is extreme.

use crate::command::{document_in, folder, said};
use crate::light::{INSIDE, check, cube, write_obj};
use crate::light_sides::red;
use std::f64::consts::PI;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Side of pictures, pixels.
const PIXELS: usize = 32;
/// Every way to compute light, with what it takes for small rooms.
const WAYS: [&str; 4] = [
    "direct --spp 4",
    "path --spp 8",
    "photon --spp 4 --photons 100k --filter off",
    "full-gi --spp 2 --photons 50k --filter off",
];

/// A room from -1 to 1 with a block in it, under a rectangle that shines; all lengths times `size`, all of it moved by
/// `offset` along each axis, all light times `power`.
struct Room {
    size: f64,
    offset: f64,
    power: f64,
}

impl Room {
    const USUAL: Room = Room { size: 1.0, offset: 0.0, power: 1.0 };

    fn place(&self, point: [f64; 3]) -> [f64; 3] {
        point.map(|x| x * self.size + self.offset)
    }

    /// Writes mesh and scene, and builds it.
    fn build(&self, folder: &Path) {
        let mut obj = "mtllib m.mtl\n".to_owned();
        for (material, lo, hi) in
            [("wall", [-1.0; 3], [1.0; 3]), ("block", [-0.5, -1.0, -0.5], [0.25, -0.25, 0.25])]
        {
            for corner in 0..8 {
                let point = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { lo[a] } else { hi[a] });
                let [x, y, z] = self.place(point);
                writeln!(obj, "v {x} {y} {z}").unwrap();
            }
            writeln!(obj, "usemtl {material}").unwrap();
            for [a, b, c, d] in
                [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
            {
                writeln!(obj, "f {} {} {} {}", a - 8, b - 8, c - 8, d - 8).unwrap();
            }
        }
        fs::write(folder.join("m.obj"), obj).unwrap();
        let materials =
            "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl block\nKd 0.3 0.3 0.3\nKs 0.4 0.4 0.4\nNs 20\nillum 2\n";
        fs::write(folder.join("m.mtl"), materials).unwrap();
        let [position, target, corner] =
            [[-0.75, 0.5, 0.75], [0.125, -0.5, -0.25], [-0.25, 0.9375, -0.25]].map(|point| self.place(point));
        let scene = format!(
            "model = 'm.trex'\n[camera]\nposition = {position:?}\ntarget = {target:?}\nfov_x = 75\n\
             [render]\nresolution = [{PIXELS}, {PIXELS}]\nseed = 3\n[[light]]\ntype = 'rect'\ncorner = {corner:?}\n\
             edge_u = [{0:?}, 0, 0]\nedge_v = [0, 0, {0:?}]\nradiance = [{1:?}, {1:?}, {1:?}]\n",
            0.5 * self.size,
            8.0 * self.power
        );
        fs::write(folder.join("m.toml"), scene).unwrap();
        document_in(folder, "build m.obj -o m.trex --voxels 256 --overwrite");
    }

    /// The first channel of its picture.
    fn picture(&self, folder: &Path, options: &str) -> Vec<f64> {
        document_in(folder, &format!("render m.toml -o m.exr --overwrite --integrator {options}"));
        red(&folder.join("m.exr")).into_iter().map(|radiance| radiance / self.power).collect()
    }
}

/// Mean of (a - b)^2 / (b^2 + 0.01), the error of `a` for `b`.
fn relmse(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b) / (b * b + 0.01)).sum::<f64>() / a.len() as f64
}

/// Light a millionth as strong, and 10^9 times, is the same picture bit by bit: powers of two scale every number of it.
#[test]
fn light_of_any_power_gives_the_same_picture() {
    let usual = folder();
    Room::USUAL.build(usual.path());
    for power in [2f64.powi(-20), 2f64.powi(30)] {
        let folder = folder();
        let room = Room { power, ..Room::USUAL };
        room.build(folder.path());
        for way in WAYS {
            let (expected, found) =
                (Room::USUAL.picture(usual.path(), way), room.picture(folder.path(), way));
            assert!(expected.iter().sum::<f64>() > 10.0, "{way}: it is dark");
            assert!(
                found == expected,
                "{way}: light times {power:e} is off by {}",
                relmse(&found, &expected)
            );
        }
    }
}

/// A room of 10^-6 units and one of 10^9 are the same picture bit by bit; 10^7 from the origin, where a double has 29
/// bits left below a unit, it is the same but for rounding.
#[test]
fn a_room_of_any_size_and_place_gives_the_same_picture() {
    let usual = folder();
    Room::USUAL.build(usual.path());
    for (size, offset) in [(2f64.powi(-20), 0.0), (2f64.powi(30), 0.0), (1.0, 1e7)] {
        let folder = folder();
        let room = Room { size, offset, ..Room::USUAL };
        room.build(folder.path());
        for way in WAYS {
            let (expected, found) =
                (Room::USUAL.picture(usual.path(), way), room.picture(folder.path(), way));
            let error = relmse(&found, &expected);
            said(&format!("{way}, size {size:e}, {offset:e} away: relMSE {error:.2e}"));
            if offset == 0.0 {
                assert!(found == expected, "{way}: a room of {size:e} is off by {error}");
            } else {
                assert!(error < 1e-8, "{way}: {offset:e} from the origin it is off by {error}");
            }
        }
    }
}

/// The scene of one square of side 2 about the origin, seen from straight above, and its first channel's mean.
fn square(folder: &Path, material: &str, light: &str, options: &str) -> f64 {
    let obj = "mtllib m.mtl\nusemtl m\nv -1 0 -1\nv -1 0 1\nv 1 0 1\nv 1 0 -1\nf 1 2 3 4\n";
    fs::write(folder.join("m.obj"), obj).unwrap();
    fs::write(folder.join("m.mtl"), format!("newmtl m\n{material}\n")).unwrap();
    document_in(folder, "build m.obj -o m.trex --voxels 256 --overwrite");
    let scene = format!(
        "model = 'm.trex'\n[camera]\nposition = [0, 4, 0]\ntarget = [0, 0, 0]\nup = [0, 0, 1]\nfov_x = 1\n\
         [render]\nresolution = [16, 16]\nseed = 3\n[[light]]\n{light}\n"
    );
    fs::write(folder.join("m.toml"), scene).unwrap();
    let line = format!("render m.toml -o m.exr --overwrite --integrator {options}");
    document_in(folder, &line)["image"]["mean"][0].as_f64().unwrap()
}

/// A sun 89.9 and 89.999 degrees from the normal: L = rho / pi * E * cos.
#[test]
fn a_sun_that_grazes_lights_by_its_cosine() {
    let folder = folder();
    for degrees in [89.9f64, 89.999] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let light = format!(
            "type = 'directional'\ndirection = [{sin:?}, {:?}, 0]\nirradiance = [3e4, 3e4, 3e4]",
            -cos
        );
        let expected = 0.7 / PI * 3e4 * cos;
        for way in [
            "direct --spp 4",
            "path --spp 4",
            "photon --spp 4 --photons 10k",
            "full-gi --spp 4 --photons 10k",
        ] {
            let found = square(folder.path(), "Kd 0.7 0.7 0.7", &light, way);
            said(&format!("{way}, {degrees} degrees: {:+.1e}", found / expected - 1.0));
            assert!(
                (found / expected - 1.0).abs() < 1e-4,
                "{way}, {degrees} degrees: {found} for {expected}"
            );
        }
    }
}

/// Seen along its normal, a surface of modified Phong under an even sky returns Kd + Ks, whatever its exponent:
/// the lobe's integral, (n + 2) / (2 pi) cos^n times the cosine, is 1.
#[test]
fn gloss_of_any_exponent_returns_what_it_should() {
    let folder = folder();
    let sky = "type = 'sky'\nradiance = [1, 1, 1]";
    for exponent in ["1", "10", "1000", "100000"] {
        let material = format!("Kd 0.2 0.2 0.2\nKs 0.6 0.6 0.6\nNs {exponent}\nillum 2");
        for way in ["path --spp 256", "photon --spp 64 --n-gather 4 --photons 10k --filter off"] {
            let found = square(folder.path(), &material, sky, way);
            said(&format!("{way}, exponent {exponent}: {:+.4}", found / 0.8 - 1.0));
            assert!((found / 0.8 - 1.0).abs() < 0.01, "{way}, exponent {exponent}: {found} for 0.8");
        }
    }
}

/// A closed box of albedo rho that shines with 1: L = 1 / (1 - rho), at 0.999 after a thousand bounces on average.
#[test]
fn an_albedo_of_nearly_one_keeps_light_for_a_thousand_bounces() {
    let folder = folder();
    let (corners, faces) = cube();
    let photon = "photon --spp 16 --photons 300k --filter off";
    let full = "full-gi --spp 4 --photons 100k --filter off";
    // What each has of the light: photons end by roulette before they have brought all of 0.999.
    for (albedo, ways) in [
        (0.9, [("path --spp 16", 1.0, 0.02), (photon, 1.0, 0.02), (full, 0.95, 0.1)]),
        (0.95, [("path --spp 16", 1.0, 0.02), (photon, 1.0, 0.02), (full, 0.77, 0.1)]),
        (0.99, [("path --spp 16", 1.0, 0.02), (photon, 1.0, 0.03), (full, 0.25, 0.1)]),
        (0.999, [("path --spp 16", 1.0, 0.05), (photon, 0.26, 0.3), (full, 0.028, 0.1)]),
    ] {
        write_obj(folder.path(), &corners, &faces, &format!("Kd {albedo} {albedo} {albedo}\nKe 1 1 1"));
        for (way, share, within) in ways {
            check(folder.path(), "64", INSIDE, share / (1.0 - albedo), &[(way, within)]);
        }
    }
}

/// A thread of 0.1 mm across a room of 10 m is seen as wide as it is, hides the lamp from what is behind it and no
/// more, and the voxels around it, 4 cm wide, take no light from the walls.
#[test]
fn a_thread_of_a_tenth_of_a_millimetre_is_as_wide_as_it_is() {
    let folder = folder();
    let width = 1e-4;
    let write = |has_thread: bool| {
        let mut obj = "mtllib m.mtl\nusemtl wall\n".to_owned();
        for corner in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { -5.0 } else { 5.0 });
            writeln!(obj, "v {x} {y} {z}").unwrap();
        }
        obj.push_str("f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n");
        if has_thread {
            let half = width / 2.0;
            writeln!(
                obj,
                "usemtl thread\nv -5 {0} 0\nv 5 {0} 0\nv 5 {half} 0\nv -5 {half} 0\nf -4 -3 -2 -1",
                -half
            )
            .unwrap();
        }
        fs::write(folder.path().join("m.obj"), obj).unwrap();
        fs::write(folder.path().join("m.mtl"), "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl thread\nKd 0 0 0\n")
            .unwrap();
        // Its width is a hundred steps of the lattice.
        document_in(folder.path(), "build m.obj -o m.trex --voxels 256 --error 5e-7 --overwrite");
    };
    let picture = |view: &str, options: &str| {
        let light = "[[light]]\ntype = 'point'\nposition = [0, 0, 4]\nintensity = [9, 9, 9]\n";
        let scene = format!(
            "model = 'm.trex'\n{view}\n[render]\nresolution = [{PIXELS}, {PIXELS}]\nseed = 3\n{light}"
        );
        fs::write(folder.path().join("m.toml"), scene).unwrap();
        document_in(
            folder.path(),
            &format!("render m.toml -o m.exr --overwrite --filter off --integrator {options}"),
        );
        red(&folder.path().join("m.exr"))
    };
    // From 0.1 m away eight threads wide; the wall behind it is lit, the thread is black.
    let across = 8.0 * width;
    let near = format!(
        "[camera]\nposition = [1, 0, 0.1]\ntarget = [1, 0, 0]\nfov_x = {:?}",
        2.0 * (across / 2.0 / 0.1f64).atan().to_degrees()
    );
    // The shadow of it on the far wall, 9 m from the point and 4 m behind the thread.
    let shadow_width = width * 9.0 / 4.0;
    let behind = format!(
        "[camera]\nposition = [0, 0, -4.9]\ntarget = [0, 0, -5]\nfov_x = {:?}",
        2.0 * (4.0 * shadow_width / 0.1f64).atan().to_degrees()
    );
    write(true);
    for (view, what) in [(&near, "thread"), (&behind, "shadow")] {
        for way in ["direct --spp 16", "photon --spp 16 --photons 200k --n-gather 0"] {
            let seen = picture(view, way);
            let lit = seen.iter().copied().fold(0.0, f64::max);
            let dark = seen.iter().map(|radiance| 1.0 - radiance / lit).sum::<f64>() / seen.len() as f64;
            said(&format!("{what}, {way}: {dark:.4} of the picture for 0.125"));
            assert!((dark - 0.125).abs() < 0.002, "{what}, {way}: {dark} of the picture for an eighth");
        }
    }
    // The walls: the same light with the thread and without.
    let room = "[camera]\nposition = [-4, 3, 4]\ntarget = [1, -2, -2]\nfov_x = 80";
    let way = "photon --spp 32 --photons 1M";
    let with = picture(room, way).iter().sum::<f64>();
    write(false);
    let without = picture(room, way).iter().sum::<f64>();
    said(&format!("walls with a thread: {:+.4}", with / without - 1.0));
    assert!((with / without - 1.0).abs() < 0.005, "{with} with a thread, {without} without");
}

/// A closed room without a lamp under a sun: what comes in through roofs of one sheet to 30 cm is nothing.
#[test]
fn a_wall_that_is_lit_from_one_side_is_dark_on_the_other() {
    let folder = folder();
    for roof in [0.0, 1e-6, 1e-3, 0.02, 0.3] {
        let mut obj = "mtllib m.mtl\nusemtl m\n".to_owned();
        for (lo, hi) in [([-5.0, 0.0, -5.0], [5.0, 10.0, 5.0]), ([-5.0, 10.0, -5.0], [5.0, 10.0 + roof, 5.0])]
        {
            for corner in 0..8 {
                let [x, y, z] = [0, 1, 2].map(|a: usize| if corner >> a & 1 == 0 { lo[a] } else { hi[a] });
                writeln!(obj, "v {x} {y} {z}").unwrap();
            }
            obj.push_str(
                "f -8 -7 -5 -6\nf -4 -2 -1 -3\nf -8 -4 -3 -7\nf -6 -5 -1 -2\nf -8 -6 -2 -4\nf -7 -3 -1 -5\n",
            );
            if roof == 0.0 {
                break;
            }
        }
        fs::write(folder.path().join("m.obj"), obj).unwrap();
        fs::write(folder.path().join("m.mtl"), "newmtl m\nKd 0.7 0.7 0.7\n").unwrap();
        let scene = format!(
            "model = 'm.trex'\n[camera]\nposition = [0, 5, 4.9]\ntarget = [0, 5, 0]\nfov_x = 120\n\
             [render]\nresolution = [{PIXELS}, {PIXELS}]\nseed = 3\n\
             [[light]]\ntype = 'directional'\ndirection = [0.2, -1, -0.4]\nirradiance = [3, 3, 3]\n"
        );
        fs::write(folder.path().join("m.toml"), scene).unwrap();
        document_in(folder.path(), "build m.obj -o m.trex --voxels 256 --overwrite");
        let outside = 0.7 / PI * 3.0;
        for way in ["path --spp 64", "photon --spp 32 --photons 1M --filter off"] {
            let line = format!("render m.toml -o m.exr --overwrite --integrator {way}");
            let inside = document_in(folder.path(), &line)["image"]["mean"][0].as_f64().unwrap();
            said(&format!("a roof of {roof:e} m, {way}: {:.1e} of the light outside", inside / outside));
            let most = if way.starts_with("path") { 0.0 } else { 1e-3 };
            assert!(inside / outside <= most, "{roof} m, {way}: {inside} inside, {outside} outside");
        }
    }
}
