//! `ListMemory`: the memory of lists that nobody knows the length of before the input has been read: cells, their runs,
//! the pieces of chunks. A mesh whose triangles come in no order has as many runs as buffers are emptied, times cells.
//!
//! Invariant: what is taken is leased.

use crate::budget::{Budget, Lease};
use crate::error::Result;

/// What they are called in messages.
const LISTS: &str = "the lists of cells and runs";
/// Bytes that are leased at a time.
const STEP_BYTES: u64 = 128 << 10;

/// See the module's description.
pub(crate) struct ListMemory {
    lease: Lease,
    taken_bytes: u64,
}

impl ListMemory {
    /// Of nothing yet.
    pub(crate) fn begin(budget: &Budget) -> Result<ListMemory> {
        Ok(ListMemory { lease: budget.lease(LISTS, 0)?, taken_bytes: 0 })
    }

    /// Takes so many bytes more.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`](crate::Code::MemoryLimit); nothing is taken then.
    pub(super) fn take(&mut self, bytes: u64) -> Result<()> {
        let lacking = (self.taken_bytes + bytes).saturating_sub(self.lease.bytes());
        if lacking > 0 {
            self.lease.grow(LISTS, lacking.max(STEP_BYTES))?;
        }
        self.taken_bytes += bytes;
        Ok(())
    }

    /// So many of the bytes are free for other lists.
    pub(super) fn give_back(&mut self, bytes: u64) {
        self.taken_bytes -= bytes;
    }

    /// The lease of what is taken.
    pub(crate) fn into_lease(mut self) -> Lease {
        self.lease.shrink_to(self.taken_bytes);
        self.lease
    }
}
