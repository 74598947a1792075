//! `trex image diff`: its figures against pictures and formulas of our own, its verdicts, its picture, and what bad
//! pictures get.

use crate::command::{Ran, document_in, folder, listing, pixels, run_in};
use crate::fixtures::built_in;
use crate::oracle::pictures::{Pixels, exr, figures, noise, png};
use serde_json::Value;
use std::path::Path;

fn write(inside: &Path, name: &str, bytes: &[u8]) {
    std::fs::write(inside.join(name), bytes).unwrap();
}

fn diff(inside: &Path, line: &str) -> Ran {
    run_in(inside, &format!("image diff {line} --json -q"))
}

#[track_caller]
fn close(found: &Value, expected: f64) {
    let found = found.as_f64().unwrap_or_else(|| panic!("{found}"));
    assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1e-9), "{found} instead of {expected}");
}

#[test]
fn figures_are_those_of_the_formulas() {
    let inside = folder();
    let (a, b) = (noise(61 * 37, 1), noise(61 * 37, 2));
    write(inside.path(), "a.exr", &exr(61, &a));
    write(inside.path(), "b.exr", &exr(61, &b));
    for (flags, epsilon, peak) in [("", 0.01, 1.0), (" --epsilon 0.5 --peak 4", 0.5, 4.0)] {
        let document = document_in(inside.path(), &format!("image diff a.exr b.exr{flags}"));
        assert_eq!(document["verdict"], "different");
        let channel =
            |pixels: &Pixels, c: usize| -> Vec<f32> { pixels.iter().map(|pixel| pixel[c]).collect() };
        let mut sides = vec![("/all", a.concat(), b.concat())];
        for (c, name) in ["/channels/r", "/channels/g", "/channels/b"].into_iter().enumerate() {
            sides.push((name, channel(&a, c), channel(&b, c)));
        }
        for (name, a, b) in &sides {
            let found = document.pointer(name).unwrap();
            let expected = figures(a, b, epsilon, peak);
            for (key, expected) in ["rmse", "relmse", "psnr_db"].into_iter().zip(expected) {
                close(&found[key], expected);
            }
            let error = |at: usize| (f64::from(a[at]) - f64::from(b[at])).abs();
            let largest = (0..a.len()).max_by(|x, y| error(*x).total_cmp(&error(*y))).unwrap();
            close(&found["max_error"], error(largest));
            let pixel = largest / (a.len() / (61 * 37));
            assert_eq!(found["max_error_pixel"], serde_json::json!([pixel % 61, pixel / 61]), "{name}");
            for (key, values) in [("mean_a", a), ("mean_b", b)] {
                close(&found[key], values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64);
            }
        }
    }
}

#[test]
fn png_and_exr_are_compared_in_linear_radiance() {
    let inside = folder();
    let codes: Vec<[u8; 3]> = (0..=255).map(|code| [code, 255 - code, 0]).collect();
    let linear = |code: u8| {
        let v = f64::from(code) / 255.0;
        (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32
    };
    write(inside.path(), "a.png", &png(16, &codes));
    write(inside.path(), "a.exr", &exr(16, &codes.iter().map(|pixel| pixel.map(linear)).collect()));
    let same = document_in(inside.path(), "image diff a.png a.exr");
    assert_eq!(
        (&same["verdict"], &same["a"]["format"], &same["b"]["format"]),
        (&"equal".into(), &"png".into(), &"exr".into()),
        "{same:#}"
    );
    // What render writes of one film, in both formats, differs by half a step of 8 bits at the most: 2.28 / 510.
    built_in(inside.path(), "gen:scan:20k", "scan.trex");
    for name in ["film.png", "film.exr --layers normal,albedo,depth,id"] {
        let line = format!("render scan.trex --integrator ao --resolution 64x48 --spp 3 -o {name}");
        document_in(inside.path(), &line);
    }
    let rounded = document_in(inside.path(), "image diff film.png film.exr");
    assert_eq!(rounded["b"]["channels"], "R G B");
    let largest = rounded["all"]["max_error"].as_f64().unwrap();
    assert!((1e-5..0.0046).contains(&largest), "{rounded:#}");
    close(&rounded["all"]["mean_b"], rounded["all"]["mean_b"].as_f64().unwrap());
}

#[test]
fn the_mean_is_that_of_the_render() {
    let inside = folder();
    built_in(inside.path(), "gen:scan:20k", "scan.trex");
    let drawn = document_in(
        inside.path(),
        "render scan.trex --resolution 64x48 --integrator direct --spp 3 -o film.exr",
    );
    let found = document_in(inside.path(), "image diff film.exr film.exr");
    for (c, name) in ["r", "g", "b"].into_iter().enumerate() {
        close(&found["channels"][name]["mean_a"], drawn["image"]["mean"][c].as_f64().unwrap());
    }
}

#[test]
fn the_threshold_decides_the_exit_status() {
    let inside = folder();
    // An error of 0.25 everywhere: RMSE 0.25, relMSE 0.0625 / 1.01, PSNR 12.04 dB.
    write(inside.path(), "a.exr", &exr(4, &vec![[1.25; 3]; 8]));
    write(inside.path(), "b.exr", &exr(4, &vec![[1.0; 3]; 8]));
    for (flags, code, verdict) in [
        ("--threshold 0.25", 0, "within"),
        ("--threshold 0.2499", 1, "beyond"),
        ("--threshold 0.062 --metric relmse", 0, "within"),
        ("--threshold 0.061 --metric relmse", 1, "beyond"),
        ("--threshold 12 --metric psnr", 0, "within"),
        ("--threshold 12.1 --metric psnr", 1, "beyond"),
        ("--threshold -3 --metric psnr", 0, "within"),
        // Both are white where they are shown.
        ("--threshold 0 --metric flip", 0, "within"),
    ] {
        let ran = diff(inside.path(), &format!("a.exr b.exr {flags}"));
        ran.expect(code);
        let document = ran.document();
        assert_eq!(
            (&document["verdict"], &document["threshold"]["is_kept"]),
            (&verdict.into(), &(code == 0).into())
        );
        let text = run_in(inside.path(), &format!("image diff a.exr b.exr {flags}"));
        text.expect(code);
        assert!(text.stdout.lines().last().unwrap().starts_with(verdict), "{}", text.stdout);
    }
    for metric in ["rmse", "relmse", "psnr", "flip"] {
        let ran = diff(inside.path(), &format!("a.exr a.exr --threshold 0 --metric {metric}"));
        ran.expect(0);
        let document = ran.document();
        assert_eq!(document["verdict"], "equal");
        assert_eq!((&document["all"]["rmse"], &document["all"]["psnr_db"]), (&0.0.into(), &Value::Null));
    }
}

/// FLIP is told where it is asked for, alone or as what the threshold holds.
#[test]
fn flip_tells_black_from_white() {
    let inside = folder();
    write(inside.path(), "black.exr", &exr(4, &vec![[0.0; 3]; 8]));
    write(inside.path(), "white.exr", &exr(4, &vec![[1.0; 3]; 8]));
    for (flags, code) in [("", 0), ("--flip", 0), ("--threshold 0.9 --metric flip", 1)] {
        let ran = diff(inside.path(), &format!("black.exr white.exr {flags}"));
        ran.expect(code);
        let flip = ran.document()["flip"].as_f64();
        assert_eq!(flip.is_some_and(|flip| (0.9..=1.0).contains(&flip)), !flags.is_empty(), "{flip:?}");
        let text = run_in(inside.path(), &format!("image diff black.exr white.exr {flags}"));
        assert_eq!(text.stdout.contains("FLIP 0.9"), !flags.is_empty(), "{}", text.stdout);
    }
}

#[test]
fn what_is_not_finite_is_told_and_left_out() {
    let inside = folder();
    let (mut a, mut b) = (vec![[1.0f32; 3]; 8], vec![[1.0f32; 3]; 8]);
    (a[1][0], a[2][2], b[2], b[5][1]) = (f32::NAN, f32::INFINITY, [f32::NAN; 3], f32::NEG_INFINITY);
    write(inside.path(), "a.exr", &exr(4, &a));
    write(inside.path(), "b.exr", &exr(4, &b));
    let ran = run_in(inside.path(), "image diff a.exr b.exr -o d.png");
    ran.expect(0);
    assert!(ran.stdout.contains("left out: 3 of 8 pixels, not finite (2 in A, 2 in B)"), "{}", ran.stdout);
    let document = document_in(inside.path(), "image diff a.exr b.exr");
    assert_eq!((&document["pixel_count"], &document["compared_pixel_count"]), (&8.into(), &5.into()));
    assert_eq!((&document["all"]["rmse"], &document["verdict"]), (&0.0.into(), &"different".into()));
    let (_, _, colours) = pixels(&inside.path().join("d.png"));
    let magenta: Vec<usize> = (0..8).filter(|at| colours[at * 3..][..3] == [255, 0, 255]).collect();
    assert_eq!(magenta, [1, 2, 5]);
    // Nothing left to compare: no figures, and no threshold is kept.
    write(inside.path(), "nan.exr", &exr(4, &vec![[f32::NAN; 3]; 8]));
    let ran = diff(inside.path(), "a.exr nan.exr --threshold 1e30");
    ran.expect(1);
    assert_eq!(ran.document()["all"]["rmse"], Value::Null);
    diff(inside.path(), "nan.exr nan.exr --threshold 0").expect(0);
}

#[test]
fn false_colours_state_their_scale() {
    let inside = folder();
    let ramp: Pixels = (0..200).map(|at| [at as f32 / 100.0; 3]).collect();
    write(inside.path(), "a.exr", &exr(20, &ramp));
    write(inside.path(), "b.exr", &exr(20, &vec![[0.0; 3]; 200]));
    let document = document_in(inside.path(), "image diff a.exr b.exr -o d.png");
    // 198 of the 200 errors are at most 1.97.
    close(&document["false_colour"]["scale_max"], f64::from(1.97f32));
    assert_eq!(document["false_colour"]["scale_percentile"], 99.0);
    let (width, height, colours) = pixels(&inside.path().join("d.png"));
    assert_eq!((width, height), (20, 10));
    assert_eq!((&colours[..3], &colours[199 * 3..]), (&[0x44, 0x01, 0x54][..], &[0xfd, 0xe7, 0x25][..]));
    let given = run_in(inside.path(), "image diff a.exr b.exr -o e.png --scale-max 4");
    given.expect(0);
    assert!(given.stdout.contains("viridis from 0 to 4"), "{}", given.stdout);
    let (_, _, darker) = pixels(&inside.path().join("e.png"));
    assert!(darker[199 * 3..] != colours[199 * 3..]);
}

#[test]
fn pictures_of_different_sizes_are_refused_by_name_and_numbers() {
    let inside = folder();
    write(inside.path(), "wide.exr", &exr(16, &vec![[1.0; 3]; 128]));
    write(inside.path(), "tall.png", &png(8, &[[1; 3]; 128]));
    let document = diff(inside.path(), "wide.exr tall.png -o d.png").expect_error(3, "input-mismatch");
    for part in ["wide.exr is 16x8", "tall.png is 8x16"] {
        assert!(document["numbers"].as_str().unwrap().contains(part), "{document:#}");
    }
    assert_eq!(listing(inside.path()).len(), 2);
}

#[test]
fn bad_pictures_are_refused_in_either_place() {
    let inside = folder();
    let (exr_file, png_file) = (exr(4, &vec![[1.0; 3]; 8]), png(4, &[[1; 3]; 8]));
    let with = |bytes: &[u8], at: usize, value: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + value.len()].copy_from_slice(value);
        bytes
    };
    let after = |name: &[u8]| exr_file.windows(name.len()).position(|w| w == name).unwrap() + name.len();
    // dataWindow: after its type and length, xMin and yMin, come xMax and yMax.
    let window = after(b"dataWindow\0box2i\0") + 4 + 8;
    let huge = [i32::to_le_bytes(60_000); 2].concat();
    let compression = after(b"compression\0compression\0") + 4;
    std::fs::create_dir(inside.path().join("folder.png")).unwrap();
    write(inside.path(), "good.exr", &exr_file);
    for (name, bytes, code) in [
        ("empty.exr", vec![], "input-empty"),
        ("mesh.exr", b"ply\nformat ascii 1.0\n".to_vec(), "input-format"),
        ("cut.exr", exr_file[..exr_file.len() - 5].to_vec(), "input-truncated"),
        ("head.exr", exr_file[..100].to_vec(), "input-truncated"),
        ("magic.exr", exr_file[..4].to_vec(), "input-truncated"),
        ("cut.png", png_file[..png_file.len() - 30].to_vec(), "input-truncated"),
        ("end.png", png_file[..png_file.len() - 6].to_vec(), "input-truncated"),
        ("crc.png", with(&png_file, 50, &[0xff]), "input-format"),
        ("huge.exr", with(&exr_file, window, &huge), "input-truncated"),
        ("beyond.exr", with(&exr_file, window, &[0xff, 0xff, 0xff, 0x1f]), "input-range"),
        ("dwa.exr", with(&exr_file, compression, &[8]), "input-format"),
        ("later.exr", with(&exr_file, 4, &[9]), "input-format"),
        ("letters.exr", with(&exr_file, after(b"chlist\0") + 4, b"X"), "input-format"),
        ("missing.exr", vec![], "input-unreadable"),
        ("folder.png", vec![], "input-unreadable"),
    ] {
        if code != "input-unreadable" {
            write(inside.path(), name, &bytes);
        }
        for line in [format!("{name} good.exr"), format!("good.exr {name}")] {
            // Sizes that lie are found before memory is asked for: the limit has no room for them.
            let document = diff(inside.path(), &format!("{line} --memory-limit 48MiB")).expect_error(3, code);
            assert!(document["where"].as_str().unwrap().contains(name), "{line}: {document:#}");
        }
    }
}
