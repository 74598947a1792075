//! A client's two threads: one reads what the page says, one writes what it is to see.
//!
//! ```text
//! head, upgrade -> hello in time, with the token -> welcome -> reader: ack, events -> mailbox
//!                                                              writer: outbox -> texts, frames
//! ```
//!
//! Invariants: 1. nothing but a close goes to who has not said the token; 2. a message is bounded before it is kept; 3.
//! a page that takes nothing of what is written for [`WRITE_TIME_MAX`], or gives no sign of life for the time that its
//! outbox allows, is let go; 4. the reader ends the writer, and the other way round; 5. a shutdown of the stream ends
//! both at once.

use crate::atlas::{FrameHead, FrameWidth, frame_bytes, part_head};
use crate::client::Client;
use crate::guard::Token;
use crate::http::{DeadlineStream, HEAD_TIME_MAX};
use crate::mail::PostOutcome;
use crate::message::{FromClient, MESSAGE_BYTES_MAX, Notice, text_of};
use crate::outbox::{Next, PART_BYTES, close};
use crate::picture::SettledPng;
use crate::reception::WRITE_TIME_MAX;
use crate::shared::SharedState;
use std::io::{self, Write};
use std::net::{Shutdown, TcpStream};
use std::thread;
use std::time::Instant;
use tungstenite::protocol::frame::FrameHeader;
use tungstenite::protocol::frame::coding::{Control, Data, OpCode};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Bytes that are read at a time.
const READ_BYTES: usize = 16 << 10;
/// Stack of a writer.
const WRITER_STACK_BYTES: usize = 512 << 10;
/// Most messages that cannot be read before who sends them is let go.
const WRONG_MAX: u32 = 16;

/// The socket of a page.
pub(crate) type Socket = WebSocket<DeadlineStream>;

/// Serves a page whose request to become a socket has been granted; `rest` is what came after its head.
pub(crate) fn serve(shared: &SharedState, incoming: DeadlineStream, rest: Vec<u8>) {
    let Some((mut socket, size)) = open(&shared.admission.token, incoming, rest) else { return };
    let stream = socket.get_ref().stream.clone();
    let Some(client) = shared.admit(stream.clone(), size) else {
        return say_goodbye(&stream, close::GOING_AWAY);
    };
    thread::scope(|scope| {
        let writer = thread::Builder::new().name("view-write".into()).stack_size(WRITER_STACK_BYTES);
        if writer.spawn_scoped(scope, || write(shared, &client)).is_ok() {
            client.close(read(shared, &client, &mut socket));
        }
    });
    shared.dismiss(&client);
}

/// The socket of a page that says the token in time, and the size that it says it has; else it is closed.
pub(crate) fn open(token: &Token, mut incoming: DeadlineStream, rest: Vec<u8>) -> Option<(Socket, [u32; 2])> {
    incoming.deadline = Some(Instant::now() + HEAD_TIME_MAX);
    let config = WebSocketConfig::default()
        .read_buffer_size(READ_BYTES)
        .max_message_size(Some(MESSAGE_BYTES_MAX))
        .max_frame_size(Some(MESSAGE_BYTES_MAX));
    let mut socket = WebSocket::from_partially_read(incoming, rest, Role::Server, Some(config));
    match hello(token, &mut socket) {
        Ok(size) => {
            let incoming = socket.get_mut();
            incoming.deadline = None;
            incoming.stream.set_read_timeout(None).ok().map(|()| (socket, size))
        }
        Err(code) => {
            say_goodbye(&socket.get_ref().stream, code);
            None
        }
    }
}

/// The size that a page says it has, once it has said the token; else the code to close with.
fn hello(token: &Token, socket: &mut Socket) -> Result<[u32; 2], u16> {
    let text = loop {
        match socket.read() {
            Ok(Message::Text(text)) => break text,
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            _ => return Err(close::POLICY),
        }
    };
    match serde_json::from_str(&text) {
        Ok(FromClient::Hello { token: said, size, .. }) if token.is(&said) => Ok(size),
        Ok(FromClient::Hello { .. }) => Err(close::BAD_TOKEN),
        _ => Err(close::POLICY),
    }
}

/// Reads until the page has gone. Gives the code to close with.
fn read(shared: &SharedState, client: &Client, socket: &mut Socket) -> u16 {
    let mut wrong = 0;
    loop {
        let message = socket.read();
        client.outbox().hear();
        let text = match message {
            Ok(Message::Text(text)) => text,
            Ok(Message::Ping(payload)) => {
                client.pong(payload.to_vec());
                continue;
            }
            Ok(Message::Pong(_)) => continue,
            Ok(Message::Close(_)) => return close::NORMAL,
            Ok(_) | Err(_) => return close::POLICY,
        };
        match serde_json::from_str(&text) {
            Ok(FromClient::Ack { frame }) => client.acknowledge(frame),
            // Once is enough.
            Ok(FromClient::Hello { .. }) => return close::POLICY,
            Ok(message) => {
                let is_shot = matches!(message, FromClient::Screenshot { .. });
                answer(client, shared.mailbox.post(client.id, message), is_shot);
            }
            Err(error) => {
                wrong += 1;
                if wrong > WRONG_MAX {
                    return close::POLICY;
                }
                client.send_text(text_of(&Notice::wrong(&error.to_string())));
            }
        }
    }
}

/// Answers a message that changed nothing: one for a screenshot by a code by which the page knows that none comes.
fn answer(client: &Client, posted: PostOutcome, is_shot: bool) {
    let notice = match posted {
        PostOutcome::Accepted => return,
        PostOutcome::Watching => Notice::info("watching", "somebody else drives", "ask for the wheel"),
        PostOutcome::Driven => {
            let next = "wait until the driver has been idle for 10 s, and ask again";
            Notice::info("driven", "the wheel is not free", next)
        }
        PostOutcome::Full => {
            Notice::info("busy", "too much waits to be done; this was left out", "wait a little")
        }
        PostOutcome::Cancelled => Notice::cancelled(),
    };
    client.send_text(text_of(&if is_shot { notice.of("screenshot") } else { notice }));
}

/// Writes until there is nothing more to write, or nobody who takes it.
fn write(shared: &SharedState, client: &Client) {
    let mut frame = Vec::new();
    // The reader learns of the end by the stream's.
    let _ = write_all(shared, client, &mut frame);
    let _ = client.stream.shutdown(Shutdown::Both);
}

fn write_all(shared: &SharedState, client: &Client, frame: &mut Vec<u8>) -> io::Result<()> {
    client.stream.set_write_timeout(Some(WRITE_TIME_MAX))?;
    loop {
        match client.next() {
            Next::Text(text) => send(client, OpCode::Data(Data::Text), text.as_bytes())?,
            Next::Ping => send(client, OpCode::Control(Control::Ping), &[])?,
            Next::Pong(payload) => send(client, OpCode::Control(Control::Pong), &payload)?,
            Next::Blocks => send_blocks(shared, client, frame)?,
            Next::Part(settled, from) => send_part(shared, client, &settled, from)?,
            Next::File(file) => {
                put(client, &file.head)?;
                put(client, &file.bytes)?;
            }
            Next::Close(code) => {
                say_goodbye(&client.stream, code);
                return Ok(());
            }
        }
    }
}

/// Sends what is marked, or as much of it as the line bears.
fn send_blocks(shared: &SharedState, client: &Client, frame: &mut Vec<u8>) -> io::Result<()> {
    let Some(_wide) = shared.wide_frame(client.id) else {
        return send_frame(shared, client, frame, FrameWidth::Narrow);
    };
    let sent = send_frame(shared, client, frame, FrameWidth::Wide);
    // The next wide frame may be another client's.
    *frame = Vec::new();
    sent
}

fn send_frame(
    shared: &SharedState,
    client: &Client,
    frame: &mut Vec<u8>,
    width: FrameWidth,
) -> io::Result<()> {
    let mut atlas = shared.atlas();
    let mut most_blocks = usize::MAX;
    let start = loop {
        let picture = shared.picture();
        let mut outbox = client.outbox();
        // A picture that moves is seen whole or not at all.
        let bearable = if picture.scale == 1 { outbox.window.blocks() } else { usize::MAX };
        atlas.blocks.clear();
        outbox.marks.take(bearable.min(most_blocks), &mut atlas.blocks);
        drop(outbox);
        if atlas.blocks.is_empty() {
            // Another picture has begun meanwhile.
            return Ok(());
        }
        atlas.copy(&picture);
        let layout = picture.layout;
        let most = frame_bytes(picture.full, width);
        drop(picture);
        if frame.capacity() > most {
            *frame = Vec::new();
        }
        if let Some(start) = atlas.encode(most, frame) {
            break start;
        }
        // They go in more than one frame, unless the picture has become another one meanwhile.
        most_blocks = (atlas.blocks.len() / 2).max(1);
        let picture = shared.picture();
        if picture.layout == layout {
            client.outbox().marks.put_back(&atlas.blocks);
        }
    };
    client.outbox().fly(atlas.head().frame, frame.len() - start, atlas.blocks.len());
    drop(atlas);
    put(client, &frame[start..])
}

/// Sends the part of a settled picture from a byte on, unless another picture has begun meanwhile.
fn send_part(shared: &SharedState, client: &Client, settled: &SettledPng, from: usize) -> io::Result<()> {
    let head = {
        let picture = shared.picture();
        if picture.frame != settled.frame {
            return Ok(());
        }
        FrameHead::new(&picture)
    };
    let total = settled.png.len();
    let part = &settled.png[from..total.min(from + PART_BYTES)];
    client.outbox().fly_part(settled.frame, part.len(), from + part.len() == total);
    put(client, &part_head(head, from, part.len(), total))?;
    put(client, part)
}

/// Sends a short message.
fn send(client: &Client, opcode: OpCode, payload: &[u8]) -> io::Result<()> {
    put(client, &header(opcode, payload.len()))?;
    put(client, payload)
}

fn put(client: &Client, bytes: &[u8]) -> io::Result<()> {
    if bytes.is_empty() {
        return Ok(());
    }
    // Before they go: a page that answers at once would owe an answer from then on.
    client.outbox().count_sent(bytes.len(), Instant::now());
    (&*client.stream).write_all(bytes)
}

/// The header of a message of so many bytes.
fn header(opcode: OpCode, length: usize) -> Vec<u8> {
    let header = FrameHeader { opcode, ..FrameHeader::default() };
    let mut bytes = Vec::with_capacity(header.len(length as u64));
    header.format(length as u64, &mut bytes).expect("a vector takes what is written");
    bytes
}

/// Sends a text to a page that is no client.
pub(crate) fn send_text(mut stream: &TcpStream, text: &str) -> io::Result<()> {
    stream.write_all(&header(OpCode::Data(Data::Text), text.len()))?;
    stream.write_all(text.as_bytes())
}

/// Sends the close of a connection.
pub(crate) fn say_goodbye(mut stream: &TcpStream, code: u16) {
    // Who has gone hears nothing.
    let _ = stream.set_write_timeout(Some(WRITE_TIME_MAX));
    let code = code.to_be_bytes();
    let _ = stream.write_all(&[header(OpCode::Control(Control::Close), code.len()), code.to_vec()].concat());
}
