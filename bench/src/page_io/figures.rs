//! The figures of `io`, as its JSON shows them.

use serde::Serialize;
use std::collections::BTreeMap;

/// Figures of a run.
#[derive(Clone, Debug, Serialize)]
pub struct PageIoFigures {
    /// The model.
    pub scene: String,
    /// Seed of the order.
    pub seed: u64,
    /// Length of the file.
    pub file_bytes: u64,
    /// Pages of a round.
    pub page_count: usize,
    /// Bytes of a page on disk, mean.
    pub bytes_per_page: f64,
    /// Triangles of a page, mean.
    pub triangles_per_page: f64,
    /// Threads that decode.
    pub thread_count: usize,
    /// Measured rounds.
    pub round_count: usize,
    /// Every way: key is `uring`, `uring_cached`, `pread`, `mmap` (raw), `hashed`, `traceable`, `ready`,
    /// `waited`, `waited_busy`, `fio`, `mapped`, `mapped_random` or `mapped_populate`, and the depth.
    pub ways: BTreeMap<String, WayFigures>,
}

/// How far pages come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ReadStage {
    /// Their bytes are there.
    Raw,
    /// And their hash is right.
    Hashed,
    /// And they stand in frames of a pool, their clusters packed.
    Traceable,
    /// And all of their clusters are unpacked, by as many threads as decode.
    Ready,
    /// One after the other: each is waited for.
    Waited,
    /// The same while others are asked for ahead, more than the pool queues.
    WaitedBusy,
}

/// Figures of a way.
#[derive(Clone, Debug, Serialize)]
pub struct WayFigures {
    /// `uring`, `pread`, `mmap`, `fio`, or a mapping.
    pub backend: String,
    /// Past the page cache.
    pub direct: bool,
    /// How far pages come.
    pub stage: ReadStage,
    /// Reads in flight, at most.
    pub depth: usize,
    /// Pages per second of wall time, median.
    pub pages_per_s: f64,
    /// Bytes on disk per second.
    pub bytes_per_s: f64,
    /// Triangles per second.
    pub triangles_per_s: f64,
    /// Processor time of a page, microseconds, all threads together, median.
    pub cpu_us_per_page: f64,
    /// From the request to the answer, microseconds, all rounds; `None` where it was not measured.
    pub latency_us: Option<LatencyFigures>,
    /// Pages per second over fio's at the same depth, median of the rounds' own ratios.
    pub of_fio: Option<f64>,
}

/// Percentiles.
#[derive(Clone, Copy, Debug, Serialize)]
#[allow(missing_docs)] // Named as fio does.
pub struct LatencyFigures {
    pub p50: u64,
    pub p99: u64,
    pub p999: u64,
    pub max: u64,
}
