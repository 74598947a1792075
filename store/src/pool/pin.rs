//! `Pin` and `PinToken`: a page that stays where it is for as long as somebody holds one of these.
//!
//! Unsafe code stands here because frames are lent out under the proof of a pin.
//!
//! Invariants: 1. there is one `Pin` or `PinToken` for each pin that the word counts, and it cannot be copied; 2. a
//! token works with the pool that made it alone; 3. a pool that is dropped while tokens are out leaks its control
//! block, so that no later pool can stand at its address and be taken for it.
#![allow(unsafe_code)]

use super::page_pool::PagePool;
use super::shared::PoolState;
use std::ops::Deref;
use std::sync::Arc;

/// A pinned page, as bytes of its frame. Unpins on drop.
pub struct Pin<'pool> {
    pool: &'pool PagePool,
    bytes: &'pool [u8],
    page: u32,
}

/// A pin without a lifetime, for tables that live beside the pool. Give it back with [`PagePool::unpin`]: a token that
/// is only dropped leaves its page pinned for ever.
#[derive(Debug)]
#[must_use = "a token that is dropped leaves its page pinned"]
pub struct PinToken {
    page: u32,
    frame: u32,
    pool: usize,
}

impl PinToken {
    /// The pinned page.
    pub fn page(&self) -> u32 {
        self.page
    }
}

impl Pin<'_> {
    /// The pinned page.
    pub fn page(&self) -> u32 {
        self.page
    }
}

impl Deref for Pin<'_> {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        self.bytes
    }
}

impl Drop for Pin<'_> {
    fn drop(&mut self) {
        self.pool.shared.unpin(self.page);
    }
}

impl PagePool {
    /// Pins `page` if it is resident. No lock, no system call, no allocation; counts a hit or a miss.
    ///
    /// # Panics
    /// When there is no such page.
    pub fn pin(&self, page: u32) -> Option<Pin<'_>> {
        self.try_pin(page).map(|token| self.pin_of(token))
    }

    /// Pins `page` if it is resident, as [`PagePool::pin`], with a token instead of a borrow.
    pub fn try_pin(&self, page: u32) -> Option<PinToken> {
        let token = self.pin_uncounted(page);
        match token {
            Some(_) => self.shared.counters.hit(),
            None => self.shared.counters.miss(),
        }
        token
    }

    /// The frame of a pinned page.
    ///
    /// # Panics
    /// When the token is another pool's.
    pub fn bytes<'a>(&'a self, token: &'a PinToken) -> &'a [u8] {
        self.check_token(token);
        // SAFETY: the token is this pool's, so its page is RESIDENT and pinned while the token is borrowed.
        unsafe { self.shared.arena.frame(token.frame) }
    }

    /// Takes a pin back.
    ///
    /// # Panics
    /// When the token is another pool's.
    pub fn unpin(&self, token: PinToken) {
        self.check_token(&token);
        self.shared.unpin(token.page);
    }

    pub(super) fn pin_of(&self, token: PinToken) -> Pin<'_> {
        // SAFETY: the pin that the token stood for is kept until the drop of the `Pin`, which borrows the pool.
        let bytes = unsafe { self.shared.arena.frame(token.frame) };
        Pin { pool: self, bytes, page: token.page }
    }

    pub(super) fn pin_uncounted(&self, page: u32) -> Option<PinToken> {
        let frame = self.shared.words[page as usize].try_pin()?;
        Some(PinToken { page, frame, pool: self.key() })
    }

    fn check_token(&self, token: &PinToken) {
        assert!(token.pool == self.key(), "the token of page {} is another pool's", token.page);
    }

    fn key(&self) -> usize {
        Arc::as_ptr(&self.shared) as usize
    }

    /// Keeps the address of a pool with tokens out from being used again (invariant 3).
    pub(super) fn leak_if_pinned(&self) {
        if self.shared.words.iter().any(|word| word.view().pins > 0) {
            std::mem::forget(Arc::clone(&self.shared));
        }
    }
}

impl PoolState {
    fn unpin(&self, page: u32) {
        if self.words[page as usize].unpin() && self.starved.is_set() {
            self.bell.ring();
        }
    }
}
