//! `Outbox`: what is to go to one page, what is on its way to it, and when it was heard last.
//!
//! ```text
//! blocks are marked -> one frame goes, with all that is marked -> the page draws it, acknowledges -> the next
//!                      what changes meanwhile is marked ........................................'
//! nothing is marked -> a part of the settled picture goes -> the page has it, acknowledges -> the next part
//! something was sent -> nothing is heard for half of the longest silence: a ping -> for all of it: the page is let go
//! ```
//!
//! Invariants: 1. one frame is in flight, or one part: what is newer waits for no more, and has the parts left dropped;
//! 2. texts that wait or are being written take at most [`TEXT_BYTES_MAX`] together: a page that takes none is let go;
//! 3. a page that owes nothing is asked nothing: a picture that stands still costs no message.

use crate::atlas::header;
use crate::blocks::Marks;
use crate::picture::SettledPng;
use crate::state::Stats;
use crate::window::Window;
use crate::wire::{FILE_EXR, FILE_HEAD_BYTES, FILE_PNG, FILE_SCENE, KIND_FILE};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use trex_store::{Budget, Lease, Result};

/// Most texts that wait.
const TEXTS_MAX: usize = 256;
/// Most bytes of texts that wait or are being written.
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
    pub(crate) const BAD_TOKEN: u16 = crate::wire::CLOSE_BAD_TOKEN;
}

/// See the module's description.
#[derive(Debug)]
pub(crate) struct Outbox {
    pub(crate) marks: Marks,
    pub(crate) window: Window,
    /// The settled picture, and how many of its bytes have gone.
    settled: Option<(SettledPng, usize)>,
    in_flight: Option<InFlight>,
    texts: VecDeque<String>,
    /// Of texts that wait, and of the one that is being written.
    text_bytes: usize,
    written_bytes: usize,
    stats: Option<Arc<Stats>>,
    files: VecDeque<File>,
    pong: Option<Vec<u8>>,
    close: Option<u16>,
    sent: SendCounts,
    debt: Debt,
}

/// A file for the page.
#[derive(Debug)]
pub(crate) struct File {
    /// What goes before it in its message.
    pub(crate) head: Vec<u8>,
    pub(crate) bytes: Vec<u8>,
    _room: FileRoom,
}

/// The formats of files, with their numbers in messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum FileFormat {
    Png = FILE_PNG,
    Exr = FILE_EXR,
    Scene = FILE_SCENE,
}

/// Bytes of files that are made or wait for their pages: so much less is there for frames of pages.
#[derive(Clone, Debug, Default)]
pub(crate) struct FileBytes(Arc<AtomicU64>);

/// Leased room for a file.
#[derive(Debug)]
pub(crate) struct FileRoom {
    lease: Lease,
    all: FileBytes,
}

impl FileBytes {
    /// All of them now.
    pub(crate) fn now(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }

    /// Leases room for a file of at most so many bytes.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn lease(&self, budget: &Budget, what: &str, most: u64) -> Result<FileRoom> {
        let lease = budget.lease(what, most)?;
        self.0.fetch_add(most, Ordering::AcqRel);
        Ok(FileRoom { lease, all: self.clone() })
    }
}

impl Drop for FileRoom {
    fn drop(&mut self) {
        let bytes = self.lease.bytes();
        self.lease.shrink_to(0);
        self.all.0.fetch_sub(bytes, Ordering::AcqRel);
    }
}

impl File {
    /// A file in its room, of which it gives back what it does not take.
    pub(crate) fn new(format: FileFormat, id: u32, mut bytes: Vec<u8>, mut room: FileRoom) -> File {
        bytes.shrink_to_fit();
        let (before, now) = (room.lease.bytes(), bytes.len() as u64);
        room.lease.shrink_to(now);
        room.all.0.fetch_sub(before - now, Ordering::AcqRel);
        let mut head = header(FILE_HEAD_BYTES + bytes.len());
        head.extend_from_slice(&[KIND_FILE, format as u8, 0, 0]);
        head.extend_from_slice(&id.to_le_bytes());
        File { head, bytes, _room: room }
    }
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
struct SendCounts {
    bytes: u64,
    frames: u64,
    /// Bytes and frames when statistics went last, and when that was.
    before: (u64, u64),
    at: Instant,
}

/// A sign of life that the page owes.
#[derive(Clone, Copy, Debug)]
struct Debt {
    /// When the first bytes went since it was heard.
    since: Option<Instant>,
    /// When a ping went for it.
    asked: Option<Instant>,
    longest: Duration,
}

/// What goes next.
#[derive(Debug)]
pub(crate) enum Next {
    Text(String),
    /// Marked blocks.
    Blocks,
    /// The part of a settled picture from this byte on.
    Part(SettledPng, usize),
    File(File),
    Ping,
    Pong(Vec<u8>),
    Close(u16),
}

impl Outbox {
    /// For a page that has seen nothing of a picture whose blocks are all marked, and may be silent for `silence_max`.
    pub(crate) fn new(marks: Marks, settled: Option<SettledPng>, silence_max: Duration) -> Outbox {
        Outbox {
            marks,
            window: Window::default(),
            settled: settled.map(|settled| (settled, 0)),
            in_flight: None,
            texts: VecDeque::new(),
            text_bytes: 0,
            written_bytes: 0,
            stats: None,
            files: VecDeque::new(),
            pong: None,
            close: None,
            sent: SendCounts { bytes: 0, frames: 0, before: (0, 0), at: Instant::now() },
            debt: Debt { since: None, asked: None, longest: silence_max },
        }
    }

    /// What goes next, if anything does at this time.
    pub(crate) fn next(&mut self, now: Instant) -> Option<Next> {
        // Whoever asks has written the text before.
        self.text_bytes -= std::mem::take(&mut self.written_bytes);
        if self.debt.is_unpaid(now) {
            self.close(close::POLICY);
        }
        if let Some(code) = self.close {
            return Some(Next::Close(code));
        }
        if let Some(payload) = self.pong.take() {
            return Some(Next::Pong(payload));
        }
        if self.debt.asks(now) {
            return Some(Next::Ping);
        }
        if let Some(text) = self.texts.pop_front() {
            self.written_bytes = text.len();
            return Some(Next::Text(text));
        }
        if let Some(stats) = self.stats.take() {
            return Some(Next::Text(self.sent.text(&stats)));
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

    /// When something may have to go that nobody asks for.
    pub(crate) fn wakes_at(&self) -> Option<Instant> {
        self.debt.wakes_at()
    }

    /// Adds a text; a page that has too many waiting is let go.
    pub(crate) fn push_text(&mut self, text: String) {
        let is_full = self.text_bytes + text.len() > TEXT_BYTES_MAX;
        if self.texts.len() >= TEXTS_MAX || is_full {
            return self.close(close::POLICY);
        }
        self.text_bytes += text.len();
        self.texts.push_back(text);
    }

    /// Has statistics sent, in place of those that have not gone.
    pub(crate) fn set_stats(&mut self, stats: Arc<Stats>) {
        self.stats = Some(stats);
    }

    /// Adds a file. Its memory is leased: the budget bounds how many wait.
    pub(crate) fn push_file(&mut self, file: File) {
        self.files.push_back(file);
    }

    /// Has a ping answered.
    pub(crate) fn set_pong(&mut self, payload: Vec<u8>) {
        self.pong = Some(payload);
    }

    /// Has the settled picture sent once what is marked has gone; `None` for no such picture.
    pub(crate) fn set_settled(&mut self, settled: Option<SettledPng>) {
        self.settled = settled.map(|settled| (settled, 0));
    }

    /// Has the connection closed once what is being written is through.
    pub(crate) fn close(&mut self, code: u16) {
        self.close.get_or_insert(code);
    }

    /// Notes that the page was heard.
    pub(crate) fn hear(&mut self) {
        (self.debt.since, self.debt.asked) = (None, None);
    }

    /// Learns that a frame has been drawn.
    pub(crate) fn acknowledge(&mut self, frame: u32) {
        if let Some(flight) = self.in_flight.take_if(|flight| flight.frame == frame) {
            self.window.learn(flight.bytes, flight.blocks, flight.since.elapsed());
            self.sent.frames += u64::from(flight.is_whole);
        }
    }

    /// Notes that a frame of so many blocks is on its way.
    pub(crate) fn fly(&mut self, frame: u32, bytes: usize, blocks: usize) {
        self.in_flight = Some(InFlight { frame, since: Instant::now(), bytes, blocks, is_whole: true });
    }

    /// Notes that a part of a settled picture is on its way.
    pub(crate) fn fly_part(&mut self, frame: u32, bytes: usize, is_last: bool) {
        self.in_flight = Some(InFlight { frame, since: Instant::now(), bytes, blocks: 0, is_whole: is_last });
    }

    /// Counts bytes that were written at a time.
    pub(crate) fn count_sent(&mut self, bytes: usize, now: Instant) {
        self.sent.bytes += bytes as u64;
        self.debt.since.get_or_insert(now);
    }

    /// Bytes and frames that were sent.
    pub(crate) fn sent(&self) -> (u64, u64) {
        (self.sent.bytes, self.sent.frames)
    }
}

impl Debt {
    /// True when the other half of the time has passed since it was asked: a file may have taken all of it.
    fn is_unpaid(&self, now: Instant) -> bool {
        self.asked.is_some_and(|asked| now.saturating_duration_since(asked) >= self.longest / 2)
    }

    /// True once for each debt, when half of the time has passed.
    fn asks(&mut self, now: Instant) -> bool {
        let is_due = self.since.is_some_and(|since| now.saturating_duration_since(since) >= self.longest / 2);
        let asks = is_due && self.asked.is_none();
        if asks {
            self.asked = Some(now);
        }
        asks
    }

    fn wakes_at(&self) -> Option<Instant> {
        Some(self.asked.or(self.since)? + self.longest / 2)
    }
}

impl SendCounts {
    /// Statistics as a message, with those of this client.
    fn text(&mut self, stats: &Stats) -> String {
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
    use crate::blocks::Layout;

    const SILENCE: Duration = Duration::from_secs(60);

    fn outbox() -> Outbox {
        Outbox::new(Marks::none(Layout::new([64, 64], 1)), None, SILENCE)
    }

    /// A page that neither read nor acknowledged kept its place for ever, since nothing more was written to it. Half of
    /// the time after something went it is asked, after all of it it is let go; a page that is heard owes nothing.
    #[test]
    fn a_silent_page_is_asked_and_then_let_go() {
        let (mut outbox, start) = (outbox(), Instant::now());
        assert!(outbox.next(start + 10 * SILENCE).is_none() && outbox.wakes_at().is_none());
        outbox.count_sent(100, start);
        assert_eq!(outbox.wakes_at(), Some(start + SILENCE / 2));
        assert!(outbox.next(start + SILENCE / 3).is_none());
        assert!(matches!(outbox.next(start + SILENCE / 2), Some(Next::Ping)));
        // The ping, and what else goes, is no new debt.
        outbox.count_sent(2, start + SILENCE / 2);
        assert!(outbox.next(start + SILENCE / 2).is_none());
        assert_eq!(outbox.wakes_at(), Some(start + SILENCE));
        outbox.hear();
        assert!(outbox.next(start + 10 * SILENCE).is_none() && outbox.wakes_at().is_none());
        outbox.count_sent(2, start + SILENCE);
        // A file took all of that time to be written.
        assert!(matches!(outbox.next(start + 3 * SILENCE), Some(Next::Ping)));
        assert!(outbox.next(start + 3 * SILENCE + SILENCE / 3).is_none());
        assert!(matches!(outbox.next(start + 3 * SILENCE + SILENCE / 2), Some(Next::Close(close::POLICY))));
    }

    /// The bytes of a text count until it has been written, and a single one has no way past the bound.
    #[test]
    fn texts_that_wait_or_are_written_are_bounded() {
        let (mut outbox, now) = (outbox(), Instant::now());
        outbox.push_text("x".repeat(TEXT_BYTES_MAX));
        assert!(matches!(outbox.next(now), Some(Next::Text(_))));
        outbox.push_text("y".into());
        assert!(matches!(outbox.next(now), Some(Next::Close(close::POLICY))));
        let mut outbox = self::outbox();
        outbox.push_text("x".repeat(TEXT_BYTES_MAX));
        assert!(matches!(outbox.next(now), Some(Next::Text(_))) && outbox.next(now).is_none());
        outbox.push_text("y".repeat(TEXT_BYTES_MAX));
        assert!(matches!(outbox.next(now), Some(Next::Text(_))));
        let mut outbox = self::outbox();
        outbox.push_text("x".repeat(TEXT_BYTES_MAX + 1));
        assert!(matches!(outbox.next(now), Some(Next::Close(close::POLICY))));
    }
}
