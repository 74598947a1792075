//! What a display keeps of light of before: the picture before, and light where it is in the world.
//!
//! Invariant: it is there if there is room for it: leased before it is taken, within what was planned for it.

use super::{Coarse, Display};
use trex_store::{Budget, Lease};

/// Which light of before a display keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeptLight {
    /// That of the picture before.
    pub in_picture: bool,
    /// That of earlier ones, where it is in the world.
    pub in_world: bool,
    /// Most bytes for both.
    pub most_bytes: u64,
}

impl Display {
    /// Bytes that the picture before takes beside one of `resolution`.
    pub fn history_bytes(resolution: [u32; 2]) -> u64 {
        Coarse::history_bytes(resolution)
    }

    /// Keeps the picture before from now on, in a lease of [`Display::history_bytes`], or none.
    pub(crate) fn keep_history(&mut self, lease: Option<Lease>) {
        self.coarse.keep_history(lease.is_some());
        (self.history_lease, self.is_fresh) = (lease, false);
    }

    /// Bytes that light kept in the world takes beside a picture of `resolution`.
    pub fn cache_bytes(resolution: [u32; 2]) -> u64 {
        Coarse::cache_bytes(resolution)
    }

    /// Keeps light where it is in the world from now on, in a lease of [`Display::cache_bytes`], or none.
    pub(crate) fn keep_cache(&mut self, lease: Option<Lease>) {
        self.coarse.keep_cache(lease.is_some());
        self.cache_lease = lease;
    }

    /// Keeps of the light of before what `kept` asks for and `budget` has room for, and no more: what is kept already
    /// stays where it may.
    pub fn keep_light(&mut self, kept: &KeptLight, budget: &Budget) {
        let resolution = self.resolution;
        let (of_picture, of_world) = (Display::history_bytes(resolution), Display::cache_bytes(resolution));
        let (mut left, lease) = (kept.most_bytes, |what, bytes| budget.lease(what, bytes).ok());
        let mut fits = |is_asked: bool, bytes: u64| {
            let fits = is_asked && bytes <= left;
            left -= if fits { bytes } else { 0 };
            fits
        };
        let (has_picture, has_world) = (fits(kept.in_picture, of_picture), fits(kept.in_world, of_world));
        if has_picture != self.history_lease.is_some() {
            let lease = has_picture.then(|| lease("the picture before the one on show", of_picture));
            self.keep_history(lease.flatten());
        }
        if has_world != self.cache_lease.is_some() {
            let lease = has_world.then(|| lease("light kept in the world", of_world));
            self.keep_cache(lease.flatten());
        }
    }

    /// Keeps no light of before.
    pub fn keep_no_light(&mut self) {
        self.keep_history(None);
        self.keep_cache(None);
    }

    /// An event: what is on show is from now on the picture before. False where nothing was shown since the last event:
    /// the picture before stays what it is. Where it is `lit_anew`, nothing is kept in the world.
    pub fn remember(&mut self, lit_anew: bool) -> bool {
        let is_fresh = std::mem::take(&mut self.is_fresh);
        if let Some((_, step)) = self.shown.filter(|_| is_fresh) {
            self.coarse.remember(step, lit_anew);
        }
        if lit_anew {
            self.coarse.forget_cache();
        }
        is_fresh
    }

    /// Something changes that leaves no light of before right.
    pub fn forget(&mut self) {
        self.is_fresh = false;
        self.coarse.forget();
        self.coarse.forget_cache();
    }
}
