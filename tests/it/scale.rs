//! `trex bench scale`: models of rising size, and how each cost grows.

use crate::command::{document_in, folder, run_in};
use serde_json::Value;

const LINE: &str = "bench scale gen:isosurface:10k gen:isosurface:50k -o scale --switches 2 --resolution 64x48 \
                    --views-limit 128MiB";

/// The costs of each model.
fn costs(document: &Value) -> &Vec<Value> {
    document["points"].as_array().unwrap()
}

#[test]
fn costs_are_those_of_the_commands_and_exponents_those_of_the_costs() {
    let inside = folder();
    let first = document_in(inside.path(), LINE);
    assert_eq!(first["schema"], "trex.bench-scale/1");
    let [small, large] = &costs(&first)[..] else { panic!("{first:#}") };
    for (cost, model) in [(small, "gen:isosurface:10k"), (large, "gen:isosurface:50k")] {
        // What does not depend on the time of day: the file that the same model makes.
        document_in(inside.path(), &format!("build {model} -o same.trex --overwrite --render-limit 128MiB"));
        let info = document_in(inside.path(), "info same.trex");
        assert_eq!(cost["model"], model);
        assert_eq!(cost["triangle_count"], info["triangle_count"]);
        assert_eq!(cost["file_bytes"], info["file_bytes"]);
        for key in
            ["build_ms", "start_ms", "whole_p50_ms", "primary_per_s", "shadow_per_s", "incoherent_per_s"]
        {
            assert!(cost[key].as_f64().is_some_and(|number| number > 0.0), "{key}: {cost:#}");
        }
        assert!(cost["views_peak_rss_bytes"].as_u64().unwrap() <= 128 << 20, "{cost:#}");
    }
    let logarithm = |of: &Value, key: &str| of[key].as_f64().unwrap().ln();
    for key in ["file_bytes", "build_ms", "start_ms", "primary_per_s"] {
        let rise = |key| logarithm(large, key) - logarithm(small, key);
        let expected = rise(key) / rise("triangle_count");
        let told = first["exponents"][key]["exponent"].as_f64().unwrap();
        assert!((told - expected).abs() < 1e-9, "{key}: {told}, by two points {expected}");
    }
    let svg = std::fs::read_to_string(inside.path().join("scale/scale.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("build_ms"));
    assert!(!inside.path().join("scale/model.trex").exists(), "the folder keeps no model");

    // Nothing is measured twice, and a model may come later: here a page file, which is taken as it is.
    let more = document_in(inside.path(), &LINE.replace(" -o", " same.trex -o"));
    let [small_again, large_again, file] = &costs(&more)[..] else { panic!("{more:#}") };
    assert_eq!([small_again, large_again], [small, large]);
    assert_eq!((&file["file_bytes"], &file["build_ms"]), (&large["file_bytes"], &Value::Null));
    assert!(inside.path().join("same.trex").exists());
    run_in(inside.path(), &format!("{LINE} --rounds 2 --json")).expect_error(3, "input-mismatch");
}

#[test]
fn models_that_the_limit_refuses_are_told() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:50k -o small.trex --voxels 64");
    document_in(inside.path(), "build gen:isosurface:50k -o large.trex --voxels 512");
    let line =
        "bench scale small.trex large.trex -o scale --switches 1 --resolution 32x24 --views-limit 33MiB";
    let told = document_in(inside.path(), line);
    for cost in costs(&told) {
        assert!(cost["refused"].as_str().is_some_and(|why| why.contains("limit")), "{cost:#}");
        assert!(cost["file_bytes"].is_null(), "{cost:#}");
    }
    assert!(told["exponents"].as_object().unwrap().is_empty());

    // One that is refused takes nothing from one that is measured.
    let told = document_in(inside.path(), &line.replace("33MiB", "48MiB").replace("-o scale", "-o other"));
    let [small, large] = &costs(&told)[..] else { panic!("{told:#}") };
    assert!(small["refused"].is_null() && small["whole_p50_ms"].as_f64().unwrap() > 0.0, "{small:#}");
    assert!(large["refused"].as_str().is_some_and(|why| why.contains("limit")), "{large:#}");
    assert!(told["exponents"].as_object().unwrap().is_empty());
    run_in(inside.path(), "bench scale nowhere.trex -o nowhere --json").expect_error(3, "input-unreadable");
}
