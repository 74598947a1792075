//! `Seats`: the workers that share one pool. Each has a number of its own, by which it asks for pages, and an equal
//! share of the frames to pin.
//!
//! Invariants: 1. no two seats that are held have one number; 2. a seat is free again when its [`Seat`] is dropped.

use super::want::ORIGINS_MAX;
use crate::error::{Code, Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

// A bit a seat.
const _: () = assert!(ORIGINS_MAX == u64::BITS as usize);

/// The workers of one pool.
#[derive(Debug, Default)]
pub struct Seats(AtomicU64);

/// A worker's place at a pool.
#[derive(Debug)]
pub struct Seat {
    seats: Arc<Seats>,
    number: usize,
}

impl Seats {
    /// Assigns a free seat.
    ///
    /// # Errors
    /// [`Code::Usage`] when [`ORIGINS_MAX`] workers share the pool already.
    pub fn assign(self: &Arc<Seats>) -> Result<Seat> {
        let free = |taken: u64| (taken != u64::MAX).then(|| taken | (taken + 1));
        match self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, free) {
            Ok(taken) => Ok(Seat { seats: self.clone(), number: taken.trailing_ones() as usize }),
            Err(_) => Err(Error::new(Code::Usage, "too many workers share one pool of pages")
                .at_place("the workers of a model")
                .numbers(format!("{ORIGINS_MAX} at most"))
                .next("use fewer threads, or end a session first")),
        }
    }

    /// Seats that are held.
    fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed).count_ones() as usize
    }
}

impl Seat {
    /// The worker's number, below [`ORIGINS_MAX`]: the origin of its want-list.
    pub fn number(&self) -> usize {
        self.number
    }

    /// Workers that share the frames, this one included.
    pub fn workers(&self) -> usize {
        self.seats.count()
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.seats.0.fetch_and(!(1 << self.number), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_distinct_and_come_back() {
        let seats = Arc::new(Seats::default());
        let mut held: Vec<Seat> = (0..ORIGINS_MAX).map(|_| seats.assign().unwrap()).collect();
        let numbers: Vec<usize> = held.iter().map(Seat::number).collect();
        assert_eq!(numbers, (0..ORIGINS_MAX).collect::<Vec<_>>());
        assert_eq!(seats.assign().unwrap_err().code(), Code::Usage);
        held.remove(5);
        assert_eq!(held[0].workers(), ORIGINS_MAX - 1);
        assert_eq!(seats.assign().unwrap().number(), 5);
    }
}
