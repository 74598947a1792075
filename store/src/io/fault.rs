//! `Fault`: wraps a backend and lets reads go wrong, by a seed. For tests.
//!
//! Invariant: what goes wrong depends on the seed, the read's offset and how often that offset was read, never on time;
//! a read of a `broken` range fails every time.

use super::{Backend, IoDescription, RawCompletion, RawRead, Wait};
use std::collections::HashMap;
use std::ops::Range;
use std::time::Duration;

/// Faults that a [`Fault`] makes, and how often. Rates count in 1024 reads.
#[derive(Clone, Debug, Default)]
pub struct FaultPlan {
    /// Chooses the reads.
    pub seed: u64,
    /// Reads that fail with EIO.
    pub error_per_1024: u32,
    /// Reads that are interrupted (EINTR).
    pub interrupt_per_1024: u32,
    /// Reads that come back short.
    pub short_per_1024: u32,
    /// Reads in which one bit is wrong.
    pub flip_per_1024: u32,
    /// Reads that come later than others that were asked for after them.
    pub late_per_1024: u32,
    /// Every call of `complete` that waits takes this much longer.
    pub delay: Duration,
    /// A part of the file that cannot be read at all.
    pub broken: Option<Range<u64>>,
    /// Reads by their number, the first that completes is 0, that fail with this errno.
    pub failing: Option<(Range<u64>, i32)>,
    /// The backend itself panics at the first read that completes after so many.
    pub panic_after: Option<u64>,
}

/// A backend with faults.
pub struct Fault {
    inner: Box<dyn Backend>,
    plan: FaultPlan,
    seen: HashMap<u64, u64>,
    /// Reads that are held back.
    late: Vec<RawCompletion>,
    /// Reads that completed.
    completed: u64,
    description: IoDescription,
}

impl Fault {
    /// Wraps `inner`.
    pub fn new(inner: Box<dyn Backend>, plan: FaultPlan) -> Fault {
        let mut description = inner.describe().clone();
        description.backend = format!("fault+{}", description.backend);
        Fault { inner, plan, seen: HashMap::new(), late: Vec::new(), completed: 0, description }
    }

    /// Holds back some of what came, and gives what was held back before in another order; where that is waited for and
    /// nothing else comes, at once.
    fn hold_back(&mut self, first: usize, wait: Wait, done: &mut Vec<RawCompletion>) {
        let mut dice = Dice(self.plan.seed ^ mix(self.completed));
        let mut all: Vec<RawCompletion> = self.late.drain(..).chain(done.drain(first..)).collect();
        while !all.is_empty() {
            let one = all.swap_remove(dice.below(all.len() as u64) as usize);
            if dice.hits(self.plan.late_per_1024) { self.late.push(one) } else { done.push(one) }
        }
        if wait == Wait::One && done.len() == first {
            done.append(&mut self.late);
        }
    }

    fn disturb(&mut self, done: &mut RawCompletion) {
        let read = &mut done.read;
        let Ok(got) = done.result else { return };
        if let Some((numbers, errno)) = &self.plan.failing
            && numbers.contains(&(self.completed - 1))
        {
            done.result = Err(std::io::Error::from_raw_os_error(*errno));
            return;
        }
        if self
            .plan
            .broken
            .as_ref()
            .is_some_and(|broken| broken.start < read.offset + read.bytes as u64 && read.offset < broken.end)
        {
            done.result = Err(rustix::io::Errno::IO.into());
            return;
        }
        let times = self.seen.entry(read.offset).or_default();
        *times += 1;
        let mut dice = Dice(self.plan.seed ^ mix(read.offset) ^ mix(!*times));
        if dice.hits(self.plan.error_per_1024) {
            done.result = Err(rustix::io::Errno::IO.into());
        } else if dice.hits(self.plan.interrupt_per_1024) {
            done.result = Err(rustix::io::Errno::INTR.into());
        } else if got > 1 && dice.hits(self.plan.short_per_1024) {
            done.result = Ok(1 + dice.below(got as u64 - 1) as usize);
        } else if got > 0 && dice.hits(self.plan.flip_per_1024) {
            let bit = dice.below(got as u64 * 8);
            read.target()[(bit / 8) as usize] ^= 1 << (bit % 8);
        }
    }
}

/// Numbers from a seed (splitmix64).
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.0) % end
    }

    fn hits(&mut self, per_1024: u32) -> bool {
        self.below(1024) < u64::from(per_1024)
    }
}

fn mix(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

impl Backend for Fault {
    fn describe(&self) -> &IoDescription {
        &self.description
    }

    fn align_bytes(&self) -> usize {
        self.inner.align_bytes()
    }

    fn depth(&self) -> usize {
        self.inner.depth()
    }

    fn in_flight(&self) -> usize {
        self.inner.in_flight() + self.late.len()
    }

    fn submit(&mut self, read: RawRead) {
        self.inner.submit(read);
    }

    fn complete(&mut self, wait: Wait, done: &mut Vec<RawCompletion>) {
        if wait == Wait::One && !self.plan.delay.is_zero() {
            std::thread::sleep(self.plan.delay);
        }
        let first = done.len();
        self.inner.complete(wait, done);
        for one in &mut done[first..] {
            self.completed += 1;
            assert!(self.plan.panic_after.is_none_or(|most| self.completed <= most), "a panic on demand");
            self.disturb(one);
        }
        if self.plan.late_per_1024 > 0 {
            self.hold_back(first, wait, done);
        }
    }
}
