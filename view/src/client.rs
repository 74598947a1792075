//! `Client`: what is to go to one page, between the session's thread, the one that reads from it and the one that
//! writes to it.
//!
//! ```text
//! blocks are marked -> one frame goes, with all that is marked -> the page draws it, acknowledges -> the next
//!                      what changes meanwhile is marked ........................................'
//! nothing is marked -> a part of the settled picture goes -> the page has it, acknowledges -> the next part
//! ```
//!
//! Invariants: 1. one frame is in flight, or one part: what is newer waits for no more, and has the parts left dropped;
//! 2. texts that wait are bounded: a page that takes none is let go; 3. nobody but its own writer ever waits for a
//! page.

use crate::blocks::{Layout, Marks};
use crate::picture::{Changed, Settled};
use crate::state::Stats;
use crate::window::Window;
use std::collections::VecDeque;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Instant;
use trex_store::Lease;

/// Most texts that wait.
const TEXTS_MAX: usize = 256;
/// Most bytes of texts that wait; a single one may be longer.
pub(crate) const TEXT_BYTES_MAX: usize = 128 << 10;
/// Bytes of a part of a settled picture: 0.1 s of 2.5 Mbit/s. With its head it stays below 32 KiB.
pub(crate) const PART_BYTES: usize = (32 << 10) - 64;
/// Codes of closing.
pub(crate) mod close {
    /// All is well.
    pub(crate) const NORMAL: u16 = 1000;
    /// The server ends.
    pub(crate) const GOING_AWAY: u16 = 1001;
    /// It broke a rule.
    pub(crate) const POLICY: u16 = 1008;
    /// It said a wrong token.
    pub(crate) const BAD_TOKEN: u16 = 4401;
}

/// A page that is connected.
#[derive(Debug)]
pub(crate) struct Client {
    pub(crate) id: u32,
    pub(crate) stream: TcpStream,
    outbox: Mutex<Outbox>,
    wake: Condvar,
}

/// What is to go.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) marks: Marks,
    pub(crate) window: Window,
    /// The settled picture, and how many of its bytes have gone.
    settled: Option<(Settled, usize)>,
    in_flight: Option<InFlight>,
    texts: VecDeque<String>,
    text_bytes: usize,
    stats: Option<Arc<Stats>>,
    files: VecDeque<File>,
    pong: Option<Vec<u8>>,
    close: Option<u16>,
    sent: Sent,
}

/// A file for the page.
#[derive(Debug)]
pub(crate) struct File {
    /// What goes before it in its message.
    pub(crate) head: Vec<u8>,
    pub(crate) bytes: Vec<u8>,
    pub(crate) _lease: Lease,
}

/// A frame on its way.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    frame: u32,
    since: Instant,
    bytes: usize,
    blocks: usize,
    /// The page has a picture to draw of it.
    is_whole: bool,
}

/// What has been sent.
#[derive(Clone, Copy, Debug)]
struct Sent {
    bytes: u64,
    frames: u64,
    /// The same when statistics went last, and when that was.
    before: (u64, u64),
    at: Instant,
}

/// What goes next.
#[derive(Debug)]
pub(crate) enum Next {
    Text(String),
    /// Marked blocks.
    Blocks,
    /// The part of a settled picture from this byte on.
    Part(Settled, usize),
    File(File),
    Pong(Vec<u8>),
    Close(u16),
}

impl Client {
    /// A page that has seen nothing of a picture, whose blocks are all marked.
    pub(crate) fn new(id: u32, stream: TcpStream, marks: Marks, settled: Option<Settled>) -> Client {
        let outbox = Outbox {
            marks,
            window: Window::default(),
            settled: settled.map(|settled| (settled, 0)),
            in_flight: None,
            texts: VecDeque::new(),
            text_bytes: 0,
            stats: None,
            files: VecDeque::new(),
            pong: None,
            close: None,
            sent: Sent { bytes: 0, frames: 0, before: (0, 0), at: Instant::now() },
        };
        Client { id, stream, outbox: Mutex::new(outbox), wake: Condvar::new() }
    }

    /// What is to go.
    pub(crate) fn outbox(&self) -> MutexGuard<'_, Outbox> {
        self.outbox.lock().expect("a thread of the viewer panicked")
    }

    fn change(&self, change: impl FnOnce(&mut Outbox)) {
        change(&mut self.outbox());
        self.wake.notify_one();
    }

    /// Sends a text.
    pub(crate) fn tell(&self, text: String) {
        self.change(|outbox| {
            let is_long = outbox.text_bytes > 0 && outbox.text_bytes + text.len() > TEXT_BYTES_MAX;
            if outbox.texts.len() >= TEXTS_MAX || is_long {
                outbox.close.get_or_insert(close::POLICY);
                return;
            }
            outbox.text_bytes += text.len();
            outbox.texts.push_back(text);
        });
    }

    /// Sends statistics, in place of those that have not gone.
    pub(crate) fn tell_stats(&self, stats: &Arc<Stats>) {
        self.change(|outbox| outbox.stats = Some(stats.clone()));
    }

    /// Sends a file. Its memory is leased: the budget bounds how many wait.
    pub(crate) fn send_file(&self, file: File) {
        self.change(|outbox| outbox.files.push_back(file));
    }

    /// Answers a ping.
    pub(crate) fn pong(&self, payload: Vec<u8>) {
        self.change(|outbox| outbox.pong = Some(payload));
    }

    /// Marks what has changed in a picture of `layout`.
    pub(crate) fn mark(&self, changed: &Changed, layout: Layout) {
        self.change(|outbox| {
            match changed {
                Changed::All => outbox.marks = Marks::all(layout),
                Changed::Some(marks) => outbox.marks.add(marks),
            }
            outbox.settled = None;
        });
    }

    /// Another picture begins, of which there is nothing yet.
    pub(crate) fn begin(&self, marks: Marks) {
        let mut outbox = self.outbox();
        (outbox.marks, outbox.settled) = (marks, None);
    }

    /// Sends the settled picture, once what is marked has gone.
    pub(crate) fn settle(&self, settled: &Settled) {
        self.change(|outbox| outbox.settled = Some((settled.clone(), 0)));
    }

    /// Learns that a frame has been drawn.
    pub(crate) fn acknowledge(&self, frame: u32) {
        self.change(|outbox| {
            if let Some(flight) = outbox.in_flight.take_if(|flight| flight.frame == frame) {
                outbox.window.learn(flight.bytes, flight.blocks, flight.since.elapsed());
                outbox.sent.frames += u64::from(flight.is_whole);
            }
        });
    }

    /// Ends the connection once what is being written is through.
    pub(crate) fn close(&self, code: u16) {
        self.change(|outbox| {
            outbox.close.get_or_insert(code);
        });
    }

    /// Ends the connection now.
    pub(crate) fn hang_up(&self) {
        self.close(close::GOING_AWAY);
        // It may have ended by itself.
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    /// Waits for what goes next.
    pub(crate) fn next(&self) -> Next {
        let mut outbox = self.outbox();
        loop {
            if let Some(next) = outbox.next() {
                return next;
            }
            outbox = self.wake.wait(outbox).expect("a thread of the viewer panicked");
        }
    }
}

impl Outbox {
    fn next(&mut self) -> Option<Next> {
        if let Some(code) = self.close {
            return Some(Next::Close(code));
        }
        if let Some(payload) = self.pong.take() {
            return Some(Next::Pong(payload));
        }
        if let Some(text) = self.texts.pop_front() {
            self.text_bytes -= text.len();
            return Some(Next::Text(text));
        }
        if let Some(stats) = self.stats.take() {
            return Some(Next::Text(self.sent.tell(&stats)));
        }
        if let Some(file) = self.files.pop_front() {
            return Some(Next::File(file));
        }
        if self.in_flight.is_some() {
            return None;
        }
        if !self.marks.is_empty() {
            return Some(Next::Blocks);
        }
        let (settled, gone) = self.settled.as_mut()?;
        let from = *gone;
        *gone += PART_BYTES;
        let part = Next::Part(settled.clone(), from);
        self.settled.take_if(|(settled, gone)| *gone >= settled.png.len());
        Some(part)
    }

    /// Notes that a frame of so many blocks is on its way.
    pub(crate) fn fly(&mut self, frame: u32, bytes: usize, blocks: usize) {
        self.in_flight = Some(InFlight { frame, since: Instant::now(), bytes, blocks, is_whole: true });
    }

    /// Notes that a part of a settled picture is on its way.
    pub(crate) fn fly_part(&mut self, frame: u32, bytes: usize, is_last: bool) {
        self.in_flight = Some(InFlight { frame, since: Instant::now(), bytes, blocks: 0, is_whole: is_last });
    }

    /// Counts bytes that were written.
    pub(crate) fn count_sent(&mut self, bytes: usize) {
        self.sent.bytes += bytes as u64;
    }

    /// Bytes and frames that were sent.
    pub(crate) fn sent(&self) -> (u64, u64) {
        (self.sent.bytes, self.sent.frames)
    }
}

impl Sent {
    /// Statistics, with those of this client.
    fn tell(&mut self, stats: &Stats) -> String {
        let seconds = self.at.elapsed().as_secs_f64().max(1e-3);
        let (bytes, frames) = self.before;
        let rates = [self.bytes - bytes, self.frames - frames].map(|count| count as f64 / seconds);
        (self.before, self.at) = ((self.bytes, self.frames), Instant::now());
        stats.text(self.bytes, rates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn client() -> Client {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        Client::new(1, stream, Marks::all(Layout::new([64, 64], 1)), None)
    }

    #[test]
    fn one_frame_is_in_flight() {
        let client = client();
        assert!(matches!(client.next(), Next::Blocks));
        let mut taken = vec![];
        client.outbox().marks.take(usize::MAX, &mut taken);
        client.outbox().fly(7, 1000, taken.len());
        let settled = Settled { frame: 8, png: Arc::new(vec![]) };
        client.mark(&Changed::All, Layout::new([64, 64], 4));
        client.settle(&settled);
        assert!(client.outbox().next().is_none());
        client.acknowledge(6);
        assert!(client.outbox().next().is_none());
        client.acknowledge(7);
        assert!(matches!(client.next(), Next::Blocks));
        client.outbox().marks.take(usize::MAX, &mut taken);
        assert!(matches!(client.next(), Next::Part(_, 0)));
        assert!(client.outbox().next().is_none());
    }

    /// A settled picture goes in parts, each after the one before was acknowledged; texts go in between, and what is
    /// newer has the rest dropped.
    #[test]
    fn a_settled_picture_goes_in_parts_until_another_comes() {
        let client = client();
        client.outbox().marks = Marks::none(Layout::new([64, 64], 1));
        let settled = Settled { frame: 8, png: Arc::new(vec![0; 3 * PART_BYTES - 1]) };
        client.settle(&settled);
        let mut froms = vec![];
        let next = || client.outbox().next();
        while let Some(Next::Part(settled, from)) = next() {
            froms.push(from);
            let is_last = from + PART_BYTES >= settled.png.len();
            client.outbox().fly_part(settled.frame, PART_BYTES, is_last);
            assert!(next().is_none());
            client.tell("x".into());
            assert!(matches!(next(), Some(Next::Text(_))));
            client.acknowledge(8);
        }
        assert_eq!(froms, [0, PART_BYTES, 2 * PART_BYTES]);
        assert_eq!(client.outbox().sent().1, 1);
        client.settle(&settled);
        assert!(matches!(client.next(), Next::Part(..)));
        client.mark(&Changed::All, Layout::new([64, 64], 1));
        assert!(matches!(client.next(), Next::Blocks));
        client.outbox().marks = Marks::none(Layout::new([64, 64], 1));
        assert!(client.outbox().next().is_none());
        assert_eq!(Arc::strong_count(&settled.png), 1);
    }

    #[test]
    fn a_page_that_takes_no_texts_is_let_go() {
        let client = client();
        (0..TEXTS_MAX).for_each(|_| client.tell("x".into()));
        assert!(matches!(client.next(), Next::Text(_)));
        client.tell("y".into());
        assert!(matches!(client.next(), Next::Text(_)));
        client.tell("y".repeat(TEXT_BYTES_MAX));
        assert!(matches!(client.next(), Next::Close(close::POLICY)));
    }
}
