//! `Tab`: a page of the browser, driven over DevTools: one socket, calls in order, complaints of the page kept.
//!
//! Invariants: 1. each call waits for its own answer; 2. every exception, console error and refused load that comes
//! while anything is waited for is kept until it is asked for.

use super::chromium::Chromium;
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Error, Message, WebSocket};

/// An answer of a browser on a busy machine.
const ANSWER: Duration = Duration::from_secs(60);
/// How long a state of the page is waited for.
pub(crate) const PATIENCE: Duration = Duration::from_secs(90);
/// The socket gives up a read after this, so that a wait can end.
const READ: Duration = Duration::from_millis(50);
/// A picture of the page is one message.
const MESSAGE_MAX_BYTES: usize = 64 << 20;

/// A page under DevTools.
pub(crate) struct Tab {
    // First, so that the socket is closed before the browser is killed.
    socket: WebSocket<TcpStream>,
    session: Option<String>,
    calls: u64,
    complaints: Vec<String>,
    chromium: Chromium,
}

impl Tab {
    /// Opens an empty page of `size` (width, height; CSS pixels).
    pub(crate) fn open(command: &Path, size: [u32; 2]) -> Tab {
        let mut chromium = Chromium::start(command);
        let (port, path) = chromium.devtools();
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_nodelay(true).unwrap();
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_MAX_BYTES))
            .max_frame_size(Some(MESSAGE_MAX_BYTES));
        let address = format!("ws://127.0.0.1:{port}{path}");
        let (socket, _) = tungstenite::client::client_with_config(address, stream, Some(config)).unwrap();
        socket.get_ref().set_read_timeout(Some(READ)).unwrap();
        let mut tab = Tab { socket, session: None, calls: 0, complaints: Vec::new(), chromium };
        let target = tab.call("Target.createTarget", json!({ "url": "about:blank" }));
        let target = json!({ "targetId": target["targetId"], "flatten": true });
        let session = tab.call("Target.attachToTarget", target);
        let downloads = json!({ "behavior": "allow", "downloadPath": tab.downloads() });
        tab.call("Browser.setDownloadBehavior", downloads);
        tab.session = session["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            tab.call(&format!("{domain}.enable"), json!({}));
        }
        let metrics = json!({ "width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": false });
        tab.call("Emulation.setDeviceMetricsOverride", metrics);
        tab
    }

    /// The folder that downloads go to.
    pub(crate) fn downloads(&self) -> PathBuf {
        self.chromium.folder().join("downloads")
    }

    /// Goes to `address`.
    pub(crate) fn go(&mut self, address: &str) {
        self.call("Page.navigate", json!({ "url": address }));
    }

    /// Calls a method of DevTools and gives its result.
    #[track_caller]
    pub(crate) fn call(&mut self, method: &str, params: Value) -> Value {
        self.calls += 1;
        let id = self.calls;
        let mut call = json!({ "id": id, "method": method, "params": params });
        if let Some(session) = &self.session {
            call["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        let begin = Instant::now();
        while begin.elapsed() < ANSWER {
            let Some(message) = self.read() else { continue };
            if message["id"] == id {
                assert!(message.get("error").is_none(), "{method} {params}: {}", message["error"]);
                return message["result"].clone();
            }
        }
        panic!("no answer to {method} within {} s", ANSWER.as_secs());
    }

    /// The next message, if one comes in time; what is a complaint is kept.
    fn read(&mut self) -> Option<Value> {
        let text = match self.socket.read() {
            Ok(Message::Text(text)) => text,
            Ok(_) => return None,
            Err(Error::Io(error)) if is_late(&error) => return None,
            Err(error) => panic!("DevTools: {error}"),
        };
        let message: Value = serde_json::from_str(text.as_str()).unwrap();
        let params = &message["params"];
        let is_complaint = match message["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => true,
            "Runtime.consoleAPICalled" => {
                ["error", "warning", "assert"].iter().any(|kind| params["type"] == *kind)
            }
            "Log.entryAdded" => ["error", "warning"].iter().any(|level| params["entry"]["level"] == *level),
            _ => false,
        };
        if is_complaint {
            self.complaints.push(params.to_string());
        }
        Some(message)
    }

    /// The value of an expression of JavaScript; promises are awaited.
    #[track_caller]
    pub(crate) fn value(&mut self, expression: &str) -> Value {
        let params = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.call("Runtime.evaluate", params);
        let thrown = answer.get("exceptionDetails");
        assert!(thrown.is_none(), "{expression}: {}", thrown.unwrap_or(&Value::Null));
        answer["result"].get("value").cloned().unwrap_or(Value::Null)
    }

    /// The number that an expression gives.
    #[track_caller]
    pub(crate) fn number(&mut self, expression: &str) -> f64 {
        let value = self.value(expression);
        value.as_f64().unwrap_or_else(|| panic!("{expression} is {value}"))
    }

    /// Waits until `expression` is true.
    #[track_caller]
    pub(crate) fn wait_for(&mut self, expression: &str) {
        let begin = Instant::now();
        let guarded =
            format!("(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()");
        while self.value(&guarded) != Value::Bool(true) {
            if begin.elapsed() > PATIENCE {
                let state = self.value("document.body.innerText");
                panic!("not within {} s: {expression}\n{state}\n{:#?}", PATIENCE.as_secs(), self.complaints);
            }
            self.listen(READ);
        }
    }

    /// Takes what comes for so long.
    pub(crate) fn listen(&mut self, time: Duration) {
        let begin = Instant::now();
        while begin.elapsed() < time {
            self.read();
        }
    }

    /// What the page has complained of since the last time.
    pub(crate) fn take_complaints(&mut self) -> Vec<String> {
        self.listen(READ);
        std::mem::take(&mut self.complaints)
    }

    /// A mouse event of `kind` at a place, with the left button's state.
    pub(crate) fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], modifiers: u32) {
        let is_down = kind != "mouseReleased";
        let params = json!({
            "type": kind, "x": x, "y": y, "button": "left", "buttons": u32::from(is_down), "clickCount": 1,
            "modifiers": modifiers,
        });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Drags with the left button in `steps` movements.
    pub(crate) fn drag(&mut self, from: [f64; 2], to: [f64; 2], steps: u32) {
        self.mouse("mousePressed", from, 0);
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            let at = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            self.mouse("mouseMoved", at, 0);
            self.listen(Duration::from_millis(30));
        }
        self.mouse("mouseReleased", to, 0);
    }

    /// A click, with the keys of `modifiers` held (2: Ctrl).
    pub(crate) fn click(&mut self, at: [f64; 2], modifiers: u32) {
        self.mouse("mousePressed", at, modifiers);
        self.mouse("mouseReleased", at, modifiers);
    }

    /// A turn of the wheel.
    pub(crate) fn wheel(&mut self, [x, y]: [f64; 2], amount: f64) {
        let params = json!({ "type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": amount });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Fingers at places; none: all are lifted.
    pub(crate) fn touch(&mut self, kind: &str, points: &[[f64; 2]]) {
        let points: Vec<Value> =
            (0..).zip(points).map(|(id, [x, y])| json!({ "x": x, "y": y, "id": id })).collect();
        self.call("Input.dispatchTouchEvent", json!({ "type": kind, "touchPoints": points }));
    }

    /// A key pressed, held for a time and let go. `code`: its place on the keyboard.
    pub(crate) fn key(&mut self, key: &str, code: &str, held: Duration) {
        for kind in ["keyDown", "keyUp"] {
            let params = json!({ "type": kind, "key": key, "code": code });
            self.call("Input.dispatchKeyEvent", params);
            self.listen(if kind == "keyDown" { held } else { Duration::ZERO });
        }
    }
}

/// Nothing came in time, or a signal was taken in between: a socket with a time limit says so.
fn is_late(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
