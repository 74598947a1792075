//! `Feed`: compressed bytes in order, a window at a time; and why they cannot be decoded.
//!
//! Invariant: no byte behind the end is given.

use super::super::bytes::ByteSource;
use crate::budget::{Budget, Lease};
use crate::error::{Error, Result};

/// Bytes of the window: a block of vertices takes 13 KiB at most.
pub(super) const FEED_BYTES: usize = 16 << 10;

/// Why a view cannot be decoded.
#[derive(Debug)]
pub(crate) enum Undecodable {
    /// Its bytes are wrong.
    Wrong(&'static str),
    /// They cannot be had.
    Unread(Error),
}

impl Undecodable {
    /// The error, with the name of the view by `named`.
    pub(crate) fn named(self, named: impl FnOnce(&'static str) -> Error) -> Error {
        match self {
            Undecodable::Wrong(why) => named(why),
            Undecodable::Unread(error) => error,
        }
    }
}

/// What a step of a decoder gives.
pub(super) type DecodeResult<T> = Result<T, Undecodable>;

/// Compressed bytes from an offset to another.
pub(crate) struct Feed {
    source: ByteSource,
    /// What follows the window.
    at: u64,
    end: u64,
    window: Vec<u8>,
    start: usize,
    _lease: Lease,
}

impl Feed {
    /// The bytes `at..end` of a source.
    pub(crate) fn new(source: ByteSource, at: u64, end: u64, budget: &Budget) -> Result<Feed> {
        let lease = budget.lease("a window of a compressed view", FEED_BYTES as u64)?;
        Ok(Feed { source, at, end, window: Vec::with_capacity(FEED_BYTES), start: 0, _lease: lease })
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> u64 {
        self.end - self.at + (self.window.len() - self.start) as u64
    }

    /// The next bytes: `want` of them, or all that are left.
    pub(super) fn peek(&mut self, want: usize) -> DecodeResult<&[u8]> {
        debug_assert!(want <= FEED_BYTES);
        if self.window.len() - self.start < want && self.at < self.end {
            self.window.drain(..self.start);
            self.start = 0;
            let held = self.window.len();
            let more = ((FEED_BYTES - held) as u64).min(self.end - self.at) as usize;
            self.window.resize(held + more, 0);
            self.source.read(self.at, &mut self.window[held..]).map_err(Undecodable::Unread)?;
            self.at += more as u64;
        }
        Ok(&self.window[self.start..])
    }

    /// Steps over bytes that `peek` gave.
    pub(super) fn consume(&mut self, count: usize) {
        assert!(count <= self.window.len() - self.start);
        self.start += count;
    }

    /// The next byte.
    #[inline]
    pub(super) fn byte(&mut self) -> DecodeResult<u8> {
        if self.start == self.window.len() {
            self.peek(1)?;
        }
        let byte = *self.window.get(self.start).ok_or(Undecodable::Wrong("it ends early"))?;
        self.start += 1;
        Ok(byte)
    }

    /// The first byte, which stays; before any other is asked for.
    pub(super) fn first(&mut self) -> DecodeResult<u8> {
        let mut byte = [0];
        if self.left() == 0 {
            return Err(Undecodable::Wrong("it ends early"));
        }
        self.source.read(self.at, &mut byte).map_err(Undecodable::Unread)?;
        Ok(byte[0])
    }

    /// The last `count` bytes before the end, which are then outside of the feed.
    pub(super) fn take_tail(&mut self, count: usize) -> DecodeResult<Vec<u8>> {
        if self.left() < count as u64 {
            return Err(Undecodable::Wrong("it ends early"));
        }
        debug_assert!(self.window.is_empty(), "a tail is taken first");
        let mut tail = vec![0; count];
        self.end -= count as u64;
        self.source.read(self.end, &mut tail).map_err(Undecodable::Unread)?;
        Ok(tail)
    }

    /// A number in groups of seven bits, the lowest first, in five bytes at most.
    pub(super) fn vbyte(&mut self) -> DecodeResult<u32> {
        let mut number = 0;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.byte()?;
            number |= u32::from(byte & 127) << shift;
            if byte < 128 {
                break;
            }
        }
        Ok(number)
    }
}

/// The signed number that an unsigned one stands for: 0, -1, 1, -2, ...
pub(super) fn unzigzag(number: u32) -> u32 {
    (number >> 1) ^ (number & 1).wrapping_neg()
}
