//! `Clock`: what a round takes.

use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// Wall time, and processor time of all threads of this process.
pub(super) struct Clock(Instant, Duration);

impl Clock {
    /// Starts now.
    pub(super) fn start() -> Clock {
        Clock(Instant::now(), Clock::process_time())
    }

    /// Both since then.
    pub(super) fn spent(&self) -> (Duration, Duration) {
        (self.0.elapsed(), Clock::process_time() - self.1)
    }

    fn process_time() -> Duration {
        let now = clock_gettime(ClockId::ProcessCPUTime);
        Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
    }
}
