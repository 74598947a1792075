//! `Times`: durations of one kind, and their percentiles.
//!
//! Invariant: kept in microseconds, to three digits, up to a minute; longer ones count as a minute.

use hdrhistogram::Histogram;
use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};
use std::time::Duration;

/// Longest duration that is told from others.
const LONGEST_US: u64 = 60_000_000;

/// Durations of one kind.
#[derive(Clone, Debug)]
pub struct Times(Histogram<u64>);

impl Default for Times {
    fn default() -> Times {
        Times(Histogram::new_with_bounds(1, LONGEST_US, 3).expect("the bounds are in order"))
    }
}

impl Times {
    /// Adds one.
    pub fn add(&mut self, time: Duration) {
        self.0.saturating_record((time.as_micros() as u64).max(1));
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// The `percentile`-th, ms; 0 without any.
    pub fn percentile(&self, percentile: f64) -> f64 {
        self.0.value_at_percentile(percentile) as f64 / 1e3
    }

    /// Mean, ms; 0 without any.
    pub fn mean(&self) -> f64 {
        self.0.mean() / 1e3
    }

    /// The longest, ms; 0 without any.
    pub fn max(&self) -> f64 {
        self.0.max() as f64 / 1e3
    }
}

impl Serialize for Times {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Times", 5)?;
        fields.serialize_field("count", &self.count())?;
        fields.serialize_field("mean", &self.mean())?;
        fields.serialize_field("p50", &self.percentile(50.0))?;
        fields.serialize_field("p99", &self.percentile(99.0))?;
        fields.serialize_field("max", &self.max())?;
        fields.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_sorted_list() {
        let mut times = Times::default();
        for ms in (1..=100).rev() {
            times.add(Duration::from_millis(ms));
        }
        for (percentile, expected) in [(50.0, 50.0), (99.0, 99.0), (100.0, 100.0)] {
            assert!((times.percentile(percentile) - expected).abs() < 0.1);
        }
        assert!((times.mean() - 50.5).abs() < 0.1 && times.count() == 100);
        times.add(Duration::from_secs(3600));
        assert!((times.max() - 60_000.0).abs() < 60.0);
    }
}
