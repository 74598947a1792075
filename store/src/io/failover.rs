//! `Failover`: reads through a ring, and through `pread` for the rest of the run once the ring has failed.
//!
//! ```text
//! submit -> ring ----(enter fails)----> left for good
//!             | reads the kernel never took, or does not give back -> pread
//!             '- reads in the kernel's hands -> waited for, as they are
//! submit ----------------------------------------------------------> pread
//! ```
//!
//! Invariants: 1. a read is in the ring or in `pread`, never in both; 2. the number of reads in flight, and so of
//! buffers, is the same before and after; 3. the description says what happened, from the next completion on.

use super::pread::pread;
use super::uring::GLANCE;
use super::{Backend, IoDescription, RawCompletion, RawRead, ReadThreads, Source, Uring, Wait};

/// A ring with `pread` behind it.
pub struct Failover {
    pub(super) ring: Uring,
    pread: Option<ReadThreads>,
    source: Source,
    depth: usize,
    pread_threads: usize,
    /// Reads on their way from the ring to `pread`. Empty between calls.
    moved: Vec<RawRead>,
}

impl Failover {
    /// Reads through `ring`, whose file is `source`; with up to so many threads, should it fail.
    pub(super) fn new(ring: Uring, source: Source, pread_threads: usize) -> Failover {
        let depth = ring.depth();
        Failover { ring, pread: None, source, depth, pread_threads, moved: Vec::with_capacity(depth) }
    }

    /// Starts `pread` if the ring has failed since, and gives it what the ring gives back.
    fn move_on(&mut self) {
        let Some(error) = self.ring.failure() else { return };
        let pread = self.pread.get_or_insert_with(|| {
            let notice = format!("io_uring failed while it read ({error}); reads continue through pread");
            let reason = format!("the ring failed; before that, {}", self.ring.describe().reason);
            let mut pread = pread(self.source.clone(), self.depth, self.pread_threads, reason);
            pread.description.notice = Some(notice);
            pread
        });
        self.ring.take_back(&mut self.moved);
        self.moved.drain(..).for_each(|read| pread.submit(read));
    }
}

impl Backend for Failover {
    fn describe(&self) -> &IoDescription {
        self.pread.as_ref().map_or(self.ring.describe(), ReadThreads::describe)
    }

    fn align_bytes(&self) -> usize {
        self.source.align_bytes()
    }

    fn depth(&self) -> usize {
        self.depth
    }

    fn in_flight(&self) -> usize {
        self.ring.in_flight() + self.pread.as_ref().map_or(0, ReadThreads::in_flight)
    }

    fn submit(&mut self, read: RawRead) {
        match &mut self.pread {
            None => self.ring.submit(read),
            Some(pread) => pread.submit(read),
        }
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>) {
        let before = done.len();
        loop {
            self.ring.complete(wait, done);
            self.move_on();
            let Some(pread) = &mut self.pread else { return };
            // Only one of the two can be slept for.
            let may_sleep = self.ring.in_flight() == 0 && done.len() == before;
            pread.complete(if may_sleep { wait } else { Wait::No }, done);
            if wait == Wait::No || done.len() > before || self.in_flight() == 0 {
                return;
            }
            std::thread::sleep(GLANCE);
        }
    }
}
