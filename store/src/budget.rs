//! `Budget`: the ledger of the memory limit. Memory is counted here before it is taken.
//!
//! Invariants: 1. the sum of live leases never exceeds the ledger (`limit - RESERVE_BYTES`); 2. a lease gives
//! its bytes back when dropped; 3. `peak_bytes` only grows.

use crate::error::{Code, Error, Result};
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
                .at_place("--memory-limit")
                .numbers(format!(
                    "{bytes} bytes asked, {} free of {} ({} reserved for the process)",
                    self.free_bytes(),
                    self.limit_bytes(),
                    RESERVE_BYTES
                ))
                .next(format!("raise the limit to at least {}MiB", smallest.div_ceil(1 << 20)))
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
        let mut more = self.budget.lease(what, bytes)?;
        self.bytes += std::mem::take(&mut more.bytes);
        Ok(())
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
}
