//! What pages are sent: frames, one at a time, the settled picture, and then nothing.

use crate::client::{Came, Page};
use crate::stage::{SIZE, Server, keys, rendered, view_threads};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use trex_render::RenderKeys;

/// Flags of frames.
const DONE: u8 = 8;

/// A camera beside the model.
pub(crate) fn camera(seq: u32, x: f64) -> Value {
    json!({"type": "camera", "seq": seq, "position": [x, 1.0, 2.0], "target": [0.5, 0.0, 0.5], "up": [0, 1, 0],
        "fov_y": 40.0})
}

#[test]
fn a_page_gets_the_picture_as_the_command_line_makes_it_and_then_nothing() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    let welcome = &page.welcome;
    assert_eq!(
        (&welcome["role"], &welcome["name"], &welcome["size"]),
        (&json!("drive"), &json!("wave"), &json!(SIZE))
    );
    assert_eq!(welcome["settings"]["integrator"], "photon");
    assert_eq!(welcome["model"]["triangle_count"], 7200);
    let recipe = welcome["command"].as_str().unwrap();
    assert!(recipe.starts_with("Opened") && recipe.contains("resolution: [160, 120]"), "{recipe}");
    assert_eq!(welcome["keys"].as_array().unwrap().len(), 19);
    assert_eq!(welcome["sides"], json!([16, 16_384]));
    let first = page.frame();
    assert_eq!((first.kind, first.blocks.len() as u32), (1, first.blocks_in_all()));
    page.acknowledge(&first);
    let settled = page.settle();
    assert!(settled.flags & DONE != 0 && settled.size == SIZE);
    assert!(settled.body == rendered(keys()), "the settled picture is another one");
    // Statistics and texts of the end, and silence after them.
    let texts = page.text("texts");
    assert!(texts["scene"].as_str().unwrap().contains("model = \"/models/wave.trex\""), "{texts}");
    while !matches!(page.next(Duration::from_millis(300)), Came::Nothing) {}
    assert!(matches!(page.next(Duration::from_millis(700)), Came::Nothing));
    let served = server.end();
    assert_eq!((served.clients, served.events), (1, 0));
    assert!(served.frames_drawn >= 2 && served.sent_bytes > settled.body.len() as u64);
}

#[test]
fn a_camera_brings_frames_that_say_so() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.settle();
    page.say(&camera(5, 1.5));
    let frame = page.frame_until(|frame| frame.seq == 5);
    assert_eq!(frame.kind, 1);
    let settled = page.settle();
    assert_eq!(settled.seq, 5);
    assert!(settled.body != rendered(keys()));
}

/// The settled picture comes in parts, and what is newer goes before those that are left, which do not come any more.
#[test]
fn an_event_does_not_wait_for_the_settled_picture() {
    let size = [640, 480];
    let server = Server::new(RenderKeys { resolution: size, spp: 1, ..keys() });
    let mut page = Page::new(&server, size);
    page.on_part = Some(camera(5, 1.5));
    let next = page.frame_until(|frame| frame.kind == 2 || frame.seq == 5);
    assert!(page.on_part.is_none(), "a picture of less than 32 KiB");
    assert_eq!((next.kind, next.seq), (1, 5), "{next:?}");
    assert_eq!(page.settle().seq, 5);
}

/// Events that come fast bring small pictures, each whole.
#[test]
fn a_drag_is_seen_in_whole_pictures() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.settle();
    let (begin, mut seen, mut moving) = (Instant::now(), 0, 0);
    let mut seq = 10;
    while begin.elapsed() < Duration::from_secs(1) {
        seq += 1;
        page.say(&camera(seq, f64::from(seq) * 0.01));
        let due = Instant::now() + Duration::from_millis(33);
        while let Some(left) = due.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            if let Came::Frame(frame) = page.next(left) {
                seen += u32::from(frame.seq > 10);
                if frame.flags & 2 != 0 {
                    moving += 1;
                    assert!(
                        frame.scale > 1 && frame.blocks.len() as u32 == frame.blocks_in_all(),
                        "{frame:?}"
                    );
                }
                page.acknowledge(&frame);
            }
        }
    }
    assert!(seen >= 8 && moving >= 4, "{seen} frames, {moving} of them moving");
    page.say(&json!({"type": "rest"}));
    assert_eq!(page.settle().seq, seq);
}

#[test]
fn who_never_acknowledges_gets_one_frame_and_holds_up_nobody() {
    let server = Server::new(keys());
    let mut stuck = Page::new(&server, SIZE);
    stuck.frame();
    let mut other = Page::new(&server, SIZE);
    assert_eq!(other.welcome["role"], "watch");
    let settled = other.settle();
    assert!(settled.body == rendered(keys()));
    while !matches!(stuck.next(Duration::from_millis(300)), Came::Nothing) {}
    assert!(!stuck.texts.is_empty() || matches!(stuck.next(Duration::from_millis(50)), Came::Nothing));
}

#[test]
fn who_comes_late_gets_all_of_it() {
    let server = Server::new(keys());
    Page::new(&server, SIZE).settle();
    let mut late = Page::new(&server, SIZE);
    let frame = late.frame();
    assert_eq!((frame.kind, frame.scale, frame.blocks.len() as u32), (1, 1, frame.blocks_in_all()));
    late.acknowledge(&frame);
    assert!(late.settle().body == rendered(keys()));
}

#[test]
fn pages_that_come_and_go_leave_no_threads() {
    let server = Server::new(keys());
    let mut page = Page::new(&server, SIZE);
    page.settle();
    let before = view_threads();
    for _ in 0..50 {
        let mut guest = Page::new(&server, SIZE);
        guest.frame();
    }
    // The system lists a thread for a moment after it was joined.
    let left = |count| {
        let begin = Instant::now();
        while view_threads() > count && begin.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(20));
        }
        view_threads()
    };
    assert_eq!(left(before), before);
    drop(page);
    assert_eq!(server.end().clients, 51);
    assert_eq!(left(0), 0);
}
