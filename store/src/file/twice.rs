//! Reading twice: what looks damaged is read once more before it counts.
//!
//! A bit may turn in the page cache, in a buffer or on the way from the device, and the disk be whole. The second read
//! goes by another way than the first: past what the page cache holds.
//!
//! Invariants: 1. damage is told only of what was read twice; 2. there is no third time; 3. nothing but damage is read
//! again here: failed calls are repeated below (`io`).

use crate::error::{Code, Result};
use crate::io::Origin;

/// What `attempt` gives, which reads `bytes` of `file` at `offset`; where that is damage, what it gives after the page
/// cache has dropped them.
///
/// # Errors
/// Those of the last attempt.
pub(crate) fn twice<T>(
    file: &Origin,
    (offset, bytes): (u64, u64),
    mut attempt: impl FnMut() -> Result<T>,
) -> Result<T> {
    attempt().or_else(|first| {
        if first.code() != Code::Damaged {
            return Err(first);
        }
        file.drop_cached(offset, bytes);
        attempt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    #[test]
    fn damage_is_read_again_once_and_nothing_else() {
        let file = Origin::File(tempfile::tempfile().unwrap());
        let with = |codes: &[Option<Code>]| {
            let mut calls = 0;
            let result = twice(&file, (0, 10), || {
                calls += 1;
                codes[calls - 1].map_or(Ok(()), |code| Err(Error::new(code, "a test")))
            });
            (calls, result.err().map(|error| error.code()))
        };
        assert_eq!(with(&[None]), (1, None));
        assert_eq!(with(&[Some(Code::Damaged), None]), (2, None));
        assert_eq!(with(&[Some(Code::Damaged), Some(Code::Damaged)]), (2, Some(Code::Damaged)));
        assert_eq!(with(&[Some(Code::Damaged), Some(Code::Io)]), (2, Some(Code::Io)));
        assert_eq!(with(&[Some(Code::Io)]), (1, Some(Code::Io)));
    }
}
