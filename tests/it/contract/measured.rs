//! The documents of `trex stress` and `trex bench`: their keys and types, and that their figures agree with each other.

use super::Kind::{self, Count, Flag, List, MaybeNumber, Number, Text};
use super::{check, with_memory};
use crate::command::{document_in, folder};
use crate::fixtures::built_in;
use serde_json::Value;

/// Figures are rounded where they are printed, some of them to a thousandth.
const ROUNDING: f64 = 0.01;

const STRESS: [(&str, Kind); 45] = [
    ("scene", Text),
    ("integrator", Text),
    ("resolution", List),
    ("n_shadow", Count),
    ("n_gather", Count),
    ("t_max_ms", Number),
    ("fetch_block", Count),
    ("reference_spp", MaybeNumber),
    ("scenario", Text),
    ("triangle_count", Count),
    ("file_bytes", Count),
    ("resident_pages.mesh", Count),
    ("resident_pages.units", Count),
    ("switches", Count),
    ("look_ups_per_s", Number),
    ("time_ms", Count),
    ("block_tiles", Number),
    ("response_share", Number),
    ("light_share_at_300", MaybeNumber),
    ("error_floor.flip", Number),
    ("requirements", List),
    ("per_switch", List),
    ("coverage", MaybeNumber),
    ("holes", Count),
    ("stalls", Count),
    ("livelock", Flag),
    ("narrow_samples", Count),
    ("refault_ratio", Number),
    ("first_touch_misses", Number),
    ("bytes_read", Count),
    ("g_stage.batches", Number),
    ("g_stage.shadow", Number),
    ("g_stage.gather", Number),
    ("g_stage.far", Number),
    ("g_stage.bytes_in", Number),
    ("g_stage.bytes_out", Number),
    ("g_stage.time_ns", Number),
    ("g_stage.queue_peak", Number),
    ("pixel_error.asked", Number),
    ("pixel_error.worst", Number),
    ("memory_slope_bytes", MaybeNumber),
    ("failures", List),
    ("io_backend.backend", Text),
    ("io_backend.direct", Flag),
    ("io_backend.reason", Text),
];

const POOL: [&str; 7] = ["hits", "misses", "evictions", "bytes_read", "refaults", "pages_read", "pages"];
const RAY_KINDS: [&str; 5] = ["primary", "mirror", "shadow", "gather", "photon"];
const TIMES: [&str; 7] =
    ["first_picture_ms", "rough_ms", "whole_ms", "response_ms", "complete_ms", "converged_ms", "frame_ms"];

const BENCH_RAYS: [(&str, Kind); 13] = [
    ("scene", Text),
    ("seed", Count),
    ("result_hash", Text),
    ("triangle_count", Count),
    ("thread_count", Count),
    ("round_count", Count),
    ("resolution", List),
    ("arithmetic", Text),
    ("pages", Text),
    ("resident_bytes", Count),
    ("resident_bytes_per_triangle", Number),
    ("voxel_resolution", Count),
    ("peer", MaybeNumber),
];

const BENCH_BUILD: [(&str, Kind); 10] = [
    ("scene", Text),
    ("result_hash", Text),
    ("triangle_count", Count),
    ("thread_count", Count),
    ("round_count", Count),
    ("triangles_per_s", Number),
    ("triangles_with_source_per_s", Number),
    ("output_bytes", Count),
    ("bytes_per_triangle", Number),
    ("scratch_peak_bytes", Count),
];

const BENCH_IO: [(&str, Kind); 8] = [
    ("scene", Text),
    ("seed", Count),
    ("file_bytes", Count),
    ("page_count", Count),
    ("bytes_per_page", Number),
    ("triangles_per_page", Number),
    ("thread_count", Count),
    ("round_count", Count),
];

/// Phases of a build, in the order of their work.
const PHASES: [&str; 4] = ["generate", "partition", "clusters", "publish"];

/// The keys of an object below `parent`, each of one kind.
fn below(parent: &str, keys: &[&str], kind: Kind) -> Vec<(String, Kind)> {
    keys.iter().map(|key| (format!("{parent}.{key}"), kind)).collect()
}

/// [`check`] with the envelope, these keys, the memory, and what stands below others.
#[track_caller]
fn check_all(document: &Value, schema: &str, keys: &[(&'static str, Kind)], nested: &[(String, Kind)]) {
    let mut all: Vec<(&str, Kind)> = with_memory(keys);
    all.extend(nested.iter().map(|(key, kind)| (key.as_str(), *kind)));
    check(document, schema, &all);
}

#[track_caller]
pub(super) fn number(document: &Value, pointer: &str) -> f64 {
    let found = document.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number at {pointer} in {document:#}"))
}

/// Equal up to `share` of the greater.
#[track_caller]
pub(super) fn near(a: f64, b: f64, share: f64, document: &Value) {
    assert!((a - b).abs() <= share * a.abs().max(b.abs()), "{a} and {b} in {document:#}");
}

/// Only these keys are there: what a document gains is told here too, in the open.
#[track_caller]
fn has_only(object: &Value, keys: &[&str]) {
    let mut found: Vec<&str> = object.as_object().unwrap().keys().map(String::as_str).collect();
    let mut keys = keys.to_vec();
    found.sort_unstable();
    keys.sort_unstable();
    assert_eq!(found, keys, "{object:#}");
}

#[test]
fn stress_tells_times_rays_and_a_verdict() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    // With nothing to be decided, or the pool would have been read before the first switch.
    let flags = "--resolution 64x48 --photons 5k --memory-limit 128MiB --switches 4 --hold 80 --t-max 50 \
                 --reference-spp 2 --exposure 1 --light scene";
    let document = document_in(inside.path(), &format!("stress iso.trex --scenario flip {flags}"));
    let mut nested: Vec<(String, Kind)> = Vec::new();
    for key in TIMES {
        nested.extend(below(key, &["count"], Count));
        nested.extend(below(key, &["mean", "p50", "p99", "max"], Number));
    }
    nested.extend(below("rays", &RAY_KINDS, Count));
    nested.extend(below("rays_per_s", &RAY_KINDS, Number));
    nested.extend(below("pool", &POOL, Count));
    nested.push(("verdict".into(), Text));
    check_all(&document, "trex.stress/1", &STRESS, &nested);

    let at = |pointer: &str| number(&document, pointer);
    assert_eq!((at("/switches"), at("/resolution/0"), at("/resolution/1")), (4.0, 64.0, 48.0));
    assert_eq!((document["scenario"].as_str(), at("/t_max_ms")), (Some("flip"), 50.0));
    for key in TIMES {
        let of = |part: &str| at(&format!("/{key}/{part}"));
        assert!(of("p50") <= of("p99") && of("p99") <= of("max") && of("mean") <= of("max"), "{document:#}");
        assert_eq!(of("count") > 0.0, of("max") > 0.0, "{key} of {document:#}");
        has_only(&document[key], &["count", "mean", "p50", "p99", "max"]);
    }
    // Every switch has a first picture, a whole one and a response; a view that is left early has no exact one.
    for key in ["first_picture_ms", "rough_ms", "whole_ms", "response_ms"] {
        assert_eq!(at(&format!("/{key}/count")), 4.0, "{key} of {document:#}");
    }
    assert!(at("/rough_ms/p50") <= at("/whole_ms/p50") && at("/whole_ms/p50") <= at("/response_ms/p50"));
    assert_eq!(at("/converged_ms/count"), 0.0, "no light has changed");
    assert_eq!(at("/whole_steps/2"), 4.0);
    near(at("/response_share") * 48.0, at("/block_tiles"), ROUNDING, &document);
    let lines = document["per_switch"].as_array().unwrap();
    assert_eq!(lines.len(), 4);
    let longest = lines.iter().map(|line| line["whole_ms"].as_f64().unwrap()).fold(0.0, f64::max);
    near(longest, at("/whole_ms/max"), ROUNDING, &document);
    // Errors of what was on show, which are there for as long as a view was held.
    for error in ["/error_at_ms/33", "/error_at_ms/33/flip"] {
        let [median, max] = ["median", "max"].map(|key| at(&format!("{error}/{key}")));
        assert!(max > 0.0 && median <= max, "{error} of {document:#}");
    }
    assert!(document["drag"].is_null() && at("/error_floor/relmse") > 0.0);
    assert!(at("/complete_ms/count") <= 4.0 && at("/frame_ms/count") >= 4.0);
    has_only(&document["rays"], &RAY_KINDS);
    for kind in RAY_KINDS {
        let seconds = at("/time_ms") / 1e3;
        // Whole milliseconds of a run that takes some tens of them.
        let rounding = 1.5 / at("/time_ms");
        near(at(&format!("/rays_per_s/{kind}")) * seconds, at(&format!("/rays/{kind}")), rounding, &document);
    }
    assert!(at("/rays/primary") > 0.0 && at("/rays/shadow") > 0.0 && at("/rays/gather") > 0.0);
    assert_eq!(at("/bytes_read"), at("/pool/bytes_read"));
    near(at("/refault_ratio") * at("/pool/pages_read").max(1.0), at("/pool/refaults"), ROUNDING, &document);
    assert!(at("/pixel_error/worst") >= at("/pixel_error/asked"));
    let passed = document["failures"].as_array().unwrap().is_empty();
    assert_eq!(document["verdict"], if passed { "pass" } else { "fail" });
    assert!(at("/memory/ledger_peak_bytes") <= at("/memory/limit_bytes"));
}

#[test]
fn bench_rays_tells_its_sets() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    let document = document_in(inside.path(), "bench rays iso.trex --resolution 64x48 --rounds 2");
    let mut nested: Vec<(String, Kind)> = Vec::new();
    let sets = ["primary", "shadow", "incoherent", "gray", "gray_shadow"];
    for set in sets {
        nested.extend(below(set, &["ray_count", "hit_count"], Count));
        nested.extend(below(set, &["per_s", "per_core_s"], Number));
        nested.extend(below(set, &["ratio"], MaybeNumber));
    }
    for set in ["primary", "shadow"] {
        nested.extend(below(&format!("{set}.single"), &["per_s", "per_core_s"], Number));
    }
    for set in ["gray", "gray_shadow"] {
        nested.extend(below(
            &format!("{set}.against_mesh"),
            &["false_hit_share", "false_miss_share"],
            Number,
        ));
    }
    check_all(&document, "trex.bench-rays/1", &BENCH_RAYS, &nested);

    let at = |pointer: &str| number(&document, pointer);
    assert_eq!((at("/resolution/0"), at("/resolution/1"), at("/round_count")), (64.0, 48.0, 2.0));
    assert_eq!(at("/primary/ray_count"), 64.0 * 48.0);
    for set in sets {
        let [rays, hits] = ["ray_count", "hit_count"].map(|key| at(&format!("/{set}/{key}")));
        assert!(hits <= rays && rays > 0.0, "{set} of {document:#}");
        assert!(at(&format!("/{set}/per_s")) > 0.0 && at(&format!("/{set}/per_core_s")) > 0.0);
        assert!(document[set]["ratio"].is_null(), "a ratio to nobody: {document:#}");
    }
    let per_triangle = at("/resident_bytes") / at("/triangle_count");
    near(at("/resident_bytes_per_triangle"), per_triangle, ROUNDING, &document);
    assert!(document["peer"].is_null());
}

/// Visits per ray are those of a tree: each level adds up, and the reference has neither top nor clusters.
#[test]
fn bench_rays_counts_visits_when_asked() {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k", "pipes.trex");
    let line = "bench rays pipes.trex --resolution 64x48 --rounds 1 --stats";
    let [document, again] = [1, 2].map(|_| document_in(inside.path(), line));
    assert_eq!(document["visits"], again["visits"], "counts that time changes");
    for tree in ["ours", "reference"] {
        let at = |key: String| number(&document, &format!("/visits/{tree}/{key}"));
        for set in ["primary", "shadow", "incoherent"] {
            let [top, node, cluster, leaf, total] =
                ["top", "node", "cluster", "leaf", "total"].map(|level| at(format!("{set}/{level}")));
            near(total, top + node + cluster + leaf, ROUNDING, &document);
            assert!(total >= 1.0 && leaf > 0.0, "{document:#}");
            assert_eq!(tree == "reference", top + cluster == 0.0, "{document:#}");
        }
        assert!(at("sah_cost".into()) > 1.0 && (1.0..=8.0).contains(&at("leaf_triangles".into())));
    }
    let of = |tree: &str| number(&document, &format!("/visits/{tree}/incoherent/total"));
    assert!(of("ours") < 3.0 * of("reference"), "{document:#}");
}

#[test]
fn bench_io_tells_every_way() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    let document = document_in(inside.path(), "bench io iso.trex --depth 1,4 --rounds 2");
    let names = ["uring", "uring_cached", "pread", "mmap", "hashed", "traceable", "ready"];
    let ways: Vec<String> =
        [1, 4].iter().flat_map(|depth| names.map(|name| format!("{name}_{depth}"))).collect();
    let mut nested = Vec::new();
    for way in &ways {
        let keys = ["pages_per_s", "bytes_per_s", "triangles_per_s", "cpu_us_per_page"];
        nested.extend(below(&format!("ways.{way}"), &keys, Number));
        nested.extend(below(&format!("ways.{way}"), &["backend", "stage"], Text));
        nested.extend(below(&format!("ways.{way}"), &["direct"], Flag));
        nested.extend(below(&format!("ways.{way}"), &["depth"], Count));
        nested.extend(below(&format!("ways.{way}"), &["of_fio"], MaybeNumber));
        if way.starts_with("ready") || way.starts_with("traceable") {
            nested.extend(below(&format!("ways.{way}"), &["latency_us"], MaybeNumber));
        } else {
            nested.extend(below(&format!("ways.{way}.latency_us"), &["p50", "p99", "p999", "max"], Count));
        }
    }
    check_all(&document, "trex.bench-io/1", &BENCH_IO, &nested);
    let bytes_per_page = number(&document, "/bytes_per_page");
    for way in &ways {
        let at = |key: &str| number(&document, &format!("/ways/{way}/{key}"));
        near(at("bytes_per_s") / at("pages_per_s"), bytes_per_page, ROUNDING, &document);
        let way = &document["ways"][way];
        assert!(at("cpu_us_per_page") > 0.0 && way["of_fio"].is_null(), "{way:#}");
        let is_one_by_one = way["stage"] != "ready" && way["stage"] != "traceable";
        assert_eq!(way["latency_us"].is_null(), !is_one_by_one, "{way:#}");
    }
}

#[test]
fn bench_build_tells_its_phases() {
    let inside = folder();
    let document = document_in(inside.path(), "bench build gen:pipes:20k --rounds 2");
    let mut nested = below("phase_ms", &PHASES, Number);
    nested.extend(below("phase_ms", &["total"], Number));
    check_all(&document, "trex.bench-build/1", &BENCH_BUILD, &nested);
    let at = |pointer: &str| number(&document, pointer);
    assert_eq!((at("/round_count"), at("/memory/ledger_peak_bytes") > 0.0), (2.0, true));
    assert!(at("/triangles_per_s") >= at("/triangles_with_source_per_s"), "{document:#}");
    near(at("/bytes_per_triangle"), at("/output_bytes") / at("/triangle_count"), ROUNDING, &document);
    let total = at("/phase_ms/total");
    assert!(PHASES.iter().all(|phase| (0.0..=total).contains(&at(&format!("/phase_ms/{phase}")))));
    // The same model, built by the verb for it.
    let built = document_in(inside.path(), "build gen:pipes:20k -o pipes.trex --no-asvo");
    for key in ["result_hash", "triangle_count", "output_bytes"] {
        assert_eq!(document[key], built[key], "{key}");
    }
}
