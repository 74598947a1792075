//! A page as a test plays it.

use crate::stage::Server;
use serde_json::{Value, json};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Error, Message, WebSocket};

/// Longest wait for what has to come.
const PATIENCE: Duration = Duration::from_secs(60);
/// Side of a block, pixels.
const BLOCK: u32 = 16;

/// A page that is connected.
pub(crate) struct Page {
    socket: WebSocket<TcpStream>,
    pub(crate) welcome: Value,
    /// Texts that came while something else was waited for.
    pub(crate) texts: Vec<Value>,
    /// The settled picture, as far as its parts have come.
    parts: Vec<u8>,
    /// Said once when a part has come, some time before that is acknowledged.
    pub(crate) on_part: Option<Value>,
}

/// A frame.
pub(crate) struct Frame {
    pub(crate) kind: u8,
    pub(crate) flags: u8,
    pub(crate) scale: u32,
    pub(crate) frame: u32,
    pub(crate) seq: u32,
    pub(crate) size: [u32; 2],
    pub(crate) blocks: Vec<u16>,
    /// The JPEG, the PNG, or the file.
    pub(crate) body: Vec<u8>,
}

/// What came.
pub(crate) enum Came {
    Text(Value),
    Frame(Frame),
    File { id: u32, format: u8, body: Vec<u8> },
    Closed(u16),
    Nothing,
}

/// A connection that has become a socket; else the status of its refusal.
pub(crate) fn connect(
    server: &Server,
    headers: &[(&'static str, &str)],
) -> Result<WebSocket<TcpStream>, u16> {
    let mut request = format!("ws://{}/socket", server.address).into_client_request().unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    let stream = TcpStream::connect(server.address).unwrap();
    stream.set_nodelay(true).unwrap();
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(Error::Http(answer))) => Err(answer.status().as_u16()),
        Err(other) => panic!("{other}"),
    }
}

impl Page {
    /// A page of `size` pixels.
    pub(crate) fn new(server: &Server, size: [u32; 2]) -> Page {
        let socket = connect(server, &[]).unwrap_or_else(|status| panic!("refused: {status}"));
        let mut page = Page { socket, welcome: Value::Null, texts: vec![], parts: vec![], on_part: None };
        page.say(&json!({"type": "hello", "token": server.token, "size": size}));
        match page.next(PATIENCE) {
            Came::Text(text) if text["type"] == "welcome" => page.welcome = text,
            _ => panic!("no welcome"),
        }
        page
    }

    /// Sends a message.
    pub(crate) fn say(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// Sends any message; whoever hears it may hang up.
    pub(crate) fn throw(&mut self, message: Message) {
        let _ = self.socket.send(message);
    }

    /// Says that a frame is drawn.
    pub(crate) fn acknowledge(&mut self, frame: &Frame) {
        self.say(&json!({"type": "ack", "frame": frame.frame}));
    }

    /// What comes within a time.
    pub(crate) fn next(&mut self, time: Duration) -> Came {
        self.socket.get_mut().set_read_timeout(Some(time)).unwrap();
        match self.socket.read() {
            Ok(Message::Text(text)) => Came::Text(serde_json::from_str(&text).unwrap()),
            Ok(Message::Binary(bytes)) if bytes[0] == 3 => Came::File {
                id: u32::from_le_bytes(bytes[4..8].try_into().unwrap()),
                format: bytes[1],
                body: bytes[8..].to_vec(),
            },
            Ok(Message::Binary(bytes)) => match self.whole(&bytes) {
                Some(frame) => Came::Frame(frame),
                None => self.next(time),
            },
            Ok(Message::Close(close)) => Came::Closed(close.map_or(0, |close| close.code.into())),
            Err(Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => Came::Nothing,
            Ok(_) => self.next(time),
            // The kernel's work for rings of this thread comes in between.
            Err(Error::Io(error)) if error.kind() == std::io::ErrorKind::Interrupted => self.next(time),
            Err(_) => Came::Closed(0),
        }
    }

    /// The frame that a message brings; none for a part of a picture, which is acknowledged, until its last.
    fn whole(&mut self, bytes: &[u8]) -> Option<Frame> {
        let mut frame = Frame::read(bytes);
        if frame.kind == 1 {
            self.parts.clear();
            return Some(frame);
        }
        assert!(bytes.len() <= 32 << 10, "a part of {} bytes", bytes.len());
        let (head, part) = frame.body.split_at(8);
        let [from, total] =
            [0, 4].map(|at| u32::from_le_bytes(head[at..at + 4].try_into().unwrap()) as usize);
        if from == 0 {
            self.parts.clear();
        }
        assert_eq!(from, self.parts.len(), "parts come in order");
        self.parts.extend_from_slice(part);
        assert!(self.parts.len() <= total);
        if self.parts.len() < total {
            if let Some(said) = self.on_part.take() {
                self.say(&said);
                std::thread::sleep(Duration::from_millis(500));
            }
            self.acknowledge(&frame);
            return None;
        }
        frame.body = std::mem::take(&mut self.parts);
        assert!(frame.body.starts_with(b"\x89PNG"), "{frame:?}");
        Some(frame)
    }

    /// The next frame, not acknowledged.
    #[track_caller]
    pub(crate) fn frame(&mut self) -> Frame {
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            match self.next(PATIENCE) {
                Came::Frame(frame) => return frame,
                Came::Text(text) => self.texts.push(text),
                Came::File { .. } => {}
                Came::Closed(code) => panic!("closed: {code}"),
                Came::Nothing => break,
            }
        }
        panic!("no frame came")
    }

    /// The next text of this type; frames are acknowledged meanwhile.
    #[track_caller]
    pub(crate) fn text(&mut self, kind: &str) -> Value {
        if let Some(at) = self.texts.iter().position(|text| text["type"] == kind) {
            return self.texts.remove(at);
        }
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            match self.next(PATIENCE) {
                Came::Text(text) if text["type"] == kind => return text,
                Came::Text(text) => self.texts.push(text),
                Came::Frame(frame) => self.acknowledge(&frame),
                Came::File { .. } => {}
                Came::Closed(code) => panic!("closed: {code}"),
                Came::Nothing => break,
            }
        }
        panic!("no {kind} came: {:?}", self.texts)
    }

    /// Acknowledges frames until one `is_it`. Gives it, acknowledged.
    #[track_caller]
    pub(crate) fn frame_until(&mut self, is_it: impl Fn(&Frame) -> bool) -> Frame {
        loop {
            let frame = self.frame();
            self.acknowledge(&frame);
            if is_it(&frame) {
                return frame;
            }
        }
    }

    /// Acknowledges frames until the settled picture. Gives it.
    #[track_caller]
    pub(crate) fn settle(&mut self) -> Frame {
        self.frame_until(|frame| frame.kind == 2)
    }

    /// The code that the connection is closed with.
    pub(crate) fn closed(&mut self) -> u16 {
        loop {
            match self.next(PATIENCE) {
                Came::Closed(code) => return code,
                Came::Nothing => panic!("not closed"),
                _ => {}
            }
        }
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Frame { kind, flags, scale, frame, seq, size, blocks, body } = self;
        let (count, bytes) = (blocks.len(), body.len());
        write!(f, "kind {kind}, flags {flags}, scale {scale}, frame {frame}, seq {seq}, {size:?}, ")?;
        write!(f, "{count} blocks, {bytes} bytes")
    }
}

impl Frame {
    fn read(bytes: &[u8]) -> Frame {
        let short = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let long = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let count = usize::from(short(18));
        let frame = Frame {
            kind: bytes[0],
            flags: bytes[1],
            scale: short(2).into(),
            frame: long(4),
            seq: long(8),
            size: [short(12).into(), short(14).into()],
            blocks: (0..count).map(|block| short(20 + 2 * block)).collect(),
            body: bytes[20 + 2 * count..].to_vec(),
        };
        assert!(frame.kind == 2 || frame.body.starts_with(&[0xff, 0xd8, 0xff]), "{frame:?}");
        assert!(frame.blocks.windows(2).all(|pair| pair[0] < pair[1]), "{:?}", frame.blocks);
        assert!(frame.blocks.iter().all(|&block| u32::from(block) < frame.blocks_in_all()));
        frame
    }

    /// Blocks of the picture that is sent.
    pub(crate) fn blocks_in_all(&self) -> u32 {
        self.size.map(|side| side.div_ceil(self.scale).div_ceil(BLOCK)).iter().product()
    }
}
