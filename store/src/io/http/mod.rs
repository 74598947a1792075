//! `HttpFile`: what a server has at an address, in ranges.
//!
//! ```text
//! open       the last 64 KiB: length, version (ETag or date), the superblock
//! tables     ranges side by side, each a piece of at most 512 KiB
//! pages      a range each, from threads that stay connected (`ReadThreads`)
//! ```
//!
//! Invariants
//! 1. All bytes are of one version: each request names that of the first answer (RFC 9110, section 13), and an answer
//!    of another version or length is an error.
//! 2. Nothing is taken but the range that was asked for: a longer, shorter or other one is an error.
//! 3. Each request ends: connecting, waiting and reading have bounds, and so has the count of tries.
//! 4. No password is sent: an address that holds one is refused, and what is told of a place is its address.

mod parts;
mod request;

use super::read_threads::{ReadThreads, ThreadsSetup};
use super::{IoDescription, IoOptions};
use crate::error::{Code, Error, Result};
use parts::{FetchedParts, KEPT_BYTES_MAX};
use request::{Client, Version};
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::thread;

/// Bytes of the end that opening asks for: the superblock, and what stands before it.
const TAIL_BYTES: u64 = 64 << 10;
/// Bytes that are got at a time where a file is read from its beginning to its end.
pub(super) const RUN_BYTES: u64 = 4 << 20;
/// Longest range of one request: several pieces come side by side.
const PIECE_BYTES: usize = 512 << 10;
/// Most requests under way at a time, and connections that are kept.
const CONNECTIONS: usize = 32;
/// Stack of a thread that asks: it shakes hands by TLS, too.
const STACK_BYTES: usize = 512 << 10;
/// Times that a request is made: what fails by the network may be well the next time.
const TRIES: u32 = 3;

/// A file behind HTTP.
pub struct HttpFile {
    client: Client,
    version: Version,
    parts: FetchedParts,
}

impl HttpFile {
    /// Bytes that all connections take: buffers of TLS and of messages, and what is touched of stacks; and what is got
    /// ahead of those who read from the beginning to the end.
    pub(super) const CONNECTIONS_BYTES: u64 = CONNECTIONS as u64 * (160 << 10) + TAIL_BYTES + RUN_BYTES;

    /// Asks the server for the end of it.
    ///
    /// # Errors
    /// [`Code::Usage`] for an address with a password; [`Code::InputUnreadable`] where nothing is there, or no ranges
    /// are given; [`Code::Io`].
    pub(super) fn open(path: &Path) -> Result<HttpFile> {
        let url = path.to_str().ok_or_else(|| {
            Error::new(Code::Usage, "this address is no text")
                .at(path)
                .next("write it in letters that the web knows")
        })?;
        let host = url.split("//").nth(1).and_then(|rest| rest.split(['/', '?', '#']).next());
        if host.is_none_or(|host| host.is_empty() || host.contains('@')) {
            return Err(Error::new(Code::Usage, "this address cannot be used")
                .at_place(url.split('@').next_back().unwrap_or_default())
                .next("write https://HOST/PATH: no name and no password stand in it"));
        }
        let failed = |error: io::Error| Error::io("open", path, &error);
        let client = Client::new(url, CONNECTIONS);
        let (version, tail) = again(|| client.tail(TAIL_BYTES)).map_err(failed)?;
        let parts = FetchedParts::default();
        parts.keep(version.length - tail.len() as u64, tail);
        Ok(HttpFile { client, version, parts })
    }

    /// Length, bytes.
    pub(super) fn length(&self) -> u64 {
        self.version.length
    }

    /// See [`super::Origin::read_exact_at`].
    pub(super) fn read_exact_at(&self, out: &mut [u8], offset: u64) -> io::Result<()> {
        if offset.checked_add(out.len() as u64).is_none_or(|end| end > self.version.length) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if self.parts.copy(out, offset) {
            return Ok(());
        }
        let pieces = out.chunks_mut(PIECE_BYTES).enumerate();
        side_by_side(pieces.collect(), |(index, piece)| {
            let from = offset + (index * PIECE_BYTES) as u64;
            again(|| self.client.range(&self.version, from, piece))
        })
    }

    /// True where so many bytes from `offset` on were got ahead.
    pub(super) fn has(&self, offset: u64, bytes: u64) -> bool {
        self.parts.has(offset, bytes)
    }

    /// See [`super::Origin::fetch_parts`].
    pub(super) fn fetch_parts(&self, parts: &[(u64, u64)]) {
        let wanted = |&(offset, bytes): &(u64, u64)| {
            let end = offset.checked_add(bytes).filter(|&end| end <= self.version.length)?;
            // Heads stay when longer parts go, so they are parts of their own.
            let is_head = bytes <= KEPT_BYTES_MAX as u64;
            (bytes > 0 && (is_head || !self.parts.has(offset, bytes))).then_some(offset..end)
        };
        let wanted: Vec<Range<u64>> = parts.iter().filter_map(wanted).collect();
        let _ = side_by_side(wanted, |part: Range<u64>| {
            let mut bytes = vec![0; (part.end - part.start) as usize];
            self.read_exact_at(&mut bytes, part.start)?;
            self.parts.keep(part.start, bytes);
            Ok(())
        });
    }

    /// See [`super::Origin::forget_parts`].
    pub(super) fn forget_parts(&self) {
        self.parts.forget();
    }

    /// What was got ahead is asked for again.
    pub(super) fn forget_all(&self) {
        self.parts.forget_all();
    }

    /// The backend: a range a read. [`super::Reader`] reads again what fails.
    pub(super) fn threads(self: &Arc<HttpFile>, options: &IoOptions) -> ReadThreads {
        let file = Arc::clone(self);
        let reason = "the file is behind an address of the web".to_owned();
        ReadThreads::new(ThreadsSetup {
            description: IoDescription::new("http", false, reason),
            align_bytes: 1,
            depth: options.depth,
            threads: CONNECTIONS,
            stack_bytes: STACK_BYTES,
            read: Box::new(move |read| {
                let (offset, bytes) = (read.offset, read.bytes);
                let left = file.version.length.saturating_sub(offset).min(bytes as u64) as usize;
                if left == 0 {
                    return Ok(0);
                }
                let tried = file.client.range(&file.version, offset, &mut read.target()[..left]);
                tried.map(|()| left).inspect_err(|_| pause(0))
            }),
        })
    }
}

/// Does `work` for each item, some at a time; the first error, if there is one.
fn side_by_side<T: Send>(items: Vec<T>, work: impl Fn(T) -> io::Result<()> + Sync) -> io::Result<()> {
    let count = items.len().min(CONNECTIONS);
    let queue = std::sync::Mutex::new((items.into_iter(), Ok(())));
    let serve = || {
        loop {
            let next = {
                let mut queue = queue.lock().expect("a reading thread panicked");
                if queue.1.is_err() { None } else { queue.0.next() }
            };
            let Some(item) = next else { return };
            if let Err(error) = work(item) {
                queue.lock().expect("a reading thread panicked").1 = Err(error);
                return;
            }
        }
    };
    thread::scope(|scope| {
        for index in 1..count {
            let thread = thread::Builder::new().name(format!("trex-http-part-{index}"));
            // As many as the system gives: this one is there.
            if thread.stack_size(STACK_BYTES).spawn_scoped(scope, serve).is_err() {
                break;
            }
        }
        serve();
    });
    queue.into_inner().expect("a reading thread panicked").1
}

/// What `request` gives, made again where it failed in a way that may be well the next time.
fn again<T>(mut request: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let mut tries = 0;
    loop {
        match request() {
            Err(error) if tries + 1 < TRIES && !request::is_final(&error) => pause(tries),
            outcome => return outcome,
        }
        tries += 1;
    }
}

/// Waits before a request is made again: .1 s, .4 s, more or less, so that many do not come back together.
fn pause(tries: u32) {
    let spread = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |now| u64::from(now.subsec_nanos()) % 100);
    thread::sleep(std::time::Duration::from_millis((100 << (2 * tries)) * (50 + spread) / 100));
}
