//! `Budget`: the ledger of the memory limit. Memory is counted here before it is taken.
//!
//! Invariants: 1. the sum of live leases never exceeds the ledger (`limit - RESERVE_BYTES`); 2. a lease gives
//! its bytes back when dropped; 3. `peak_bytes` only grows; 4. what is exchanged is never anybody else's in between.

use crate::error::{Code, Error, Result};
use crate::next_step::{NextStep, Setting};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that the process takes outside of the ledger: text, stacks, allocator slack.
pub const RESERVE_BYTES: u64 = 24 << 20;

/// A memory limit and what is left of it. Clones share one ledger.
#[derive(Clone, Debug)]
pub struct Budget(Arc<Ledger>);

#[derive(Debug)]
struct Ledger {
    limit_bytes: AtomicU64,
    used_bytes: AtomicU64,
    peak_bytes: AtomicU64,
}

/// Bytes taken from a [`Budget`]; given back on drop.
#[derive(Debug)]
pub struct Lease {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    /// A ledger for a process that may take `limit_bytes` in all.
    pub fn new(limit_bytes: u64) -> Budget {
        Budget(Arc::new(Ledger {
            limit_bytes: AtomicU64::new(limit_bytes),
            used_bytes: AtomicU64::new(0),
            peak_bytes: AtomicU64::new(0),
        }))
    }

    /// A ledger that never says no, for tests and for tools without a limit.
    pub fn unlimited() -> Budget {
        Budget::new(u64::MAX)
    }

    /// The limit of the whole process.
    pub fn limit_bytes(&self) -> u64 {
        self.0.limit_bytes.load(Ordering::Relaxed)
    }

    /// Changes the limit. Live leases stay; new ones are refused until enough has been given back.
    pub fn set_limit(&self, limit_bytes: u64) {
        self.0.limit_bytes.store(limit_bytes, Ordering::Relaxed);
    }

    /// Bytes that the ledger may lease in all.
    pub fn ledger_bytes(&self) -> u64 {
        self.limit_bytes().saturating_sub(RESERVE_BYTES)
    }

    /// Leased now.
    pub fn used_bytes(&self) -> u64 {
        self.0.used_bytes.load(Ordering::Relaxed)
    }

    /// Most that was ever leased at once.
    pub fn peak_bytes(&self) -> u64 {
        self.0.peak_bytes.load(Ordering::Relaxed)
    }

    /// Still to be leased.
    pub fn free_bytes(&self) -> u64 {
        self.ledger_bytes().saturating_sub(self.used_bytes())
    }

    /// Takes `bytes` for `what` (a noun for the message).
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the limit that would have been enough for this lease.
    pub fn lease(&self, what: &str, bytes: u64) -> Result<Lease> {
        let mut used = self.used_bytes();
        loop {
            let wanted = used.saturating_add(bytes);
            if wanted > self.ledger_bytes() {
                let smallest = wanted.saturating_add(RESERVE_BYTES);
                return Err(Error::new(
                    Code::MemoryLimit,
                    format!("the memory limit has no room for {what}"),
                )
                .at_setting(Setting::MemoryLimit)
                .numbers(format!(
                    "{bytes} bytes asked, {} free of {} ({} reserved for the process)",
                    self.free_bytes(),
                    self.limit_bytes(),
                    RESERVE_BYTES
                ))
                .next(NextStep::RaiseLimit { bytes: smallest })
                .smallest_limit(smallest));
            }
            match self.0.used_bytes.compare_exchange_weak(used, wanted, Ordering::Relaxed, Ordering::Relaxed)
            {
                Ok(_) => {
                    self.0.peak_bytes.fetch_max(wanted, Ordering::Relaxed);
                    return Ok(Lease { budget: self.clone(), bytes });
                }
                Err(now) => used = now,
            }
        }
    }

    /// Takes `bytes` for `what` in the place of `old` leases, which hold nothing afterwards. Their memory has to go
    /// before that of `what` is taken, so the lease holds at least what they held: [`Lease::split`] what is needed off
    /// it, and drop the rest.
    ///
    /// # Errors
    /// Those of [`Budget::lease`], for what is asked beyond the old ones; these are unchanged then.
    ///
    /// # Panics
    /// When an old lease is of another ledger.
    pub fn exchange(&self, what: &str, bytes: u64, old: &mut [&mut Lease]) -> Result<Lease> {
        let held: u64 = old.iter().map(|lease| lease.bytes).sum();
        let mut room = self.lease(what, bytes.saturating_sub(held))?;
        old.iter_mut().for_each(|lease| room.absorb(lease.split(lease.bytes)));
        Ok(room)
    }
}

impl Lease {
    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes `bytes` more into this lease.
    ///
    /// # Errors
    /// Those of [`Budget::lease`]; the lease is unchanged then.
    pub fn grow(&mut self, what: &str, bytes: u64) -> Result<()> {
        self.absorb(self.budget.lease(what, bytes)?);
        Ok(())
    }

    /// Holds the bytes of `other`, too.
    ///
    /// # Panics
    /// For a lease of another ledger.
    pub(crate) fn absorb(&mut self, mut other: Lease) {
        assert!(Arc::ptr_eq(&self.budget.0, &other.budget.0), "leases of two ledgers");
        self.bytes += std::mem::take(&mut other.bytes);
    }

    /// Makes `bytes` of those held a lease of their own.
    ///
    /// # Panics
    /// When fewer are held.
    pub fn split(&mut self, bytes: u64) -> Lease {
        self.bytes = self.bytes.checked_sub(bytes).expect("no more is split off than is held");
        Lease { budget: self.budget.clone(), bytes }
    }

    /// Gives back all but `bytes`. Does nothing when fewer are held.
    pub fn shrink_to(&mut self, bytes: u64) {
        let back = self.bytes.saturating_sub(bytes);
        self.bytes -= back;
        self.budget.0.used_bytes.fetch_sub(back, Ordering::Relaxed);
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leases_add_up_and_come_back() {
        let budget = Budget::new(RESERVE_BYTES + 100);
        let first = budget.lease("a", 60).unwrap();
        let refused = budget.lease("b", 41).unwrap_err();
        assert_eq!(refused.code(), Code::MemoryLimit);
        assert_eq!(refused.smallest_limit_bytes(), Some(RESERVE_BYTES + 101));
        let mut second = budget.lease("b", 40).unwrap();
        assert_eq!(budget.free_bytes(), 0);
        drop(first);
        second.grow("b", 10).unwrap();
        second.shrink_to(5);
        assert_eq!(budget.used_bytes(), 5);
        drop(second);
        assert_eq!((budget.used_bytes(), budget.peak_bytes()), (0, 100));
    }

    /// What goes makes room for what comes, and is never free for others in between.
    #[test]
    fn old_leases_are_exchanged_in_one_step_or_not_at_all() {
        let budget = Budget::new(RESERVE_BYTES + 100);
        let (mut film, mut map) = (budget.lease("a", 50).unwrap(), budget.lease("b", 30).unwrap());
        let refused = budget.exchange("c", 101, &mut [&mut film, &mut map]).unwrap_err();
        assert_eq!(refused.smallest_limit_bytes(), Some(RESERVE_BYTES + 101));
        assert_eq!((film.bytes(), map.bytes(), budget.used_bytes()), (50, 30, 80));
        let larger = budget.exchange("c", 100, &mut [&mut film, &mut map]).unwrap();
        assert_eq!((film.bytes(), map.bytes(), larger.bytes(), budget.free_bytes()), (0, 0, 100, 0));
        let mut film = larger;
        let mut smaller = budget.exchange("d", 20, &mut [&mut film]).unwrap();
        // The old memory may still be there.
        assert_eq!((smaller.bytes(), budget.free_bytes()), (100, 0));
        let needed = smaller.split(20);
        drop(smaller);
        assert_eq!((needed.bytes(), budget.used_bytes(), budget.peak_bytes()), (20, 20, 100));
    }

    #[test]
    #[should_panic(expected = "no more is split off than is held")]
    fn no_more_is_split_off_than_is_held() {
        let _ = Budget::unlimited().lease("a", 5).unwrap().split(6);
    }
}
