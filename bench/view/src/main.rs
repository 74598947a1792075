//! Figures of a running `trex view`, taken by pages without a browser: one line of JSON each. `bench/view.sh` runs it.
//!
//! ```sh
//! cargo run --release -p trex-bench-view -- URL drag SCALE [EVENTS]   # event to frame; 0: as fits
//! ... URL pictures FOLDER         # pictures of a drag, shown-N.png, and of the same views once settled, settled-N.png
//! ... URL first SINCE_NS          # from a moment (date +%s%N) to the first pixels
//! ... URL converge PID            # bytes from an event to 16 samples; bytes and processor share of PID once settled
//! ... URL edits                   # an edit of lights, of a material, to the first changed pixels
//! ... URL soak PID MINUTES        # eight pages, one of which drags while others come and go: memory, threads, files
//! ```
//!
//! Pages acknowledge each frame at once, as one does that draws in no time.
#![allow(clippy::print_stdout)]

mod page;
mod picture;
mod process;
mod soak;

use page::{Failure, Log, Page, SIZE, percentiles};
use picture::Canvas;
use process::Process;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Events a second of a drag.
const PER_S: f64 = 30.0;
/// Radians from one event to the next.
const TURN: f64 = 0.01;
/// Time that a picture gets to settle.
const SETTLE: Duration = Duration::from_secs(300);
/// Time over which a settled viewer is watched.
const STILL: Duration = Duration::from_secs(20);
/// Events of the drag of which pictures are kept, and every how many.
const SEEN_EVENTS: u32 = 192;
const SEEN_EVERY: u32 = 16;
/// Edits of each kind.
const EDITS: u32 = 20;
/// Between two edits: the picture has become complete, not settled.
const EDIT_EVERY: Duration = Duration::from_millis(1500);

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [url, what, rest @ ..] = &words[..] else {
        return Err("give the address that trex view prints, and a figure: see the head of this file".into());
    };
    let number = |at: usize, or: u64| rest.get(at).map_or(Ok(or), |word| word.parse());
    let figure = match what.as_str() {
        "drag" => drag(url, number(0, 0)?, number(1, 200)? as u32)?,
        "pictures" => pictures(url, Path::new(rest.first().map_or(".", String::as_str)))?,
        "first" => first(url, number(0, 0)?)?,
        "converge" => converge(url, &Process(number(0, 0)?))?,
        "edits" => edits(url)?,
        "soak" => soak::soak(url, &Process(number(0, 0)?), Duration::from_secs(60 * number(1, 1)?))?,
        other => return Err(format!("{other} is no figure").into()),
    };
    println!("{}", json!({ "figure": what, "value": figure }));
    Ok(())
}

/// Event to the frame that shows it, while the view turns.
fn drag(url: &str, scale: u64, events: u32) -> Result<Value, Failure> {
    let mut page = Page::open(url, SIZE)?;
    page.say(&json!({"type": "moving", "scale": scale}))?;
    page.settle(SETTLE)?;
    page.log = Log::default();
    let begin = Instant::now();
    for event in 1..=events {
        page.turn(f64::from(event) * TURN)?;
        page.listen(begin + Duration::from_secs_f64(f64::from(event) / PER_S))?;
    }
    let seconds = begin.elapsed().as_secs_f64();
    let Log { times_ms, frames, bytes, scales, .. } = &page.log;
    Ok(json!({
        "scale_asked": scale,
        "event_to_frame_ms": percentiles(times_ms),
        "frames_per_s": f64::from(*frames) / seconds,
        "bytes_per_s": *bytes as f64 / seconds,
        "frames_by_scale": scales,
    }))
}

/// Keeps what is shown during a drag, and what the same views are once they have settled.
fn pictures(url: &str, folder: &Path) -> Result<Value, Failure> {
    let mut page = Page::open(url, SIZE)?;
    page.canvas = Some(Canvas::default());
    page.say(&json!({"type": "moving", "scale": 0}))?;
    page.settle(SETTLE)?;
    let begin = Instant::now();
    let (mut angles, mut seen) = (BTreeMap::new(), vec![]);
    for event in 1..=SEEN_EVENTS {
        let angle = f64::from(event) * TURN;
        angles.insert(page.turn(angle)?, angle);
        page.listen(begin + Duration::from_secs_f64(f64::from(event) / PER_S))?;
        let angle = page.canvas.as_ref().and_then(|canvas| angles.get(&canvas.seq));
        if let (0, Some(angle)) = (event % SEEN_EVERY, angle) {
            seen.push((*angle, page.canvas.clone()));
        }
    }
    for (index, (angle, shown)) in seen.iter().enumerate() {
        page.turn(*angle)?;
        page.say(&json!({"type": "rest"}))?;
        page.settle(SETTLE)?;
        for (name, canvas) in [("shown", shown), ("settled", &page.canvas)] {
            let path = folder.join(format!("{name}-{index:02}.png"));
            canvas.as_ref().ok_or("no picture is shown")?.write(&path)?;
        }
    }
    Ok(json!({ "pictures": seen.len() }))
}

/// From `since_ns` after 1970 to the first pixels, ms.
fn first(url: &str, since_ns: u64) -> Result<Value, Failure> {
    let mut page = Page::open(url, SIZE)?;
    page.listen_until(SETTLE, |log| log.frames > 0)?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
    Ok(json!({ "first_pixels_ms": now.saturating_sub(Duration::from_nanos(since_ns)).as_secs_f64() * 1e3 }))
}

/// Bytes of a picture that converges, and what is done once it has.
fn converge(url: &str, process: &Process) -> Result<Value, Failure> {
    let mut page = Page::open(url, SIZE)?;
    page.settle(SETTLE)?;
    page.log = Log::default();
    let begin = Instant::now();
    page.turn(0.5)?;
    page.say(&json!({"type": "rest"}))?;
    page.settle(SETTLE)?;
    let (bytes, settled_s) = (page.log.bytes, begin.elapsed().as_secs_f64());
    // Statistics and texts of the end.
    page.listen(Instant::now() + Duration::from_secs(2))?;
    page.log = Log::default();
    let before = process.cpu_s()?;
    page.listen(Instant::now() + STILL)?;
    Ok(json!({
        "spp": page.welcome["settings"]["spp"],
        "converging_bytes": bytes,
        "settled_s": settled_s,
        "settled_bytes": page.log.bytes,
        "settled_core_share": (process.cpu_s()? - before) / STILL.as_secs_f64(),
    }))
}

/// Edits to the first frame that shows them.
fn edits(url: &str) -> Result<Value, Failure> {
    let mut page = Page::open(url, SIZE)?;
    page.settle(SETTLE)?;
    let mut figures = vec![];
    for kind in ["lights", "material"] {
        page.log.times_ms.clear();
        for edit in 1..=EDITS {
            let seq = page.next_seq();
            let strength = 0.3 + 0.5 * f64::from(edit % 2);
            let message = match kind {
                "lights" => json!({"type": kind, "seq": seq, "lights": [
                    {"type": "sky", "radiance": [strength, strength, strength]},
                ]}),
                _ => json!({"type": kind, "seq": seq, "index": 0, "edit": {"kd": [strength, 0.4, 0.3]}}),
            };
            page.event(seq, &message)?;
            page.listen(Instant::now() + EDIT_EVERY)?;
        }
        figures.push(percentiles(&page.log.times_ms));
    }
    Ok(json!({ "light_to_pixels_ms": figures[0], "material_to_pixels_ms": figures[1] }))
}
