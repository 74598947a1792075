//! Pins that are waited for, for simple callers, and for those who have nothing else to do; and memory for pages that
//! are pinned.
//!
//! Invariant: a blocking call ends: with a page, with the page's error, with the pool's, or after [`STALL_MAX`] in
//! which nothing came.

use super::frame_room::BLOCK_BYTES;
use super::loader::DAMAGE_MAX;
use super::page_pool::PagePool;
use super::pin::Pin;
use super::shared::PoolState;
use super::signal::lock;
use super::word::PageState;
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use std::time::{Duration, Instant};

/// Pages that [`PagePool::fetch_blocking`] asks for ahead of the one it waits for.
const FETCH_WINDOW: usize = 32;

/// After so long without any arrival a blocking call gives up: all frames are pinned, or the device hangs.
const STALL_MAX: Duration = Duration::from_secs(60);

impl PagePool {
    /// Pins `page`, and reads it first when it must.
    ///
    /// # Errors
    /// The error of a damaged page; [`Code::MemoryLimit`] when nothing has arrived for a minute, since all frames are
    /// pinned; [`Code::Bug`] when a thread of the pool has panicked.
    pub fn pin_blocking(&self, page: u32) -> Result<Pin<'_>> {
        let (mut epoch, mut since) = (self.epoch(), Instant::now());
        loop {
            if let Some(token) = self.pin_uncounted(page) {
                return Ok(self.pin_of(token));
            }
            if self.is_damaged(page) {
                return Err(self.damage_of(page));
            }
            if let Some(error) = self.failure() {
                return Err(error);
            }
            self.hold(page);
            let now = self.shared.progress.wait(epoch, Duration::from_millis(20));
            if now != epoch {
                (epoch, since) = (now, Instant::now());
            } else if since.elapsed() > STALL_MAX {
                return Err(self.stalled(page));
            }
        }
    }

    /// Sees to it that each of `pages` has been in a frame once, in this order, and so was checked. They need not fit
    /// at once.
    ///
    /// # Errors
    /// The first error of [`PagePool::pin_blocking`], after all pages were tried.
    pub fn fetch_blocking(&self, pages: &[u32]) -> Result<()> {
        self.visit_blocking(pages, &mut |_| {})
    }

    /// [`PagePool::fetch_blocking`], and hands each page to `visit` when it is there.
    ///
    /// # Errors
    /// The first error of [`PagePool::pin_blocking`], after all pages were tried.
    pub fn visit_blocking(&self, pages: &[u32], visit: &mut dyn FnMut(Pin<'_>)) -> Result<()> {
        let frames = lock(&self.shared.clock).live();
        let window = FETCH_WINDOW.min(frames / 2).max(1);
        let mut first_error = Ok(());
        for (index, &page) in pages.iter().enumerate() {
            // One step ahead for each step done, the whole window at the start.
            let ahead =
                if index == 0 { 0..window.min(pages.len()) } else { index + window - 1..index + window };
            for &page in pages.get(ahead).unwrap_or_default() {
                self.hold(page);
            }
            first_error = first_error.and(self.pin_blocking(page).map(&mut *visit));
        }
        first_error
    }

    fn hold(&self, page: u32) {
        if self.state(page) == PageState::Absent || self.state(page) == PageState::Queued {
            lock(&self.shared.requests).hold(page, &self.shared.words);
            self.shared.bell.ring();
        }
    }

    fn damage_of(&self, page: u32) -> Error {
        let damage = lock(&self.shared.damage);
        let known = damage.iter().find(|(damaged, _)| *damaged == page);
        known.map(|(_, error)| error.clone()).unwrap_or_else(|| {
            Error::new(Code::Damaged, "a page is damaged")
                .at_place(format!("page {page}"))
                .numbers(format!(
                    "more than {DAMAGE_MAX} pages are damaged, and the errors of so many are kept"
                ))
                .next(NextStep::Verify)
        })
    }

    fn stalled(&self, page: u32) -> Error {
        Error::new(Code::MemoryLimit, "no page has arrived for a minute")
            .at_place(format!("page {page}"))
            .numbers(format!("{:?}, saturated: {}", self.frames(), self.is_saturated()))
            .next(NextStep::RaiseLimitOrCheckDevice)
    }
}

impl PoolState {
    /// Takes memory for so many bytes at the begin of the frame of a pinned page, which may wait for pages that are
    /// being read. False when there is none for so long that there will be none.
    pub(super) fn grow(&self, page: u32, head_bytes: usize) -> bool {
        let (frame, head) = (self.words[page as usize].view().frame, head_bytes.div_ceil(BLOCK_BYTES) as u32);
        let (mut epoch, begin) = (self.progress.epoch(), Instant::now());
        while !lock(&self.clock).grow(frame, head, &self.words, &self.arena) {
            if begin.elapsed() > STALL_MAX || self.failure.get().is_some() {
                return false;
            }
            epoch = self.progress.wait(epoch, Duration::from_millis(1));
        }
        true
    }
}
