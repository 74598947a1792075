//! What a run took: the `memory` object of every JSON document.
//!
//! Invariant: `peak_rss_bytes` is the kernel's count (VmHWM), not ours; the promise is that it stays at or below
//! `limit_bytes`.
//!
//! glibc keeps freed memory per thread ("arenas"), which VmHWM counts. Tuning that from inside the process needs
//! `mallopt`, an unsafe call, so nothing is done here: large buffers are mapped and returned as they are, and the
//! ledger's reserve covers the rest. `MALLOC_ARENA_MAX=1` in the environment narrows it further.

use crate::host::kib_field;
use serde::Serialize;
use std::fs;
use trex_store::Budget;

/// The limit, what the ledger leased at most, and what the kernel counted at most.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Memory {
    /// `--memory-limit`, resolved.
    pub limit_bytes: u64,
    /// Most that was leased from the ledger at once.
    pub ledger_peak_bytes: u64,
    /// Peak resident set of the process; `None` (JSON `null`) where the system does not tell.
    pub peak_rss_bytes: Option<u64>,
}

impl Memory {
    /// The figures up to now.
    pub fn new(budget: &Budget) -> Memory {
        let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
        Memory {
            limit_bytes: budget.limit_bytes(),
            ledger_peak_bytes: budget.peak_bytes(),
            peak_rss_bytes: kib_field(&status, "VmHWM:"),
        }
    }
}

/// Bytes that the process holds now; `None` where the system does not tell.
pub fn resident_bytes() -> Option<u64> {
    kib_field(&fs::read_to_string("/proc/self/status").unwrap_or_default(), "VmRSS:")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn the_kernel_counts_this_process() {
        let memory = Memory::new(&Budget::new(1 << 30));
        assert_eq!((memory.limit_bytes, memory.ledger_peak_bytes), (1 << 30, 0));
        assert!(memory.peak_rss_bytes.unwrap() > 100 << 10);
    }
}
