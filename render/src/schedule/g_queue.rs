//! `GQueue`: the bounded queue between the C-ray workers of a pass and the G-stage. Paper, section 5.1.
//!
//! ```text
//! C-rays of a tile -> push -> ... a batch of samples waits, or nothing else is to be done -> take -> G-stage
//! ```
//!
//! Invariants: 1. no worker begins a tile while a batch waits that it may take, and what is pushed back was taken from
//! here, so that at most a batch and a tile a worker are here, and as many again in the hands of each; 2. tiles leave
//! in the order in which they came; 3. a worker without room for more tiles that wait for pages takes its own alone.

use super::job::Job;
use crate::g_stage::GNeeds;
use crate::integrate::RAYS_ASKED_MAX;
use std::collections::VecDeque;
use std::sync::Mutex;

/// Samples whose rays make a batch, if each asks for all that a path may.
pub(super) fn batch_samples(needs: &GNeeds) -> usize {
    needs.batch_rays.div_ceil(RAYS_ASKED_MAX)
}

/// Tiles whose G-rays wait.
#[derive(Default)]
pub(super) struct GQueue {
    waiting: Mutex<JobBacklog>,
}

#[derive(Default)]
struct JobBacklog {
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

    /// Count of tiles that worker `home` began.
    pub(super) fn tiles_of(&self, home: usize) -> usize {
        self.lock().jobs.iter().filter(|job| job.home == home).count()
    }

    /// Takes the first tiles, of worker `home` alone where that is given: a batch of so many samples, and where there
    /// are fewer an equal share for each of `workers`, but at least one tile if there is any.
    pub(super) fn take(&self, samples: usize, workers: usize, home: Option<usize>) -> Vec<Job> {
        let mut waiting = self.lock();
        let most = if waiting.samples >= samples { samples } else { waiting.samples.div_ceil(workers) };
        let (mut taken, mut count, mut at) = (Vec::new(), 0, 0);
        while count < most && at < waiting.jobs.len() {
            if home.is_some_and(|home| waiting.jobs[at].home != home) {
                at += 1;
                continue;
            }
            let job = waiting.jobs.remove(at).expect("it is there");
            count += job.samples.pending.len();
            taken.push(job);
        }
        waiting.samples -= count;
        taken
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, JobBacklog> {
        self.waiting.lock().expect("a worker panicked")
    }
}
