//! A page without a browser: says hello, acknowledges, notes what comes and when.

use crate::picture::Canvas;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tungstenite::{Message, WebSocket};

pub(crate) type Failure = Box<dyn std::error::Error + Send + Sync>;

pub(crate) const SIZE: [u32; 2] = [1280, 720];
/// Bytes in front of a part of a settled picture.
const PART_HEAD_BYTES: usize = 28;
const KIND_WHOLE: u8 = 2;

/// A page that is connected.
pub(crate) struct Page {
    socket: WebSocket<TcpStream>,
    pub(crate) welcome: Value,
    pub(crate) log: Log,
    /// What is shown, where it is asked for.
    pub(crate) canvas: Option<Canvas>,
    seq: u32,
}

/// What has come.
#[derive(Default)]
pub(crate) struct Log {
    /// When events went that are not shown yet.
    sent: BTreeMap<u32, Instant>,
    /// Event to frame, ms, of those that were shown themselves.
    pub(crate) times_ms: Vec<f64>,
    pub(crate) frames: u32,
    /// Settled pictures among them, and the last event that one of them shows.
    pub(crate) settled: u32,
    shown: u32,
    /// Of all messages.
    pub(crate) bytes: usize,
    /// Frames by scale.
    pub(crate) scales: BTreeMap<u16, u32>,
}

impl Page {
    /// A page of `size` pixels at the address that `trex view` prints.
    pub(crate) fn open(url: &str, size: [u32; 2]) -> Result<Page, Failure> {
        let (base, token) = url.split_once("/#token=").ok_or("the address has no token")?;
        let host = base.trim_start_matches("http://");
        let stream = TcpStream::connect(host)?;
        stream.set_nodelay(true)?;
        let (mut socket, _) = tungstenite::client(format!("ws://{host}/socket"), stream)
            .map_err(|error| format!("no socket: {error}"))?;
        let hello = json!({"type": "hello", "token": token, "size": size});
        socket.send(Message::text(hello.to_string()))?;
        let welcome = serde_json::from_str(socket.read()?.to_text()?)?;
        // The server's picture may show events of another page, which had smaller numbers.
        let since = SystemTime::now().duration_since(UNIX_EPOCH)?.as_millis() / 10;
        Ok(Page { socket, welcome, log: Log::default(), canvas: None, seq: (since % (1 << 31)) as u32 })
    }

    pub(crate) fn say(&mut self, message: &Value) -> Result<(), Failure> {
        Ok(self.socket.send(Message::text(message.to_string()))?)
    }

    /// The number of the next event.
    pub(crate) fn next_seq(&mut self) -> u32 {
        self.seq += 1;
        self.seq
    }

    /// Sends an event, of which the time is taken.
    pub(crate) fn event(&mut self, seq: u32, message: &Value) -> Result<(), Failure> {
        self.log.sent.insert(seq, Instant::now());
        self.say(message)
    }

    /// Sends the camera of the welcome, turned about the vertical through its target. Gives the event's number.
    pub(crate) fn turn(&mut self, angle: f64) -> Result<u32, Failure> {
        let seq = self.next_seq();
        let camera = &self.welcome["camera"];
        let number = |key: &str, axis: usize| camera[key][axis].as_f64().unwrap_or_default();
        let [dx, dz] = [0, 2].map(|axis| number("position", axis) - number("target", axis));
        let (sin, cos) = angle.sin_cos();
        let x = number("target", 0) + dx * cos - dz * sin;
        let z = number("target", 2) + dx * sin + dz * cos;
        let message = json!({"type": "camera", "seq": seq, "position": [x, number("position", 1), z],
            "target": camera["target"], "up": camera["up"], "fov_y": camera["fov_y"]});
        self.event(seq, &message)?;
        Ok(seq)
    }

    /// Takes what comes, up to a time.
    pub(crate) fn listen(&mut self, until: Instant) -> Result<(), Failure> {
        self.listen_until(until.saturating_duration_since(Instant::now()), |_| false).map(drop)
    }

    /// Takes what comes until the last event's picture has settled.
    pub(crate) fn settle(&mut self, longest: Duration) -> Result<(), Failure> {
        let (before, waits_for) = (self.log.settled, self.log.sent.keys().last().copied().unwrap_or(0));
        match self.listen_until(longest, |log| log.settled > before && log.shown >= waits_for)? {
            true => Ok(()),
            false => Err("the picture has not settled".into()),
        }
    }

    /// Takes what comes until `is_it`, which is told, or a time has passed.
    pub(crate) fn listen_until(
        &mut self,
        longest: Duration,
        is_it: impl Fn(&Log) -> bool,
    ) -> Result<bool, Failure> {
        let end = Instant::now() + longest;
        while let Some(left) = end.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            self.socket.get_mut().set_read_timeout(Some(left))?;
            match self.socket.read() {
                Ok(Message::Binary(bytes)) => {
                    let frame = self.log.learn(&bytes);
                    self.canvas.as_mut().map_or(Ok(()), |canvas| canvas.draw(&bytes))?;
                    self.say(&json!({"type": "ack", "frame": frame}))?;
                }
                Ok(message) => self.log.bytes += message.len(),
                Err(tungstenite::Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
            if is_it(&self.log) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Log {
    /// Learns of a frame, or of a part of one. Gives its number.
    fn learn(&mut self, bytes: &[u8]) -> u32 {
        let long = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let (scale, frame, seq) = (u16::from_le_bytes([bytes[2], bytes[3]]), long(4), long(8));
        self.bytes += bytes.len();
        if bytes[0] == KIND_WHOLE {
            let there = long(20) as usize + bytes.len() - PART_HEAD_BYTES;
            if there < long(24) as usize {
                return frame;
            }
            (self.settled, self.shown) = (self.settled + 1, seq);
        }
        let later = self.sent.split_off(&(seq + 1));
        let shown = std::mem::replace(&mut self.sent, later);
        self.times_ms.extend(shown.get(&seq).map(|at| at.elapsed().as_secs_f64() * 1e3));
        self.frames += 1;
        *self.scales.entry(scale).or_default() += 1;
        frame
    }
}

/// Count, median, 99th percentile and maximum.
pub(crate) fn percentiles(times_ms: &[f64]) -> Value {
    let mut times = times_ms.to_vec();
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get(((times.len() as f64 * share).ceil() as usize).saturating_sub(1));
    json!({ "count": times.len(), "p50": at(0.5), "p99": at(0.99), "max": times.last() })
}
