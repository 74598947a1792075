//! A page without a browser that drags: how long from an event to the frame that shows it, and how many bytes.
//! `cargo run --release -p trex-view --example drag -- URL [EVENTS] [PER_SECOND]`, with the address that `trex view`
//! prints. It acknowledges each frame at once, as a page does that draws in no time.
#![allow(clippy::print_stdout)]

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::error::Error;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Time that the picture gets to come before the drag, and after it.
const SETTLE: Duration = Duration::from_secs(3);
const SIZE: [u32; 2] = [1280, 720];
/// Radians from one event to the next.
const TURN: f64 = 0.01;

/// What has come.
#[derive(Default)]
struct Log {
    /// When events went that are not shown yet.
    sent: BTreeMap<u32, Instant>,
    /// Event to frame, ms, of those that were shown themselves.
    times_ms: Vec<f64>,
    frames: u32,
    bytes: usize,
    /// Frames by scale.
    scales: BTreeMap<u16, u32>,
    last_stats: Value,
}

type Socket = WebSocket<TcpStream>;

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let url = words.next().ok_or("give the address that trex view prints")?;
    let events: u32 = words.next().map_or(Ok(200), |word| word.parse())?;
    let per_s: f64 = words.next().map_or(Ok(30.0), |word| word.parse())?;
    let (base, token) = url.split_once("/#token=").ok_or("the address has no token")?;
    let host = base.trim_start_matches("http://");
    let stream = TcpStream::connect(host)?;
    stream.set_nodelay(true)?;
    let (mut socket, _) = tungstenite::client(format!("ws://{host}/socket"), stream)?;
    say(&mut socket, &json!({"type": "hello", "token": token, "size": SIZE}))?;
    let welcome: Value = serde_json::from_str(socket.read()?.to_text()?)?;
    let mut log = Log::default();
    listen(&mut socket, &mut log, Instant::now() + SETTLE)?;
    tell("before", &log, SETTLE);

    log = Log::default();
    let begin = Instant::now();
    for seq in 1..=events {
        let camera = turned(&welcome["camera"], f64::from(seq) * TURN, seq);
        log.sent.insert(seq, Instant::now());
        say(&mut socket, &camera)?;
        listen(&mut socket, &mut log, begin + Duration::from_secs_f64(f64::from(seq) / per_s))?;
    }
    tell("drag", &log, begin.elapsed());
    log = Log::default();
    listen(&mut socket, &mut log, Instant::now() + SETTLE)?;
    tell("after", &log, SETTLE);
    println!("memory {}", log.last_stats["memory"]);
    Ok(())
}

fn say(socket: &mut Socket, message: &Value) -> Result<(), tungstenite::Error> {
    socket.send(Message::text(message.to_string()))
}

/// The camera of the welcome, turned about the vertical through its target.
fn turned(camera: &Value, angle: f64, seq: u32) -> Value {
    let number = |key: &str, axis: usize| camera[key][axis].as_f64().unwrap_or_default();
    let [dx, dz] = [0, 2].map(|axis| number("position", axis) - number("target", axis));
    let (sin, cos) = angle.sin_cos();
    let x = number("target", 0) + dx * cos - dz * sin;
    let z = number("target", 2) + dx * sin + dz * cos;
    json!({"type": "camera", "seq": seq, "position": [x, number("position", 1), z], "target": camera["target"],
        "up": camera["up"], "fov_y": camera["fov_y"]})
}

/// Takes what comes, up to a time.
fn listen(socket: &mut Socket, log: &mut Log, until: Instant) -> Result<(), Box<dyn Error>> {
    while let Some(left) = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
        socket.get_mut().set_read_timeout(Some(left))?;
        match socket.read() {
            Ok(Message::Binary(bytes)) => {
                let frame = log.learn(&bytes);
                say(socket, &json!({"type": "ack", "frame": frame}))?;
            }
            Ok(Message::Text(text)) => {
                let text: Value = serde_json::from_str(&text)?;
                if text["type"] == "stats" {
                    log.last_stats = text;
                }
            }
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

impl Log {
    /// Learns of a frame. Gives its number.
    fn learn(&mut self, bytes: &[u8]) -> u32 {
        let long = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let (scale, frame, seq) = (u16::from_le_bytes([bytes[2], bytes[3]]), long(4), long(8));
        let later = self.sent.split_off(&(seq + 1));
        let shown = std::mem::replace(&mut self.sent, later);
        self.times_ms.extend(shown.get(&seq).map(|at| at.elapsed().as_secs_f64() * 1e3));
        let [from, total] = [20, 24].map(long);
        // A settled picture comes in parts.
        let is_frame = bytes[0] != 2 || from as usize + bytes.len() - 28 == total as usize;
        self.frames += u32::from(is_frame);
        self.bytes += bytes.len();
        *self.scales.entry(scale).or_default() += u32::from(is_frame);
        frame
    }
}

fn tell(what: &str, log: &Log, time: Duration) {
    let seconds = time.as_secs_f64();
    print!(
        "{what}: {:.1} frames/s, {:.0} KB/s, frames by scale {:?}",
        f64::from(log.frames) / seconds,
        log.bytes as f64 / seconds / 1e3,
        log.scales
    );
    let mut times = log.times_ms.clone();
    times.sort_by(f64::total_cmp);
    let percentile = |p: f64| times[((times.len() - 1) as f64 * p).round() as usize];
    if !times.is_empty() {
        print!(
            "; event to frame: median {:.1} ms, 99 % {:.1} ms ({})",
            percentile(0.5),
            percentile(0.99),
            times.len()
        );
    }
    println!();
}
