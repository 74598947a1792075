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
use super::stats::count;
use crate::cluster::{Frame, SharedFrame, Unpack};
use std::ops::Deref;
use std::sync::Arc;

/// A pinned page, as bytes of its frame. Unpins on drop.
pub struct Pin<'pool> {
    pool: &'pool PagePool,
    token: PinToken,
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
        self.token.page
    }

    /// Its frame.
    pub fn frame(&self) -> Frame<'_> {
        self.pool.frame(&self.token)
    }
}

impl Deref for Pin<'_> {
    type Target = [u8];

    /// The bytes of its frame.
    ///
    /// # Panics
    /// For a page that is unpacked on demand: see [`Pin::frame`].
    fn deref(&self) -> &[u8] {
        self.pool.bytes(&self.token)
    }
}

impl Drop for Pin<'_> {
    fn drop(&mut self) {
        self.pool.shared.unpin(self.token.page);
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

    /// The bytes of the frame of a pinned page.
    ///
    /// # Panics
    /// When the token is another pool's, and for a page that is unpacked on demand: see [`PagePool::frame`].
    pub fn bytes<'a>(&'a self, token: &'a PinToken) -> &'a [u8] {
        self.check_token(token);
        assert!(!self.shared.store.is_unpacked_later(token.page), "page {} may be written", token.page);
        // SAFETY: the token is this pool's, so its page is RESIDENT and pinned while the token is borrowed.
        unsafe { self.shared.arena.frame(token.frame) }
    }

    /// The frame of a pinned page, of a pool over a page file. Clusters are unpacked into it when they are asked for:
    /// while more pages are pinned than [`PagePool::frames`] says, there may be no room for one, which is lost then.
    ///
    /// # Panics
    /// When the token is another pool's, or frames have not the bytes of those of page files.
    #[inline]
    pub fn frame<'a>(&'a self, token: &'a PinToken) -> Frame<'a> {
        self.check_token(token);
        // SAFETY: the token is this pool's, so its page is RESIDENT and pinned while the token is borrowed.
        let memory = unsafe { self.shared.arena.shared(token.frame) };
        Frame::of_page(memory, token.page, &*self.shared)
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
        Pin { pool: self, token }
    }

    /// Pins `page` if it is resident, for who looks ahead: no hit and no miss is counted, and a page that was read
    /// ahead is still one that nobody has asked for.
    pub fn try_pin_ahead(&self, page: u32) -> Option<PinToken> {
        let before = self.shared.words[page as usize].try_pin(true)?;
        Some(PinToken { page, frame: before.frame, pool: self.key() })
    }

    pub(super) fn pin_uncounted(&self, page: u32) -> Option<PinToken> {
        let before = self.shared.words[page as usize].try_pin(false)?;
        if before.ahead {
            count(&self.shared.counters.ahead_used);
        }
        Some(PinToken { page, frame: before.frame, pool: self.key() })
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

impl Unpack for PoolState {
    fn is_unpacked_later(&self, page: u32) -> bool {
        self.store.is_unpacked_later(page)
    }

    fn unpack(&self, page: u32, frame: SharedFrame<'_>, cluster: usize) {
        let grow = |head_bytes| self.grow(page, head_bytes);
        if let Err(error) = self.store.unpack(page, frame, cluster, &grow) {
            self.keep_damage(page, error);
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
