//! `HttpFile`: what a server has at an address, in ranges.
//!
//! ```text
//! open       the last 64 KiB: length, version (ETag or date), the superblock
//! tables     ranges side by side, each a piece of at most 512 KiB
//! pages      ranges of one page or of several, from threads that stay connected (`ReadThreads`)
//!            what `RangeCache` has is read from there, where there is one
//! ```
//!
//! Invariants
//! 1. All bytes are of one version: each request names that of the first answer (RFC 9110, section 13), and an answer
//!    of another version or length is an error.
//! 2. Nothing is taken but the range that was asked for: a longer, shorter or other one is an error.
//! 3. Each request ends: connecting, waiting and reading have bounds, and so has the count of tries.
//! 4. No password is told: an address that holds one is refused, and what is told of a place is what the user wrote.
//! 5. What is kept on this machine's disk is asked for only after the server has said which version it has.

mod address;
mod cache;
mod parts;
mod request;

use super::network::network_options;
use super::read_threads::{ReadThreads, ThreadsSetup};
use super::reader::is_final;
use super::{CONNECTION_BYTES, IoDescription, IoOptions, RawRead};
use crate::error::{Error, Result};
use address::Address;
use cache::RangeCache;
use parts::{FetchedParts, KEPT_BYTES_MAX};
use request::{Client, TimeBounds, Version};
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
/// Most requests under way at a time, beside those that [`IoOptions::connections`] adds.
const CONNECTIONS: usize = 32;
/// Most connections that are kept while nothing is asked for.
const IDLE_MAX: usize = 64;
/// Stack of a thread that asks: it shakes hands by TLS, too.
const STACK_BYTES: usize = 512 << 10;
/// Times that a request is made: what fails by the network may be well the next time.
const TRIES: u32 = 3;

/// A file behind HTTP.
pub struct HttpFile {
    client: Client,
    version: Version,
    parts: FetchedParts,
    /// None where nothing is kept, or the server does not tell versions apart.
    cache: Option<RangeCache>,
}

impl HttpFile {
    /// Bytes that its connections take, and what is got ahead of those who read from the beginning to the end.
    pub(super) const CONNECTIONS_BYTES: u64 = CONNECTIONS as u64 * CONNECTION_BYTES + TAIL_BYTES + RUN_BYTES;

    /// Asks the server for the end of it, as the process's [`super::NetworkOptions`] say.
    ///
    /// # Errors
    /// [`Code::Usage`](crate::Code::Usage) for an address with a password, or one that is none;
    /// [`Code::InputUnreadable`](crate::Code::InputUnreadable) where nothing is there, or no ranges are given;
    /// [`Code::Io`](crate::Code::Io).
    pub(super) fn open(path: &Path) -> Result<HttpFile> {
        let options = network_options();
        let address = Address::new(path, &options.s3)?;
        let client = Client::new(address, IDLE_MAX, TimeBounds::USUAL, &options)?;
        let failed = |error: io::Error| Error::io("open", path, &error);
        let (version, tail) = again(|| client.tail(TAIL_BYTES)).map_err(failed)?;
        let parts = FetchedParts::default();
        parts.keep(version.length - tail.len() as u64, tail);
        let cache = options.cache.as_ref().zip(version.text());
        let cache = cache.map(|(cache, version)| RangeCache::new(cache, &client.address().name(), &version));
        Ok(HttpFile { client, version, parts, cache })
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
            if self.is_cached(piece, from) {
                return Ok(());
            }
            again(|| self.client.range(&self.version, from, piece))?;
            self.cache(piece, from);
            Ok(())
        })
    }

    /// True where the cache had all of these bytes; they are in `out` then.
    fn is_cached(&self, out: &mut [u8], offset: u64) -> bool {
        self.cache.as_ref().is_some_and(|cache| cache.read(out, offset))
    }

    /// Keeps what the server gave.
    fn cache(&self, bytes: &[u8], offset: u64) {
        if let Some(cache) = &self.cache {
            cache.keep(bytes, offset);
        }
    }

    /// One read of a page or of several, by one try.
    fn read_once(&self, read: &mut RawRead) -> io::Result<usize> {
        let (offset, bytes) = (read.offset, read.bytes);
        let left = self.version.length.saturating_sub(offset).min(bytes as u64) as usize;
        let tries = read.failures;
        let out = &mut read.target()[..left];
        if left > 0 && !self.is_cached(out, offset) {
            if tries > 0 {
                pause(tries - 1);
            }
            self.client.range(&self.version, offset, out)?;
            self.cache(out, offset);
        }
        Ok(left)
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

    /// What was got ahead is asked for again, and these bytes of what is kept on disk.
    pub(super) fn forget_all(&self, offset: u64, bytes: u64) {
        self.parts.forget_all();
        if let Some(cache) = &self.cache {
            cache.forget(offset, bytes);
        }
    }

    /// The backend: a range a read. [`super::Reader`] reads again what fails.
    pub(super) fn threads(self: &Arc<HttpFile>, options: &IoOptions) -> ReadThreads {
        let reason = match &self.cache {
            None => "the file is behind an address of the web".to_owned(),
            Some(cache) => {
                format!("the file is behind an address of the web, and kept in {}", cache.folder())
            }
        };
        let (file, told) = (Arc::clone(self), Arc::clone(self));
        ReadThreads::new(ThreadsSetup {
            description: IoDescription::new(self.client.address().backend_name(), false, reason),
            align_bytes: 1,
            depth: options.depth + options.connections,
            threads: CONNECTIONS + options.connections,
            stack_bytes: STACK_BYTES,
            read: Box::new(move |read| file.read_once(read)),
            notice: Box::new(move || told.cache.as_ref().and_then(RangeCache::trouble)),
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
            Err(error) if tries + 1 < TRIES && !is_final(&error) => pause(tries),
            outcome => return outcome,
        }
        tries += 1;
    }
}

/// Waits before a request is made again: .25 s, 1 s, more or less, so that many do not come back together.
fn pause(tries: u32) {
    let spread = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |now| u64::from(now.subsec_nanos()) % 100);
    thread::sleep(std::time::Duration::from_millis((250 << (2 * tries)) * (50 + spread) / 100));
}
