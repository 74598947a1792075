//! `Pass`: all tiles of a picture taken to so many samples, by workers, while pages come and go.
//!
//! ```text
//! per worker:  next tile in order -> C-rays of all its samples -> hit points: queue of the G-stage
//!              a batch in the queue -> G-stage -> each tile on -> done: add to the film
//!                                                              -> more C-rays (mirrors), queue again
//!              blocked: request pages, park the tile, next tile
//!              no more tiles, or no room for more parked: the parked ones again, the oldest first
//!              a round without one answer: wait; some of these: narrow
//! narrow:      one sample of the oldest tile, alone: ask one ray, request, wait, ask again, until it is done
//! ```
//!
//! A pass may be run in pieces (`Until`): by a deadline, or until some tiles are done. Then tiles that find no room
//! among the parked ones are deferred to the end of the pass (`WhenFull`), so that what can be drawn is drawn first.
//!
//! Why it ends, however few frames there are: see [`crate::trace::Retry`]. A deadline interrupts the narrow mode, and
//! the next piece goes on with it.
//!
//! Invariants: 1. the film's bytes depend on the world and the sample count alone, not on threads, tile order,
//! deadlines, batches or blocked rays; 2. no worker begins a tile while a batch that it may take waits for the G-stage,
//! nor, but to defer it, while as many of its own wait for pages as it has room for; 3. a tile's samples reach the film
//! all together or not at all, so a stopped pass leaves a film that can go on.

use super::g_queue::{GQueue, batch_samples};
use super::job::{JOB_SAMPLES_MAX, Job};
use super::worker::{Canvas, Lane, Piece, TileWork, Until, WhenFull, Worker, parked_bytes};
use crate::g_stage::GNeeds;
use crate::integrate::{RayNeeds, Together};
use crate::stats::PassStats;
use crate::trace::PagedTracer;
use rayon::ThreadPool;
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use trex_film::Tiles;

/// The workers of a pass: a tracer each, and the threads that they run on.
pub(crate) struct Workers<'a, T> {
    pub(crate) tracers: &'a mut [T],
    pub(crate) pool: &'a ThreadPool,
}

/// A pass in work: takes every tile to so many samples a pixel, by at most [`super::PASS_SAMPLES_MAX`].
pub(crate) struct Pass {
    target: u32,
    full: WhenFull,
    /// The next tile's turn.
    turn: AtomicU32,
    /// Tiles that were blocked and found no room, to be begun again.
    deferred: Mutex<VecDeque<u32>>,
    /// Tiles whose G-rays wait.
    queue: GQueue,
    lanes: Vec<Lane>,
}

impl Pass {
    /// A pass to `target` samples a pixel, for so many workers.
    pub(crate) fn new(target: u32, worker_count: usize, full: WhenFull) -> Pass {
        let lanes = (0..worker_count).map(|_| Lane::default()).collect();
        Pass {
            target,
            full,
            turn: AtomicU32::new(0),
            deferred: Mutex::default(),
            queue: GQueue::default(),
            lanes,
        }
    }

    /// True when every tile has had its turn, and none waits.
    pub(crate) fn is_done(&self, tiles: &Tiles) -> bool {
        self.left(tiles) == 0
    }

    /// Changes what becomes of blocked tiles that find no room.
    pub(crate) fn set_full(&mut self, full: WhenFull) {
        self.full = full;
    }

    fn left(&self, tiles: &Tiles) -> u64 {
        let begun = self.turn.load(Ordering::Relaxed).min(tiles.count());
        let waiting: usize = self.lanes.iter().map(|lane| lane.parked.len()).sum();
        let deferred = self.deferred.lock().expect("a worker panicked").len();
        u64::from(tiles.count() - begun) + (waiting + deferred + self.queue.tiles()) as u64
    }

    /// Goes on until the pass or the piece is over. A worker a tracer, on a thread of `pool` each.
    ///
    /// # Panics
    /// When there are not as many tracers as workers, or a worker panics.
    pub(crate) fn run<T: PagedTracer + Send>(
        &mut self,
        work: &TileWork<'_>,
        canvas: Canvas<'_>,
        workers: Workers<'_, T>,
        until: &Until<'_>,
    ) -> PassStats {
        let Workers { tracers, pool } = workers;
        assert_eq!(tracers.len(), self.lanes.len(), "a pass needs a tracer per worker");
        let Pass { target, full, turn, deferred, queue, lanes } = self;
        let piece = Piece {
            work,
            canvas: Mutex::new(canvas),
            target: *target,
            full: *full,
            until,
            turn,
            deferred,
            queue,
            workers: tracers.len(),
            finished: AtomicU32::new(0),
        };
        let done = Mutex::new(PassStats::default());
        pool.scope(|scope| {
            for (number, (tracer, lane)) in tracers.iter_mut().zip(lanes).enumerate() {
                let (piece, done) = (&piece, &done);
                scope.spawn(move |_| {
                    let mut worker = Worker::new(piece, number, tracer, lane);
                    worker.work();
                    done.lock().expect("a worker panicked").add(&worker.stats());
                });
            }
        });
        let mut stats = done.into_inner().expect("a worker panicked");
        stats.tiles_left = self.left(work.tiles);
        stats.g_stage.queue_peak = self.queue.peak() as u64;
        stats
    }
}

/// Bytes that a pass takes for `worker_count` workers and the tile order, films not counted; samples ask for so many
/// rays at a time, of a stage with these needs; pages are near, or come from afar.
pub(crate) fn pass_bytes(
    resolution: [u32; 2],
    (worker_count, is_far): (usize, bool),
    rays_asked: RayNeeds,
    needs: &GNeeds,
) -> u64 {
    let batch = batch_samples(needs);
    // A batch, and a tile that it is over by: in the queue, where each worker may add one; in each worker's hands, and
    // as many more as it has calls under way.
    let in_queue = batch + worker_count * JOB_SAMPLES_MAX;
    let in_hands = needs.calls * worker_count * (batch + JOB_SAMPLES_MAX);
    let sample_bytes = Job::bytes() as usize / JOB_SAMPLES_MAX;
    // Once a worker parks the batches that others began, beside those in its hands; while a tile takes its answers, it
    // asks again.
    let parked = in_hands * sample_bytes;
    let again = worker_count * rays_asked.times(JOB_SAMPLES_MAX).bytes();
    let asking = (in_queue + in_hands) * (sample_bytes + rays_asked.bytes())
        + parked
        + again
        + in_hands * rays_asked.voxel * needs.ray_bytes;
    let at_worker = parked_bytes(is_far) + Job::bytes() + Together::bytes(JOB_SAMPLES_MAX);
    // The order, and the deferred tiles.
    2 * Tiles::bytes(resolution) + worker_count as u64 * at_worker + asking as u64
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
