//! `Memory`: a backend over bytes in memory, for tests and for files that were never written.
//!
//! Invariant: reads complete in the order of their submission, with what a file of these bytes would give.

use super::{Backend, IoDescription, RawCompletion, RawRead, Wait, check_read};
use std::collections::VecDeque;
use std::sync::Arc;

/// Reads from a shared slice.
pub struct Memory {
    bytes: Arc<[u8]>,
    depth: usize,
    align_bytes: usize,
    queue: VecDeque<RawRead>,
    description: IoDescription,
}

impl Memory {
    /// A backend over `bytes`. `align_bytes` is 1, or [`ALIGN_BYTES`](super::ALIGN_BYTES) to act like direct reads.
    pub fn new(bytes: Arc<[u8]>, depth: usize, align_bytes: usize) -> Memory {
        let description = IoDescription::new("memory", false, "the file is in memory".into());
        Memory { bytes, depth, align_bytes, queue: VecDeque::with_capacity(depth), description }
    }
}

impl Backend for Memory {
    fn describe(&self) -> &IoDescription {
        &self.description
    }

    fn align_bytes(&self) -> usize {
        self.align_bytes
    }

    fn depth(&self) -> usize {
        self.depth
    }

    fn in_flight(&self) -> usize {
        self.queue.len()
    }

    fn submit(&mut self, read: RawRead) {
        check_read(&read, self.queue.len(), self.depth, self.align_bytes);
        self.queue.push_back(read);
    }

    fn complete(&mut self, _wait: Wait, done: &mut Vec<RawCompletion>) {
        for mut read in self.queue.drain(..) {
            let start = usize::try_from(read.offset).unwrap_or(usize::MAX).min(self.bytes.len());
            let end = start.saturating_add(read.bytes).min(self.bytes.len());
            read.target()[..end - start].copy_from_slice(&self.bytes[start..end]);
            done.push(RawCompletion { result: Ok(end - start), read });
        }
    }
}
