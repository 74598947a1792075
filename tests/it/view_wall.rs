//! The viewer in a control group of exactly its limit, with all the pages that it takes: one drives and changes sizes,
//! limits, materials and lights, seven watch, of which one never acknowledges anything. The kernel never has to end it.

use crate::cgroup::Cgroup;
use crate::command::{folder, said};
use crate::fixtures::built_in;
use crate::view::{KIND_FILE, ViewProcess, say, smallest_limit_mib, text_until};
use serde_json::{Value, json};
use std::net::TcpStream;
use std::path::Path;
use std::thread;
use tungstenite::{Message, WebSocket};

const MIB: u64 = 1 << 20;
/// Pages that watch; the last of them never acknowledges.
const SPECTATORS: usize = 7;
/// Events of the driver.
const EVENTS: u32 = 60;

/// Watches until the viewer ends; gives how many frames came.
fn watch(mut page: WebSocket<TcpStream>, acknowledges: bool) -> u32 {
    let mut frames = 0;
    while let Ok(message) = page.read() {
        let Message::Binary(bytes) = message else { continue };
        frames += 1;
        if acknowledges && bytes[0] != KIND_FILE {
            let frame = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
            // The viewer may have ended meanwhile.
            let _ = page.send(Message::text(json!({"type": "ack", "frame": frame}).to_string()));
        }
    }
    frames
}

/// The `seq`-th event of the driver, under a limit of so many MiB.
fn event(seq: u32, limit_mib: u64) -> Value {
    let turn = f64::from(seq);
    let method = ["photon", "direct", "path"][seq as usize / 6 % 3];
    let size = [[320, 240], [1280, 720], [50, 40], [640, 480], [1920, 1080]][seq as usize / 6 % 5];
    match seq % 6 {
        0 => json!({"type": "size", "seq": seq, "size": size}),
        1 => json!({"type": "limit", "seq": seq, "bytes": (limit_mib - u64::from(seq) % 4) * MIB}),
        2 => {
            json!({"type": "material", "seq": seq, "index": 0, "edit": {"kd": [0.2, turn.sin().abs(), 0.5]}})
        }
        3 => json!({"type": "camera", "seq": seq, "position": [turn.sin(), 1.0, turn.cos()],
                    "target": [0, 0, 0], "up": [0, 1, 0], "fov_y": 40}),
        4 => {
            json!({"type": "lights", "seq": seq, "lights": [{"type": "sky", "radiance": [1, turn / 60.0, 1]}]})
        }
        _ => json!({"type": "settings", "seq": seq, "settings": {"integrator": method}}),
    }
}

/// Runs the viewer in a group of `limit_mib`. Gives how many frames went to those who watched; `None` where no group
/// can be made.
fn run(inside: &Path, line: &str, limit_mib: u64) -> Option<Vec<u32>> {
    let group = Cgroup::new("view", limit_mib * MIB)?;
    let line = format!("view {line} --no-open --json --memory-limit {limit_mib}MiB");
    let viewing = ViewProcess::start_as(group.command_in(inside, &line), line);
    let mut driver = viewing.page();
    text_until(&mut driver, |text| text["type"] == "welcome");
    let watching: Vec<_> = (1..=SPECTATORS)
        .map(|number| {
            let page = viewing.page();
            thread::spawn(move || watch(page, number < SPECTATORS))
        })
        .collect();
    text_until(&mut driver, |text| text["clients"] == 1 + SPECTATORS);
    for seq in 1..=EVENTS {
        say(&mut driver, &event(seq, limit_mib));
        // Some follow each other at once, some find a picture that has begun.
        if seq % 4 == 0 {
            text_until(&mut driver, |text| text["type"] == "stats");
        }
    }
    text_until(&mut driver, |text| text["progress"] == "done" || text["progress"] == "complete");
    let ran = viewing.end();
    assert_eq!(group.oom_kill_count(), 0, "{limit_mib} MiB: {}", ran.stderr);
    ran.expect(0);
    let document = ran.document();
    assert_eq!(document["clients"], 1 + SPECTATORS, "{document:#}");
    Some(watching.into_iter().map(|page| page.join().unwrap()).collect())
}

#[test]
fn eight_pages_do_not_pass_the_limit() {
    let inside = folder();
    built_in(inside.path(), "gen:scan:300k --voxels 256", "m.trex");
    let line = "m.trex --spp 1 --photons 20k";
    let smallest = smallest_limit_mib(inside.path(), &format!("{line} --resolution 640x480"));
    for limit_mib in [smallest, smallest + 24] {
        let Some(frames) = run(inside.path(), line, limit_mib) else { return };
        let (silent, others) = frames.split_last().unwrap();
        assert!(others.iter().all(|&frames| frames > *silent), "{frames:?}");
        // One goes out, and is never confirmed.
        assert!(*silent <= 1, "{frames:?}");
        said(&format!("{limit_mib} MiB: {} events, 8 pages, {frames:?} frames to those who watched", EVENTS));
    }
}
