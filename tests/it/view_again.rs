//! `trex view` before there is a model, and when that changes: pages wait and are told, and see it again from where
//! they were.

use crate::command::{document_in, folder, run_in};
use crate::view::{ViewProcess, say, text_until};
use serde_json::{Value, json};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};
use tungstenite::WebSocket;

/// Longest wait for what has to come.
const PATIENCE: Duration = Duration::from_secs(120);

/// Writes a mesh of another seed in the place of `mesh.ply`.
fn write_mesh(inside: &Path, triangles: &str, seed: u32) {
    let line = format!("gen isosurface --triangles {triangles} --seed {seed} -o mesh.ply --overwrite");
    document_in(inside, &line);
}

/// The welcome, and what pages were told before it: nothing but waits.
fn welcome_after_waits(viewing: &ViewProcess) -> (Value, Vec<Value>) {
    let told = viewing.told_after_waits(|text| text["type"] == "welcome");
    assert!(told.1.iter().all(|text| text["type"] == "waiting"), "{:?}", told.1);
    told
}

/// A page that drives: the one before may not have been missed yet.
fn driver(viewing: &ViewProcess) -> WebSocket<TcpStream> {
    let mut page = viewing.page();
    loop {
        let text = text_until(&mut page, |text| text["role"].is_string() || text["type"] == "notice");
        if text["role"] == "drive" {
            return page;
        }
        std::thread::sleep(Duration::from_millis(50));
        say(&mut page, &json!({"type": "drive"}));
    }
}

#[test]
fn a_page_is_told_how_far_the_build_is() {
    let inside = folder();
    write_mesh(inside.path(), "400k", 1);
    let viewing = ViewProcess::start(inside.path(), "mesh.ply --quiet --spp 1 --memory-limit 256MiB");
    let (welcome, waits) = welcome_after_waits(&viewing);
    // A share of a phase, and words that tell which.
    let phases: Vec<&str> = waits.iter().map(|text| text["text"].as_str().unwrap()).collect();
    assert!(phases.iter().any(|text| text.contains("triangles")), "{phases:?}");
    let shares = waits.iter().filter_map(|text| text["share"].as_f64());
    assert!(
        shares.clone().count() > 0 && shares.clone().all(|share| (0.0..1.0).contains(&share)),
        "{waits:?}"
    );
    assert!(welcome["model"]["triangle_count"].as_u64().unwrap() > 300_000, "{welcome}");
    let ran = viewing.end();
    ran.expect(0);
    assert_eq!(ran.document()["shows"], 1);
}

/// The limit that a viewer names does, also where a build comes first and pages wait for it.
#[test]
fn pages_that_wait_do_not_raise_the_smallest_limit() {
    let inside = folder();
    write_mesh(inside.path(), "20k", 1);
    let line = "mesh.ply --no-open --json --quiet";
    let refused = run_in(inside.path(), &format!("view {line} --memory-limit 1MiB"));
    let smallest = refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
    let viewing = ViewProcess::start(inside.path(), &format!("mesh.ply --quiet --memory-limit {smallest}B"));
    let (begin, built) = (Instant::now(), inside.path().join("mesh.ply.trex"));
    while !built.exists() && begin.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(built.exists());
    let ran = viewing.end();
    // A picture may need more than the build.
    assert!([Some(0), Some(4), Some(130)].contains(&ran.code), "{:?}: {}", ran.code, ran.stderr);
}

/// Another mesh in the place of the first: from the same camera, under the same lights, with the edits of materials.
#[test]
fn a_model_that_changes_is_seen_again_from_where_it_was_looked_at() {
    let inside = folder();
    write_mesh(inside.path(), "20k", 1);
    let viewing = ViewProcess::start(inside.path(), "mesh.ply --quiet --spp 1 --watch --memory-limit 256MiB");
    let (first, _) = welcome_after_waits(&viewing);
    let camera = json!({
        "type": "camera", "seq": 1, "position": [3.0, 2.5, 2.0], "target": [0.5, 0.5, 0.5], "up": [0.0, 0.0, 1.0],
        "fov_y": 40.0
    });
    let looks_so = |seen: &Value| ["position", "target", "fov_y"].iter().all(|key| seen[key] == camera[key]);
    let mut page = driver(&viewing);
    say(&mut page, &camera);
    // A picture of it has been drawn.
    text_until(&mut page, |text| text["command"].as_str().is_some_and(|line| line.contains("--fov-y 40")));
    write_mesh(inside.path(), "30k", 2);
    // The page loses its server.
    while page.read().is_ok() {}
    let (second, _) = welcome_after_waits(&viewing);
    let counts = [&first, &second].map(|welcome| welcome["model"]["triangle_count"].as_u64().unwrap());
    assert!(counts[1] > counts[0] + 5000, "{counts:?}");
    assert!(looks_so(&second["camera"]), "{}", second["camera"]);
    // What makes the picture is still the mesh's page file.
    let mut page = driver(&viewing);
    let light = json!({"type": "point", "position": [1.0, 1.0, 9.0], "intensity": [90.0, 90.0, 90.0]});
    say(&mut page, &json!({"type": "lights", "seq": 2, "lights": [light]}));
    text_until(&mut page, |text| text["command"].as_str().is_some_and(|line| line.contains("view.toml")));
    // A mesh that is none is told, and waited for.
    std::fs::write(inside.path().join("mesh.ply"), "ply\nformat ascii 1.0\nend_header\n").unwrap();
    while page.read().is_ok() {}
    let (told, _) =
        viewing.told_after_waits(|text| text["text"].as_str().is_some_and(|text| text.contains("change")));
    assert!(told["text"].as_str().unwrap().contains("mesh.ply"), "{told}");
    write_mesh(inside.path(), "20k", 3);
    let (last, _) = welcome_after_waits(&viewing);
    assert!(looks_so(&last["camera"]) && last["lights"] == json!([light]), "{last}");
    assert_eq!(last["command"], "trex render view.toml -o picture.png");
    let ran = viewing.end();
    ran.expect(0);
    assert_eq!(ran.document()["shows"], 3);
}

/// The command ended with the mistake.
#[test]
fn a_mistake_in_a_scene_is_waited_for() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:10k -o m.trex");
    let write = |text: &str| std::fs::write(inside.path().join("s.toml"), text).unwrap();
    write("model = 'm.trex'\n");
    let viewing = ViewProcess::start(inside.path(), "s.toml --quiet --spp 1 --watch --memory-limit 256MiB");
    welcome_after_waits(&viewing);
    let mut page = driver(&viewing);
    write("model = 'm.trex'\n[camra]\n");
    while page.read().is_ok() {}
    let is_told = |text: &Value| text["text"].as_str().is_some_and(|text| text.contains("camra"));
    viewing.told_after_waits(is_told);
    write("model = 'm.trex'\n[camera]\nposition = [9, 9, 9]\ntarget = [0, 0, 0]\n");
    welcome_after_waits(&viewing);
    let ran = viewing.end();
    ran.expect(0);
    assert_eq!(ran.document()["shows"], 2);
}

/// With a section, or a hidden material, nothing of a scene's file was seen again.
#[test]
fn lights_of_a_scene_count_beside_sections() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:10k -o m.trex");
    let write = |bright: u32, parts: &str| {
        let light = format!("[[light]]\ntype = 'sky'\nradiance = [{bright}, 0, 0]\n");
        std::fs::write(inside.path().join("s.toml"), format!("model = 'm.trex'\n{light}{parts}")).unwrap();
    };
    let cut = |height: f64| format!("[parts]\nsection = [[0.5, 0.5, {height}, 0.0, 0.0, -1.0]]\n");
    write(1, &cut(0.5));
    let viewing = ViewProcess::start(inside.path(), "s.toml --quiet --spp 1 --watch --memory-limit 256MiB");
    let seen = |welcome: &Value| {
        let heights = welcome["parts"]["section"].as_array().unwrap().iter().map(|plane| plane[2].clone());
        (welcome["lights"][0]["radiance"][0].clone(), heights.collect::<Vec<_>>())
    };
    assert_eq!(seen(&welcome_after_waits(&viewing).0), (json!(1.0), vec![json!(0.5)]));
    // Sections of the file count as its lights do.
    let mut page = driver(&viewing);
    write(2, &cut(0.25));
    while page.read().is_ok() {}
    assert_eq!(seen(&welcome_after_waits(&viewing).0), (json!(2.0), vec![json!(0.25)]));
    // Those of the page stay, and lights are still the file's.
    let mut page = driver(&viewing);
    let section = json!([[0.5, 0.5, 0.75, 0.0, 0.0, -1.0]]);
    say(&mut page, &json!({"type": "parts", "seq": 1, "parts": {"section": section}}));
    text_until(&mut page, |text| text["parts"]["section"][0][2] == json!(0.75));
    write(3, "");
    while page.read().is_ok() {}
    assert_eq!(seen(&welcome_after_waits(&viewing).0), (json!(3.0), vec![json!(0.75)]));
    viewing.end().expect(0);
}

/// A library of materials that was saved again was neither seen by `--watch`, nor did the next view build anew.
#[test]
fn what_a_mesh_names_counts_as_the_mesh() {
    let inside = folder();
    let paint = |kd: f64| {
        std::fs::write(inside.path().join("m.mtl"), format!("newmtl paint\nKd {kd} 0 0\n")).unwrap()
    };
    let mesh = "# a roof\nmtllib m.mtl\no roof\nv 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 0\nusemtl paint\nf 1 2 3\nf 1 3 4\n";
    std::fs::write(inside.path().join("m.obj"), mesh).unwrap();
    paint(0.25);
    let line = "m.obj --quiet --spp 1 --memory-limit 256MiB";
    let seen = |page: &mut WebSocket<TcpStream>| {
        say(page, &json!({"type": "materials", "id": 1, "find": "paint", "from": 0}));
        text_until(page, |text| text["type"] == "materials")["items"][0]["kd"][0].clone()
    };
    let viewing = ViewProcess::start(inside.path(), &format!("{line} --watch"));
    welcome_after_waits(&viewing);
    let mut page = driver(&viewing);
    assert_eq!(seen(&mut page), json!(0.25));
    paint(0.5);
    while page.read().is_ok() {}
    welcome_after_waits(&viewing);
    assert_eq!(seen(&mut driver(&viewing)), json!(0.5));
    viewing.end().expect(0);
    // Times of files are as coarse as the clock of the kernel.
    std::thread::sleep(Duration::from_millis(20));
    paint(0.75);
    let viewing = ViewProcess::start(inside.path(), line);
    welcome_after_waits(&viewing);
    assert_eq!(seen(&mut driver(&viewing)), json!(0.75));
    viewing.end().expect(0);
}

/// What waits for a screenshot is done at once: the camera of before was told with the settings that came with the new
/// one, and the hand's page went back to it.
#[test]
fn settings_are_told_with_the_camera_that_came_with_them() {
    let inside = folder();
    document_in(inside.path(), "build gen:isosurface:10k -o m.trex");
    let viewing = ViewProcess::start(inside.path(), "m.trex --quiet --spp 1 --memory-limit 256MiB");
    welcome_after_waits(&viewing);
    let mut page = driver(&viewing);
    say(&mut page, &json!({"type": "screenshot", "id": 1, "format": "png", "size": [320, 240], "spp": 16}));
    text_until(&mut page, |text| text["type"] == "progress");
    let camera = json!({
        "type": "camera", "seq": 2, "position": [3.0, 2.5, 2.0], "target": [0.5, 0.5, 0.5], "up": [0.0, 0.0, 1.0],
        "fov_y": 40.0
    });
    say(&mut page, &json!({"type": "settings", "seq": 1, "settings": {"exposure": 2.0}}));
    say(&mut page, &camera);
    let told = text_until(&mut page, |text| text["settings"]["exposure"] == json!(2.0));
    assert_eq!((&told["camera"]["position"], &told["seq"]), (&camera["position"], &json!(2)), "{told}");
    viewing.end().expect(0);
}

#[test]
fn what_does_not_change_is_not_watched() {
    let inside = folder();
    for line in ["gen:soup:1k --watch", "http://127.0.0.1:1/model.trex --watch"] {
        run_in(inside.path(), &format!("view {line} --no-open --json")).expect_error(2, "usage");
    }
}
