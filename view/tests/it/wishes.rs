//! What pages ask for: edits, sizes, picks, screenshots, the wheel.

use crate::client::{Came, Page};
use crate::stage::{Play, PlayModel, SIZE, Server, keys, rendered};
use crate::stream::camera;
use serde_json::json;
use std::time::Duration;
use trex_render::{Exposure, Method, RenderKeys};

#[test]
fn edits_are_seen_by_those_who_watch_and_in_the_texts() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    let mut watcher = Page::new(&server, SIZE);
    page.say(&json!({"type": "material", "seq": 1, "index": 0, "edit": {"kd": [0.5, 0.25, 0.125]}}));
    page.say(&json!({"type": "lights", "seq": 2, "lights": [{"type": "sky", "radiance": [1.0, 0.5, 0.25]}]}));
    let mut states = vec![];
    while states.iter().all(|state: &serde_json::Value| state["lights"].is_null()) {
        states.push(watcher.text("state"));
    }
    assert!(states.iter().any(|state| state["material"]["kd"] == json!([0.5, 0.25, 0.125])), "{states:?}");
    assert_eq!(states.last().unwrap()["lights"][0]["radiance"], json!([1.0, 0.5, 0.25]));
    page.frame_until(|frame| frame.seq == 2 && frame.kind == 2);
    let texts = page.text("texts");
    let scene = texts["scene"].as_str().unwrap();
    assert!(scene.contains("[material.\"default\"]\nkd = [0.5, 0.25, 0.125]"), "{scene}");
    assert!(scene.contains("type = \"sky\"\nradiance = [1.0, 0.5, 0.25]"), "{scene}");
    assert_eq!(texts["command"], "Saved");
}

#[test]
fn parts_are_seen_by_those_who_watch_and_in_the_texts() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    let mut watcher = Page::new(&server, SIZE);
    let plane = json!([0.5, 0.0, 0.125, 1.0, 0.0, 0.0]);
    page.say(&json!({"type": "parts", "seq": 1, "parts": {"section": [plane], "hide": [0]}}));
    let told = |page: &mut Page| loop {
        let state = page.text("state");
        if !state["parts"].is_null() {
            return state["parts"].clone();
        }
    };
    let parts = told(&mut watcher);
    assert_eq!((&parts["section"], &parts["hidden_count"]), (&json!([plane]), &json!(1)), "{parts}");
    page.frame_until(|frame| frame.seq == 1 && frame.kind == 2);
    let texts = page.text("texts");
    let scene = texts["scene"].as_str().unwrap();
    assert!(scene.contains("[parts]\nsection = [[0.5, 0.0, 0.125, 1.0, 0.0, 0.0], ]"), "{scene}");
    assert!(scene.contains("hide = [\"default\", ]") && texts["command"] == "Saved", "{texts}");
    // Who names no materials leaves them as they are; who comes late is told what is shown.
    page.say(&json!({"type": "parts", "seq": 2, "parts": {"section": []}}));
    assert_eq!(told(&mut watcher), json!({"section": [], "hidden_count": 1, "hide": null, "only": []}));
    assert_eq!(Page::new(&server, SIZE).welcome["parts"]["hidden_count"], 1);
}

#[test]
fn what_makes_no_sense_is_told_and_changes_nothing() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.settle();
    for said in [
        json!({"type": "camera", "seq": 1, "position": [0, 0, 0], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y": 40}),
        json!({"type": "material", "seq": 2, "index": 7, "edit": {}}),
        json!({"type": "settings", "seq": 3, "settings": {"spp": 0}}),
        json!({"type": "lights", "seq": 4, "lights": [{"type": "sky", "radiance": [-1, 0, 0]}]}),
        json!({"type": "parts", "seq": 5, "parts": {"section": [[0, 0, 0, 0, 0, 0]]}}),
        json!({"type": "parts", "seq": 6, "parts": {"hide": [7]}}),
    ] {
        page.say(&said);
        let notice = page.text("notice");
        assert_eq!((&notice["level"], &notice["code"]), (&json!("error"), &json!("scene-format")), "{said}");
        for part in ["text", "place", "numbers", "next"] {
            assert!(notice[part].as_str().is_some_and(|part| !part.is_empty()), "{notice}");
        }
        while page.text("state")["settings"]["spp"] != 4 {}
    }
}

#[test]
fn settings_and_sizes_make_the_picture_that_they_say() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, [96, 64]);
    page.say(&json!({"type": "settings", "seq": 1, "settings": {"integrator": "direct", "spp": 2, "exposure": 0.5}}));
    let settled = page.frame_until(|frame| frame.kind == 2 && frame.seq == 1);
    assert_eq!(settled.size, [96, 64]);
    let expected = RenderKeys {
        integrator: Method::Direct,
        spp: 2,
        exposure: Exposure::Factor(0.5),
        resolution: [96, 64],
        ..keys()
    };
    assert!(settled.body == rendered(expected));
    let before = server.exchanges();
    page.say(&json!({"type": "size", "seq": 2, "size": [50, 40]}));
    let settled = page.frame_until(|frame| frame.kind == 2 && frame.seq == 2);
    assert!(settled.body == rendered(RenderKeys { resolution: [50, 40], ..expected }));
    assert_eq!(server.exchanges(), before + 1, "memory is planned once for another size");
}

/// The exposure is decided when it is asked for, by what is on show, and stays a number; lamps are those that are said.
#[test]
fn an_exposure_is_decided_when_it_is_asked_for() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    assert_eq!(
        (&page.welcome["settings"]["exposure"], &page.welcome["settings"]["light"]),
        (&json!(1.0), &json!("scene"))
    );
    let key =
        page.welcome["keys"].as_array().unwrap().iter().find(|key| key["name"] == "light").unwrap().clone();
    assert_eq!(key["choices"].as_array().unwrap().len(), 2, "what is decided is no choice of a page: {key}");
    page.settle();
    // A surface that is brighter than white is brought below it, and one that is dark is brought there, too.
    let (mut found, mut exposure) = (vec![], 0.0);
    for (seq, radiance) in [(1, 40.0), (3, 0.01)] {
        let lights = json!([{"type": "sky", "radiance": [radiance, radiance, radiance]}]);
        page.say(&json!({"type": "lights", "seq": seq, "lights": lights}));
        page.frame_until(|frame| frame.seq == seq && frame.kind == 2);
        page.say(
            &json!({"type": "settings", "seq": seq + 1, "settings": {"exposure": "auto", "light": "auto"}}),
        );
        let settings = loop {
            let state = page.text("state");
            if !state["settings"].is_null() {
                break state["settings"].clone();
            }
        };
        assert_eq!(settings["light"], "scene");
        exposure = settings["exposure"].as_f64().unwrap();
        found.push(exposure * radiance);
        page.frame_until(|frame| frame.seq == seq + 1 && frame.kind == 2);
    }
    assert!(found[0] > 0.5 && found[0] < 20.0 && (found[1] / found[0] - 1.0).abs() < 0.1, "{found:?}");
    // What is copied has the number.
    let said = format!("exposure = {exposure:?}\n");
    while !page.text("texts")["scene"].as_str().unwrap().contains(&said) {}
}

/// A page that asks for more than there is memory for gets the largest that fits, and is told so once, with the limit
/// that would do.
#[test]
fn a_picture_that_is_too_large_becomes_smaller() {
    let server = Server::start(Play { limit_bytes: 128 << 20, ..Play::default() });
    let mut page = Page::new(&server, SIZE);
    page.settle();
    page.say(&json!({"type": "size", "seq": 2, "size": [4000, 4000]}));
    let told = loop {
        let state = page.text("state");
        if !state["smaller"].is_null() {
            break state["smaller"].clone();
        }
    };
    assert_eq!(told["asked"], json!([4000, 4000]));
    // What the viewer shows takes more than 10 bytes a pixel.
    assert!(told["limit_bytes"].as_u64().unwrap() > 10 * 4000 * 4000, "{told}");
    let frame = page.frame_until(|frame| frame.seq == 2);
    assert!((200..4000).contains(&frame.size[0]), "{:?}", frame.size);
    // Who comes later knows, too.
    assert_eq!(Page::new(&server, SIZE).welcome["smaller"], told);
    page.say(&json!({"type": "size", "seq": 3, "size": SIZE}));
    page.frame_until(|frame| frame.seq == 3);
    assert!(page.texts.iter().all(|text| text["type"] != "notice"), "{:?}", page.texts);
    assert!(Page::new(&server, SIZE).welcome["smaller"].is_null());
}

#[test]
fn a_pick_says_what_is_there() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.say(&json!({"type": "pick", "id": 7, "pixel": [80, 60]}));
    let picked = page.text("picked");
    assert_eq!((&picked["id"], &picked["hit"]["name"]), (&json!(7), &json!("default")));
    assert!(picked["hit"]["distance"].as_f64().unwrap() > 0.0, "{picked}");
    // Of the material alone, and flat: the model has neither colours nor normals.
    assert_eq!(picked["hit"]["colour"], json!([0.7, 0.7, 0.7]), "{picked}");
    assert_eq!(picked["hit"]["shading_normal"], picked["hit"]["normal"]);
    let square = |part: &serde_json::Value| part.as_f64().unwrap().powi(2);
    let squares: f64 = picked["hit"]["normal"].as_array().unwrap().iter().map(square).sum();
    assert!((squares - 1.0).abs() < 1e-5, "{picked}");
    for pixel in [[0, 0], [160, 0], [u32::MAX, u32::MAX]] {
        page.say(&json!({"type": "pick", "id": 8, "pixel": pixel}));
        assert!(page.text("picked")["hit"].is_null());
    }
}

#[test]
fn a_pick_of_a_cap_names_no_triangle() {
    let server = Server::start(Play { shown: PlayModel::Block, ..Play::default() });
    let mut page = Page::new(&server, SIZE);
    let pick = |page: &mut Page, id| {
        page.say(&json!({"type": "pick", "id": id, "pixel": [80, 60]}));
        page.text("picked")["hit"].clone()
    };
    let whole = pick(&mut page, 1);
    assert!(whole["triangle"].as_u64().unwrap() < 12 && whole["page"] == 0, "{whole}");
    page.say(&json!({"type": "parts", "seq": 1, "parts": {"section": [[0, 0, 0, 0, -1, 0]]}}));
    let cut = pick(&mut page, 2);
    assert!(cut["triangle"].is_null() && cut["page"].is_null(), "{cut}");
    assert_eq!((&cut["normal"], &cut["name"]), (&json!([0.0, 1.0, 0.0]), &json!("default")), "{cut}");
    // A section lies less than half a step of the lattice within what it keeps.
    assert!((-0.5_f64.powi(17)..=0.0).contains(&cut["position"][1].as_f64().unwrap()), "{cut}");
}

#[test]
fn a_screenshot_is_the_picture_of_the_command_line() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    assert!(page.settle().body == rendered(keys()));
    for (id, format) in [(3, "png"), (4, "exr")] {
        page.say(&json!({"type": "screenshot", "id": id, "format": format, "size": [64, 48], "spp": 3}));
        let body = loop {
            match page.next(Duration::from_secs(30)) {
                Came::File { id: found, format: kind, body } => {
                    assert_eq!((found, kind), (id, u8::from(format == "exr")));
                    break body;
                }
                Came::Frame(frame) => panic!("the picture is what it was: {frame:?}"),
                Came::Text(text) => assert_ne!(text["type"], "notice", "{text}"),
                Came::Closed(code) => panic!("closed: {code}"),
                Came::Nothing => panic!("no file came"),
            }
        };
        if format == "png" {
            assert!(body == rendered(RenderKeys { resolution: [64, 48], spp: 3, ..keys() }));
        } else {
            assert!(body.starts_with(&[0x76, 0x2f, 0x31, 0x01]));
        }
    }
    page.say(&json!({"type": "screenshot", "id": 5, "format": "png", "size": [60_000, 60_000], "spp": 1}));
    assert_eq!(page.text("notice")["code"], "screenshot");
    page.say(&camera(9, 1.5));
    page.frame_until(|frame| frame.kind == 2 && frame.seq == 9);
    assert_eq!(server.end().screenshots, 2);
}

#[test]
fn who_watches_asks_for_the_wheel() {
    let server = Server::new(keys());
    let driver = Page::new(&server, SIZE);
    let mut watcher = Page::new(&server, SIZE);
    watcher.say(&camera(1, 1.5));
    assert_eq!(watcher.text("notice")["code"], "watching");
    // By the code that ends it in the page.
    watcher.say(&json!({"type": "screenshot", "id": 5, "format": "png", "size": [8, 8], "spp": 1}));
    assert_eq!(watcher.text("notice")["code"], "screenshot");
    watcher.say(&json!({"type": "drive"}));
    assert_eq!(watcher.text("notice")["code"], "driven");
    drop(driver);
    while watcher.text("state")["clients"] != 1 {}
    watcher.say(&json!({"type": "drive"}));
    while watcher.text("state")["role"] != "drive" {}
    watcher.say(&camera(2, 1.5));
    watcher.frame_until(|frame| frame.seq == 2);
}
