//! `Window`: how much a frame may hold. A line that is slow gets small ones, or the next event waits behind them.
//!
//! Invariant: it lies between [`LEAST_BYTES`] and what fast acknowledgements have shown that the line bears.

use std::time::Duration;

/// Bytes of a frame that is not small, at first, and at least.
const FIRST_BYTES: f64 = 262_144.0;
const LEAST_BYTES: f64 = 16_384.0;
/// A frame that is acknowledged within the first may be followed by a greater one; after the second, by a smaller.
const FAST: Duration = Duration::from_millis(80);
const SLOW: Duration = Duration::from_millis(250);

/// See the module's description.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    bytes: f64,
    bytes_per_block: f64,
}

impl Default for Window {
    fn default() -> Window {
        Window { bytes: FIRST_BYTES, bytes_per_block: 0.0 }
    }
}

impl Window {
    /// Blocks of the next frame, at most.
    pub(crate) fn blocks(&self) -> usize {
        if self.bytes_per_block > 0.0 {
            (self.bytes / self.bytes_per_block).max(1.0) as usize
        } else {
            usize::MAX
        }
    }

    /// Learns of a frame of so many bytes and blocks that was acknowledged after a `time`.
    pub(crate) fn learn(&mut self, bytes: usize, blocks: usize, time: Duration) {
        if blocks == 0 {
            return;
        }
        let bytes = bytes as f64;
        self.bytes_per_block = bytes / blocks as f64;
        if time < FAST && bytes > 0.5 * self.bytes {
            self.bytes *= 2.0;
        } else if time > SLOW {
            let fitting = bytes * SLOW.as_secs_f64() / time.as_secs_f64();
            self.bytes = fitting.min(self.bytes).max(LEAST_BYTES);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_lines_get_small_frames() {
        let mut window = Window::default();
        assert_eq!(window.blocks(), usize::MAX);
        window.learn(400_000, 3600, Duration::from_millis(1000));
        assert!((800..1000).contains(&window.blocks()), "{}", window.blocks());
        window.learn(4_000_000, 3600, Duration::from_millis(60_000));
        assert!(window.bytes >= LEAST_BYTES);
        for _ in 0..10 {
            window.learn(window.bytes as usize, window.blocks(), Duration::from_millis(1));
        }
        assert!(window.blocks() > 3600);
    }
}
