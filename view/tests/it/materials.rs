//! Models of many materials: none of their lists goes to a page that has not asked for it, and no message is long.

use crate::client::{Came, Page};
use crate::stage::{Play, SIZE, Server};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;
use trex_render::Scene;

/// As many as a file may have.
const COUNT: usize = 65_536;
/// Edits whose text is longer than what every page is sent.
const EDITS: usize = 80;

fn server() -> Server {
    // The first is the model's own.
    Server::start(Play { more_materials: COUNT - 1, ..Play::default() })
}

fn indices(list: &Value) -> Vec<usize> {
    list["items"].as_array().unwrap().iter().map(|item| item["index"].as_u64().unwrap() as usize).collect()
}

/// The whole list, megabytes, went to every page with the welcome, and again at every edit, past every bound.
#[test]
fn parts_of_the_list_come_when_they_are_asked_for() {
    let server = server();
    let mut page = Page::new(&server, SIZE);
    let mut watcher = Page::new(&server, SIZE);
    assert_eq!(page.welcome["material_count"], COUNT);
    assert!(page.welcome.to_string().len() < 16 << 10 && page.welcome["materials"].is_null());
    let mut ask = |wish: Value| {
        let mut message = json!({"type": "materials", "id": 5});
        message.as_object_mut().unwrap().extend(wish.as_object().unwrap().clone());
        page.say(&message);
        let list = page.text("materials");
        assert!(list["id"] == 5 && list.to_string().len() < 48 << 10);
        list
    };
    let first = ask(json!({}));
    let part = indices(&first);
    assert_eq!((&first["found"], &part[..3]), (&json!(COUNT), &[0, 1, 2][..]));
    let next = ask(json!({"from": part.len()}));
    assert_eq!(indices(&next), (part.len()..2 * part.len()).collect::<Vec<_>>());
    // Names begin with five digits, one less than the index.
    let named: Vec<usize> =
        (0..COUNT - 1).filter(|n| format!("{n:05}").contains("4242")).map(|n| n + 1).collect();
    let found = ask(json!({"find": "4242"}));
    assert_eq!((found["found"].as_u64().unwrap() as usize, indices(&found)), (named.len(), named));
    assert_eq!(ask(json!({"find": "STAHL"}))["found"], COUNT - 1);
    assert!(indices(&ask(json!({"index": 40_000}))).contains(&40_000));
    assert_eq!(ask(json!({"from": u64::MAX}))["items"], json!([]));

    page.say(&json!({"type": "material", "seq": 1, "index": 40_000, "edit": {"kd": [0.5, 0.25, 0.125]}}));
    for page in [&mut page, &mut watcher] {
        let state = loop {
            let state = page.text("state");
            if !state["material"].is_null() {
                break state;
            }
        };
        let material = (&state["material"]["index"], &state["material"]["kd"]);
        assert_eq!(material, (&json!(40_000), &json!([0.5, 0.25, 0.125])));
        assert!(state.to_string().len() < 2048, "{state}");
    }
}

/// The text of a scene holds every edited material: a long one comes as a file, to who asks for it.
#[test]
fn a_long_scene_comes_as_a_file() {
    let server = server();
    let mut page = Page::new(&server, SIZE);
    page.settle();
    for index in 1..=EDITS {
        let edit = json!({"mirror": true, "ks": [0.5, 0.5, 0.5]});
        page.say(&json!({"type": "material", "seq": index, "index": index, "edit": edit}));
        while page.text("state")["material"]["index"] != index {}
    }
    page.frame_until(|frame| frame.kind == 2 && frame.seq as usize == EDITS);
    let texts = loop {
        let texts = page.text("texts");
        if texts["scene"].is_null() {
            break texts;
        }
    };
    assert!(texts.to_string().len() < 2048, "{texts}");
    page.say(&json!({"type": "scene", "id": 9}));
    let body = loop {
        match page.next(Duration::from_secs(30)) {
            Came::File { id, format, body } => {
                assert_eq!((id, format), (9, 2));
                break body;
            }
            Came::Frame(frame) => page.acknowledge(&frame),
            Came::Text(_) => {}
            Came::Closed(_) | Came::Nothing => panic!("no file came"),
        }
    };
    assert_eq!(texts["scene_bytes"], body.len());
    let scene = Scene::parse(std::str::from_utf8(&body).unwrap(), Path::new("view.toml")).unwrap();
    assert_eq!(scene.materials.len(), EDITS);
    assert!(scene.materials.values().all(|edit| edit.mirror == Some(true)));
    // Those who come later are told of its length, too.
    assert_eq!(Page::new(&server, SIZE).welcome["scene_bytes"], body.len());
}
