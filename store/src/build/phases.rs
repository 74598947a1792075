//! How long the phases of a build take, on the wall and in the processor: a phase that keeps two cores busy takes twice
//! its wall time there.
//!
//! Invariant: processor time is that of the whole process, of the source's threads and of any others, too.

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;
use std::time::Instant;

/// Wall time of each phase, milliseconds. `generate` is the time that partition waited for its source.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PhaseMs {
    /// Waiting for the source, within `scan` and `partition`.
    pub generate: u64,
    /// First pass over a file.
    pub scan: u64,
    /// Snap and sort into cells.
    pub partition: u64,
    /// Clusters, pages, voxel records, emit.
    pub clusters: u64,
    /// Merge of voxel records.
    pub voxels: u64,
    /// fsync, read back, rename.
    pub publish: u64,
    /// All of it.
    pub total: u64,
}

/// Processor time of each phase, milliseconds of one core.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PhaseCpuMs {
    /// First pass over a file.
    pub scan: u64,
    /// Snap and sort into cells, with the work of the source.
    pub partition: u64,
    /// Clusters, pages, voxel records, emit.
    pub clusters: u64,
    /// Merge of voxel records.
    pub voxels: u64,
    /// fsync, read back, rename.
    pub publish: u64,
    /// All of it.
    pub total: u64,
}

/// Both clocks.
pub(super) struct PhaseClock {
    wall: Instant,
    cpu_ms: u64,
}

impl PhaseClock {
    /// From now on.
    pub(super) fn start() -> PhaseClock {
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        PhaseClock { wall: Instant::now(), cpu_ms: cpu.tv_sec as u64 * 1000 + cpu.tv_nsec as u64 / 1_000_000 }
    }

    /// Milliseconds on the wall and in the processor since the start or the last lap.
    pub(super) fn lap(&mut self) -> (u64, u64) {
        let before = std::mem::replace(self, PhaseClock::start());
        (self.wall.duration_since(before.wall).as_millis() as u64, self.cpu_ms - before.cpu_ms)
    }
}
