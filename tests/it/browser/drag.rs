//! How long a page waits for a picture while a hand drags: an instrument, not a test.
//!
//! ```sh
//! trex view FILE --no-open --memory-limit 128MiB          # prints the address
//! export TREX_VIEW_ADDRESS='http://127.0.0.1:PORT/#token=...' TREX_VIEW_LINE=60,2.5    # ms there and back, Mbit/s
//! cargo test -p trex --test it -- --ignored --nocapture a_drag_is_measured
//! ```
//!
//! A time runs from the event in the page to the animation frame after the draw of the first picture that shows it.

use super::chromium;
use super::devtools::Tab;
use super::link::{Line, slow_port};
use crate::command::said;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

const ADDRESS: &str = "TREX_VIEW_ADDRESS";
const LINE: &str = "TREX_VIEW_LINE";
const SIZE: [u32; 2] = [1280, 720];
const EVENTS: u32 = 200;
const EVENTS_PER_S: f64 = 30.0;
/// The page stands still for so long before and after.
const STILL: Duration = Duration::from_secs(3);
/// For a picture to settle: pages of a large model come from disk.
const SETTLES: Duration = Duration::from_secs(300);
/// Notes when events come, and when pictures show them. `whole`: with one ray in 4x4 pixels at least.
const WATCH: &str = "(() => {
    const watch = window.watch = { waiting: [], events: [], states: new Set(), frames: 0 };
    const { app } = trex;
    app.stage.addEventListener('pointermove', () => { watch.waiting.push(performance.now()); }, true);
    app.listen('moved', ({ seq }) => {
        watch.waiting.forEach((at) => watch.events.push({ at, seq, shown: null, whole: null }));
        watch.waiting = [];
    });
    app.listen('frame', ({ seq, scale }) => {
        const now = performance.now();
        watch.frames += 1;
        watch.states.add(seq);
        for (const event of watch.events.filter((event) => event.seq <= seq)) {
            event.shown ??= now - event.at;
            event.whole ??= scale <= 4 ? now - event.at : null;
        }
    });
})()";

#[test]
#[ignore = "an instrument: the head of its file says how to use it"]
fn a_drag_is_measured() {
    let address =
        std::env::var(ADDRESS).unwrap_or_else(|_| panic!("{ADDRESS} is not set: see the head of this file"));
    let command = chromium::installed().expect("there is no chromium");
    let address = match std::env::var(LINE) {
        Ok(line) => over(&address, &line),
        Err(_) => address,
    };
    let mut tab = Tab::open(&command, SIZE);
    tab.go(&address);
    tab.wait_for("trex.link === 'driving' && trex.drawn > 0");
    tab.listen(STILL);
    tab.value(WATCH);
    let received = |tab: &mut Tab| tab.number("trex.counts.received_bytes");
    let before = received(&mut tab);
    let seconds = drag(&mut tab);
    let dragged = received(&mut tab);
    let events = tab.value("watch.events");
    let (frames, states) = (tab.number("watch.frames"), tab.number("watch.states.size"));
    let begin = Instant::now();
    while tab.value("trex.last.kind === 2 && trex.last.seq >= trex.seq") != true && begin.elapsed() < SETTLES
    {
        tab.listen(Duration::from_millis(50));
    }
    let settled_s = begin.elapsed().as_secs_f64();
    let settled = received(&mut tab);
    tab.listen(STILL);
    let document = json!({
        "picture": tab.value("trex.app.state.size"),
        "events": EVENTS,
        "shown_ms": percentiles(&events, "shown"),
        "whole_ms": percentiles(&events, "whole"),
        "last_half_by_first": median_of_half(&events, 1) / median_of_half(&events, 0),
        "pictures_per_s": states / seconds,
        "frames_per_s": frames / seconds,
        "dragging_bytes_per_s": (dragged - before) / seconds,
        "settled_s": settled_s,
        "settling_bytes": settled - dragged,
        "still_bytes": received(&mut tab) - settled,
    });
    said(&document.to_string());
}

/// `address` by way of a line, "MS,MBIT".
fn over(address: &str, line: &str) -> String {
    let (round_trip_ms, mbit) = line.split_once(',').expect("MS,MBIT");
    let delay = Duration::from_secs_f64(round_trip_ms.parse::<f64>().unwrap() / 2e3);
    let line = Line { delay, bytes_per_s: mbit.parse::<f64>().unwrap() * 1e6 / 8.0 };
    let (host, path) = address.strip_prefix("http://").and_then(|rest| rest.split_once('/')).unwrap();
    let port = host.rsplit_once(':').unwrap().1.parse().unwrap();
    format!("http://127.0.0.1:{}/{path}", slow_port(port, line))
}

/// Drags round and round, gives how long that took, seconds.
fn drag(tab: &mut Tab) -> f64 {
    let middle = SIZE.map(|side| f64::from(side) / 2.0);
    let begin = Instant::now();
    tab.mouse("mousePressed", middle, 0);
    for event in 1..=EVENTS {
        let turn = f64::from(event) / EVENTS_PER_S;
        let at = [middle[0] + 260.0 * (1.2 * turn).sin(), middle[1] + 60.0 * (1.7 * turn).sin()];
        tab.mouse("mouseMoved", at, 0);
        tab.listen(Duration::from_secs_f64(turn).saturating_sub(begin.elapsed()));
    }
    let seconds = begin.elapsed().as_secs_f64();
    tab.mouse("mouseReleased", middle, 0);
    seconds
}

fn times(events: &Value, key: &str) -> Vec<f64> {
    events.as_array().unwrap().iter().filter_map(|event| event[key].as_f64()).collect()
}

fn percentiles(events: &Value, key: &str) -> Value {
    let mut times = times(events, key);
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get(((times.len() as f64 * share).ceil() as usize).saturating_sub(1));
    json!({ "count": times.len(), "p50": at(0.5), "p90": at(0.9), "p99": at(0.99), "max": times.last() })
}

fn median_of_half(events: &Value, half: usize) -> f64 {
    let times = times(events, "shown");
    let mut times = times[half * times.len() / 2..(half + 1) * times.len() / 2].to_vec();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}
