//! `Pace`: how fast a check reads, and how far it is.
//!
//! Invariants: 1. what was read never runs ahead of the rate by more than the last piece; 2. a wait is cut into parts
//! of [`PART`], between which the caller is asked whether to continue.

use crate::error::Result;
use std::num::NonZeroU64;
use std::time::{Duration, Instant};

/// Longest sleep before the caller is asked.
const PART: Duration = Duration::from_millis(100);

/// A check's clock.
pub(super) struct Pace<'a> {
    report: &'a dyn Fn(u64, u64) -> Result<()>,
    bytes_per_s: Option<NonZeroU64>,
    begin: Instant,
    done: u64,
    /// Read more than once.
    again: u64,
    /// Bytes to come in all.
    pub(super) total: u64,
}

impl<'a> Pace<'a> {
    pub(super) fn new(
        report: &'a dyn Fn(u64, u64) -> Result<()>,
        bytes_per_s: Option<NonZeroU64>,
    ) -> Pace<'a> {
        Pace { report, bytes_per_s, begin: Instant::now(), done: 0, again: 0, total: 0 }
    }

    /// So many bytes were read: waits until they may have been.
    pub(super) fn read(&mut self, bytes: u64) -> Result<()> {
        self.done += bytes;
        self.wait()
    }

    /// So many bytes were read that had been read before.
    pub(super) fn read_again(&mut self, bytes: u64) -> Result<()> {
        self.again += bytes;
        self.wait()
    }

    fn wait(&self) -> Result<()> {
        let Some(rate) = self.bytes_per_s else { return Ok(()) };
        let due = Duration::try_from_secs_f64((self.done + self.again) as f64 / rate.get() as f64);
        let due = due.unwrap_or(Duration::MAX);
        while let Some(left) = due.checked_sub(self.begin.elapsed()).filter(|left| !left.is_zero()) {
            self.report_progress()?;
            std::thread::sleep(left.min(PART));
        }
        Ok(())
    }

    /// Says how far it is.
    pub(super) fn report_progress(&self) -> Result<()> {
        (self.report)(self.done.min(self.total), self.total)
    }

    /// All was read.
    pub(super) fn finish(&self) -> Result<()> {
        (self.report)(self.total, self.total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::{Code, Error};
    use std::cell::Cell;

    #[test]
    fn reading_waits_for_its_rate() {
        let report = |_, _| Ok(());
        let mut pace = Pace::new(&report, NonZeroU64::new(10_000));
        let begin = Instant::now();
        for _ in 0..10 {
            pace.read(200).unwrap();
            pace.read_again(100).unwrap();
        }
        assert!(begin.elapsed() >= Duration::from_millis(300), "{:?}", begin.elapsed());
        let mut free = Pace::new(&report, None);
        free.read(u64::MAX / 2).unwrap();
        assert!(begin.elapsed() < Duration::from_secs(20));
    }

    #[test]
    fn a_wait_ends_when_the_caller_says_so() {
        let asked = Cell::new(0);
        let report = |_, _| {
            asked.set(asked.get() + 1);
            if asked.get() < 3 { Ok(()) } else { Err(Error::interrupted()) }
        };
        let mut pace = Pace::new(&report, NonZeroU64::new(1));
        assert_eq!(pace.read(1 << 60).unwrap_err().code(), Code::Interrupted);
        assert_eq!(asked.get(), 3);
    }
}
