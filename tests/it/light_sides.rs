//! Light is kept by side: the sun on a roof does not light the room below it, and a crust that is thinner than a voxel
//! has an outside and an inside; what hides a lamp is the mesh, not its voxels. Each region of a picture by `photon`
//! against the same by `path`, or by `direct`.

use crate::command::{document_in, folder, said};
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Side of the picture of a room, pixels, and the greatest slope of its rays.
pub(crate) const PIXELS: usize = 48;
pub(crate) const SLOPE: f64 = 2.0;
pub(crate) const WALLS: [&str; 5] = ["floor", "ceiling", "left", "right", "back"];

/// A room of 10 m whose walls are single sheets, open to the front or closed by a lit lamp; its roof is `roof` m thick,
/// one sheet where that is 0.
fn write_room(folder: &Path, roof: f64, is_open: bool) {
    let mut obj = "mtllib m.mtl\nusemtl m\n".to_owned();
    let mut quad = |corners: [[f64; 3]; 4]| {
        corners.iter().for_each(|[x, y, z]| writeln!(obj, "v {x} {y} {z}").unwrap());
        obj.push_str("f -4 -3 -2 -1\n");
    };
    let (l, h, top) = (5.0, 10.0, 10.0 + roof);
    quad([[-l, 0.0, -l], [-l, 0.0, l], [l, 0.0, l], [l, 0.0, -l]]);
    quad([[-l, 0.0, -l], [l, 0.0, -l], [l, h, -l], [-l, h, -l]]);
    quad([[-l, 0.0, -l], [-l, h, -l], [-l, h, l], [-l, 0.0, l]]);
    quad([[l, 0.0, -l], [l, 0.0, l], [l, h, l], [l, h, -l]]);
    quad([[-l, h, -l], [l, h, -l], [l, h, l], [-l, h, l]]);
    if !is_open {
        quad([[-l, 0.0, l], [-l, h, l], [l, h, l], [l, 0.0, l]]);
    }
    if roof > 0.0 {
        quad([[-l, top, -l], [-l, top, l], [l, top, l], [l, top, -l]]);
        quad([[-l, h, l], [l, h, l], [l, top, l], [-l, top, l]]);
        quad([[-l, h, -l], [-l, top, -l], [l, top, -l], [l, h, -l]]);
        quad([[-l, h, -l], [-l, h, l], [-l, top, l], [-l, top, -l]]);
        quad([[l, h, -l], [l, top, -l], [l, top, l], [l, h, l]]);
    }
    fs::write(folder.join("m.obj"), obj).unwrap();
    fs::write(folder.join("m.mtl"), "newmtl m\nKd 0.7 0.7 0.7\n").unwrap();
    let mut scene = format!(
        "model = 'm.trex'\n[camera]\nposition = [0, 5, 4.9]\ntarget = [0, 5, 0]\nfov_x = {}\n\
         [render]\nresolution = [{PIXELS}, {PIXELS}]\nseed = 3\n\
         [[light]]\ntype = 'directional'\ndirection = [0.2, -1, -0.4]\nirradiance = [3, 3, 3]\n",
        2.0 * SLOPE.atan().to_degrees()
    );
    if !is_open {
        scene.push_str("[[light]]\ntype = 'point'\nposition = [1, 4, 0]\nintensity = [0.5, 0.5, 0.5]\n");
    }
    fs::write(folder.join("m.toml"), scene).unwrap();
}

/// Means of the first channel over the walls of the room.
pub(crate) fn wall_means(folder: &Path, options: &str) -> [f64; 5] {
    document_in(folder, &format!("render m.toml -o m.exr --overwrite --filter off --integrator {options}"));
    let red = red(&folder.join("m.exr"));
    let (mut sums, mut counts) = ([0.0; 5], [0.0; 5]);
    for (x, y) in (0..PIXELS).flat_map(|y| (0..PIXELS).map(move |x| (x, y))) {
        let [right, down] = [x, y].map(|i| ((2 * i + 1) as f64 / PIXELS as f64 - 1.0) * SLOPE);
        let wall = match () {
            // The back wall is 9.9 away, the others 5.
            () if right.abs().max(down.abs()) < 5.0 / 9.9 => 4,
            () if right.abs() < down.abs() => usize::from(down < 0.0),
            () => 2 + usize::from(right > 0.0),
        };
        sums[wall] += red[y * PIXELS + x];
        counts[wall] += 1.0;
    }
    std::array::from_fn(|wall| sums[wall] / counts[wall])
}

pub(crate) fn red(path: &Path) -> Vec<f64> {
    let picture = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let channels = &picture.layer_data[0].channel_data.list;
    let red = channels.iter().find(|channel| channel.name.eq("R")).unwrap();
    red.sample_data.values_as_f32().map(f64::from).collect()
}

/// A roof of one sheet let the sun through: the room was up to 3.4 times too bright, and 2.3 times under a roof of a
/// millimetre.
#[test]
fn the_sun_on_a_roof_stays_outside() {
    let folder = folder();
    for (roof, voxels, is_open) in [
        (0.0, 256, true),
        (0.001, 256, true),
        (0.02, 512, true),
        (0.3, 256, true),
        (0.0, 256, false),
        (0.02, 256, false),
    ] {
        write_room(folder.path(), roof, is_open);
        document_in(folder.path(), &format!("build m.obj -o m.trex --voxels {voxels} --overwrite"));
        let expected = wall_means(folder.path(), "path --spp 512");
        let found = wall_means(folder.path(), "photon --spp 64 --photons 2M");
        let apart: [f64; 5] = std::array::from_fn(|wall| found[wall] / expected[wall] - 1.0);
        let room = if is_open { "open" } else { "closed" };
        said(&format!("{room} room, roof of {roof} m, {voxels}^3: {WALLS:?} differ by {apart:.4?}"));
        assert!(apart.iter().all(|apart| apart.abs() < 0.03), "{room}, {roof} m, {voxels}: {apart:?}");
    }
}

/// Voxels are fatter than what is in them, and close the gaps between pipes: by voxels alone a plant in voxels of 64^3
/// had two thirds of its direct light, and the places between its pipes less than half.
#[test]
fn pipes_hide_lamps_as_they_do_on_the_mesh() {
    let folder = folder();
    document_in(folder.path(), "build gen:pipes:100k -o m.trex --voxels 64");
    let picture = |options: &str| {
        let line = format!(
            "render m.trex -o m.exr --overwrite --resolution 96x96 --spp 64 --filter off --light scene {options}"
        );
        document_in(folder.path(), &line);
        red(&folder.path().join("m.exr"))
    };
    let expected = picture("--integrator direct");
    let mut order: Vec<usize> = (0..expected.len()).filter(|&pixel| expected[pixel] > 0.0).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    assert!(order.len() > 500, "{} pixels show the plant", order.len());
    let fifths = |found: &[f64]| -> Vec<f64> {
        let share = |pixels: &[usize]| {
            let sum = |picture: &[f64]| pixels.iter().map(|&pixel| picture[pixel]).sum::<f64>();
            sum(found) / sum(&expected)
        };
        order.chunks(order.len().div_ceil(5)).map(share).collect()
    };
    let [found, by_voxels] = ["", "--shadows voxel"]
        .map(|how| fifths(&picture(&format!("--integrator photon --n-gather 0 {how}"))));
    said(&format!("fifths by brightness: {found:.4?}; by voxels alone {by_voxels:.4?}"));
    assert!(found.iter().all(|share| (share - 1.0).abs() < 0.02), "{found:?}");
    assert!(by_voxels[0] < 0.8, "the scene does not tell them apart: {by_voxels:?}");
}

/// An iso-surface has crusts thinner than its voxels. The darkest fifth of the picture, which is inside of them, was a
/// tenth too bright, and the error over the picture nine times as large.
#[test]
fn a_crust_has_an_inside_and_an_outside() {
    let folder = folder();
    document_in(folder.path(), "build gen:isosurface:300k -o m.trex");
    let picture = |options: &str| {
        let line = format!(
            "render m.trex -o m.exr --overwrite --resolution 96x96 --filter off --integrator {options}"
        );
        document_in(folder.path(), &line);
        red(&folder.path().join("m.exr"))
    };
    let (expected, found) = (picture("path --spp 256"), picture("photon --spp 128"));
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    let darkest = order.iter().filter(|&&pixel| expected[pixel] > 0.0).take(expected.len() / 5);
    let sum = |picture: &[f64]| darkest.clone().map(|&pixel| picture[pixel]).sum::<f64>();
    let share = sum(&found) / sum(&expected);
    let errors = found.iter().zip(&expected).map(|(f, e)| (f - e).powi(2) / (e * e + 1e-2));
    let relmse = errors.sum::<f64>() / found.len() as f64;
    said(&format!("the darkest fifth is {share:.4} of what it should be; relMSE {relmse:.5}"));
    assert!((share - 1.0).abs() < 0.03, "{share}");
    assert!(relmse < 0.004, "{relmse}");
}

/// A lamp in the plane of a ceiling, or less than a voxel below it: its photons began within the ceiling's own voxels,
/// and their light lay on its upper side.
#[test]
fn a_lamp_flush_with_the_ceiling_lights_the_room() {
    let folder = folder();
    write_room(folder.path(), 0.0, false);
    document_in(folder.path(), "build m.obj -o m.trex --voxels 64");
    let scene = fs::read_to_string(folder.path().join("m.toml")).unwrap();
    let scene = scene.split("[[light]]").next().unwrap();
    for height in [10.0, 9.98] {
        let lamp = format!(
            "{scene}[[light]]\ntype = 'rect'\ncorner = [-1.5, {height}, -1.5]\nedge_u = [3, 0, 0]\nedge_v = [0, 0, 3]\n\
             radiance = [5, 5, 5]\n"
        );
        fs::write(folder.path().join("m.toml"), lamp).unwrap();
        let expected = wall_means(folder.path(), "path --spp 64");
        for way in ["photon --spp 16 --photons 300k", "full-gi --spp 4 --photons 100k"] {
            let found = wall_means(folder.path(), way);
            said(&format!("{height}, {way}: {found:.4?}, {expected:.4?} expected"));
            for (wall, (found, expected)) in WALLS.iter().zip(found.iter().zip(&expected)) {
                assert!(
                    (found / expected - 1.0).abs() < 0.06,
                    "{height}, {way}, {wall}: {found}, {expected}"
                );
            }
        }
    }
}
