//! `FetchedParts`: bytes that were got ahead, for those who read them one after the other.
//!
//! Invariant: what is kept is what the server has from that place on.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Longest part that stays: heads of sections, which are asked for again.
pub(super) const KEPT_BYTES_MAX: usize = 256;

/// FetchedParts of a file, each with its place.
#[derive(Default)]
pub(super) struct FetchedParts(Mutex<Vec<(u64, Vec<u8>)>>);

impl FetchedParts {
    fn lock(&self) -> MutexGuard<'_, Vec<(u64, Vec<u8>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps the bytes from `offset` on.
    pub(super) fn keep(&self, offset: u64, bytes: Vec<u8>) {
        self.lock().push((offset, bytes));
    }

    /// Frees those longer than [`KEPT_BYTES_MAX`].
    pub(super) fn forget(&self) {
        self.lock().retain(|(_, bytes)| bytes.len() <= KEPT_BYTES_MAX);
    }

    /// Frees all of them.
    pub(super) fn forget_all(&self) {
        *self.lock() = Vec::new();
    }

    /// True when one part has all of these bytes.
    pub(super) fn has(&self, offset: u64, bytes: u64) -> bool {
        self.lock().iter().any(|part| within(part, offset, bytes).is_some())
    }

    /// Fills `out` with the bytes from `offset` on, if one part has all of them.
    pub(super) fn copy(&self, out: &mut [u8], offset: u64) -> bool {
        let parts = self.lock();
        let found = parts.iter().find_map(|part| within(part, offset, out.len() as u64));
        found.is_some_and(|bytes| {
            out.copy_from_slice(bytes);
            true
        })
    }
}

/// The bytes of a part from `offset` on, if it has so many there.
fn within((start, part): &(u64, Vec<u8>), offset: u64, bytes: u64) -> Option<&[u8]> {
    let from = usize::try_from(offset.checked_sub(*start)?).ok()?;
    let length = usize::try_from(bytes).ok()?;
    part.get(from..from.checked_add(length)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_gives_what_lies_in_it_and_nothing_else() {
        let parts = FetchedParts::default();
        parts.keep(10, vec![1, 2, 3, 4]);
        let read = |offset, count: usize| {
            let mut out = vec![0; count];
            assert_eq!(parts.has(offset, count as u64), parts.copy(&mut out, offset));
            parts.copy(&mut out, offset).then_some(out)
        };
        assert_eq!(read(10, 4), Some(vec![1, 2, 3, 4]));
        assert_eq!(read(12, 1), Some(vec![3]));
        assert_eq!(read(9, 1), None);
        assert_eq!(read(12, 3), None);
        assert_eq!(read(u64::MAX, 2), None);
        parts.keep(100, vec![7; KEPT_BYTES_MAX + 1]);
        parts.forget();
        assert_eq!((read(100, 1), read(10, 1)), (None, Some(vec![1])), "long ones go");
        parts.forget_all();
        assert_eq!(read(10, 1), None);
    }
}
