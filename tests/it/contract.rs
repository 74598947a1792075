//! The documents of `--json`: the keys that scripts rely on, with their types (design, "The command"). Those of what
//! measures, `stress` and `bench`, are in `contract/measured.rs`.

mod compared;
mod measured;

use crate::command::{document_in, folder, listing, run_in};
use serde_json::Value;

/// What a key holds.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// A whole number, not negative.
    Count,
    /// Any finite number.
    Number,
    /// A number that may be null where it does not apply or the system does not tell.
    MaybeNumber,
    Text,
    Flag,
    /// Three finite numbers.
    Vec3,
    List,
    /// Not there yet: null, or a map.
    Later,
}
use Kind::*;

fn is(value: &Value, kind: Kind) -> bool {
    let finite = |value: &Value| value.as_f64().is_some_and(f64::is_finite);
    match kind {
        Count => value.is_u64(),
        Number => finite(value),
        MaybeNumber => value.is_null() || finite(value),
        Text => value.as_str().is_some_and(|text| !text.is_empty()),
        Flag => value.is_boolean(),
        Vec3 => value.as_array().is_some_and(|list| list.len() == 3 && list.iter().all(finite)),
        List => value.is_array(),
        Later => value.is_null() || value.is_object(),
    }
}

/// Checks `keys` of a document, `a.b` for nested ones, all violations at once. Checks that no key is written in
/// two ways, too: names are lower case.
#[track_caller]
fn check(document: &Value, schema: &str, keys: &[(&str, Kind)]) {
    let envelope = [("schema", Text), ("command", Text), ("version", Text)];
    let mut wrong = Vec::new();
    for (key, kind) in envelope.iter().chain(keys) {
        let found = document.pointer(&format!("/{}", key.replace('.', "/")));
        match found {
            Some(value) if is(value, *kind) => {}
            Some(value) => wrong.push(format!("{key} is {value}, expected is {kind:?}")),
            None => wrong.push(format!("{key} is missing")),
        }
    }
    assert!(wrong.is_empty(), "{schema}:\n{}\nin {document:#}", wrong.join("\n"));
    assert_eq!(document["schema"], schema);
    assert!(document["command"].as_str().unwrap().starts_with("trex "));
}

const MEMORY: [(&str, Kind); 3] = [
    ("memory.limit_bytes", Count),
    ("memory.ledger_peak_bytes", Count),
    ("memory.peak_rss_bytes", MaybeNumber),
];

fn with_memory(keys: &[(&'static str, Kind)]) -> Vec<(&'static str, Kind)> {
    keys.iter().copied().chain(MEMORY).collect()
}

const BUILD: [(&str, Kind); 36] = [
    ("scene", Text),
    ("result_hash", Text),
    ("input_triangle_count", Count),
    ("triangle_count", Count),
    ("rejected_degenerate", Count),
    ("rejected_collapsed", Count),
    ("rejected_non_finite", Count),
    ("cluster_count", Count),
    ("wide_cluster_count", Count),
    ("page_count", Count),
    ("emitter_count", Count),
    ("error_bound", Number),
    ("triangles_per_s", Number),
    ("triangles_per_s_without_source", Number),
    ("bytes_per_triangle", Number),
    ("vertex_cache_miss_rate", MaybeNumber),
    ("dropped_attribute_count", Count),
    ("skipped_face_count", Count),
    ("transparent_material_count", Count),
    ("phase_ms.generate", Count),
    ("phase_ms.scan", Count),
    ("phase_ms.partition", Count),
    ("phase_ms.clusters", Count),
    ("phase_ms.publish", Count),
    ("phase_ms.total", Count),
    ("phase_cpu_ms.scan", Count),
    ("phase_cpu_ms.partition", Count),
    ("phase_cpu_ms.clusters", Count),
    ("phase_cpu_ms.voxels", Count),
    ("phase_cpu_ms.publish", Count),
    ("phase_cpu_ms.total", Count),
    ("scratch_peak_bytes", Count),
    ("resumed_triangle_count", Count),
    ("resumed_sorted_count", Count),
    ("output_bytes", Count),
    ("cluster_fill", Number),
];

const INFO: [(&str, Kind); 34] = [
    ("scene", Text),
    ("file_id", Text),
    ("input_triangle_count", Count),
    ("triangle_count", Count),
    ("vertex_count", Count),
    ("cluster_count", Count),
    ("page_count", Count),
    ("material_count", Count),
    ("emitter_count", Count),
    ("file_bytes", Count),
    ("bytes_per_triangle.disk", Number),
    ("bytes_per_triangle.resident", Number),
    ("bytes_per_triangle.file", Number),
    ("section_bytes.mesh", Count),
    ("section_bytes.tree", Count),
    ("section_bytes.asvo_upper", Count),
    ("section_bytes.asvo_lower", Count),
    ("section_bytes.tables", Count),
    ("grid.step", Number),
    ("grid.origin", Vec3),
    ("grid.error_bound", Number),
    ("asvo", Later),
    ("bounds.lo", Vec3),
    ("bounds.hi", Vec3),
    ("rejected.degenerate", Count),
    ("rejected.collapsed", Count),
    ("rejected.non_finite", Count),
    ("smallest_limit_bytes", Count),
    ("smallest_limit_view_bytes", Count),
    ("shares.reserve_bytes", Count),
    ("shares.tables_bytes", Count),
    ("shares.film_bytes", Count),
    ("shares.staging_bytes", Count),
    ("shares.frames_bytes", Count),
];

const RENDER: [(&str, Kind); 37] = [
    ("scene", Text),
    ("output", Text),
    ("integrator", Text),
    ("light", Text),
    ("exposure", Number),
    ("spp", Count),
    ("rays.primary", Count),
    ("rays.mirror", Count),
    ("rays.shadow", Count),
    ("rays.gather", Count),
    ("rays_per_s.primary", Number),
    ("rays_per_s.mirror", Number),
    ("rays_per_s.shadow", Number),
    ("rays_per_s.gather", Number),
    ("rays_per_s.photon", Number),
    ("g_stage.batches", Number),
    ("g_stage.time_ns", Number),
    ("time_ms", Count),
    ("first_picture_ms", MaybeNumber),
    ("complete_ms", MaybeNumber),
    ("exact", Flag),
    ("damaged_pages", List),
    ("image.mean", Vec3),
    ("image.width", Count),
    ("image.height", Count),
    ("pool.hits", Count),
    ("pool.misses", Count),
    ("pool.evictions", Count),
    ("pool.bytes_read", Count),
    ("pool.refaults", Count),
    ("pool.pages_read", Count),
    ("shares.frames_bytes", Count),
    ("io_backend.backend", Text),
    ("io_backend.direct", Flag),
    ("io_backend.reason", Text),
    ("device", Text),
    ("arithmetic", Text),
];

const VERIFY: [(&str, Kind); 9] = [
    ("scene", Text),
    ("verdict", Text),
    ("level", Text),
    ("page_count", Count),
    ("triangle_count", Count),
    ("bytes_read", Count),
    ("damage_count", Count),
    ("damaged_triangle_count", Count),
    ("damage", List),
];

const FIGURES: [&str; 4] = ["all", "channels.r", "channels.g", "channels.b"];

const IMAGE_DIFF: [(&str, Kind); 29] = [
    ("scene", Text),
    ("a.path", Text),
    ("a.format", Text),
    ("a.channels", Text),
    ("b.path", Text),
    ("b.format", Text),
    ("b.channels", Text),
    ("image.width", Count),
    ("image.height", Count),
    ("unit", Text),
    ("relmse_epsilon", Number),
    ("psnr_peak", Number),
    ("flip", MaybeNumber),
    ("pixel_count", Count),
    ("compared_pixel_count", Count),
    ("non_finite_pixel_count.a", Count),
    ("non_finite_pixel_count.b", Count),
    ("threshold.metric", Text),
    ("threshold.limit", Number),
    ("threshold.value", MaybeNumber),
    ("threshold.is_kept", Flag),
    ("verdict", Text),
    ("false_colour.path", Text),
    ("false_colour.map", Text),
    ("false_colour.scale_min", Number),
    ("false_colour.scale_max", Number),
    ("false_colour.scale_percentile", MaybeNumber),
    ("all.max_error_pixel", List),
    ("time_ms", Count),
];

#[test]
fn documents_hold_what_scripts_rely_on() {
    let inside = folder();
    let inside = inside.path();
    let gen_keys = with_memory(&[
        ("scene", Text),
        ("output", Text),
        ("triangle_count", Count),
        ("output_bytes", Count),
        ("time_ms", Count),
        ("triangles_per_s", Number),
    ]);
    check(&document_in(inside, "gen pipes --triangles 20k -o plant.ply"), "trex.gen/1", &gen_keys);
    let mesh = [
        ("scene", Text),
        ("format", Text),
        ("encoding", Text),
        ("file_bytes", Count),
        ("face_count", Count),
        ("vertex_count", Count),
    ];
    check(&document_in(inside, "info plant.ply"), "trex.info/1", &mesh);
    let generated =
        [("scene", Text), ("triangle_count", Count), ("median_edge", Number), ("bounds.lo", Vec3)];
    check(&document_in(inside, "info gen:pipes:20k"), "trex.info/1", &generated);
    let built = document_in(inside, "build plant.ply -o plant.trex --voxels 64");
    check(&built, "trex.build/1", &with_memory(&BUILD));
    let info = document_in(inside, "info plant.trex");
    check(&info, "trex.info/1", &INFO);
    let verified = document_in(inside, "verify plant.trex");
    check(&verified, "trex.verify/1", &with_memory(&VERIFY));
    let rendered =
        document_in(inside, "render plant.trex -o plant.png --filter off --resolution 40x30 --spp 2");
    check(&rendered, "trex.render/1", &with_memory(&RENDER));
    let demo = document_in(inside, "demo --triangles 50k --resolution 16x16 --spp 1 -o demo.png");
    check(&demo, "trex.demo/1", &[("build.triangle_count", Count), ("render.image.mean", Vec3)]);

    document_in(inside, "render plant.trex -o other.png --resolution 40x30 --spp 1 --integrator ao");
    let line = "image diff plant.png other.png -o diff.png --threshold 9 --metric relmse";
    let compared = document_in(inside, line);
    check(&compared, "trex.image-diff/1", &with_memory(&IMAGE_DIFF));
    for figures in FIGURES {
        for key in ["rmse", "relmse", "psnr_db", "max_error", "mean_a", "mean_b"] {
            let found = compared.pointer(&format!("/{}/{key}", figures.replace('.', "/")));
            assert!(found.is_some_and(Value::is_number), "{figures}.{key} in {compared:#}");
        }
    }

    // The documents agree with each other and with the files.
    for (a, b) in [
        (&built["triangle_count"], &info["triangle_count"]),
        (&built["input_triangle_count"], &info["input_triangle_count"]),
        (&built["triangle_count"], &verified["triangle_count"]),
        (&built["page_count"], &info["page_count"]),
        (&built["page_count"], &verified["page_count"]),
        (&built["output_bytes"], &info["file_bytes"]),
        (&built["result_hash"], &info["file_id"]),
        (&built["error_bound"], &info["grid"]["error_bound"]),
        (&built["emitter_count"], &info["emitter_count"]),
        (&rendered["image"]["width"], &Value::from(40)),
        (&rendered["image"]["height"], &Value::from(30)),
        (&rendered["rays"]["primary"], &Value::from(40 * 30 * 2)),
        (&built["output_bytes"], &Value::from(listing(inside)["plant.trex"].0)),
    ] {
        assert_eq!(a, b, "{built:#}{info:#}");
    }
    let sections = info["section_bytes"].as_object().unwrap().values().map(|bytes| bytes.as_u64().unwrap());
    assert_eq!(sections.sum::<u64>(), info["file_bytes"].as_u64().unwrap());
    let count = |key: &str| built[key].as_u64().unwrap();
    let rejected = count("rejected_degenerate") + count("rejected_non_finite");
    assert_eq!(count("input_triangle_count"), count("triangle_count") + rejected);
}

/// Results on stdout, all else on stderr, in every mode of progress.
#[test]
fn streams_are_kept_apart() {
    let inside = folder();
    for mode in ["auto", "plain", "bar", "json", "none"] {
        let line = format!("build gen:soup:20k -o out.trex --no-asvo --overwrite --progress {mode}");
        let plain = run_in(inside.path(), &line);
        plain.expect(0);
        assert!(plain.stdout.contains("triangles in"), "{mode}: {}", plain.stdout);
        assert!(!plain.stdout.contains("plan:"), "{mode}: {}", plain.stdout);
        assert!(plain.stderr.contains("plan:"), "{mode}: {}", plain.stderr);
        let json = run_in(inside.path(), &format!("{line} --json"));
        json.expect(0);
        assert_eq!(json.document()["schema"], "trex.build/1", "{mode}");
        let quiet = run_in(inside.path(), &format!("{line} -q"));
        assert!(quiet.stderr.is_empty(), "{mode}: {}", quiet.stderr);
        if mode == "json" {
            let lines = plain.stderr.lines().filter(|line| line.starts_with('{'));
            lines.for_each(|line| assert!(serde_json::from_str::<Value>(line).is_ok(), "{line}"));
        }
    }
}

/// `-o` without an ending, odd names, spaces: paths are bytes.
#[test]
fn odd_names_are_names() {
    let inside = folder();
    for name in ["no-ending", "-dash.trex", "späße.trex", "a b.trex"] {
        let build = std::process::Command::new(crate::command::TREX)
            .args(["build", "gen:soup:10k", "--no-asvo", "-q", "--output"])
            .arg(format!("./{name}"))
            .current_dir(inside.path())
            .status()
            .unwrap();
        assert!(build.success(), "{name}");
        assert!(inside.path().join(name).exists(), "{name}");
    }
}
