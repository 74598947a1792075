//! What buffered reads leave in the page cache, and how it is dropped: a memory limit is not to be filled with it.

use super::ALIGN_BYTES;
use std::fs::File;

/// Drops what a buffered read left in the page cache: whole cache pages around the bytes read.
pub(crate) fn drop_cached(file: &File, offset: u64, bytes: u64) {
    let align = ALIGN_BYTES as u64;
    let start = offset / align * align;
    let length = offset.saturating_add(bytes).next_multiple_of(align) - start;
    let length = std::num::NonZeroU64::new(length);
    let _ = rustix::fs::fadvise(file, start, length, rustix::fs::Advice::DontNeed);
}
