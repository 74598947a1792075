//! `Client`: a page that is connected, between the session's thread, the one that reads from it and the one that writes
//! to it. What goes to it, and when, is up to its [`Outbox`].
//!
//! Invariant: nobody but its own writer ever waits for a page.

use crate::blocks::{Layout, Marks};
use crate::outbox::{File, Next, Outbox, close};
use crate::picture::{BlockChanges, SettledPng};
use crate::state::Stats;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Instant;

/// A page that is connected.
#[derive(Debug)]
pub(crate) struct Client {
    pub(crate) id: u32,
    pub(crate) stream: Arc<TcpStream>,
    outbox: Mutex<Outbox>,
    wake: Condvar,
}

impl Client {
    /// A page at the other end of `stream`.
    pub(crate) fn new(id: u32, stream: Arc<TcpStream>, outbox: Outbox) -> Client {
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
    pub(crate) fn send_text(&self, text: String) {
        self.change(|outbox| outbox.push_text(text));
    }

    /// Sends statistics, in place of those that have not gone.
    pub(crate) fn send_stats(&self, stats: &Arc<Stats>) {
        self.change(|outbox| outbox.set_stats(stats.clone()));
    }

    /// Sends a file.
    pub(crate) fn send_file(&self, file: File) {
        self.change(|outbox| outbox.push_file(file));
    }

    /// Answers a ping.
    pub(crate) fn pong(&self, payload: Vec<u8>) {
        self.change(|outbox| outbox.set_pong(payload));
    }

    /// Marks what has changed in a picture of `layout`.
    pub(crate) fn mark(&self, changed: &BlockChanges, layout: Layout) {
        self.change(|outbox| {
            match changed {
                BlockChanges::All => outbox.marks = Marks::all(layout),
                BlockChanges::Some(marks) => outbox.marks.add(marks),
            }
            outbox.set_settled(None);
        });
    }

    /// Another picture begins, of which there is nothing yet.
    pub(crate) fn begin(&self, marks: Marks) {
        let mut outbox = self.outbox();
        outbox.marks = marks;
        outbox.set_settled(None);
    }

    /// Sends the settled picture, once what is marked has gone.
    pub(crate) fn settle(&self, settled: &SettledPng) {
        self.change(|outbox| outbox.set_settled(Some(settled.clone())));
    }

    /// Learns that a frame has been drawn.
    pub(crate) fn acknowledge(&self, frame: u32) {
        self.change(|outbox| outbox.acknowledge(frame));
    }

    /// Ends the connection once what is being written is through.
    pub(crate) fn close(&self, code: u16) {
        self.change(|outbox| outbox.close(code));
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
            let now = Instant::now();
            if let Some(next) = outbox.next(now) {
                return next;
            }
            outbox = match outbox.wakes_at() {
                None => self.wake.wait(outbox).expect("a thread of the viewer panicked"),
                Some(at) => {
                    let longest = at.saturating_duration_since(now);
                    self.wake.wait_timeout(outbox, longest).expect("a thread of the viewer panicked").0
                }
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outbox::PART_BYTES;
    use std::net::TcpListener;
    use std::time::Duration;

    fn client() -> Client {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let marks = Marks::all(Layout::new([64, 64], 1));
        Client::new(1, Arc::new(stream), Outbox::new(marks, None, Duration::from_secs(60)))
    }

    #[test]
    fn one_frame_is_in_flight() {
        let client = client();
        assert!(matches!(client.next(), Next::Blocks));
        let mut taken = vec![];
        client.outbox().marks.take(usize::MAX, &mut taken);
        client.outbox().fly(7, 1000, taken.len());
        let settled = SettledPng { frame: 8, png: Arc::new(vec![]) };
        client.mark(&BlockChanges::All, Layout::new([64, 64], 4));
        client.settle(&settled);
        assert!(client.outbox().next(Instant::now()).is_none());
        client.acknowledge(6);
        assert!(client.outbox().next(Instant::now()).is_none());
        client.acknowledge(7);
        assert!(matches!(client.next(), Next::Blocks));
        client.outbox().marks.take(usize::MAX, &mut taken);
        assert!(matches!(client.next(), Next::Part(_, 0)));
        assert!(client.outbox().next(Instant::now()).is_none());
    }

    /// A settled picture goes in parts, each after the one before was acknowledged; texts go in between, and what is
    /// newer has the rest dropped.
    #[test]
    fn a_settled_picture_goes_in_parts_until_another_comes() {
        let client = client();
        client.outbox().marks = Marks::none(Layout::new([64, 64], 1));
        let settled = SettledPng { frame: 8, png: Arc::new(vec![0; 3 * PART_BYTES - 1]) };
        client.settle(&settled);
        let mut froms = vec![];
        let next = || client.outbox().next(Instant::now());
        while let Some(Next::Part(settled, from)) = next() {
            froms.push(from);
            let is_last = from + PART_BYTES >= settled.png.len();
            client.outbox().fly_part(settled.frame, PART_BYTES, is_last);
            assert!(next().is_none());
            client.send_text("x".into());
            assert!(matches!(next(), Some(Next::Text(_))));
            client.acknowledge(8);
        }
        assert_eq!(froms, [0, PART_BYTES, 2 * PART_BYTES]);
        assert_eq!(client.outbox().sent().1, 1);
        client.settle(&settled);
        assert!(matches!(client.next(), Next::Part(..)));
        client.mark(&BlockChanges::All, Layout::new([64, 64], 1));
        assert!(matches!(client.next(), Next::Blocks));
        client.outbox().marks = Marks::none(Layout::new([64, 64], 1));
        assert!(client.outbox().next(Instant::now()).is_none());
        assert_eq!(Arc::strong_count(&settled.png), 1);
    }
}
