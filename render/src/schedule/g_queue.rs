//! `GQueue`: the bounded queue between the C-ray workers of a pass and the G-stage. Paper, section 5.1.
//!
//! ```text
//! C-rays of a tile -> push -> ... a batch of samples waits, or nothing else is to be done -> take -> G-stage
//! ```
//!
//! Invariants: 1. a worker pushes a tile only after it has seen that no batch waits, so at most a batch and a tile a
//! worker are here; 2. tiles leave in the order in which they came.

use super::job::Job;
use std::collections::VecDeque;
use std::sync::Mutex;

/// Tiles whose G-rays wait.
#[derive(Default)]
pub(super) struct GQueue {
    waiting: Mutex<Waiting>,
}

#[derive(Default)]
struct Waiting {
    jobs: VecDeque<Job>,
    samples: usize,
    peak: usize,
}

impl GQueue {
    /// Count of tiles that wait.
    pub(super) fn tiles(&self) -> usize {
        self.lock().jobs.len()
    }

    /// Most tiles that have waited at a time.
    pub(super) fn peak(&self) -> usize {
        self.lock().peak
    }

    /// True when so many samples wait, or so many tiles.
    pub(super) fn holds(&self, samples: usize, tiles: usize) -> bool {
        let waiting = self.lock();
        waiting.samples >= samples || waiting.jobs.len() >= tiles
    }

    /// Adds a tile.
    pub(super) fn push(&self, job: Job) {
        let mut waiting = self.lock();
        waiting.samples += job.samples.pending.len();
        waiting.jobs.push_back(job);
        waiting.peak = waiting.peak.max(waiting.jobs.len());
    }

    /// Takes the first tiles, up to so many samples, but at least one if there is any; an equal share for each of
    /// `workers` where there are fewer.
    pub(super) fn take(&self, samples: usize, workers: usize) -> Vec<Job> {
        let mut waiting = self.lock();
        let most = samples.min(waiting.samples.div_ceil(workers));
        let (mut taken, mut count) = (Vec::new(), 0);
        while count < most {
            let Some(job) = waiting.jobs.pop_front() else { break };
            count += job.samples.pending.len();
            taken.push(job);
        }
        waiting.samples -= count;
        taken
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Waiting> {
        self.waiting.lock().expect("a worker panicked")
    }
}
