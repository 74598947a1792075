//! `trex bench tradeoff` and the qualities that it measures.

use crate::command::{document_in, folder, hash_of, run_in};
use serde_json::Value;
use std::path::Path;

const LINE: &str = "bench tradeoff gen:isosurface:20k -o trade --resolution 24x24 --reference-spp 4 \
                    --knobs quality,memory,grid-bits,no-asvo";

/// Red, green and blue of all pixels of an EXR.
fn radiance(path: &Path) -> Vec<f64> {
    let picture = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let channel = |name: &str| {
        let list = &picture.layer_data[0].channel_data.list;
        let found = list.iter().find(|channel| channel.name.to_string() == name).unwrap();
        found.sample_data.values_as_f32().map(f64::from).collect::<Vec<_>>()
    };
    let [r, g, b] = ["R", "G", "B"].map(channel);
    r.into_iter().zip(g).zip(b).flat_map(|((r, g), b)| [r, g, b]).collect()
}

fn points(document: &Value) -> &Vec<Value> {
    document["points"].as_array().unwrap()
}

#[test]
fn a_campaign_tells_what_pictures_cost_and_goes_on_where_it_was() {
    let inside = folder();
    let first = document_in(inside.path(), LINE);
    assert_eq!(first["schema"], "trex.bench-tradeoff/1");
    let found = |knob: &str| points(&first).iter().filter(|point| point["knob"] == knob).collect::<Vec<_>>();
    assert_eq!(found("quality").len(), 3);
    assert!(found("memory").len() > 1 && found("grid-bits").len() == 8 && found("no-asvo").len() == 1);
    for point in points(&first) {
        if point["refused"].is_null() {
            let whole = &point["errors"]["whole"];
            assert!(point["picture_ms"].as_f64().unwrap() > 0.0, "{point:#}");
            assert!(point["file_bytes"].as_u64().unwrap() > 1000 && whole["share"] == 1.0, "{point:#}");
            assert!(whole["relmse"].as_f64().unwrap() > 0.0, "{point:#}");
        }
    }
    // More samples of the same light are less wrong, whatever the machine does meanwhile; and each error is the one
    // that the pictures have, made again and compared here.
    let relmse = |quality: &str| first["qualities"][quality]["relmse"].as_f64().unwrap();
    assert!(relmse("reference") < relmse("normal"), "{:#}", first["qualities"]);
    let at = |name: &str| radiance(&inside.path().join("trade").join(name));
    let (a, b) = (at("reference-a.exr"), at("reference-b.exr"));
    let mean: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
    for point in found("quality") {
        let command = point["render_command"].as_str().unwrap();
        let words = command.strip_prefix("trex ").unwrap();
        run_in(inside.path(), &format!("{words} -o again.exr --overwrite -q")).expect(0);
        let again = radiance(&inside.path().join("again.exr"));
        let squares = again.iter().zip(&mean).map(|(x, r)| (x - r).powi(2) / (r * r + 0.01));
        let expected = squares.sum::<f64>() / mean.len() as f64;
        let told = point["errors"]["whole"]["relmse"].as_f64().unwrap();
        assert!((told / expected - 1.0).abs() < 1e-4, "{command}: {told}, {expected} by the pictures");
        let flip = point["errors"]["whole"]["flip"].as_f64().unwrap();
        assert!((0.0..1.0).contains(&flip) && flip > 0.0, "{point:#}");
    }
    let bits = &found("grid-bits")[2];
    assert_eq!(bits["value"], "14");
    assert_eq!(first["settings"]["grid-bits-14"]["flip"], bits["errors"]["whole"]["flip"]);
    let front = first["front"].as_object().unwrap();
    assert!(!front.is_empty());
    for on_front in front.values() {
        assert_eq!(on_front, &first["settings"][on_front["setting"].as_str().unwrap()]);
    }
    let (bare, normal) = (found("no-asvo")[0], &first["qualities"]["normal"]);
    let expected = bare["errors"]["whole"]["relmse"].as_f64().unwrap() / normal["relmse"].as_f64().unwrap();
    let told = first["without"]["octree"]["relmse_ratio"].as_f64().unwrap();
    assert!((told / expected - 1.0).abs() < 1e-9, "{told}, by its points {expected}");
    assert_eq!(first["without"].as_object().unwrap().len(), 1, "no other part was turned off");
    for plot in ["error-time.svg", "error-memory.svg"] {
        let svg = std::fs::read_to_string(inside.path().join("trade").join(plot)).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("relMSE"), "{plot}");
    }

    // Nothing is measured twice: no two runs take the same time.
    let again = document_in(inside.path(), LINE);
    assert_eq!(points(&again), points(&first));
    let log = inside.path().join("trade/points.jsonl");
    let text = std::fs::read_to_string(&log).unwrap();
    let kept: Vec<&str> = text.lines().take(text.lines().count() - 1).collect();
    std::fs::write(&log, kept.join("\n") + "\n").unwrap();
    let more = document_in(inside.path(), LINE);
    let (last, others) = points(&more).split_last().unwrap();
    assert_eq!(others, &points(&first)[..others.len()]);
    assert_ne!(Some(last), points(&first).last());

    run_in(inside.path(), &format!("{LINE} --rounds 2 --json")).expect_error(3, "input-mismatch");
}

/// A wall of three materials, seen from in front: matte on the left, glossy in the middle, a mirror on the right.
#[test]
fn gloss_and_mirrors_are_judged_where_they_are() {
    let inside = folder();
    let write = |name: &str, text: &str| std::fs::write(inside.path().join(name), text).unwrap();
    let corners = |x: usize| format!("v {x} 0 0\nv {0} 0 0\nv {0} 1 0\nv {x} 1 0\n", x + 1);
    let face = |x: usize| format!("usemtl m{x}\nf {} {} {} {}\n", 4 * x + 1, 4 * x + 2, 4 * x + 3, 4 * x + 4);
    let mesh: String = (0..3).map(corners).chain((0..3).map(face)).collect();
    write("wall.obj", &format!("mtllib wall.mtl\n{mesh}"));
    write(
        "wall.mtl",
        "newmtl m0\nKd .5 .5 .5\nnewmtl m1\nKd .5 .5 .5\nKs .3 .3 .3\nNs 30\nnewmtl m2\nKd .5 .5 .5\n",
    );
    let mirror = "[material.m2]\nks = [0.9, 0.9, 0.9]\nmirror = true\n";
    let camera = "[camera]\nposition = [1.5, 0.5, 9.0]\ntarget = [1.5, 0.5, 0.0]\nup = [0.0, 1.0, 0.0]\nfov_x = 30.0\n";
    write("wall.toml", &format!("model = 'wall.trex'\n{camera}{mirror}"));
    document_in(inside.path(), "build wall.obj -o wall.trex");
    let line = "bench tradeoff wall.toml -o trade --resolution 24x6 --reference-spp 4 --knobs quality";
    let document = document_in(inside.path(), line);

    let pixel = 2.0 * 9.0 * 15f64.to_radians().tan() / 24.0;
    let seen = |wall: std::ops::Range<f64>| {
        let on = |x: i32, y: i32| {
            let (x, y) = (1.5 + (f64::from(x) - 11.5) * pixel, 0.5 + (f64::from(y) - 2.5) * pixel);
            wall.contains(&x) && (0.0..1.0).contains(&y)
        };
        (0..6).flat_map(|y| (0..24).map(move |x| (x, y))).filter(|&(x, y)| on(x, y)).count()
    };
    let errors = &points(&document)[1]["errors"];
    for (region, wall) in [("gloss", 1.0..2.0), ("mirror", 2.0..3.0)] {
        let expected = seen(wall) as f64 / 144.0;
        assert!(expected > 0.05);
        assert_eq!(errors[region]["share"], expected, "{region}");
        assert!(errors[region]["relmse"].is_f64() && errors[region]["flip"].is_f64(), "{errors:#}");
    }
    let normal = &document["qualities"]["normal"];
    assert_eq!(normal["parts_flip"]["mirror"], errors["mirror"]["flip"]);
    assert_eq!(normal["flip"], errors["whole"]["flip"]);
}

#[test]
fn a_picture_of_which_nothing_is_said_is_normal() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:20k -o iso.trex");
    let picture = |flags: &str| {
        document_in(
            inside.path(),
            &format!("render iso.trex -o p.exr --overwrite --resolution 32x32 {flags}"),
        );
        hash_of(&inside.path().join("p.exr"))
    };
    let normal = picture("");
    assert_eq!(normal, picture("--quality normal"));
    assert_eq!(
        normal,
        picture("--integrator photon --spp 16 --n-shadow 2 --n-gather 2 --photons 1048576 --filter on")
    );
    assert_ne!(normal, picture("--quality draft"));

    std::fs::write(
        inside.path().join("s.toml"),
        "model = 'iso.trex'\n[render]\nresolution = [32, 32]\nquality = 'draft'\nspp = 2\n",
    )
    .unwrap();
    let drawn = document_in(inside.path(), "render s.toml -o s.exr");
    assert_eq!((&drawn["spp"], &drawn["lod_error_px"]), (&Value::from(2), &Value::from(1.0)));
    assert_eq!(hash_of(&inside.path().join("s.exr")), picture("--quality draft --spp 2"));

    // Without voxels there is direct light, and a word about it; what is asked for is not replaced.
    document_in(inside.path(), "build gen:isosurface:20k -o bare.trex --no-asvo");
    let line = "render bare.trex -o bare.png --overwrite --resolution 8x8";
    let ran = run_in(inside.path(), &format!("{line} --json"));
    assert_eq!(ran.document()["integrator"], "direct");
    assert!(ran.stderr.contains("no voxels"), "{}", ran.stderr);
    run_in(inside.path(), &format!("{line} --quality normal --json")).expect_error(3, "scene-format");
}

/// A turn of a knob that `build` refuses ended the campaign.
#[test]
fn each_turn_of_a_knob_of_the_build_has_a_picture() {
    let inside = folder();
    let line = "bench tradeoff gen:scan:10k -o trade --resolution 8x8 --reference-spp 2 --knobs upper";
    let document = document_in(inside.path(), line);
    assert_eq!(points(&document).len(), 4);
    for point in points(&document) {
        assert!(point["picture_ms"].is_f64(), "{point:#}");
    }
}
